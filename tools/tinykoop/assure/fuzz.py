"""libFuzzer with AddressSanitizer and UBSan on the CSV reader, every public call, sequences of calls, stored models.

New inputs are kept in build/fuzz/corpus. `build/venv/bin/python -m tinykoop.assure.fuzz` makes the corpus in test/fuzz/corpus
again from these and from itself; what has a name of its own there is the input of a mended finding and stays.
"""

import os
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor

from ..plumbing import pages
from ..plumbing.checkout import ROOT
from ..plumbing.command import need
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, progress, write_json

COMMITTED = ROOT / "test/fuzz/corpus"
BUILD = ROOT / "build/fuzz"
COMPILER, PACKAGES = "clang-19", "clang-19 libclang-rt-19-dev"

# Each target with the corpus it shares with its variants.
TARGETS = {f"{corpus}_{variant}": corpus for corpus in ("calls", "sequence", "model") for variant in ("koopf", "koopd", "scalar")} | {
    "csv": "csv"
}
LONGEST = 800  # bytes of an input: what is longer is slower and reaches no more
SLOWEST = 10  # seconds for one input, beyond which it is a finding


# ---- what libFuzzer prints -----------------------------------------------------------------------------


def executions(text):
    """How many inputs were tried."""
    numbers = re.findall(r"^stat::number_of_executed_units: (\d+)$", text, re.M)
    if not numbers:
        raise UserError(f"libFuzzer gave no count of executions:\n{text[-600:]}")
    return int(numbers[-1])


def finding(text):
    """{"input", "report"} of a run that was stopped, else None."""
    written = re.search(r"Test unit written to (\S+)", text)
    if not written:
        return None
    lines = text.splitlines()
    telling = ("FINDING ", "ERROR: ", "runtime error: ")
    first = next((i for i, line in enumerate(lines) if any(word in line for word in telling)), 0)
    frames = [line.strip() for line in lines[first + 1 :] if re.match(r"\s+#\d+ .*/(lib|host_sim|test)/\S+\.c:\d+", line)]
    return {"input": written[1], "report": [lines[first], *frames[:5]]}


def complaint(target, found, program):
    """What the user is told of a finding."""
    return "\n".join(
        [f"{target}: {found['report'][0]}", *[f"    {line}" for line in found["report"][1:]], f"  again: {program} {found['input']}"]
    )


# ---- runs -------------------------------------------------------------------------------------------------


def program(target):
    return BUILD / f"tree/test/fuzz/fuzz_{target}"


def build():
    """All targets, with the sanitizers."""
    need({COMPILER: PACKAGES, "cmake": "cmake"})
    probe = ["-fsanitize=fuzzer,address,undefined", "-x", "c", "-", "-o", os.devnull]
    source = "int LLVMFuzzerTestOneInput(const unsigned char *data, unsigned long size) { return !data && size; }"
    if subprocess.run([COMPILER, *probe], input=source, capture_output=True, text=True).returncode:
        raise UserError(f"missing: libFuzzer and the sanitizers of {COMPILER}. On Debian: sudo apt-get install {PACKAGES}")
    tree = BUILD / "tree"
    run_command("cmake", "-S", ROOT, "-B", tree, f"-DCMAKE_C_COMPILER={COMPILER}", "-DTINYKOOP_FUZZ=ON", "-DTINYKOOP_HOST=OFF")
    run_command("cmake", "--build", tree, "-j", os.cpu_count())


def call(target, *arguments, timeout):
    """What one run of a target prints."""
    environment = os.environ | {"ASAN_OPTIONS": "quarantine_size_mb=16", "UBSAN_OPTIONS": "print_stacktrace=1"}
    command = [program(target), *map(str, arguments)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", env=environment, timeout=timeout)
    except subprocess.TimeoutExpired:
        raise UserError(f"{target}: timeout after {timeout:.0f} s")
    return done.stdout + done.stderr


def fuzz(target, seconds):
    """A row of fuzz.json and the finding, or None."""
    corpus, findings = BUILD / "corpus" / TARGETS[target], BUILD / "findings"
    corpus.mkdir(parents=True, exist_ok=True)
    findings.mkdir(parents=True, exist_ok=True)
    words = [f"-dict={ROOT / 'test/fuzz/csv.dict'}"] if target == "csv" else []
    limits = [f"-max_total_time={max(1, round(seconds))}", f"-timeout={SLOWEST}", f"-max_len={LONGEST}", "-len_control=20"]
    kept = [f"-artifact_prefix={findings}/{target}-", "-print_final_stats=1", corpus, COMMITTED / TARGETS[target]]
    text = call(target, *words, *limits, *kept, timeout=seconds + 300)
    found = finding(text)
    return {"target": target, "executions": executions(text), "findings": int(found is not None)}, found


def page(rows, seconds):
    """The table of docs/assurance.md."""
    pairs = [
        ("targets", len(rows)),
        ("inputs", f"{sum(row['executions'] for row in rows):,}"),
        ("findings", sum(row["findings"] for row in rows)),
    ]
    return pages.facts(f"`make fuzz SECONDS={seconds:g}`", pairs)


def run(out, seconds, update=False):
    """Writes fuzz.json into `out`, and with `update` the table of docs/assurance.md; raises where something was found."""
    if not seconds > 0:
        raise UserError(f"--seconds {seconds:g}: must be above 0")
    out = output_folder(out)
    build()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        runs = [(target, pool.submit(fuzz, target, seconds)) for target in TARGETS]
        done = [(target, *run.result()) for target, run in progress(runs, "fuzzing")]
    rows = [row for _, row, _ in done]
    complaints = [complaint(target, found, program(target)) for target, _, found in done if found]
    write_json(out / "fuzz.json", rows)
    print_table(f"Fuzzing, {seconds:g} s each", ["target", "executions", "findings"], [list(row.values()) for row in rows])
    if complaints:
        raise UserError("\n".join(complaints))
    if update:
        pages.update("docs/assurance.md", "fuzz", page(rows, seconds))
    return rows


# ---- the committed corpus -----------------------------------------------------------------------------------


def is_regression(path):
    """Whether it was named by hand; libFuzzer names inputs by their SHA-1."""
    return not re.fullmatch(r"[0-9a-f]{40}", path.name)


def renew():
    """Replaces the committed corpus by few inputs that reach as much as it and build/fuzz/corpus do."""
    build()
    for corpus in dict.fromkeys(TARGETS.values()):
        fresh, committed, gathered = BUILD / "fresh" / corpus, COMMITTED / corpus, BUILD / "corpus" / corpus
        shutil.rmtree(fresh, ignore_errors=True)
        for folder in (fresh, committed, gathered):
            folder.mkdir(parents=True, exist_ok=True)
        for target in [target for target, shared in TARGETS.items() if shared == corpus]:
            text = call(target, "-set_cover_merge=1", "-use_counters=0", f"-max_len={LONGEST}", fresh, committed, gathered, timeout=3600)
            if found := finding(text):
                raise UserError(complaint(target, found, program(target)))
        for path in committed.iterdir():
            if not is_regression(path):
                path.unlink()
        names = {path.read_bytes() for path in committed.iterdir()}
        for path in fresh.iterdir():
            if path.read_bytes() not in names:
                shutil.copy(path, committed / path.name)
        print(f"{corpus}: {len(list(committed.iterdir()))} inputs, {sum(path.stat().st_size for path in committed.iterdir())} bytes")


if __name__ == "__main__":
    renew()
