"""Bytes and instructions of the library on a microcontroller, before anything is built for it.

Storage is what the headers' macros give. Code and stack are those measured by `make targets`; instructions
are, too, for the two sizes measured there, and follow the count of multiply-adds elsewhere.
"""

import json

from .. import bridge
from ..plumbing import checkout
from ..plumbing.errors import UserError
from ..plumbing.results import print_table

FOOTPRINT = checkout.data("targets/footprint.json", "firmware/footprint.json")
MEASURED = (("N7_m2_H50", 7), ("N22_m2_H50", 22))
STATES, INPUTS, HORIZON = 3, 2, 50  # of the measured controllers
LEVELS = ("O2", "Os")
MODEL_HEADER = 24  # bytes


def _update(lifted, inputs):
    """Multiply-adds of an update, but for a factor."""
    return (lifted + inputs) ** 2


def _condensing(lifted, inputs, horizon):
    return horizon * (inputs + 1) * lifted**2


def _solving(states, inputs, horizon):
    return (states + inputs) * (horizon * inputs) ** 2


def _line(small, large, at):
    """Through two measured points (work, instructions)."""
    (w0, i0), (w1, i1) = small, large
    return i0 + (i1 - i0) * (at - w0) / (w1 - w0)


def instructions(rows, lifted, states, inputs, horizon):
    """{what: instructions} of one target at one optimisation level.

    rows: the two rows of footprint.json. An update grows with (N + m)^2. Of a solve, what differs between the two
    measured sizes grows with H (m + 1) N^2, the rest with (n + m) (H m)^2.
    """
    sizes = [size for _, size in MEASURED]
    counts = [row["instructions"] for row in rows]
    updates = [_update(size, INPUTS) for size in sizes]
    out = {}
    for key, name in (("rls_update", "update, square root"), ("rls_update_plain", "update, plain, diagonal checked")):
        for regulator in ("dz_cs", "sift"):
            points = zip(updates, [c[key][regulator] for c in counts])
            out[f"{name}, {regulator}"] = _line(*points, _update(lifted, inputs))
    shapes = [_condensing(size, INPUTS, HORIZON) for size in sizes]
    for what in ("cold", "warm"):
        points = list(zip(shapes, [c["mpc_solve"][what] for c in counts]))
        rest = _line(*points, 0)
        share = _solving(states, inputs, horizon) / _solving(STATES, INPUTS, HORIZON)
        out[f"MPC, {what}"] = rest * share + _line(*points, _condensing(lifted, inputs, horizon)) - rest
    return out


def _rows(target, level):
    known = json.loads(FOOTPRINT.read_text())
    names = sorted({row["target"] for row in known})
    if target not in names:
        raise UserError(f"there is no target '{target}': choose one of {', '.join(names)}")
    return [next(r for r in known if (r["target"], r["config"]) == (target, f"{c}_{level}")) for c, _ in MEASURED]


def update(target, regulator, lifted, inputs):
    """Instructions of an update in square-root form at -O2, between the measured sizes; None where it was not measured."""
    counts = [(row["instructions"] or {}).get("rls_update", {}).get(regulator) for row in _rows(target, "O2")]
    if None in counts:
        return None
    points = zip([_update(size, INPUTS) for _, size in MEASURED], counts)
    return round(_line(*points, _update(lifted, inputs)))


def _significant(value):
    return f"{float(f'{value:.2g}'):,.0f}"


def run(lifted, states, inputs, horizon, precision, target):
    """Prints the tables."""
    reals, size = bridge.storage(lifted, states, inputs, horizon), precision // 8
    rows = {level: _rows(target, level) for level in LEVELS}
    k = "koopf" if precision == 32 else "koopd"
    pair, quad = f"({lifted}, {inputs})", f"({lifted}, {states}, {inputs}, {horizon})"
    print_table(
        f"N = {lifted}, n = {states}, m = {inputs}, horizon {horizon}, float{precision}: the caller's RAM",
        ["", "bytes", "reals, as an array"],
        [
            ["learner, square root", f"{size * reals['learner_sqrt']:,}", f"KOOP_RLS_REALS_SQRT{pair}"],
            ["learner, plain, at most", f"{size * reals['learner_plain']:,}", f"KOOP_RLS_REALS_PLAIN{pair}"],
            ["gate, square root", f"{size * reals['gate_sqrt']:,}", f"KOOP_GATE_REALS_SQRT{pair}"],
            ["gate, plain, at most", f"{size * reals['gate_plain']:,}", f"KOOP_GATE_REALS_PLAIN{pair}"],
            ["controller, Newton", f"{size * reals['mpc_newton']:,}", f"KOOP_MPC_REALS_NEWTON{quad}"],
            ["controller, gradient", f"{size * reals['mpc_gradient']:,}", f"KOOP_MPC_REALS_GRADIENT{quad}"],
            ["  with a rate penalty", f"+ {size * reals['mpc_rate']:,}", f"KOOP_MPC_REALS_RATE({inputs}, {horizon})"],
            ["supervisor", f"{size * reals['supervisor']:,}", f"KOOP_SUPERVISOR_REALS{quad}"],
            ["offline model, in flash", f"{size * reals['model'] + MODEL_HEADER:,}", ""],
        ],
        f"And {k}_rls, {k}_gate, {k}_mpc, {k}_supervisor: about 100 bytes each.",
    )
    table = []
    large = [rows[level][-1] for level in LEVELS]
    for name, key in (("everything in koopf.c", "text"), ("lift and update only", "text_learn")):
        table.append([f"code, {name}, bytes", *[f"{row[key]:,}" for row in large]])
    for call in ("koopf_rls_update", "koopf_mpc_solve"):
        table.append([f"stack of {call}, bytes", *[f"{row['stack'][call]:,}" for row in large]])
    if all(row["instructions"] for row in large):
        counts = [instructions(rows[level], lifted, states, inputs, horizon) for level in LEVELS]
        for what in counts[0]:
            table.append([f"{what}, instructions, about", *[_significant(c[what]) for c in counts]])
    print_table(f"{target}, float32", ["", *[f"-{level}" for level in LEVELS]], table, "And your dictionary.")
