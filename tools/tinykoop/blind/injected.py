"""Known effects put into a real flight: its first half is the healthy one, the second half gets the effect and is diagnosed.

What the vehicle would have done cannot be known, but the log can be changed into that of a vehicle which did the same with
the effect: a command that was smaller, earlier or off by a trim, a gyro that reads too much, sensors that are shaken more.

    injected.json    one row for each effect: what was put in, what the report says
"""

import tempfile
from pathlib import Path

import numpy as np
from scipy import signal

from .. import bridge
from ..plumbing.results import number, output_folder, print_table, write_json
from ..plumbing.workers import each, workers
from . import DIAGNOSE, Command

SHAKING = 10.0  # Hz, above which gyro and accelerometer are shaken


def _shaken(log, a):
    high = signal.butter(2, SHAKING, "high", fs=1 / log.dt, output="sos")
    x = log.x.copy()
    x[:, :6] += a * signal.sosfiltfilt(high, log.x[:, :6], axis=0)
    return x, log.u


def _turned(log, *bias):
    return log.x + np.r_[bias, np.zeros(7)], log.u


def _earlier(log, delay):
    return log.x, np.interp(log.t + delay, log.t, log.u[:, 0])[:, None]


CASES = {
    "none": ((), lambda log: (log.x, log.u)),
    "gyro_bias": ((0.0, 0.1, 0.0), _turned),
    "vibration": ((1.0,), _shaken),
    "trim_bias": ((0.05, 0.0), lambda log, pitch, _: (log.x, log.u - pitch)),
    "gain": ((-0.5,), lambda log, a: (log.x, log.u / (1 + a))),
    "delay": ((0.03,), _earlier),
}


def _one(name, data, healthy):
    """(name, report) of one case, both logs given as bytes."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / file for file in ("log.csv", "healthy.csv")]
        for path, content in zip(paths, (data, healthy)):
            path.write_bytes(content)
        return name, Command(_command(paths[1]))(paths[0], None)


def _command(healthy):
    """A log follows: with a space behind it, --healthy would take that log, too."""
    return (*DIAGNOSE, "--platform", "fwmav", f"--healthy={healthy}")


def run(out, path, jobs=None):
    """Writes injected.json into `out` for the flight in `path`; returns its rows."""
    from ..diagnose.platforms.fwmav import load

    out, log = output_folder(out), load(path)
    half = len(log.x) // 2
    with tempfile.TemporaryDirectory() as folder, workers(None, jobs):
        file = Path(folder) / "part.csv"

        def written(x, u, rows):
            bridge.write_log(file, x[rows], u[rows], log.dt, "fwmav")
            return file.read_bytes()

        healthy = written(log.x, log.u, slice(0, half))
        calls = [(name, written(*change(log, *p), slice(half, None)), healthy) for name, (p, change) in CASES.items()]
        reports = dict(each(_one, calls, "effects in a real flight"))
    rows = [_row(name, CASES[name][0], reports[name]) for name in CASES]
    lines = []
    for row in rows:
        size = ", ".join(map(number, row["parameters"])) or "-"
        found = ", ".join(f"{e['name']} {100 * e['confidence']:.0f} %" for e in row["effects"]) or "-"
        lines.append([row["injected"], size, row["verdict"], found, "yes" if row["not_testable"] else ""])
    print_table(
        f"Effects put into the second half of {Path(path).stem}", ["effect", "size", "verdict", "found, how sure", "not testable"], lines
    )
    write_json(out / "injected.json", rows)
    return rows


def _row(name, parameters, report):
    return {
        "injected": name,
        "parameters": list(parameters),
        "verdict": report["verdict"],
        "effects": report["effects"],
        "not_testable": name in report["not_testable"],
        "times_noise": report["unexplained"]["times_noise"],
        "frequencies": report["where"]["frequencies"],
    }
