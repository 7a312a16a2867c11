"""Offline fit of a log, as bytes that firmware starts from."""

from pathlib import Path

import numpy as np

from .. import bridge
from ..plumbing.errors import UserError
from ..plumbing.results import console, output_folder, printable, write_bytes
from . import replay


def header(model, name, comment):
    """C header with the bytes of a stored model."""
    lines = [", ".join(f"0x{byte:02x}" for byte in model[i : i + 16]) for i in range(0, len(model), 16)]
    body = ",\n\t".join(lines)
    return f"/* {comment} */\n#include <stdint.h>\n\nstatic const uint8_t {name}[{len(model)}] = {{\n\t{body},\n}};\n"


def run(path, target, dictionary="rbf", precision=32, platform=None, p0=1e4):
    """Fits `path` with lambda = 1 in float64 and writes Theta, in `precision`, to target (.h or .bin)."""
    target = Path(target)
    if target.suffix not in (".h", ".bin"):
        raise UserError(f"{target}: the model is written as .h (C header) or .bin; choose one of these endings")
    output_folder(target.parent)
    log, platform = replay.load(path, platform)
    fitted = replay.offline_fit(log, platform, dictionary, p0=p0)
    stored = bridge.Estimator(f"{dictionary}_{platform}", "none", precision, n_inputs=log.u.shape[1])
    stored.theta = fitted.theta
    model = stored.model()
    comment = (
        f"TinyKoop model: {dictionary}_{platform}, float{precision}, N = {fitted.N}, m = {fitted.m}, fitted on {printable(Path(path).name)}"
    )
    if target.suffix == ".h":
        write_bytes(target, header(model, "koop_model", comment).encode())
    else:
        write_bytes(target, model)
    trace = fitted.replay(log.x, log.u[:-1], usable=log.usable, learn=False, traces=("error",))
    console.print(f"{comment}: one-step error {np.nanmean(trace['error']):.3g} on the log itself, {len(model)} bytes in {target}")
