"""A mutant of lib/ under the C tests, which are built once for each kernel and load it as a shared library."""

import math
import os
import resource
import shutil
import subprocess
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from ..plumbing.checkout import ROOT
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import progress

LIB = ROOT / "lib"
BUILD = ROOT / "build/mutants"
WORK = BUILD / "work"  # a folder for each mutant that is being tried

KERNELS = {"vectors": 1, "scalar": 0}  # KOOP_VECTORS
PRECISIONS = ("koopf", "koopd")
PARTS = ("", "_supervisor")
# An argument that no compiler takes without a warning is no mutant; other warnings do not matter.
REFUSED = ("int-conversion", "incompatible-pointer-types", "discarded-qualifiers")
FLAGS = (*"-std=c99 -O1 -fPIC -ffp-contract=off -Iinclude".split(), *(f"-Werror={warning}" for warning in REFUSED))
SHARED = "libtinykoop.so"
SLOWER, LONGER = 5, 2.0  # a test may take this times its processor time, and this many seconds more
STOP = "void _Exit(int);\nvoid longjmp(void *frame, int value) { (void)frame; _Exit(value); }\n"  # in place of Unity's way to the next test


def processor_time():
    """Seconds that all programs started from here, and ended, have taken."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@dataclass
class Kernel:
    """The C tests, built for one kernel of lib/ as it is. A mutant's library takes the place of the one they load."""

    name: str
    limits: dict = field(default_factory=dict)  # {precision: {program: seconds}}, the fastest first
    kills: Counter = field(default_factory=Counter)  # mutants that each program has found

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

    def in_order(self, precision):
        """[(program, seconds)]: what has found most mutants for its time comes first, since a mutant needs to be found only once."""
        return sorted(self.limits[precision].items(), key=lambda limit: limit[1] / (1 + self.kills[limit[0]]))

    def kill(self, precision, folder):
        """Whether a test of the precision fails with the library in `folder`."""
        killer = next((program for program, seconds in self.in_order(precision) if self.fails(program, seconds, folder)), None)
        self.kills[killer] += 1
        return killer is not None

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


def prepare():
    """All kernels; none of what a run that was killed has left."""
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    return [Kernel(name).prepare() for name in progress(list(KERNELS), "building, timing tests")]


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
        if kernel.kill(precision, lib.parent):
            return "killed"
        verdict = "survived"
    return verdict


def judge(mutant, kernels):
    """ "killed", "survived", "equivalent", or None where it does not compile."""
    units = [precision + ("_supervisor" if mutant.file.endswith("/supervisor.c") else "") for precision in PRECISIONS]
    with TemporaryDirectory(dir=WORK) as folder:
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
