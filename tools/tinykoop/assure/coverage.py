"""Lines, branches and MC/DC of lib/ that the C tests reach through its public headers.

Each precision is counted by itself, and so are the two kernels of lib/: what koopf reaches does not count for koopd.
What no test can reach says so in lib/ itself, on its line, as /* never: reason */. It is left out of the percentages;
a reason on a line that the tests do reach is an error.
"""

import json
import os
import re
import shutil
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from ..plumbing import pages
from ..plumbing.checkout import ROOT
from ..plumbing.command import need
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, progress, write_json

LIB = ROOT / "lib"
BUILD = ROOT / "build/coverage"
TESTS = ROOT / "test/c"

KERNELS = {"vectors": 1, "scalar": 0}  # KOOP_VECTORS
PRECISIONS = ("koopf", "koopd")
KINDS = ("lines", "branches", "mcdc")
FLAGS = "-O1 -fprofile-instr-generate -fcoverage-mapping -fcoverage-mcdc"
TOOLS = {"clang-19": "clang-19", "llvm-cov-19": "llvm-19", "llvm-profdata-19": "llvm-19", "cmake": "cmake"}
NEVER = re.compile(r"/\* never: (\S.*?) \*/")


@dataclass(frozen=True)
class Item:
    """What is to be reached: a line, one way a branch can go, a condition that is to decide by itself."""

    kind: str
    file: str  # below lib/
    line: int
    what: str
    reached: bool


# ---- what llvm-cov prints ------------------------------------------------------------------------------


def read_lines(lcov):
    """Lines, from llvm-cov's export as lcov."""
    file = ""
    for record in lcov.splitlines():
        name, _, value = record.partition(":")
        if name == "SF":
            file = value
        elif name == "DA":
            line, count = map(int, value.split(",")[:2])
            yield Item("lines", file, line, "line", count > 0)


def read_branches(function):
    """Both ways of each branch; a macro's are distinguished by where it is used."""
    for line, column, _, _, true, false, file, *_ in function["branches"]:
        for way, count in (("true", true), ("false", false)):
            yield Item("branches", function["filenames"][file], line, f"column {column} never {way}", count > 0)


def read_conditions(function):
    """Conditions of each decision, placed where the condition itself is."""
    places = sorted((branch[0], branch[1]) for branch in function["branches"])
    for line, column, end_line, end_column, *_, shown in function["mcdc_records"]:
        inside = [place for place in places if (line, column) <= place < (end_line, end_column)]
        for i, reached in enumerate(shown):
            at = inside[i] if len(inside) == len(shown) else (line, column)
            yield Item("mcdc", function["filenames"][0], at[0], f"column {at[1]} does not decide by itself", reached)


def read_items(export, lcov, lib=LIB):
    """All items of one compilation of lib/, from both of llvm-cov's exports."""
    items = list(read_lines(lcov))
    for function in export["data"][0]["functions"]:
        items += [*read_branches(function), *read_conditions(function)]
    return [Item(i.kind, Path(i.file).relative_to(lib).as_posix(), i.line, i.what, i.reached) for i in items]


# ---- what is missing -----------------------------------------------------------------------------------


def read_reasons(lib=LIB):
    """{(file, line): reason} of all that says it cannot be reached."""
    reasons = {}
    for path in sorted(lib.rglob("*.[ch]")):
        for line, text in enumerate(path.read_text().splitlines(), 1):
            if found := NEVER.search(text):
                reasons[path.relative_to(lib).as_posix(), line] = found[1]
    return reasons


def missing(units):
    """{item not reached: units in which it is not}, in the order of the files; `units` as {name: items}."""
    where = {}
    for name, items in units.items():
        for item in items:
            if not item.reached:
                where.setdefault(item, set()).add(name)
    return dict(sorted(where.items(), key=lambda pair: (pair[0].file, pair[0].line, pair[0].kind, pair[0].what)))


def counts(units, reasons):
    """{file: Counter of kind and (kind, "reached")}, without what has a reason."""
    files = {}
    for item in (item for items in units.values() for item in items):
        count = files.setdefault(item.file, Counter())
        if (item.file, item.line) not in reasons:
            count[item.kind] += 1
            count[item.kind, "reached"] += item.reached
    return files


def percent(count, kind):
    """Of what can be reached; nothing to reach is all of it."""
    return 100 * count[kind, "reached"] / count[kind] if count[kind] else 100.0


def failures(lacking, reasons, source):
    """One line for each item that is neither reached nor given a reason, and for each reason without such an item."""
    lines = [
        f"lib/{item.file}:{item.line}: {item.what} ({', '.join(sorted(units))}): {source(item.file, item.line)}"
        for item, units in lacking.items()
        if (item.file, item.line) not in reasons
    ]
    needed = {(item.file, item.line) for item in lacking}
    lines += [
        f"lib/{file}:{line}: the tests do reach this: take /* never: .. */ away" for file, line in reasons if (file, line) not in needed
    ]
    return lines


# ---- builds --------------------------------------------------------------------------------------------


def need_tools():
    need(TOOLS)
    runtime = Path(run_command("clang-19", "-print-resource-dir").strip())
    if not list(runtime.rglob("libclang_rt.profile*.a")):
        raise UserError("missing: clang's profile runtime. On Debian: sudo apt-get install libclang-rt-19-dev")


def build_and_test(kernel):
    """Builds again, so that each figure is of the sources as they are, and runs the C tests; the folder."""
    folder, jobs = BUILD / kernel, os.cpu_count()
    shutil.rmtree(folder, ignore_errors=True)
    flags = f"{FLAGS} -DKOOP_VECTORS={KERNELS[kernel]}"
    options = ["-DCMAKE_C_COMPILER=clang-19", "-DCMAKE_BUILD_TYPE=None", "-DTINYKOOP_TESTS=ON", "-DTINYKOOP_HOST=OFF"]
    run_command("cmake", "-S", ROOT, "-B", folder, f"-DCMAKE_C_FLAGS={flags}", *options)
    programs = [f"{path.stem}_{precision}" for path in TESTS.glob("test_*.c") for precision in PRECISIONS]
    said = run_command("cmake", "--build", folder, "-j", jobs, "--target", *programs)
    if refused := [line for line in said.splitlines() if "unsupported MC/DC" in line]:
        raise UserError("\n".join(refused))
    environment = os.environ | {"LLVM_PROFILE_FILE": str(folder / "profile/%p.profraw")}
    tests = "|".join(name.removeprefix("test_") for name in programs)
    run_command("ctest", "--test-dir", folder, "--output-on-failure", "-j", jobs, "-R", f"^({tests})$", env=environment)
    run_command("llvm-profdata-19", "merge", "-sparse", *folder.glob("profile/*.profraw"), "-o", folder / "all.profdata")
    return folder


def read_unit(folder, precision):
    """Items of one precision: the coverage maps are read off its object files."""
    first, second = (folder / f"CMakeFiles/tinykoop.dir/lib/{precision}{part}.c.o" for part in ("", "_supervisor"))
    export = ["llvm-cov-19", "export", first, f"-object={second}", f"-instr-profile={folder / 'all.profdata'}"]
    return read_items(json.loads(run_command(*export)), run_command(*export, "-format=lcov"))


# ---- all of it -----------------------------------------------------------------------------------------


def source(file, line):
    return (LIB / file).read_text().splitlines()[line - 1].strip()


def report(files, total):
    rows = []
    for file, count in [*sorted(files.items()), ("all", total)]:
        shares = [f"{count[kind, 'reached']}/{count[kind]}" for kind in KINDS]
        rows.append([file, *(cell for kind, share in zip(KINDS, shares) for cell in (share, number(percent(count, kind), 4)))])
    headers = ["lib/", "lines", "%", "branches", "%", "MC/DC", "%"]
    print_table("Reached by the C tests", headers, rows, "Sums over koopf and koopd, each with vector registers and without.")


def page(figures):
    """The table of docs/assurance.md from what coverage.json holds."""
    names = {"lines": "lines", "branches": "branches", "mcdc": "conditions (MC/DC)"}
    pairs = [(f"{words}, of {figures['counted'][kind]:,} (%)", number(figures[kind], 4)) for kind, words in names.items()]
    return pages.facts("`make coverage`: reached by the C tests", [*pairs, ("branches out of reach, with reason", len(figures["never"]))])


def run(out, update=False):
    """Writes coverage.json into `out`, and with `update` the table of docs/assurance.md; raises where something is not reached and has no reason."""
    need_tools()
    out = output_folder(out)
    units = {}
    for kernel in progress(list(KERNELS), "building and testing"):
        folder = build_and_test(kernel)
        units |= {f"{precision} {kernel}": read_unit(folder, precision) for precision in PRECISIONS}
    reasons, lacking = read_reasons(), missing(units)
    files = counts(units, reasons)
    total = sum(files.values(), Counter())
    lines = failures(lacking, reasons, source)
    given = [{"place": f"lib/{file}:{line}", "reason": reason} for (file, line), reason in reasons.items()]
    figures = {kind: percent(total, kind) for kind in KINDS}
    result = {**figures, "counted": {kind: total[kind] for kind in KINDS}, "never": given, "missing": lines}
    write_json(out / "coverage.json", result)
    report(files, total)
    for row in given:
        print(f"{row['place']}: never: {row['reason']}")
    if lines:
        raise UserError("\n".join(lines))
    if update:
        pages.update("docs/assurance.md", "coverage", page(result))
        pages.headline("mcdc", f"{number(figures['mcdc'], 4)} %")
    return figures
