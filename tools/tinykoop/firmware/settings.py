"""Compiler settings of lib/ compared: code, instructions and estimated cycles of update and solve."""

import re
from functools import partial

from ..plumbing import pages
from ..plumbing.checkout import ROOT
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, write_json
from . import cycles, targets

SETTINGS = [f"{level} -ffp-contract={contraction}" for level in ("-O2", "-Os", "-O3") for contraction in ("off", "fast")]
SIZE = max(targets.SIZES)
CALLS = {"update": ("rls_update", "dz_cs"), "MPC warm": ("mpc_solve", "warm"), "MPC worst": ("mpc_solve", "worst")}
PAGE = "docs/microcontroller.md"


def program(tree, setting):
    """The program footprint with lib/koopf.c compiled so, and that object."""
    folder = tree.folder / "settings"
    folder.mkdir(exist_ok=True)
    name = re.sub(r"\W+", "_", setting).strip("_")
    library, out = folder / f"{name}.o", folder / name
    common = [*tree.flags, "--specs=picolibc.specs", "-std=gnu99"]
    sections = ["-ffunction-sections", "-fdata-sections"]
    tree.tool("gcc", *common, *sections, *setting.split(), f"-I{ROOT / 'lib/include'}", "-c", ROOT / "lib/koopf.c", "-o", library)
    rest = [*(tree.folder / "targets/common/CMakeFiles/footprint.dir").glob("*.obj"), tree.object.with_name("koopd.c.obj")]
    start = ["--crt0=semihost", "--oslib=semihost", "-T", targets.FOLDER / tree.target / "memory.ld", "-Wl,--gc-sections"]
    tree.tool("gcc", *common, *start, *rest, library, "-lm", "-o", out)
    return out, library


def measure(tree, setting):
    """A row of settings.json."""
    out, library = program(tree, setting)
    counted = targets.Counted.read(tree.counts(out))
    return {
        "target": tree.target,
        "setting": setting,
        "text": int(tree.tool("size", library).splitlines()[1].split()[0]),
        "instructions": targets.instructions(counted.instructions[SIZE]),
        "cycles": targets.estimated(tree.target, counted.cycles[SIZE]),
    }


def _figures(row):
    """{header: number} of a row."""
    counts = {"instructions": row["instructions"], **row["cycles"]}
    found = {f"{call}, {what}": count[key][part] for call, (key, part) in CALLS.items() for what, count in counts.items()}
    return {"code": row["text"], **found}


def turns_at(ours, theirs):
    """Cycles of a multiply-accumulate below which we take less than they do; each is (cycles if it takes 1, if 3)."""
    at_one, at_three = (a - b for a, b in zip(ours, theirs))
    if at_one >= 0:
        return "never"
    return "always" if at_three < 0 else f"{1 + 2 * at_one / (at_one - at_three):.1f}"


COMPARED = (("-O2 -ffp-contract=fast", "-O2 -ffp-contract=off"), ("-Os -ffp-contract=off", "-O2 -ffp-contract=off"))


def break_even(rows):
    """Lines of the table of turns_at, on the processor whose multiply-accumulate is in doubt."""
    cycles_of = {row["setting"]: row["cycles"] for row in rows if row["target"] == "cortex-m4f"}
    lines = []
    for ours, theirs in COMPARED:
        pairs = [[[cycles_of[name][f"VMLA {v}"][key][part] for v in (1, 3)] for name in (ours, theirs)] for key, part in CALLS.values()]
        lines.append([f"`{ours}` instead of `{theirs}`", *[turns_at(*pair) for pair in pairs]])
    return lines


def markdown(rows):
    parts = []
    for target in dict.fromkeys(row["target"] for row in rows):
        here = [row for row in rows if row["target"] == target]
        lines = [[f"`{row['setting']}`", *[f"{value:,}" for value in _figures(row).values()]] for row in here]
        parts.append(pages.table(f"{target}: N = {SIZE}, m = 2, horizon 50, cycles estimated", ["", *_figures(here[0])], lines))
    caption = "Cortex-M4F: cycles of a multiply-accumulate below which a setting is faster than another"
    return "\n".join([*parts, pages.table(caption, ["", *CALLS], break_even(rows))])


def run(out, update=False):
    """Writes settings.json into `out`."""
    if packages := targets.missing():
        raise UserError(f"missing Debian packages: sudo apt-get install {' '.join(packages)}")
    out = output_folder(out)
    trees = [targets.Tree(target, "O2") for target in cycles.ESTIMATES]
    targets.side_by_side([targets.host_loop, *[partial(tree.build, tests=False) for tree in trees]], "building")
    rows = targets.side_by_side([partial(measure, tree, setting) for tree in trees for setting in SETTINGS], "running on QEMU")
    write_json(out / "settings.json", rows)
    for target in cycles.ESTIMATES:
        here = [row for row in rows if row["target"] == target]
        cells = [[row["setting"], *[f"{value:,}" for value in _figures(row).values()]] for row in here]
        print_table(f"{target}, N = {SIZE}, m = 2, horizon 50; cycles are estimates", ["setting", *_figures(here[0])], cells)
    if update:
        pages.update(PAGE, "settings", markdown(rows))
    return rows
