"""The main job from end to end."""

from pathlib import Path

import numpy as np

from . import bridge, diagnose
from .diagnose.platforms.ddr import Teller
from .diagnose.report.html import picture
from .experiments import ablate, control, learn, windup
from .logs import replay
from .plumbing import pages
from .plumbing.results import console, output_folder, write_bytes


def gap(out):
    """Diagnoses a drive of a robot whose wheels lag, and which begins to slip half-way; a second one, slipping throughout, checks it.

    The robot is our own simulator's, so this shows the tool and proves nothing: `make blind` does.
    """
    folder, dt, rows = output_folder(Path(out) / "diagnose"), 0.05, 2000
    random = np.random.default_rng(7)
    for name, onset in (("drive", 50.0), ("fresh", 0.0)):
        robot = [bridge.Effect("actuator_lag", (0.25,)), bridge.usual_effect("pacejka_slip", onset)]
        u = np.repeat(random.uniform((-0.3, -1.0), (2.0, 1.0), (rows // 40, 2)), 40, axis=0)
        x = bridge.simulate(u[:-1], dt, active=robot, integrator=bridge.ARC)
        bridge.write_log(folder / f"{name}.csv", x + random.normal(0, 0.005, x.shape), u, dt)
    console.print("\nSim-to-real gap: a drive of a robot that lags, and slips from 50 s on (make diagnose LOG=..)")
    return diagnose.run(folder / "drive.csv", folder, folder / "fresh.csv")


def run(out, log=None, update=False):
    """Learning, control, ablations, precision study and gap diagnosis of the DDR; then a replay of the log, if one is given.

    update: the pictures of the README and of docs/learning.md are made again, too.
    """
    learn.run(out)
    control.run(out)
    ablate.run(out)
    windup.run(out)
    result = gap(out)
    if update:
        pages.picture(Path(out) / "learn_adaptation.png")
        pages.picture(Path(out) / "windup_lanes.png")
        write_bytes(pages.ROOT / "docs/gap.svg", picture(Teller(result).story()))
    if log:
        replay.run_log(log, out)
    console.print(f"\nResults and plots are in {out}: start with learn_adaptation.png, learn_error.png and diagnose/report.html")
