"""The same bits from both compilers, at all optimisation levels, and on an emulated Cortex-M4F.

test/determinism/bits.c runs the whole library on fixed inputs and prints a digest of all that comes out, part by
part. Each build's digests must be those of the first build. Where the compiler contracts a * b + c the bits cannot be
equal; the last values of each part must then be close. test/determinism/accuracy.c holds the elementary functions
against long double.
"""

import math
import re
import shutil
from dataclasses import dataclass, field
from functools import partial

from ..firmware.targets import FOLDER as TARGETS
from ..firmware.targets import ROOT, Tree, side_by_side
from ..plumbing import pages
from ..plumbing.command import need
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, write_json

BUILD = ROOT / "build/determinism"
SOURCES = ROOT / "test/determinism"
PRECISIONS = {"float32": "koopf", "float64": "koopd"}
PLAIN = ("-std=c99", f"-I{ROOT / 'lib'}", f"-I{ROOT / 'lib/include'}", f"-I{ROOT / 'test/c'}")
WAYS = ("-O0", "-O1", "-O2", "-O3", "-Os", "-O3 -march=native", "-O2 -DKOOP_VECTORS=0")
CONTRACTED = "-ffp-contract=fast"

# Of what is contracted: the largest difference, relative to the largest of the values. Not where P winds up in the
# plain form: the paper's recursion then ends in round-off, whichever way it is rounded.
TOLERANCE = {"float32": 1e-3, "float64": 1e-9}
UNBOUNDED = re.compile(r"update-(ef|dz_cs|dz_ks)-plain-.*")

POINTS = 1_000_000  # on each line of accuracy
MOST_ULP = 1.0


# ---- builds ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Build:
    """One way of compiling and running the two programs of bits.c."""

    name: str
    compiler: str
    flags: tuple
    link: tuple = ("-lm",)
    runner: tuple = ()

    @property
    def contracted(self):
        return CONTRACTED in self.flags

    def make(self, source, precision, library=("", "_supervisor")):
        """The program. Only the library is contracted: what the script does itself is the same everywhere."""
        folder = BUILD / re.sub(r"\W+", "-", self.name)
        folder.mkdir(parents=True, exist_ok=True)
        unit = PRECISIONS[precision]
        objects = []
        for part in library:
            objects.append(folder / f"{unit}{part}.o")
            contract = () if self.contracted else ("-ffp-contract=off",)
            run_command(self.compiler, *PLAIN, *self.flags, *contract, "-c", ROOT / f"lib/{unit}{part}.c", "-o", objects[-1])
        program = folder / f"{source}_{unit}"
        flags = [flag for flag in self.flags if flag != CONTRACTED] + ["-ffp-contract=off", f"-DTEST_DOUBLE={int(unit == 'koopd')}"]
        run_command(self.compiler, *PLAIN, *flags, SOURCES / f"{source}.c", *objects, "-o", program, *self.link)
        return program

    def parts(self):
        """What its programs print: {(precision, part): Part}."""
        return read_parts("".join(run_command(*self.runner, self.make("bits", precision)) for precision in PRECISIONS))


def clang(which=shutil.which):
    """The newest clang there is, or None."""
    names = ["clang", *(f"clang-{version}" for version in range(30, 13, -1))]
    return next(filter(which, names), None)


def host_builds(compiler):
    """All ways for one compiler of the host, and the contracted one."""
    ways = [*WAYS, f"-O3 -march=native {CONTRACTED}"]
    return [Build(f"{compiler} {way}", compiler, tuple(way.split())) for way in ways]


def cortex_builds():
    """The same for a Cortex-M4F, as targets/ builds and emulates it."""
    tree = Tree("cortex-m4f", "O2")
    common = (TARGETS / "common/toolchain.cmake").read_text()
    machine = re.search(r"set\(TARGET_QEMU (.+)\)", (TARGETS / "cortex-m4f/toolchain.cmake").read_text())[1]
    options = re.search(r"set\(CMAKE_CROSSCOMPILING_EMULATOR \$\{TARGET_QEMU\}(.*?)\)", common, re.S)[1]
    flags = (*tree.flags, "--specs=picolibc.specs", "-ffunction-sections", "-fdata-sections")
    link = ("-Wl,--gc-sections", "-T", TARGETS / "cortex-m4f/memory.ld", "--crt0=semihost", "--oslib=semihost", "-lm")
    ways = ["-O2", "-Os", f"-O2 {CONTRACTED}"]
    runner = (*machine.split(), *options.split())
    return [Build(f"cortex-m4f {way}", f"{tree.prefix}gcc", (*flags, *way.split()), link, runner) for way in ways]


def missing_here(which=shutil.which):
    """{what is not compared: Debian packages}."""
    cross = {"arm-none-eabi-gcc": "gcc-arm-none-eabi picolibc-arm-none-eabi", "qemu-system-arm": "qemu-system-arm"}
    lacking = {"cortex-m4f": [package for program, package in cross.items() if not which(program)]}
    lacking["clang"] = [] if clang(which) else ["clang"]
    return {what: " ".join(packages) for what, packages in lacking.items() if packages}


def builds(missing):
    """All that can be made here, the reference first."""
    first, *others = host_builds("gcc")
    again = Build(f"{first.name}, run again", first.compiler, first.flags)
    more = [] if "clang" in missing else host_builds(clang())
    return [first, again, *others, *more, *([] if "cortex-m4f" in missing else cortex_builds())]


# ---- comparison --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Part:
    digest: str
    values: list = field(default_factory=list)


def read_parts(text):
    """{(precision, part): Part} of what bits prints."""
    lines = [line.split() for line in text.splitlines() if line.startswith("part ")]
    parts = {(p, name): Part(digest, [float.fromhex(value) for value in values]) for _, p, name, digest, *values in lines}
    if len(parts) != len(lines):
        raise UserError("bits printed two parts of one name")
    return parts


def largest_difference(ours, theirs):
    """Of two lists of values, relative to the largest of ours."""
    if len(ours) != len(theirs):
        return math.inf
    scale = max(map(abs, ours), default=0.0) or 1.0
    differences = [0.0 if a == b or (a != a and b != b) else abs(a - b) / scale for a, b in zip(ours, theirs)]
    worst = max(differences, default=0.0)
    return worst if all(map(math.isfinite, differences)) else math.inf


def compare(reference, build, parts):
    """Rows of determinism.json for one build; a part that only one of the two has differs."""
    rows = []
    for key in dict.fromkeys([*reference, *parts]):
        ours, theirs = reference.get(key), parts.get(key)
        there = ours is not None and theirs is not None
        rows.append(
            {
                "build": build.name,
                "precision": key[0],
                "part": key[1],
                "contracted": build.contracted,
                "equal": there and ours.digest == theirs.digest,
                "digest": theirs.digest if theirs else None,
                "largest_difference": largest_difference(ours.values, theirs.values) if there else math.inf,
            }
        )
    return rows


def broken(row):
    """Why a row does not hold, or None."""
    if row["equal"]:
        return None
    where = f"{row['build']}: {row['part']} in {row['precision']}"
    if not row["contracted"] or row["digest"] is None:
        return f"{where} has other bits"
    bound = TOLERANCE[row["precision"]]
    if UNBOUNDED.fullmatch(row["part"]) or row["largest_difference"] <= bound:
        return None
    return f"{where} differs by {row['largest_difference']:.2g}, more than {bound:g}"


# ---- elementary functions ----------------------------------------------------------------------------------


def read_errors(text):
    """Rows of elementary.json of what accuracy prints."""
    rows = []
    for line in text.splitlines():
        _, precision, function, low, high, error, x = line.split()
        rows.append(
            {"precision": precision, "function": function, "from": float(low), "to": float(high), "ulp": float(error), "x": float(x)}
        )
    if not rows:
        raise UserError("accuracy printed nothing")
    return rows


def accuracy(precision):
    program = Build("accuracy", "gcc", ("-O2",)).make("accuracy", precision, library=())
    return read_errors(run_command(program, POINTS))


# ---- all of it ---------------------------------------------------------------------------------------------


def summary(rows):
    """A line of the table for each build."""
    lines = []
    for name in dict.fromkeys(row["build"] for row in rows):
        line = [name]
        for precision in PRECISIONS:
            mine = [row for row in rows if row["build"] == name and row["precision"] == precision]
            bounded = [row["largest_difference"] for row in mine if not UNBOUNDED.fullmatch(row["part"])]
            line += [f"{sum(row['equal'] for row in mine)} of {len(mine)}", number(max(bounded, default=0.0), 2)]
        lines.append(line)
    return lines


def page(rows):
    """The table of docs/assurance.md: builds that may not differ."""
    exact = [row for row in rows if not row["contracted"]]
    pairs = [("builds with the same bits", len({row["build"] for row in exact}))]
    for precision in PRECISIONS:
        mine = [row for row in exact if row["precision"] == precision]
        pairs += [(f"{precision}: parts", len(mine)), (f"{precision}: equal", sum(row["equal"] for row in mine))]
    return pages.facts("`make determinism`", pairs)


def report(rows, errors, missing):
    headers = ["", "float32 equal", "differ by", "float64 equal", "differ by"]
    note = "Parts with the bits of the first build; by how much the others differ, windup in the plain form left out."
    print_table("Bits, build by build", headers, summary(rows), note)
    lines = [[f"{row['precision']} {row['function']}", number(row["from"]), number(row["to"], 7), row["ulp"], row["x"]] for row in errors]
    print_table(
        "Elementary functions against long double", ["", "from", "to", "worst, ulp", "at"], lines, "far-angle: in ulp of the angle itself"
    )
    for what, packages in missing.items():
        print(f"Not compared: {what}. On Debian: sudo apt-get install {packages}")


def run(out, update=False):
    """Writes determinism.json and elementary.json into `out`, and with `update` the table of docs/assurance.md; raises where what is promised does not hold."""
    need({"gcc": "gcc"})
    out = output_folder(out)
    missing = missing_here()
    all_builds = builds(missing)
    seen = dict(zip(all_builds, side_by_side([build.parts for build in all_builds], "building, running")))
    reference = seen[all_builds[0]]
    if not reference:
        raise UserError(f"{all_builds[0].name}: bits printed nothing")
    rows = [row for build, parts in seen.items() for row in compare(reference, build, parts)]
    errors = [row for rows_ in side_by_side([partial(accuracy, p) for p in PRECISIONS], "elementary functions") for row in rows_]
    write_json(out / "determinism.json", rows)
    write_json(out / "elementary.json", errors)
    report(rows, errors, missing)
    failures = [why for why in map(broken, rows) if why]
    failures += [
        f"{row['function']} in {row['precision']} is off by {row['ulp']} ulp at {row['x']!r}"
        for row in errors
        if not row["ulp"] <= MOST_ULP
    ]
    if failures:
        raise UserError("\n".join(["these results differ, but must be equal:", *failures[:20]]))
    if update:
        pages.update("docs/assurance.md", "determinism", page(rows))
