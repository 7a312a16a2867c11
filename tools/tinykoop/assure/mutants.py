"""How many small faults put into lib/ the C tests find: the mutation score.

A mutant is tried in float32, then in float64, with vector registers and then without, until a test fails or exceeds its
time. One that compiles to the same objects everywhere is equivalent; others are where test/mutants/equivalent.txt
argues so, in one line each:

    lib/src/file.c:function | line before | line after | reason
"""

import math
import os
import random
import resource
import shutil
import subprocess
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from ..command import need
from ..command import run as run_command
from ..errors import UserError
from ..results import number, output_folder, print_table, write_json
from ..targets import side_by_side
from .mutation import mutants as mutants_of

ROOT = Path(__file__).resolve().parents[3]
LIB = ROOT / "lib"
BUILD = ROOT / "build/mutants"
EQUIVALENT = ROOT / "test/mutants/equivalent.txt"

KERNELS = {"vectors": 1, "scalar": 0}  # KOOP_VECTORS
PRECISIONS = ("koopf", "koopd")
PARTS = ("", "_guard")
# An argument that no compiler takes without a warning is no mutant; other warnings do not matter.
REFUSED = ("int-conversion", "incompatible-pointer-types", "discarded-qualifiers")
FLAGS = (*"-std=c99 -O1 -fPIC -ffp-contract=off -Iinclude".split(), *(f"-Werror={warning}" for warning in REFUSED))
SHARED = "libtinykoop.so"
SLOWER, LONGER = 5, 2.0  # a test may take this times its processor time, and this many seconds more
STOP = "void _Exit(int);\nvoid longjmp(void *frame, int value) { (void)frame; _Exit(value); }\n"  # in place of Unity's way to the next test
MIN_SCORE = 97.0  # percent


# ---- builds ------------------------------------------------------------------------------------------------


def processor_time():
    """Seconds that all programs started from here, and ended, have taken."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@dataclass
class Kernel:
    """The C tests, built for one kernel of lib/ as it is. A mutant's library takes the place of the one they load."""

    name: str
    limits: dict = field(default_factory=dict)  # {precision: {program: seconds}}, the fastest first

    @property
    def folder(self):
        return BUILD / self.name

    def compile(self, lib, unit, folder):
        """The object of one unit, or None where it does not compile. Same source, same bytes."""
        made = folder / f"{unit}.o"
        command = ["gcc", *FLAGS, f"-DKOOP_VECTORS={KERNELS[self.name]}", "-c", f"{unit}.c", "-o", str(made)]
        return made if subprocess.run(command, cwd=lib, capture_output=True).returncode == 0 else None

    def link(self, folder, changed=()):
        """The shared library in `folder`, of the changed objects and the unchanged ones."""
        names = [f"{precision}{part}.o" for precision in PRECISIONS for part in PARTS]
        mine = {made.name: made for made in changed}
        objects = [mine.get(name, self.folder / name) for name in names]
        run_command("gcc", "-shared", f"-Wl,-soname,{SHARED}", *objects, "-o", folder / SHARED, "-lm")

    def link_test(self, program):
        """Links a test again as CMake has, but with the shared library, and so that it ends at its first failure."""
        line = (program.parent / f"CMakeFiles/{program.name}.dir/link.txt").read_text()
        library = str(self.folder / SHARED)
        run_command(*line.replace("../libtinykoop.a", library).split(), self.folder / "stop.o", cwd=program.parent)

    def fails(self, program, seconds, folder):
        """Whether a test fails with the library in `folder`, or takes more processor time than this."""
        environment = os.environ | {"LD_LIBRARY_PATH": str(folder)}
        command = ["prlimit", f"--cpu={seconds}", "--core=0", program]
        return subprocess.run(command, env=environment, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode != 0

    def time(self, program):
        """Seconds of processor time that a test takes without a mutant."""
        before = processor_time()
        if self.fails(program, 600, self.folder):
            raise UserError(f"{program}: fails without a mutant; run make test")
        return processor_time() - before

    def prepare(self):
        """Builds and times the tests."""
        flags = f"-DCMAKE_C_FLAGS=-O2 -DKOOP_VECTORS={KERNELS[self.name]}"
        options = ["-DCMAKE_BUILD_TYPE=None", "-DTINYKOOP_TESTS=ON", "-DTINYKOOP_HOST=OFF", flags]
        run_command("cmake", "-G", "Unix Makefiles", "-S", ROOT, "-B", self.folder, *options)
        programs = {p: [f"{path.stem}_{p}" for path in (ROOT / "test/c").glob("test_*.c")] for p in PRECISIONS}
        run_command("cmake", "--build", self.folder, "-j", os.cpu_count(), "--target", *sum(programs.values(), []))
        run_command("gcc", "-x", "c", "-c", "-", "-o", self.folder / "stop.o", input=STOP)
        for unit in (precision + part for precision in PRECISIONS for part in PARTS):
            self.compile(LIB, unit, self.folder)
        self.link(self.folder)
        for precision, names in programs.items():
            paths = [self.folder / "test" / name for name in names]
            for path in paths:
                self.link_test(path)
            times = sorted((self.time(path), path) for path in paths)
            self.limits[precision] = {path: math.ceil(SLOWER * time + LONGER) for time, path in times}
        return self


def judge_with(kernel, lib, units):
    """As judge(), for one kernel and a changed copy of lib/."""
    verdict = "equivalent"
    for precision, unit in zip(PRECISIONS, units):
        made = kernel.compile(lib, unit, lib.parent)
        if made is None:
            return None
        if made.read_bytes() == (kernel.folder / made.name).read_bytes():
            continue
        kernel.link(lib.parent, [made])
        if any(kernel.fails(program, seconds, lib.parent) for program, seconds in kernel.limits[precision].items()):
            return "killed"
        verdict = "survived"
    return verdict


def judge(mutant, kernels):
    """"killed", "survived", "equivalent", or None where it does not compile."""
    units = [precision + ("_guard" if mutant.file.endswith("/guard.c") else "") for precision in PRECISIONS]
    with TemporaryDirectory(dir=BUILD) as folder:
        lib = Path(folder) / "lib"
        shutil.copytree(LIB, lib)
        (lib.parent / mutant.file).write_text(mutant.mutated)
        verdict = "equivalent"
        for kernel in kernels:
            found = judge_with(kernel, lib, units)
            if found in ("killed", None):
                return found
            verdict = found if verdict == "equivalent" else verdict
        return verdict


# ---- mutants -----------------------------------------------------------------------------------------------


def all_mutants(lib=LIB):
    paths = sorted((lib / "src").glob("*.c"))
    return [mutant for path in paths for mutant in mutants_of(path.relative_to(lib.parent).as_posix(), path.read_text())]


def key(mutant):
    """What names a mutant in equivalent.txt."""
    return f"{mutant.file}:{mutant.function} | {mutant.before} | {mutant.after}"


def read_equivalent(text, known):
    """{key of a mutant: reason}; refuses what argues for none of the `known` keys."""
    reasons = {}
    for line, entry in enumerate(text.splitlines(), 1):
        if entry and not entry.startswith("#"):
            name, _, reason = entry.rpartition(" | ")
            if name not in known:
                raise UserError(f"test/mutants/equivalent.txt:{line}: no mutant of lib/ is this any more; remove the line: {entry}")
            reasons[name] = reason
    return reasons


def draw(candidates, seed):
    """All of them in an order that only the seed decides."""
    order = list(candidates)
    random.Random(seed).shuffle(order)
    return order


def try_all(order, n, kernels):
    """[(mutant, verdict)] of the first n that compile."""
    tried = []
    while order and len(tried) < n:
        batch, order = order[: n - len(tried)], order[n - len(tried) :]
        verdicts = side_by_side([partial(judge, mutant, kernels) for mutant in batch], "trying mutants")
        tried += [(mutant, verdict) for mutant, verdict in zip(batch, verdicts) if verdict]
    return tried


def with_reasons(tried, reasons):
    """Survivors that are argued equivalent become so; refuses an argument that a test disproves."""
    for mutant, verdict in tried:
        if verdict == "killed" and key(mutant) in reasons:
            raise UserError(f"test/mutants/equivalent.txt: a test kills this; remove the line: {key(mutant)}")
    return [(mutant, "equivalent" if key(mutant) in reasons else verdict) for mutant, verdict in tried]


# ---- all of it ---------------------------------------------------------------------------------------------


def score(count):
    """Percent killed of those that can be."""
    able = count["killed"] + count["survived"]
    return 100 * count["killed"] / able if able else 100.0


def report(tried):
    files = {}
    for mutant, verdict in tried:
        files.setdefault(mutant.file, Counter())[verdict] += 1
    total = sum(files.values(), Counter())
    rows = [
        [file, count.total(), count["killed"], count["equivalent"], count["survived"], number(score(count))]
        for file, count in [*sorted(files.items()), ("all", total)]
    ]
    print_table("Mutants of lib/ under the C tests", ["", "mutants", "killed", "equivalent", "survived", "score, %"], rows)
    return total


def choose(file, n):
    """The mutants to draw from, and how many."""
    if n < 1:
        raise UserError(f"--n {n}: must be above 0")
    known = all_mutants()
    if file is None:
        return known, known, n
    chosen = [mutant for mutant in known if mutant.file == file]
    if not chosen:
        raise UserError(f"--file {file}: no source of the library; such as lib/src/mpc.c")
    return known, chosen, len(chosen)


def run(out, n, seed, file=None):
    """Writes mutants.json into `out`; raises where the score is too low."""
    need({"gcc": "gcc", "cmake": "cmake", "prlimit": "util-linux"})
    out = output_folder(out)
    known, chosen, n = choose(file, n)
    reasons = read_equivalent(EQUIVALENT.read_text(), {key(mutant) for mutant in known})
    kernels = [Kernel(name).prepare() for name in KERNELS]
    tried = with_reasons(try_all(draw(chosen, seed), n, kernels), reasons)
    survivors = [mutant for mutant, verdict in tried if verdict == "survived"]
    rows = [{"place": m.place, "function": m.function, "before": m.before, "after": m.after} for m in survivors]
    total = report(tried)
    write_json(
        out / "mutants.json",
        {"mutants": total.total(), "killed": total["killed"], "equivalent": total["equivalent"], "survivors": rows},
    )
    for mutant in survivors:
        print(f"{mutant.place}: {mutant.before}\n    {mutant.after}")
    if score(total) < MIN_SCORE:
        low = f"{number(score(total))} % of the mutants are killed, less than {MIN_SCORE:g} %; no test fails for:"
        raise UserError("\n".join([low, *map(key, survivors)]))
    return total
