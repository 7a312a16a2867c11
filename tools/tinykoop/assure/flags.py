"""The C tests with lib/ compiled as flight stacks compile it, and under more aggressive flags.

test/flags/stacks.json holds the flags, read from the stacks' own build files. They are for lib/ alone: the tests'
reference arithmetic must be right. Each compiler has one build tree, which keeps the objects of the tests; each set
of flags compiles lib/ again and links. Where two sets give the same library, bit for bit, its tests are run once.

lib/src/strict.h is what makes lib/ safe. Without it koopf_self_test() must find what the flags have done.
"""

import hashlib
import json
import os
import shutil
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from queue import Queue
from threading import Event

from ..firmware.targets import FOLDER as TARGETS
from ..firmware.targets import ROOT, left_out
from ..plumbing.command import need
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, progress, write_json
from .determinism import missing_here
from .sanitize import c_tests

DATA = ROOT / "test/flags/stacks.json"
TESTS = ROOT / "test/c"
BUILD = ROOT / "build/flags"

HOST, EMULATED = "x86-64", "cortex-m4f"
COMPILERS = ("gcc", "clang", "clang-19")
CROSS = "arm-none-eabi-gcc"
# What Clang, and GCC on x86, say by lib/src/strict.h where nothing but the command line can help, and what is to be done then.
REFUSAL, REMEDY = "TinyKoop: add -fno-finite-math-only", "-fno-finite-math-only"

SHARE = 10  # of the tests' long searches, a tenth
SECONDS = 120  # of one test: unsafe flags may take the end from a loop


# ---- sets of flags -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FlagSet:
    """What one firmware compiles with."""

    name: str
    flags: tuple
    link: str = ""  # of the tests' programs
    emulated: bool = False  # on the microcontroller, too
    left_out: tuple = ()  # tests that cannot pass, whatever lib/ does


def flag_set(row):
    """Of a row of stacks.json; its warnings count as flags."""
    words = f"{row['flags']} {row.get('warnings', '')}".split()
    return FlagSet(row["name"], tuple(words), row.get("link", ""), row.get("emulated", False), tuple(row.get("left_out", {})))


def read_sets(data):
    return [flag_set(row) for row in [*data["stacks"], *data["ours"]]]


def split(flags, accepts):
    """Those a compiler takes, and those dropped. Some are taken only in company, so all are tried together first."""
    if accepts(flags):
        return flags, ()
    kept = tuple(flag for flag in flags if accepts((flag,)))
    return kept, tuple(flag for flag in flags if flag not in kept)


# ---- one compiler ------------------------------------------------------------------------------------------


def first_error(text):
    """The line of a failed build that says why."""
    lines = text.splitlines()
    return next((line.strip() for line in lines if "error" in line and "exit status" not in line), lines[-1])


def complaint(name, text):
    """A failed test: its first failed assertion, or how it ended."""
    lines = text.splitlines()
    return f"{name}: {next((line for line in lines if ':FAIL' in line), lines[0])}"


def result(stack, compiler, target, tests, failed, dropped=(), same_as=None):
    """A row of flags.json."""
    row = {"stack": stack, "compiler": compiler, "target": target, "tests": tests, "failed": failed}
    return row | {"dropped": list(dropped), "same_as": same_as, "seconds": None}


class Tree:
    """A build tree: one compiler for one target."""

    def __init__(self, compiler, target):
        self.compiler, self.target = compiler, target
        self.folder = BUILD / f"{compiler}-{target}"
        self.seen = {}  # {library, link and tests: (name of the set, what failed)}

    def accepts(self, flags):
        """Whether the compiler takes these flags without a word; the host's also links with them."""
        command = [self.compiler, "-Werror", *flags, *([] if self.target == HOST else ["-c"]), "-x", "c", "-", "-o", "/dev/null"]
        return not subprocess.run(command, input="int main(void) { return 0; }", capture_output=True, text=True).returncode

    @property
    def options(self):
        """Of CMake. No debug information: it holds the flags, and libraries are compared."""
        own = {"CMAKE_C_COMPILER": self.compiler}
        if self.target == EMULATED:
            own = {"CMAKE_TOOLCHAIN_FILE": TARGETS / EMULATED / "toolchain.cmake"}
        flags = f"-O2 -DTEST_SHARE={SHARE}"
        return own | {"CMAKE_BUILD_TYPE": "Release", "CMAKE_C_FLAGS_RELEASE": flags, "TINYKOOP_TESTS": "ON", "TINYKOOP_HOST": "OFF"}

    def configure(self, flags=(), link=""):
        # stopped at the first error: the last lines, which are all that is kept, then hold it
        options = self.options | {"TINYKOOP_LIBRARY_FLAGS": ";".join((*flags, "-Wfatal-errors"))}
        if self.target == HOST:  # the other's linker flags are its toolchain's
            options["CMAKE_EXE_LINKER_FLAGS"] = link
        run_command("cmake", "-S", ROOT, "-B", self.folder, *[f"-D{name}={value}" for name, value in options.items()])

    @property
    def names(self):
        """Of the tests: all of test/c; in float32 those that an emulated processor has time for."""
        subjects = sorted(path.stem.removeprefix("test_") for path in TESTS.glob("test_*.c"))
        precisions = ("koopf", "koopd") if self.target == HOST else ("koopf",)
        names = [f"{subject}_{precision}" for precision in precisions for subject in subjects]
        return [name for name in names if self.target == HOST or not left_out(self.target, name)]

    def names_under(self, flags):
        """Of the tests that are run under a set."""
        return [name for name in self.names if name.rsplit("_", 1)[0] not in flags.left_out]

    def build(self, flags, link):
        self.configure(flags, link)
        programs = ["c_tests"] if self.target == HOST else [f"test_{name}" for name in self.names]
        run_command("cmake", "--build", self.folder, "--target", *programs)

    def library(self):
        """A digest of what was built."""
        return hashlib.sha256((self.folder / "libtinykoop.a").read_bytes()).hexdigest()

    def failures(self, names):
        """A line for each of these tests that fails."""
        commands, lines = c_tests(self.folder), []
        for name in names:
            try:
                run_command(*commands[name], timeout=SECONDS)
            except UserError as error:
                lines.append(complaint(name, str(error)))
        return lines

    def build_as_told(self, flags, link):
        """Builds; with the remedy behind the flags where the library asks for it. Which it may not on a microcontroller."""
        try:
            self.build(flags, link)
        except UserError as error:
            if self.compiler == CROSS or REFUSAL not in str(error):
                raise
            self.build((*flags, REMEDY), link)

    def outcome(self, flags, kept):
        """What failed, and the set whose library is the same, or None."""
        try:
            self.build_as_told(kept, flags.link)
        except UserError as error:
            return [f"build: {first_error(str(error))}"], None
        names = self.names_under(flags)
        key = (self.library(), flags.link, *names)
        if key in self.seen:
            first, failed = self.seen[key]
            return failed, first
        self.seen[key] = (flags.name, self.failures(names))
        return self.seen[key][1], None

    def row(self, flags):
        """A row of flags.json for one set."""
        begin = time.monotonic()
        kept, dropped = split(flags.flags, self.accepts)
        failed, same = self.outcome(flags, kept)
        row = result(flags.name, self.compiler, self.target, len(self.names_under(flags)), failed, dropped, same)
        return row | {"seconds": round(time.monotonic() - begin, 1)}

    def meant(self, sets):
        """Those for this target."""
        return [flags for flags in sets if self.target == HOST or flags.emulated]


# ---- the self-test -----------------------------------------------------------------------------------------

LOOSE = ("-O2", "-ffast-math")
SELF_TEST = """#include "tinykoop.h"
int main(void) { return koopf_self_test() != KOOP_OK && koopd_self_test() != KOOP_OK ? 0 : 1; }
"""


def without_strictness(folder):
    """Makes a copy of lib/ whose files do not ask for strict arithmetic."""
    shutil.copytree(ROOT / "lib", folder, dirs_exist_ok=True)
    strict = folder / "src/strict.h"
    if not strict.read_text().count("#pragma"):
        raise UserError(f"{strict}: no #pragma is there to be left out")
    strict.write_text("")


def self_test_finds(compiler):
    """Raises unless the self-tests of both precisions find that lib/ is compiled loosely."""
    folder = BUILD / f"without-strictness-{compiler}"
    without_strictness(folder)
    (folder / "main.c").write_text(SELF_TEST)
    sources = [folder / name for name in ("main.c", "koopf.c", "koopd.c")]
    run_command(compiler, *LOOSE, "-w", "-I", folder / "include", *sources, "-o", folder / "main", "-lm")
    run_command(folder / "main")


def self_test_row(compiler):
    """A row of flags.json."""
    failed = []
    try:
        self_test_finds(compiler)
    except (UserError, OSError) as error:
        failed = [f"self_test: does not find that strict.h is left out: {error}"]
    return result(f"{' '.join(LOOSE)} without strict.h", compiler, HOST, 1, failed)


# ---- the page ----------------------------------------------------------------------------------------------


def markdown(data):
    """The table of docs/microcontroller.md."""
    lines = ["| stack | compiles with | read from | what the library does |", "|---|---|---|---|"]
    for row in data["stacks"]:
        places = "<br>".join(f"{file} at {commit[:10]}" for file, commit in row["read_from"])
        lines.append(f"| {row['name']} | `{row['flags']}` | {row['repository']}<br>{places} | {row['note']} |")
    return "\n".join(lines) + "\n"


# ---- all of it ---------------------------------------------------------------------------------------------


def trees(which=shutil.which):
    """Those that can be built here, the one that takes longest first."""
    emulated = [] if EMULATED in missing_here(which) else [Tree(CROSS, EMULATED)]
    return emulated + [Tree(compiler, HOST) for compiler in COMPILERS if which(compiler)]


def chosen(available, compilers):
    """The trees of these compilers; of all where none is named."""
    for compiler in compilers or ():
        if compiler not in [tree.compiler for tree in available]:
            raise UserError(f"--compiler {compiler}: not one of those that are here: {', '.join(tree.compiler for tree in available)}")
    return [tree for tree in available if not compilers or tree.compiler in compilers]


def named(sets, names):
    """The sets of these names; all where none is given."""
    for name in names or ():
        if name not in [flags.name for flags in sets]:
            raise UserError(f"--set {name}: not one of {', '.join(flags.name for flags in sets)}")
    return [flags for flags in sets if not names or flags.name in names]


def every_row(available, sets):
    """Rows as they are done. A tree does its sets one after the other; trees are side by side."""
    done, stop = Queue(), Event()

    def work(tree):
        try:
            for flags in tree.meant(sets):
                if not stop.is_set():
                    done.put(tree.row(flags))
        except Exception as error:
            done.put(error)

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            for tree in available:
                pool.submit(work, tree)
            for _ in progress(range(sum(len(tree.meant(sets)) for tree in available)), "building, testing"):
                row = done.get()
                if isinstance(row, Exception):
                    raise row
                yield row
        finally:
            stop.set()


def failed_names(row):
    return " ".join(line.split(":")[0] for line in row["failed"])


def reasons(data):
    """A line for each test that is left out."""
    return [f"Left out under {row['name']}: {test}, which {why}" for row in data["ours"] for test, why in row.get("left_out", {}).items()]


def report(rows, data, missing):
    lines = []
    for row in rows:
        passed = f"{row['tests'] - len(row['failed'])} of {row['tests']}"
        result = "does not build" if failed_names(row) == "build" else passed
        lines.append([row["stack"], row["compiler"], row["target"], result, row["same_as"] or "", number(row["seconds"])])
    headers = ["flags", "compiler", "target", "passed", "same library as", "s"]
    print_table("C tests with lib/ under the flags of flight stacks, and ours", headers, lines)
    for compiler in COMPILERS:
        if dropped := sorted({flag for row in rows if row["compiler"] == compiler for flag in row["dropped"]}):
            print(f"Dropped, since {compiler} does not take them: {' '.join(dropped)}")
    for line in reasons(data):
        print(line)
    for what, packages in missing.items():
        print(f"Not tried: {what}. On Debian: sudo apt-get install {packages}")


def run(out, compilers=None, names=None):
    """Writes flags.json into `out`; raises where a test fails under some flags."""
    need({"gcc": "gcc", "cmake": "cmake"})
    out, data = output_folder(out), json.loads(DATA.read_text())
    available, sets = chosen(trees(), compilers), named(read_sets(data), names)
    for tree in available:  # one after the other: the first may have to fetch Unity
        tree.configure()
    rows = sorted(every_row(available, sets), key=lambda row: (row["target"], row["compiler"]))
    rows += [self_test_row(tree.compiler) for tree in available if tree.target == HOST]
    write_json(out / "flags.json", rows)
    report(rows, data, missing_here())
    if lines := [f"{row['stack']}, {row['compiler']}, {row['target']}: {line}" for row in rows for line in row["failed"]]:
        raise UserError("\n".join([f"{len(lines)} failures", *lines]))
    return rows
