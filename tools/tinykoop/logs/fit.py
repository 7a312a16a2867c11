"""Offline fit of a log, as bytes that firmware starts from."""

from pathlib import Path

import numpy as np

from ..learner import RLS
from ..plumbing.errors import UserError
from ..plumbing.results import console, output_folder, printable
from . import replay


def run(path, target, dictionary="rbf", precision=32, platform=None, p0=1e4):
    """Fits `path` with lambda = 1 in float64 and writes Theta, in `precision`, to target (.h or .bin).

    dictionary: poly or rbf of the platform, or FILE.py:NAME; a header has C code of one that is made of parts.
    """
    target = Path(target)
    if target.suffix not in (".h", ".bin"):
        raise UserError(f"{target}: the model is written as .h (C header) or .bin; choose one of these endings")
    output_folder(target.parent)
    log, platform = replay.load(path, platform)
    fitted = replay.offline_fit(log, platform, dictionary, p0=p0)
    stored = RLS(replay.given(log, platform, dictionary), log.u.shape[1], regulator="none", precision=f"f{precision}").begin(log.x.shape[1])
    stored.theta = fitted.theta
    comment = f"{dictionary}, {platform}, fitted on {printable(Path(path).name)}{replay.told_states(log)}"
    stored.export(target, comment=comment)
    trace = fitted.replay(log.x, log.u[:-1], usable=log.usable, learn=False, traces=("error",))
    console.print(
        f"{comment}: one-step error {np.nanmean(trace['error']):.3g} on the log itself, {target.stat().st_size} bytes in {target}"
    )
