"""The main job from end to end."""

from pathlib import Path

from . import ablate, control, learn, replay, windup
from .results import console

# Real logs that may lie beside the checkout; they are not part of the project.
REAL_LOGS = ("norlab_drive/warthog_gravel.csv", "flapper/pitch_wind_step_fan500.csv")


def run(out, data, log=None):
    """Learning, control, ablations and precision study of the DDR; then the given log, or the real ones in `data`."""
    learn.run(out)
    control.run(out)
    ablate.run(out)
    windup.run(out)
    logs = [log] if log else [Path(data) / name for name in REAL_LOGS if (Path(data) / name).exists()]
    for path in logs:
        replay.run_log(path, out)
    console.print(f"\nResults and plots are in {out}: start with learn_error.png and windup_lanes.png")
