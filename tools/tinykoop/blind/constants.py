"""The diagnoser's constants: each with its reason, and how many answers change when it is halved and doubled.

The list is read from the code: numbers in capitals at the top of a module, with the comment beside them. The logs are those of the blind
plant, of several tiers and of at most SHORT rows.
"""

import ast
import re
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from sys import modules

import numpy as np

from .. import diagnose as diagnoser
from ..plumbing import pages
from ..plumbing.errors import UserError
from ..plumbing.results import busy, output_folder, print_table, write_json
from ..plumbing.workers import each, workers
from . import SHORT, plant, tiers

PARTS = ("prediction_errors", "platforms.ddr")
TIERS_USED = ("single", "single_other", "pair", "none_slip", "slipping", "lags")
N, SEED = 2, 7
FACTORS = (0.5, 2.0)
HEADERS = ["constant", "value", "reason", "changed at half", "changed at double", "right at half", "right as it is", "right at double"]


def listed():
    """[(module, name, value, reason)] of all numbers in capitals."""
    out = []
    for part in PARTS:
        package = import_module(f"{diagnoser.__name__}.{part}")
        names = [found.name for found in iter_modules(package.__path__) if not found.name.startswith("told")]
        for name in names:
            out += _of_module(import_module(f"{package.__name__}.{name}"))
    return out


def _of_module(module):
    lines = Path(module.__file__).read_text().splitlines()
    out = []
    for node in ast.parse("\n".join(lines)).body:
        if isinstance(node, ast.Assign) and not any(isinstance(part, ast.Call) for part in ast.walk(node.value)):
            target = node.targets[0]
            names = [part.id for part in getattr(target, "elts", [target]) if isinstance(part, ast.Name)]
            names = [name for name in names if name.isupper() and _is_number(getattr(module, name))]
            out += [(module.__name__, name, getattr(module, name), why) for name, why in zip(names, _reasons(lines, node, len(names)))]
    return out


def _is_number(value):
    return not isinstance(value, bool) and np.asarray(value).dtype.kind in "if" and np.size(value) > 0 and np.all(np.isfinite(value))


def _reasons(lines, node, count):
    """What the comment beside an assignment says of each of its names."""
    found = re.search(r"#\s*(.*)$", lines[node.lineno - 1])
    said = found[1] if found else ""
    return said.split("; ") if said.count("; ") == count - 1 else [said] * count


def _scaled(value, factor):
    if isinstance(value, tuple):
        return tuple(_scaled(part, factor) for part in value)
    return max(round(value * factor), 1) if isinstance(value, int) else value * factor


def _set(module, name, value):
    """Gives a constant another value wherever it was imported to."""
    old = getattr(import_module(module), name)
    for other in [m for key, m in modules.items() if key.startswith(diagnoser.__name__) and getattr(m, name, None) is old]:
        if other.__name__ == module or not _assigns(other, name):
            setattr(other, name, value)


def _assigns(module, name):
    """Whether a module has a constant of this name by itself."""
    return bool(re.search(rf"^(?:[A-Z_]+, )*{name}(?:, [A-Z_]+)* = ", Path(module.__file__).read_text(), re.M))


def _answers(logs, module=None, name=None, value=None):
    """((module, name, value), [(verdict, families)]) of logs, with another value of a constant."""
    listed()  # every module is there before one is changed
    if module:
        old = getattr(import_module(module), name)
        _set(module, name, value)
    try:
        return (module, name, value), [_answer(*log) for log in logs]
    finally:
        if module:
            _set(module, name, old)


def _answer(x, u, dt):
    from .. import bridge
    from ..diagnose.platforms.ddr import diagnose

    usable = np.isfinite(x[1:]).all(1) & np.isfinite(x[:-1]).all(1)
    try:
        report = diagnose(bridge.Log(np.arange(len(x)) * dt, x, u, usable, dt)).report
    except (UserError, ValueError, IndexError, ZeroDivisionError, np.linalg.LinAlgError) as error:
        return type(error).__name__, ()
    return report["verdict"], tuple(sorted({plant.family(effect["name"]) for effect in report["effects"]}))


def run(out, n=N, seed=SEED, cluster=None, jobs=None, update=False):
    """Writes constants.json into `out`, and with `update` docs/diagnose-constants.md; returns [(constant, .., figures)]."""
    with busy("drawing logs"):
        drawn = [tiers.draw(tier, seed, k, SHORT) for tier in TIERS_USED for k in range(n)]
    logs = [(*log[:2], label["dt"]) for label, log, _ in drawn]
    truth = [("known" if label["truth"] else "none", tuple(label["families"])) for label, _, _ in drawn]
    constants = listed()
    calls = [(logs,), *((logs, module, name, _scaled(v, f)) for module, name, v, _ in constants for f in FACTORS)]
    with workers(cluster, jobs):
        found = dict(each(_answers, calls, "constants"))
    base = found[None, None, None]
    lines = [_line(*constant, found, base, truth) for constant in constants]
    write_json(output_folder(out) / "constants.json", [dict(zip(HEADERS, line)) for line in lines])
    title = f"`make constants N={n} SEED={seed}`: {len(lines)} constants, {len(logs)} drives"
    print_table(title, HEADERS[:2] + HEADERS[3:], [line[:2] + line[3:] for line in lines])
    if update:
        pages.update("docs/diagnose-constants.md", "constants", pages.table(title, HEADERS, lines, "---"))
    return lines


def _line(module, name, value, reason, found, base, truth):
    half, double = (found[module, name, _scaled(value, factor)] for factor in FACTORS)
    changed = [sum(a != b for a, b in zip(answers, base)) for answers in (half, double)]
    right = [sum(a == b for a, b in zip(answers, truth)) for answers in (half, base, double)]
    shown = ", ".join(f"{part:g}" for part in np.ravel(value))
    return [f"`{module.partition('.diagnose.')[2].replace('.', '/')}.{name}`", shown, reason, *changed, *right]
