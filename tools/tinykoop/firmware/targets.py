"""Builds for microcontrollers, runs on QEMU: tests, closed loop, footprint.

A target is a folder of targets/ with a toolchain.cmake and a memory.ld. Where the toolchain names a QEMU
machine, the C tests and the closed loop run there and instructions are counted; the others are only sized.
Where the timing of the processor is known, cycles are estimated too (cycles.py).
"""

import json
import math
import os
import re
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial, reduce
from pathlib import Path

from ..plumbing import pages
from ..plumbing.checkout import ROOT
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, progress, write_json
from ..plumbing.sources import regulators
from . import boards, callgraph, cycles

FOLDER = ROOT / "targets"
BUILD = ROOT / "build/targets"
COMMITTED = FOLDER / "footprint.json"
WEIGH = BUILD / "host/targets/common/libweigh.so"  # the plugin of QEMU that sums cycles

LEVELS = {"O2": "RelWithDebInfo", "Os": "MinSizeRel"}
GROWTH = 0.05  # of a figure, that is let pass
STACK = 512  # bytes, of any public call
SLACK = 16  # bytes of stack that paint cannot tell
AGREE = 16, 0.001  # instructions, and share of them, by which the plugin and the clock of QEMU may differ

# Tests that are not run on a target: (target, test, why).
LEFT_OUT = (
    (".*", "mpc_random_.*", "a campaign of 30,000 solves, minutes under emulation; in double its arrays exceed the M4F's RAM"),
    (".*", "elementary_koopd", "holds against long double, which is no wider than double there, or computed in software"),
    ("(?!cortex-m7)", "supervisor_koopf", "dozens of closed loops, a minute or more: run on one target"),
    (".*", "supervisor_koopd", "the same, and the code is supervisor_koopf's"),
    (
        "rv32imafc",
        "long_run_koopf",
        "compares in double, which is computed in software: half a minute; it is so on the M4F too, where this runs",
    ),
    (
        "(?!cortex-m7)",
        "(regulators|covariance|long_run|mpc|mpc_limits|refusal|extremes|gate|flips)_koopd",
        "double is computed in software, minutes under emulation",
    ),
    (
        "(?!cortex-m7)",
        "(mpc_steps|mpc_factor|mpc_round_off|gate_rules|supervisor_reference|forms)_koopd",
        "the same, or exceeds the M4F's RAM",
    ),
)

# What lib/ may ask of its surroundings in float32. Not on the list: any double arithmetic, heap, printing.
ALLOWED = re.compile(
    r"mem(cpy|move|set|cmp)|strlen|(sqrt|fabs)f"
    r"|__aeabi_(fadd|fsub|frsub|fmul|fdiv|fcmp(eq|lt|le|ge|gt|un)|f2u?iz|u?i2f|u?l2f|u?idiv|u?idivmod|lmul|llsl|llsr|mem(cpy|move|set|clr)[48]?)"
    r"|__(clz|ctz)[sd]i2|__gnu_thumb1_case_\w+"
)

LEARN = ("koopf_lift", "koopf_rbf_ddr", "koopf_rls_init", "koopf_rls_update", "koopf_reg_dz_cs", "koopf_form_sqrt")


# ---- what the system must have ---------------------------------------------------------------------


def _has_specs(compiler):
    done = subprocess.run([compiler, "-print-file-name=picolibc.specs"], capture_output=True, text=True)
    return Path(done.stdout.strip()).is_absolute()


def missing(which=shutil.which, has_specs=_has_specs):
    """Debian packages that are needed and not there."""
    packages = []
    for prefix, compiler, libc in (
        ("arm-none-eabi-", "gcc-arm-none-eabi", "picolibc-arm-none-eabi"),
        ("riscv64-unknown-elf-", "gcc-riscv64-unknown-elf", "picolibc-riscv64-unknown-elf"),
    ):
        there = which(f"{prefix}gcc")
        packages += [] if there else [compiler]
        packages += [] if there and has_specs(f"{prefix}gcc") else [libc]
    packages += [] if which("qemu-system-arm") else ["qemu-system-arm"]
    packages += [] if which("qemu-system-riscv32") else ["qemu-system-misc"]
    return packages


# ---- one build tree --------------------------------------------------------------------------------


class Tree:
    """The build of one target at one optimisation level."""

    def __init__(self, target, level):
        self.target, self.level = target, level
        self.folder = BUILD / f"{target}-{level}"
        text = (FOLDER / target / "toolchain.cmake").read_text()
        self.prefix = re.search(r"set\(TARGET_COMPILER (\S+)\)", text)[1]
        self.flags = re.search(r"set\(TARGET_FLAGS (.+)\)", text)[1].split()
        self.runs = "set(TARGET_QEMU " in text
        self.tested = self.runs and level == "O2"

    def build(self, tests=True):
        options = {
            "CMAKE_TOOLCHAIN_FILE": FOLDER / self.target / "toolchain.cmake",
            "CMAKE_BUILD_TYPE": LEVELS[self.level],
            "TINYKOOP_HOST": "OFF",
            "TINYKOOP_TESTS": "ON" if self.runs else "OFF",
            "TINYKOOP_TARGETS": "ON" if self.runs else "OFF",
        }
        run_command("cmake", "-S", ROOT, "-B", self.folder, *[f"-D{name}={value}" for name, value in options.items()])
        programs = ["tinykoop"] + (["closed_loop", "footprint"] if self.runs else [])
        programs += [f"test_{name}" for name in self.tests()] if self.tested and tests else []
        run_command("cmake", "--build", self.folder, "--target", *programs)

    def ctest(self):
        return json.loads(run_command("ctest", "--test-dir", self.folder, "--show-only=json-v1"))["tests"]

    def tests(self):
        """{name: command} of those to be run."""
        return {test["name"]: test["command"] for test in self.ctest() if not left_out(self.target, test["name"])}

    def emulate(self, program, *options):
        """What a program of targets/common prints; QEMU is called as CTest calls it."""
        *qemu, kernel, _ = self.ctest()[0]["command"]
        return run_command(*qemu, *options, kernel, self.folder / "targets/common" / program)

    def counts(self, program="footprint"):
        """What footprint prints, and the plugin's sums between its lines where cycles are estimated."""
        return self.emulate(program, "-icount", "shift=0", *self.weighing(self.folder / "targets/common" / program))

    def weighing(self, program):
        """Options of QEMU for the plugin; none where cycles are not estimated."""
        if self.target not in cycles.ESTIMATES:
            return []
        table = program.with_name(f"{program.name}_weights.txt")
        table.write_text(cycles.weights(self.target, self.tool("objdump", "-d", program)))
        return ["-plugin", ",".join([_escaped(WEIGH), f"table={_escaped(table)}"])]

    def tool(self, name, *arguments):
        return run_command(f"{self.prefix}{name}", *arguments)

    @property
    def object(self):
        return self.folder / "CMakeFiles/tinykoop.dir/lib/koopf.c.obj"


def _escaped(path):
    """As QEMU reads it in a list."""
    return str(path).replace(",", ",,")


def left_out(target, test):
    """Why a test is not run on a target, or None."""
    return next((why for where, what, why in LEFT_OUT if re.fullmatch(f"{where}.*", target) and re.fullmatch(what, test)), None)


# ---- closed loop ------------------------------------------------------------------------------------


def read_runs(text):
    """{run: rows of floats} of what closed_loop prints."""
    runs, rows = {}, None
    for line in text.splitlines():
        if line.startswith("run "):
            rows = runs.setdefault(line[4:], [])
        elif rows is not None and line:
            rows.append([float.fromhex(value) for value in line.split()])
    return runs


def largest_difference(ours, theirs):
    """Largest difference of two runs' poses and inputs, relative to the largest value of its column."""
    if len(ours) != len(theirs) or not ours:
        return math.inf
    scale = [max(map(abs, column)) or 1.0 for column in zip(*ours)]
    differences = [abs(a - b) / s for row, other in zip(ours, theirs) for a, b, s in zip(row, other, scale)]
    return max(differences) if all(map(math.isfinite, differences)) else math.inf


def compare_loops(ours, theirs):
    """{run: largest_difference}."""
    ours, theirs = read_runs(ours), read_runs(theirs)
    if not ours:
        raise UserError("the host's closed loop printed nothing")
    return {name: largest_difference(rows, theirs.get(name, [])) for name, rows in ours.items()}


def host_loop():
    """What closed_loop prints on the host."""
    folder = BUILD / "host"
    run_command("cmake", "-S", ROOT, "-B", folder, "-DTINYKOOP_HOST=OFF", "-DTINYKOOP_TARGETS=ON")
    run_command("cmake", "--build", folder)
    return run_command(folder / "targets/common/closed_loop")


# ---- footprint --------------------------------------------------------------------------------------


def linked_size(tree, roots):
    """{text, data, bss} of the library's object once a linker has thrown away what `roots` do not need."""
    part = tree.folder / "part.o"
    keep = [f"-Wl,-u,{name}" for name in roots]
    tree.tool("gcc", *tree.flags, "-r", "-nostdlib", "-Wl,--gc-sections", *keep, tree.object, "-o", part)
    text, data, bss = tree.tool("size", part).splitlines()[1].split()[:3]
    return {"text": int(text), "data": int(data), "bss": int(bss)}


def public_names(tree):
    lines = tree.tool("nm", "-g", "--defined-only", tree.object).splitlines()
    return [line.split()[-1] for line in lines]


def foreign_names(symbols):
    """Of `nm -u`: what is not on the list of what lib/ may ask for."""
    return sorted(name for name in symbols.split() if name != "U" and not ALLOWED.fullmatch(name))


def stack(tree):
    """{public function: bytes, with all that it may call}; refuses recursion."""
    graph = tree.object.with_suffix(".ci").read_text()
    tables = callgraph.held_in_tables(tree.tool("objdump", "-r", tree.object))
    if name := callgraph.cycle(callgraph.calls(graph, tables)):
        raise UserError(f"{tree.target}: {name} is recursive")
    return {name: size for name, (size, _) in sorted(callgraph.deepest(graph, tables).items())}


@dataclass
class Counted:
    """What the program footprint prints."""

    instructions: dict  # {N: {(what, detail): (median, worst)}}
    cycles: dict  # the same, with a list for (median, worst): one for each estimate
    ram: dict  # {N: (learner, controller)}, bytes
    stack: dict  # {function: bytes}

    @classmethod
    def read(cls, text):
        seen, weighed = cls({}, {}, {}, {}), []
        for line in text.splitlines():
            kind, *words = line.split()
            if kind == "weighed":
                weighed.append(tuple(map(int, words)))
            elif kind == "instructions":
                n, what, detail, median, worst = words
                seen.instructions.setdefault(int(n), {})[what, detail] = (int(median), int(worst))
                if weighed:
                    seen.cycles.setdefault(int(n), {})[what, detail] = estimates(weighed, (int(median), int(worst)))
                weighed = []
            elif kind == "ram":
                seen.ram[int(words[0])] = tuple(map(int, words[1:]))
            elif kind == "stack":
                seen.stack[words[0]] = int(words[1])
        return seen


def estimates(weighed, counted):
    """(median, worst) of each estimate, of one function's calls; refuses sums that miss instructions."""
    calls = [call for call in weighed if any(call)]  # not the counter's own, of nothing
    instructions, *cycles = [(sorted(column)[len(column) // 2], max(column)) for column in zip(*calls)]
    for ours, theirs in zip(instructions, counted):
        if not math.isclose(ours, theirs, abs_tol=AGREE[0], rel_tol=AGREE[1]):
            raise UserError(f"the plugin weighed {ours} instructions where QEMU's clock counted {theirs}")
    return cycles


REGULATORS = regulators()
FORMS = {
    "sqrt": "rls_update",
    "plain-diagonal": "rls_update_plain",
    "plain": "rls_update_plain_checked",
    "checksum": "rls_update_checksum",
    "gate": "gate_update",
}
SIZES = (7, 22)


def instructions(counts):
    """The part of footprint.json; an update's figure is its worst, a solve's its median."""
    row = {"lift": counts["lift", "-"][0]}
    for form, key in FORMS.items():
        row[key] = {regulator: counts[regulator, form][1] for regulator in REGULATORS}
    row["mpc_solve"] = {kind: counts["mpc", kind][0] for kind in ("condense", "cold", "warm")}
    row["mpc_solve"]["worst"] = max(counts["mpc", kind][1] for kind in ("cold", "warm"))
    return row


def estimated(target, counts):
    """The part of footprint.json: the same figures in cycles, by each estimate of the target."""
    names = cycles.ESTIMATES[target]
    return {name: instructions({key: values[i] for key, values in counts.items()}) for i, name in enumerate(names)}


def check(row):
    """What must hold of a row, as lines of what does not: stack that a call took is held against the call graph's."""
    deep = [f"{name} may take {size} bytes of stack" for name, size in row["stack"].items() if size > STACK]
    for name, size in (row["stack_seen"] or {}).items():
        if size > row["stack"][name] + SLACK:
            deep.append(f"{name} took {size} bytes of stack, not {row['stack'][name]}")
    writable = [f"{row[name]} bytes of writable globals in {name}" for name in ("data", "bss") if row[name]]
    foreign = [f"koopf.c needs {name}" for name in row["foreign"]]
    return [f"{row['target']} -{_level(row)}: {line}" for line in deep + writable + foreign]


def footprint(tree, printed):
    """Rows of footprint.json for one target and level; `printed` by its footprint program, or None."""
    everything = linked_size(tree, public_names(tree))
    counted = Counted.read(printed) if printed else None
    return [
        {
            "target": tree.target,
            "precision": "f32",
            "config": f"N{n}_m2_H50_{tree.level}",
            **everything,
            "text_learn": linked_size(tree, LEARN)["text"],
            "foreign": foreign_names(tree.tool("nm", "-u", tree.object)),
            "stack": stack(tree),
            "stack_seen": counted and counted.stack,
            "ram": counted and dict(zip(("learn", "control"), counted.ram[n])),
            "instructions": counted and instructions(counted.instructions[n]),
            "cycles": estimated(tree.target, counted.cycles[n]) if counted and counted.cycles else None,
        }
        for n in SIZES
    ]


# ---- against what is committed ------------------------------------------------------------------------


def figures(rows):
    """{"target config key ..": number} of rows of footprint.json."""
    flat = {}

    def walk(path, value):
        if isinstance(value, dict):
            for key, item in value.items():
                walk((*path, key), item)
        elif isinstance(value, (int, float)):
            flat[" ".join(path)] = value

    for row in rows:
        walk((row["target"], row["config"]), {key: item for key, item in row.items() if key not in ("target", "config")})
    return flat


def changes(committed, now):
    """One line for each figure that grew by more than GROWTH, is new, or is gone."""
    old, new = figures(committed), figures(now)
    lines = [f"{name}: {new[name]}, was {old[name]}" for name in new if name in old and new[name] > old[name] * (1 + GROWTH)]
    lines += [f"{name}: {new[name]}, is new" for name in new if name not in old]
    return lines + [f"{name}: gone, was {old[name]}" for name in old if name not in new]


def read_committed():
    if not COMMITTED.exists():
        return []
    try:
        return json.loads(COMMITTED.read_text())
    except json.JSONDecodeError as error:
        raise UserError(f"{COMMITTED}: {error}")


HEADERS = [
    "target", "config", "code", "learn", "stack", "lift", "plain", "sqrt", "condense k", "warm k", "cold k", "worst k",
]  # fmt: skip


def table(rows):
    """Cells of the table on the terminal: a line for each target, size and level."""
    lines = []
    for row in rows:
        line = [row["target"], row["config"].replace("_m2_H50", ""), row["text"], row["text_learn"], max(row["stack"].values())]
        if count := row["instructions"]:
            mpc = count["mpc_solve"]
            line += [count["lift"], count["rls_update_plain"]["ef"], count["rls_update"]["ef"]]
            line += [round(mpc[key] / 1000) for key in ("condense", "warm", "cold", "worst")]
        lines.append([cell if isinstance(cell, str) else _grouped(cell) for cell in line + [None] * (len(HEADERS) - len(line))])
    return lines


def time_table(rows):
    """Cells of the table of cycles on the terminal."""
    return [
        [row["target"], row["config"].replace("_m2_H50", ""), name, *map(_grouped, _decisive(count))]
        for row in rows
        for name, count in _estimates(row)
    ]


def _grouped(value):
    return "-" if value is None else f"{value:,}"


def _estimates(row):
    """(estimate, its figures) of a row; none where no cycles are estimated."""
    return (row.get("cycles") or {}).items()


def _level(row):
    return row["config"].rsplit("_", 1)[1]


def _size(row):
    return int(row["config"].split("_")[0][1:])


def _counts_table(caption, columns):
    """A line for each function, of {header: figures as in a row's "instructions"}."""
    lines = []
    for key, value in next(iter(columns.values()), {}).items():
        names = [(key, part) for part in value] if isinstance(value, dict) else [(key,)]
        for name in names:
            cells = [reduce(lambda tree, part: tree[part], name, column) for column in columns.values()]
            lines.append([" ".join([NAMES[key], *name[1:]]), *map(_grouped, cells)])
    return pages.table(caption, ["", *columns], lines)


def _instructions_table(rows, level):
    counted = [row for row in rows if row["instructions"] and _level(row) == level]
    columns = {f"{row['target']} N = {_size(row)}": row["instructions"] for row in counted}
    return _counts_table(f"Instructions at -{level}, m = 2, horizon 50", columns)


def _cycles_table(rows, level):
    columns = {
        f"{row['target']} N = {_size(row)}, {name}": figures for row in rows if _level(row) == level for name, figures in _estimates(row)
    }
    return _counts_table(f"Cycles at -{level}, m = 2, horizon 50, estimated", columns)


NAMES = {
    "lift": "lift",
    "rls_update": "update, square root,",
    "rls_update_plain": "update, plain, diagonal checked,",
    "rls_update_plain_checked": "update, plain, factored at every sample,",
    "rls_update_checksum": "update, square root, with a checksum,",
    "gate_update": "update, square root, behind the gate,",
    "mpc_solve": "MPC",
}


def markdown(rows):
    """All of footprint.json as tables, and what was measured on boards."""
    once = [row for row in rows if _size(row) == SIZES[0]]
    code = [[f"{row['target']} -{_level(row)}", *map(_grouped, (row["text"], row["text_learn"], row["data"], row["bss"]))] for row in once]
    functions = sorted({name for row in once for name in row["stack"]})
    depth = [[f"`{name}`", *[_grouped(row["stack"].get(name)) for row in once]] for name in functions]
    ram = {_size(row): row["ram"] for row in rows if row["ram"]}
    memory = [[f"N = {n}, m = 2, horizon 50", *map(_grouped, both.values())] for n, both in ram.items()]
    parts = [
        pages.table("Bytes of code, koopf.c", ["", "everything", "lift and update only", "data", "bss"], code),
        pages.table("Bytes of the caller's RAM", ["", "learner, square root", "controller"], memory),
        pages.table("Bytes of stack", ["", *[f"{row['target']} -{_level(row)}" for row in once]], depth),
        *[_instructions_table(rows, level) for level in LEVELS],
        *[_cycles_table(rows, level) for level in LEVELS],
        boards.table(boards.read()),
    ]
    return "\n".join(filter(None, parts))


def _decisive(count, regulator="dz_cs"):
    """Of a row's counts: lift, update of both forms, solves."""
    updates = [count[key][regulator] for key in ("rls_update_plain", "rls_update")]
    return [count["lift"], *updates, *[count["mpc_solve"][key] for key in ("warm", "cold", "worst")]]


DECISIVE = ["lift", "update, plain", "square root", "MPC warm", "cold", "worst"]


def summary(rows):
    """What decides, at the larger size."""
    chosen = [row for row in rows if _size(row) == max(SIZES) and _level(row) == "O2"]
    lines = []
    for row in chosen:
        counts = _decisive(row["instructions"]) if row["instructions"] else [None] * len(DECISIVE)
        lines.append([row["target"], *map(_grouped, [row["text"], row["text_learn"], max(row["stack"].values()), *counts])])
    caption = "float32, -O2, N = 22, m = 2, horizon 50, `dz_cs`"
    time = [[f"{row['target']}, {name}", *map(_grouped, _decisive(count))] for row in chosen for name, count in _estimates(row)]
    return "\n".join(
        [
            pages.table(f"Bytes and instructions, {caption}", ["", "code, all", "lift, update", "stack", *DECISIVE], lines),
            pages.table(f"Cycles, estimated, {caption}", ["", *DECISIVE], time),
        ]
    )


def headlines(rows):
    """{name: figure} of the README, on a Cortex-M4F at the larger size."""
    (row,) = [r for r in rows if (r["target"], _size(r), _level(r)) == ("cortex-m4f", max(SIZES), "O2")]
    return {"ram": f"{row['ram']['learn'] / 1000:.1f} kB", "instructions": _grouped(row["instructions"]["rls_update"]["dz_cs"])}


PAGES = {"docs/benchmarks.md": summary, "targets/README.md": markdown}


# ---- all of it ----------------------------------------------------------------------------------------


def targets():
    return sorted(path.parent.name for path in FOLDER.glob("*/toolchain.cmake") if path.parent.name != "common")


def loops(tree, host):
    """{run: difference from the host's}, which must be none."""
    seen = compare_loops(host, tree.emulate("closed_loop"))
    for name, difference in seen.items():
        if difference:
            raise UserError(f"{tree.target} {tree.level}: closed loop {name} differs from the host's by {difference:.2g}")
    return seen


def jobs(trees, host):
    """{(target, level, what): function}, the long ones first: among the tests these are the last."""
    tests = [(tree, name, command) for tree in trees if tree.tested for name, command in tree.tests().items()]
    work = {(tree.target, tree.level, name): partial(run_command, *command) for tree, name, command in reversed(tests)}
    for tree in trees:
        if tree.runs:
            work[tree.target, tree.level, "loops"] = partial(loops, tree, host)
            work[tree.target, tree.level, "counts"] = tree.counts
    return work


def attempt(function):
    """Its result, or the UserError it raised: one target's failure does not hide the others'."""
    try:
        return function()
    except UserError as error:
        return error


def side_by_side(functions, description):
    """Their results; on all cores. Where one raises, those not yet begun are dropped."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        started = [pool.submit(function) for function in functions]
        try:
            return [future.result() for future in progress(started, description)]
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def run(out, update=False):
    """Writes footprint.json into `out`; raises where a test fails, a loop differs or a figure grew."""
    if packages := missing():
        raise UserError(f"missing Debian packages: sudo apt-get install {' '.join(packages)}")
    out = output_folder(out)
    trees = [Tree(target, level) for target in targets() for level in LEVELS]
    side_by_side([tree.build for tree in trees], "building")
    work = jobs(trees, host_loop())
    results = dict(zip(work, side_by_side([partial(attempt, function) for function in work.values()], "running on QEMU")))
    failures = [str(result) for result in results.values() if isinstance(result, UserError)]
    done = {what: result for what, result in results.items() if not isinstance(result, UserError)}

    rows = []
    for tree in trees:
        rows += footprint(tree, done.get((tree.target, tree.level, "counts")))
    write_json(out / "footprint.json", rows)
    report(trees, rows, done)
    failures += dict.fromkeys(line for row in rows for line in check(row))
    if failures:
        raise UserError("\n".join(failures))
    if update:
        write_json(COMMITTED, rows)
        for page, tables in PAGES.items():
            pages.update(page, "footprint", tables(rows))
        for name, value in headlines(rows).items():
            pages.headline(name, value)
    elif lines := changes(read_committed(), rows):
        raise UserError("\n".join(["figures against targets/footprint.json (make targets UPDATE=1 updates them):", *lines]))
    return rows


def report(trees, rows, done):
    print_table(
        "Footprint, float32: bytes of code and of the deepest stack; instructions",
        HEADERS,
        table(rows),
        "learn: lift and update only. plain, sqrt: update by ef in that form. k: thousands, of an MPC solve.",
    )
    print_table("Cycles, estimated from the processor's timing: dz_cs", ["target", "config", "estimate", *DECISIVE], time_table(rows))
    lines = []
    for target in dict.fromkeys(tree.target for tree in trees if tree.runs):
        seen = {level: done.get((target, level, "loops"), {}) for level in LEVELS}
        for name in seen["O2"]:
            lines.append([f"{target} {name}", *[number(loops.get(name), 2) for loops in seen.values()]])
    headers = ["run", *[f"-{level}" for level in LEVELS]]
    print_table("500 closed-loop steps against the host's float32: largest relative difference", headers, lines)
    passed = [[tree.target, sum((tree.target, tree.level, name) in done for name in tree.tests())] for tree in trees if tree.tested]
    print_table("C tests on QEMU", ["target", "passed"], passed)
