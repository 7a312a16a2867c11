"""The tests under AddressSanitizer, UBSan, ThreadSanitizer and valgrind."""

import json
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

from ..plumbing import pages
from ..plumbing.checkout import ROOT
from ..plumbing.command import need
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, progress, write_json

BUILD = ROOT / "build/sanitize"

PROGRAMS = {"gcc": "gcc", "cmake": "cmake", "valgrind": "valgrind"}
ADDRESS = "-fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer"
THREAD = "-fsanitize=thread"

# What valgrind is not run on, and why.
NO_VALGRIND = {
    "mpc_random": "a campaign of 30,000 solves, half an hour under valgrind; the calls are those of mpc",
    "long_run": "compares with long double of 80 bits, which valgrind computes in 64",
    "elementary": "compares with long double of 80 bits, which valgrind computes in 64",
}

# What the Python tests leave out, and why.
_HANGS = "builds with CMake, which hangs with a sanitizer before it; none of it calls the simulator of this build"
NO_PRELOAD = {"test_drop_in.py": _HANGS, "test_install.py": _HANGS}


def build(name, flags, *options):
    """A build tree with these compiler flags."""
    folder = BUILD / name
    run_command("cmake", "-S", ROOT, "-B", folder, f"-DCMAKE_C_FLAGS={flags}", *options)
    run_command("cmake", "--build", folder, "-j", os.cpu_count() or 1, timeout=1800)
    return folder


def c_tests(folder):
    """{name: command} of the C tests that are built."""
    tests = json.loads(run_command("ctest", "--test-dir", folder, "--show-only=json-v1"))["tests"]
    return {test["name"]: test["command"] for test in tests if "command" in test}


def attempt(name, *command, timeout=1800, **options):
    """None, or what went wrong, with the lines that say it."""
    try:
        run_command(*command, timeout=timeout, **options)
    except UserError as error:
        return f"{name}: {error}"
    return None


def attempt_all(commands):
    """What went wrong of {name: command}, two at a time."""
    with ThreadPoolExecutor(2) as pool:
        return [line for line in pool.map(lambda item: attempt(item[0], *item[1]), commands.items()) if line]


# ---- the checks: each gives how many tests it ran, and what went wrong -------------------------------


def address_c():
    programs = c_tests(build("address", ADDRESS, "-DTINYKOOP_TESTS=ON", "-DTINYKOOP_HOST=OFF"))
    return len(programs), attempt_all(programs)


def preloaded():
    """The sanitizers' runtimes, which Python is not linked with."""
    return ":".join(run_command("gcc", f"-print-file-name={name}").strip() for name in ("libasan.so", "libubsan.so"))


def address_python():
    folder = build("address-host", ADDRESS)
    settings = {
        "LD_PRELOAD": preloaded(),
        # leaks are Python's own; a decompressor that altered bytes ask for too much is told so
        "ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1",
        "UBSAN_OPTIONS": "print_stacktrace=1",
        "OPENBLAS_NUM_THREADS": "1",
        "TINYKOOP_SIM": str(folder / "host_sim/libtinykoop_sim.so"),
    }
    command = [sys.executable, "-m", "pytest", "-q", "-n", str(os.cpu_count() or 1), "--dist", "loadfile"]
    command += [f"--ignore=test/python/{name}" for name in NO_PRELOAD]
    environment = os.environ | settings
    done = subprocess.run([*command, "test/python"], cwd=ROOT, env=environment, capture_output=True, text=True, errors="replace")
    lines = (done.stdout + done.stderr).strip().splitlines()
    last = next((line for line in reversed(lines) if "passed" in line), "")
    count = int(last.split(" passed")[0].split()[-1]) if last else 0
    wrong = [line for line in lines if line.startswith(("FAILED", "ERROR"))] or lines[-15:]
    return count, wrong if done.returncode else []


def thread_c():
    programs = c_tests(build("thread", THREAD, "-DTINYKOOP_TESTS=ON", "-DTINYKOOP_HOST=OFF"))
    programs = {name: command for name, command in programs.items() if name.startswith("threads_")}
    return len(programs), attempt_all(programs)


def valgrind_c():
    programs = c_tests(build("plain", "-g -O1", "-DTINYKOOP_TESTS=ON", "-DTINYKOOP_HOST=OFF"))
    programs = {name: command for name, command in programs.items() if name.rsplit("_", 1)[0] not in NO_VALGRIND}
    valgrind = ["valgrind", "--quiet", "--error-exitcode=9", "--leak-check=full"]
    return len(programs), attempt_all({name: [*valgrind, *command] for name, command in programs.items()})


CHECKS = {
    "C tests, AddressSanitizer and UBSan": address_c,
    "C tests, valgrind": valgrind_c,
    "separate objects in 8 threads, ThreadSanitizer": thread_c,
    "Python tests, simulator and lib/ with AddressSanitizer and UBSan": address_python,
}


def page(rows):
    """The table of docs/assurance.md."""
    return pages.table(
        "`make sanitize`", ["", "tests", "findings"], [[row["check"], f"{row['tests']:,}", len(row["findings"])] for row in rows]
    )


def run(out, update=False):
    """Writes sanitize.json into `out`, and with `update` the table of docs/assurance.md; raises where something was found."""
    need(PROGRAMS)
    folder = output_folder(out)
    rows = []
    for name, check in progress(list(CHECKS.items()), "sanitizers"):
        begin = time.monotonic()
        tests, wrong = check()
        wrong += [] if tests else ["no test was run"]
        rows.append({"check": name, "tests": tests, "seconds": round(time.monotonic() - begin), "findings": wrong})
    write_json(folder / "sanitize.json", rows)
    print_table(
        "Sanitizers", ["", "tests", "s", "findings"], [[row["check"], row["tests"], row["seconds"], len(row["findings"])] for row in rows]
    )
    if wrong := [f"{row['check']}: {line}" for row in rows for line in row["findings"]]:
        raise UserError("\n".join([f"{len(wrong)} findings", *wrong]))
    if update:
        pages.update("docs/assurance.md", "sanitize", page(rows))
