"""Static analysis of lib/: complexity, gcc -fanalyzer, clang-tidy, cppcheck with MISRA C:2012, Frama-C's Eva.

What they may say is in test/static/, each with its reason; what they say beyond that is a finding.
"""

import itertools
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import lizard

from ..plumbing import pages
from ..plumbing.checkout import ROOT
from ..plumbing.command import need
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, progress, write_json
from ..plumbing.sources import regulators

LIB = ROOT / "lib"
FOLDER = ROOT / "test/static"
BUILD = ROOT / "build/static"
DEVIATIONS = FOLDER / "deviations.txt"
UNITS = ("koopf.c", "koopd.c", "koopf_supervisor.c", "koopd_supervisor.c")
INCLUDE = f"-I{LIB / 'include'}"
KERNELS = (0, 1)  # KOOP_VECTORS: lib/ has other kernels where there are vector registers

MOST_COMPLEX = 10  # McCabe's cyclomatic complexity, with each && and || as a branch

PROGRAMS = {"gcc": "gcc", "clang-tidy-19": "clang-tidy-19", "cppcheck": "cppcheck", "frama-c": "frama-c-base"}


# ---- the tools: each gives its findings as lines ---------------------------------------------------


def complexity():
    """Functions of lib/ above the limit."""
    files = [str(path) for path in sorted(LIB.rglob("*.c"))]
    functions = [function for file in lizard.analyze_files(files) for function in file.function_list]
    if not functions:
        raise UserError(f"{LIB}: no function found")
    return [
        f"{Path(function.filename).name}:{function.start_line}: {function.name.strip()} has complexity {function.cyclomatic_complexity}"
        for function in functions
        if function.cyclomatic_complexity > MOST_COMPLEX
    ]


def analyzer(unit, vectors):
    """gcc -fanalyzer, and all warnings."""
    warnings = "-Wall -Wextra -Wpedantic -Wconversion -Wshadow -Wdouble-promotion".split()
    text = run_command(
        "gcc", "-std=c99", "-O1", "-fanalyzer", *warnings, INCLUDE, f"-DKOOP_VECTORS={vectors}", "-c", LIB / unit, "-o", "/dev/null"
    )
    return [line for line in text.splitlines() if "warning:" in line]


def tidy(unit, vectors):
    config = FOLDER / "clang-tidy.yaml"
    command = ("clang-tidy-19", "--quiet", f"--config-file={config}", LIB / unit, "--", "-std=c99", INCLUDE, f"-DKOOP_VECTORS={vectors}")
    text = run_command(*command, passes=(0, 1))
    return [line for line in text.splitlines() if re.search(r"(warning|error): .*\[", line)]


def cppcheck(unit, vectors):
    """Findings as `misra RULE file:line`, or cppcheck's own."""
    options = "--std=c99 --enable=all --inconclusive --addon=misra --quiet".split()
    hidden = ("missingIncludeSystem", "unusedFunction", "unmatchedSuppression")  # the public functions are for the caller
    template = "--template={id} {file}:{line} {message}"
    scratch = BUILD / f"{unit}-{vectors}"  # else the addon writes beside the source
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir(parents=True)
    text = run_command(
        "cppcheck",
        *options,
        f"--cppcheck-build-dir={scratch}",
        *[f"--suppress={name}" for name in hidden],
        template,
        INCLUDE,
        f"-DKOOP_VECTORS={vectors}",
        LIB / unit,
    )
    lines = [line for line in text.splitlines() if line.strip()]
    return [re.sub(r"^misra-c2012-(\S+) (\S+) .*", r"misra \1 \2", line) for line in lines]


# Precision, and how many states are kept apart: of what was enough the fastest. The controller's Newton method is not
# among them: which rows its factor has depends on which inputs are free, and Eva keeps no such relation.
EVA = "-eva -eva-precision 0 -eva-split-return full -eva-slevel 70 -eva-auto-loop-unroll 200 -eva-no-print -warn-special-float none"
EVA_CONTROLLER = EVA.replace("slevel 70", "slevel 12")
EVA_SUPERVISOR = EVA.replace("slevel 70", "slevel 500")  # with 250 an init that fails is not distinguished from one that does not
REGULATORS = regulators()
FORMS = ("plain", "sqrt")


def eva_runs():
    """{name: (options, macros)} of what Eva is run on."""
    learner = {"LIFTED": 2, "INPUTS": 1, "REGULATOR": "koopf_reg_ef", "FORM": "koopf_form_sqrt"}
    runs = {"messages": (EVA.replace("slevel 70", "slevel 100000"), learner | {"MESSAGES": 1})}
    for regulator, form in itertools.product(REGULATORS, FORMS):
        for lifted, inputs, vectors in ((2, 1, 0), (5, 2, 1))[: 2 if regulator in ("ct", "sift") else 1]:
            macros = {"LEARNER": 1, "LIFTED": lifted, "INPUTS": inputs, "KOOP_VECTORS": vectors}
            macros |= {"REGULATOR": f"koopf_reg_{regulator}", "FORM": f"koopf_form_{form}"}
            runs[f"learner {regulator} {form} N={lifted}"] = (EVA, macros)
    for regulator, form in (("ef", "plain"), ("sift", "plain"), ("ct", "sqrt")):
        # CHECK decides how much storage there is, which Eva does not keep beside it
        macros = {"GATE": 1, "LIFTED": 2, "INPUTS": 1, "CHECK": "KOOP_CHECK_REFUSE", "KOOP_VECTORS": int(regulator == "ct")}
        runs[f"gate {regulator} {form}"] = (EVA, macros | {"REGULATOR": f"koopf_reg_{regulator}", "FORM": f"koopf_form_{form}"})
    for rate, vectors in itertools.product((0, 1), KERNELS):
        macros = {"CONTROLLER": 1, "LIFTED": 3, "INPUTS": 2, "HORIZON": 3, "METHOD": 1, "RATE": rate, "KOOP_VECTORS": vectors}
        runs[f"controller S={rate} vectors={vectors}"] = (EVA_CONTROLLER, macros | {"KOOP_MPC_MAX_GRADIENT": 3})
    macros = {
        "SUPERVISOR": 1,
        "LIFTED": 2,
        "INPUTS": 1,
        "HORIZON": 2,
        "METHOD": 1,
        "RATE": 0,
        "KOOP_VECTORS": 0,
        "KOOP_MPC_MAX_GRADIENT": 3,
    }
    runs["supervisor"] = (EVA_SUPERVISOR, macros | {"REGULATOR": "koopf_reg_ef", "FORM": "koopf_form_sqrt"})
    return runs


def read_eva(text):
    """Alarms of Eva's log as `eva FILE PREDICATE`; refuses a log of an analysis that did not come to its end."""
    if not re.search(r"alarms? generated by the analysis", text):
        raise UserError(f"Eva gave no result: {text.strip().splitlines()[-1] if text.strip() else 'nothing printed'}")
    joined = re.sub(r"\n\s+", " ", text)  # an alarm's lines
    alarms = re.findall(r"\[eva:alarm\] (\S+?):\d+: Warning: (?:.*assert \\)?(\w+)", joined)
    return [f"eva {Path(file).name} {what}" for file, what in alarms]


def eva(options, macros):
    flags = " ".join([INCLUDE, "-std=c99", *[f"-D{name}={value}" for name, value in macros.items()]])
    return read_eva(
        run_command(
            "frama-c", *options.split(), "-machdep", "gcc_x86_64", f"-cpp-extra-args={flags}", FOLDER / "eva.c", LIB / "koopf.c", LIB / "koopf_supervisor.c",
            timeout=1200,
        )
    )  # fmt: skip


# ---- what is accepted ------------------------------------------------------------------------------


def read_deviations(text):
    """{what: reason}"""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    deviations = {}
    for line in lines:
        what, colon, reason = line.partition(": ")
        if not colon or not reason.strip():
            raise UserError(
                f"{DEVIATIONS}: '{line}' gives no reason; write 'misra RULE: reason', 'eva FILE PREDICATE: reason' or 'CHECK: reason'"
            )
        deviations[what] = reason
    return deviations


def judge(findings, deviations):
    """(findings that are not accepted, deviations that nothing needs)."""

    def accepted(line):
        return next((what for what in deviations if line == what or line.startswith(what + " ")), None)

    used = {accepted(line) for line in findings}
    return [line for line in findings if accepted(line) is None], [what for what in deviations if what not in used]


# ---- all of it --------------------------------------------------------------------------------------


def jobs():
    """{tool: functions}"""
    units = list(itertools.product(UNITS, KERNELS))
    return {
        "Eva": [partial(eva, *run) for run in eva_runs().values()],
        "cppcheck, MISRA C:2012": [partial(cppcheck, *unit) for unit in units],
        "clang-tidy": [partial(tidy, *unit) for unit in units],
        "gcc -fanalyzer": [partial(analyzer, *unit) for unit in units],
        "complexity": [complexity],
    }


HEADERS = ["", "runs", "accepted, with reason", "findings"]


def table(rows):
    """A line for each tool."""
    return [[row["tool"], row["runs"], row["accepted"], len(row["findings"])] for row in rows]


def run(out, update=False):
    """Writes static.json into `out`, and with `update` the table of docs/assurance.md; raises where something was found."""
    need(PROGRAMS)
    folder = output_folder(out)
    deviations = read_deviations(DEVIATIONS.read_text())
    work = [(tool, function) for tool, functions in jobs().items() for function in functions]
    with ThreadPoolExecutor(2) as pool:
        futures = [(tool, pool.submit(function)) for tool, function in work]
        seen = [(tool, future.result()) for tool, future in progress(futures, "static analysis")]

    rows = []
    for tool, functions in jobs().items():
        findings = [line for name, lines in seen if name == tool for line in lines]
        rows.append(
            {
                "tool": tool,
                "runs": len(functions),
                "accepted": len(findings) - len(judge(findings, deviations)[0]),
                "findings": judge(findings, deviations)[0],
            }
        )
    unneeded = judge([line for _, lines in seen for line in lines], deviations)[1]
    write_json(folder / "static.json", rows)
    print_table("Static analysis of lib/", HEADERS, table(rows))
    wrong = [f"{row['tool']}: {line}" for row in rows for line in row["findings"]]
    wrong += [f"{DEVIATIONS.relative_to(ROOT)}: '{what}' is no longer needed" for what in unneeded]
    if wrong:
        raise UserError("\n".join([f"{len(wrong)} findings", *wrong]))
    if update:
        pages.update("docs/assurance.md", "static", pages.table("`make static`", HEADERS, table(rows)))
