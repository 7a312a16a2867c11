"""Estimates of processor cycles, of what QEMU executes.

QEMU has no cycles. The plugin targets/common/weigh.c adds up a weight for each instruction that is executed between
two marks; here the weights are made, from the disassembly of the program and a table of the processor's timing.
Zero wait states are assumed, and that a conditional instruction is executed.

Cortex-M4: Arm's Technical Reference Manual (DDI 0439), Table 3-1, its load and store timings, and Table 7-1.
Cortex-M7: Arm has not published its timing. Units and latencies are those of LLVM's ARMScheduleM7.td.
"""

import re
from dataclasses import dataclass
from functools import cached_property

CONDITION = "(?:eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le)?"

# The mnemonics of each kind, without the suffixes of condition, flags, width and type.
KINDS = {
    "integer": "add|addw|adc|sub|subw|sbc|rsb|mov|movw|movt|mvn|and|orr|orn|eor|bic|lsl|lsr|asr|ror|rrx|cmp|cmn|tst|teq|adr|clz"
    "|neg|rbit|rev|rev16|[su]xta?[bh]|[us]bfx|bfi|bfc|[us]sat|it[te]{0,3}|nop",
    "multiply": "mul|mla|mls|[su]mull|[su]mlal|smul[bt][bt]|smla[bt][bt]",
    "divide": "[su]div",
    "load": "ldrs?[bh]?",
    "store": "str[bh]?",
    "multiple": "ldmia|ldmdb|stmia|stmdb|push|pop|ldrd|strd|vldmia|vldmdb|vstmia|vstmdb|vpush|vpop",
    "branch": "b|bl|bx|blx|cbn?z|tb[bh]",
    "float": "vadd|vsub|vn?mul|vabs|vneg|vcmpe?|vcvtr?|vmov|vmrs|vmsr|vsel|vmaxnm|vminnm",
    "accumulate": "vn?ml[as]|vfn?m[as]",
    "root": "vdiv|vsqrt",
    "float load": "vldr",
    "float store": "vstr",
}
PATTERNS = {kind: re.compile(rf"(?:{names})s?{CONDITION}(?:\.\w+)*") for kind, names in KINDS.items()}
FLOAT = ("float", "accumulate", "root")
MEMORY = ("load", "store", "multiple", "float load", "float store")
# Of these with two operands, the first is only written.
COPIES = re.compile(r"mov|movw|mvn|adr|clz|rbit|rev|rev16|[su]xt[bh]|v(mov|abs|neg|cvtr?|sqrt)")

LINE = re.compile(r" *([0-9a-f]+):\t([0-9a-f ]+?) *\t(\S+)(?:\t([^;@<]*))?")
REGISTER = re.compile(r"\b([rsd])(\d+)(?:-[rsd](\d+))?\b|\b(sl|fp|ip|sp|lr|pc)\b")


def registers(text):
    """Names of registers in operands; a double register is its two halves, a range all of it."""
    names = set()
    for letter, first, last, other in REGISTER.findall(text):
        for number in range(int(first or 0), int(last or first or 0) + 1) if letter else ():
            names |= {f"s{2 * number}", f"s{2 * number + 1}"} if letter == "d" else {f"{letter}{number}"}
        names |= {other} if other else set()
    return names


@dataclass(frozen=True)
class Instruction:
    """One line of objdump."""

    address: int
    size: int  # bytes
    mnemonic: str
    operands: str

    @cached_property
    def kind(self):
        return next((kind for kind, pattern in PATTERNS.items() if pattern.fullmatch(self.mnemonic)), None)

    @cached_property
    def parts(self):
        return [part.strip() for part in self.operands.split(",")]

    @cached_property
    def moved(self):
        """Number of words of a multiple load or store."""
        if "{" not in self.operands:
            return 2
        return len(registers(self.operands[self.operands.index("{") :]))

    @cached_property
    def is_load(self):
        return self.kind in ("load", "float load") or self.kind == "multiple" and "st" not in self.mnemonic and "push" not in self.mnemonic

    @cached_property
    def writes(self):
        if self.kind in ("branch", "store", "float store") or re.match("v?cmp|cmn|tst|teq|it|nop", self.mnemonic):
            return set()
        if self.kind == "multiple":
            return registers(self.operands.partition("{")[2] or ",".join(self.parts[:2])) if self.is_load else set()
        return registers(",".join(self.parts[: 2 if "ull" in self.mnemonic or "lal" in self.mnemonic else 1]))

    @cached_property
    def reads(self):
        both = len(self.parts) == 2 and self.kind in ("integer", "multiply", "float") and not COPIES.match(self.mnemonic)
        written = set() if both or self.kind == "accumulate" else self.writes
        return registers(",".join(self.parts[1:]) if written else self.operands)

    @cached_property
    def address_registers(self):
        if self.kind not in MEMORY:
            return set()
        return registers(self.operands.partition("[")[2] or self.operands.partition("{")[0])

    @cached_property
    def jumps(self):
        """Whether it always goes elsewhere."""
        return self.mnemonic in ("b", "b.n", "b.w", "bx", "tbb", "tbh") or self.kind in ("load", "multiple") and "pc" in self.writes


def disassembled(text):
    """Instructions of `objdump -d`."""
    found = []
    for line in text.splitlines():
        if match := LINE.match(line):
            address, raw, mnemonic, operands = match.groups()
            found.append(Instruction(int(address, 16), len(raw.replace(" ", "")) // 2, mnemonic, (operands or "").strip()))
    return found


# ---- Cortex-M4 ---------------------------------------------------------------------------------------

REFILL = 2  # cycles to refill the pipeline after a branch that is taken: 1 to 3, by alignment and width of the target


def _m4_alone(now, accumulate):
    """Cycles by the tables, whatever is around it."""
    if now.kind == "multiple":
        return 1 + now.moved
    if now.kind == "store":
        return 1 if "#" in now.operands or len(now.parts) == 2 else 2
    cycles = {"divide": 12, "root": 14, "accumulate": accumulate, "load": 2, "float load": 2, "float store": 2}.get(now.kind, 1)
    double = now.kind in ("float load", "float store") and now.parts[0].startswith("d")
    return cycles + double + (now.mnemonic.startswith("tb"))


def _m4_waits(before, now):
    """Cycles more or less since `now` follows `before`."""
    if before.kind == "load" and now.kind in ("load", "store") and _m4_alone(now, 0) == 2:
        return 0 if before.writes & now.address_registers else -1
    if before.kind in ("integer", "multiply") and before.writes & now.address_registers:
        return 1
    return 1 if before.kind in FLOAT and before.writes & now.reads else 0


def cortex_m4(program, accumulate=3):
    """[(cycles, cycles more if the branch is taken)]; `accumulate`: cycles of VMLA, VFMA and their like."""
    costs, before = [], None
    for now in program:
        cycles = _m4_alone(now, accumulate)
        if before and before.address + before.size == now.address and not before.jumps:
            cycles += _m4_waits(before, now)
        costs.append((cycles, REFILL if now.kind == "branch" or now.jumps else 0))
        before = now
    return costs


# ---- Cortex-M7 ---------------------------------------------------------------------------------------

# Cycles until a result can be used, and the unit of which there is one; an integer unit there is for each slot.
M7 = {
    "integer": (1, None),
    "multiply": (2, "multiplier"),
    "divide": (7, "all"),
    "load": (2, "memory"),
    "store": (1, "memory"),
    "multiple": (2, "all"),
    "branch": (1, "branch"),
    "float": (3, "float"),
    "accumulate": (6, "float"),
    "root": (16, "float"),
    "float load": (2, "memory"),
    "float store": (1, "memory"),
}
EARLIER = 3  # cycles that an accumulator may come later than the factors
DOUBLES = {"float": 4, "accumulate": 11, "root": 30}


class _Pipeline:
    """In-order issue of up to `slots` instructions in a cycle."""

    def __init__(self, slots):
        self.slots = slots
        self.cycle = 0
        self.issued = 0  # instructions in this cycle
        self.ready = {}  # register: cycle
        self.free = {}  # unit: cycle

    def _start(self, now, unit):
        """First cycle at which its operands and its unit are there."""
        late = now.writes if now.kind == "accumulate" else set()
        operands = [self.ready.get(name, 0) - (EARLIER if name in late else 0) for name in now.reads]
        units = self.free.values() if unit == "all" else [self.free.get(unit, 0), self.free.get("all", 0)]
        return max([self.cycle, *operands, *units])

    def issue(self, now):
        """Cycles from the issue of the last instruction to that of this one."""
        latency, unit = M7.get(now.kind, (1, None))
        latency = DOUBLES.get(now.kind, latency) if ".f64" in now.mnemonic else latency
        start = self._start(now, unit)
        if start == self.cycle and (self.issued >= self.slots or unit == "all" and self.issued):
            start += 1
        waited, self.issued = start - self.cycle, self.issued + 1 if start == self.cycle else 1
        self.cycle = start
        busy = {"divide": latency, "root": latency, "multiple": -(-now.moved // self.slots)}.get(now.kind, 1)
        if unit:
            self.free[unit] = start + busy
        self.ready.update(dict.fromkeys(now.writes, start + latency))
        return waited


def cortex_m7(program, slots=2):
    """[(cycles, cycles more if the branch is taken)]: every branch is predicted, every access hits."""
    costs, pipeline, end = [], None, None
    for now in program:
        follows = now.address == end
        pipeline = pipeline if follows else _Pipeline(slots)
        costs.append((pipeline.issue(now) + (not follows), 0))
        end = None if now.jumps else now.address + now.size
    return costs


# ---- for the plugin ----------------------------------------------------------------------------------

# The estimates of each target; the first is the more careful one.
ESTIMATES = {
    "cortex-m4f": {
        "VMLA 3": lambda program: cortex_m4(program, accumulate=3),
        "VMLA 1": lambda program: cortex_m4(program, accumulate=1),
    },
    "cortex-m7": {
        "single issue": lambda program: cortex_m7(program, slots=1),
        "dual issue": lambda program: cortex_m7(program, slots=2),
    },
}


def weights(target, text):
    """Lines of the plugin's table: each instruction counts 1, and the cycles by both estimates."""
    program = [instruction for instruction in disassembled(text) if instruction.kind]
    lines = []
    for instruction, *costs in zip(program, *[estimate(program) for estimate in ESTIMATES[target].values()]):
        cycles, taken = zip(*costs)
        row = (f"{instruction.address:x}", instruction.size, 1, *cycles, 0, *taken)
        lines.append(" ".join(map(str, row)))
    return "\n".join(lines) + "\n"
