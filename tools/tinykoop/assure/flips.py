"""One flipped bit in the storage of a learner, its gate, its supervisor and its controller, beside a twin of which none flips.

The programs of test/flips do the work, one call for each use, regulator, form and precision; here they are built, run
and judged. test/flips/flips.c says what counts as detected, harmless and silent.
"""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from itertools import product

from ..plumbing import pages
from ..plumbing.command import run as run_command
from ..plumbing.errors import UserError
from ..plumbing.results import output_folder, print_table, progress, write_json
from ..plumbing.sources import regulators
from . import campaigns

USES = {
    "alone": "alone",
    "checksum": "checksum",
    "gate": "gate",
    "gate_checksum": "gate, checksum",
    "newton": "supervisor, Newton",
    "gradient": "supervisor, gradient",
}
PROTECTED = ("gate_checksum", "newton", "gradient")  # with gate and checksum; the latter two in a closed loop with the supervisor
REGULATORS = regulators()
FORMS = (("plain", "refuse"), ("plain", "diagonal"), ("sqrt", "refuse"))  # to the square root all checks are the same
KINDS = tuple(
    (precision, use, regulator, *form) for precision, use, regulator, form in product(campaigns.PRECISIONS, USES, REGULATORS, FORMS)
)
PARTS = {"alone": 6, "checksum": 6, "gate": 15, "gate_checksum": 15, "newton": 27, "gradient": 27}  # of the storage, as flips.c lists them
MAX_SILENT = 1e-3  # share of the trials of a part, in the protected uses
TIMEOUT = 7200  # seconds, of one kind


def trials_of_part(trials, kinds=KINDS):
    """Trials of each part of the storage of each kind, where there are to be so many in all."""
    return max(1, round(trials / sum(PARTS[use] for _, use, *_ in kinds)))


def rows_of(kind, trials, seed):
    """The rows of one kind, of so many trials each; bits and robots are others for each kind."""
    precision, *names = kind
    own = seed * len(KINDS) + KINDS.index(kind)
    printed = run_command(campaigns.program("flips", precision), *names, trials, own, timeout=TIMEOUT)
    return [json.loads(line) for line in printed.splitlines()]


# ---- judging ----------------------------------------------------------------------------------------


def groups(rows):
    """{(what, configuration): rows} in the order of USES and of the parts."""
    found = {}
    for row in sorted(rows, key=lambda row: list(USES).index(row["configuration"])):
        found.setdefault((row["what"], row["configuration"]), []).append(row)
    return found


def total(rows, key):
    """Sum over the rows."""
    return sum(row[key] for row in rows)


def example(rows, key):
    """Which kind of learner had the first of them, and where."""
    row = next(row for row in rows if row[key])
    return f"{row['regulator']} {row['form']} {row['check']} {row['precision']}, first {row['example']}"


def failures(rows):
    """What must hold and does not, a line for each: with gate and checksum next to nothing is silent and nothing refused forever."""
    lines = []
    for (what, use), group in groups(rows).items():
        name = f"{what}, {USES[use]}"
        silent, trials = total(group, "silent"), total(group, "trials")
        if use in PROTECTED and silent > MAX_SILENT * trials:
            lines.append(f"{name}: {silent} of {trials} flipped bits are silent ({example(group, 'silent')})")
        if use in PROTECTED and total(group, "for_ever"):
            lines.append(f"{name}: {total(group, 'for_ever')} of {trials} are refused forever ({example(group, 'for_ever')})")
        if total(group, "unsafe"):
            lines.append(f"{name}: {total(group, 'unsafe')} of {trials} lead to an input outside its limits ({example(group, 'unsafe')})")
    return lines


# ---- report -----------------------------------------------------------------------------------------


HEADERS = ["use: where", "trials", "detected %", "harmless %", "silent %", "forever", "unsafe"]


def cells(rows):
    """Trials; shares that are detected, harmless and silent in percent; how many are refused forever or unsafe."""
    trials = total(rows, "trials")
    shares = [f"{100 * total(rows, key) / trials:.2f}" for key in ("detected", "harmless", "silent")]
    return [f"{trials:,}", *shares, total(rows, "for_ever"), total(rows, "unsafe")]


def page(rows, seed):
    """The table of docs/assurance.md: all parts of the storage, by use."""
    lines = [[USES[use], *cells([row for row in rows if row["configuration"] == use])] for use in USES]
    return pages.table(f"`make flips TRIALS={total(rows, 'trials')} SEED={seed}`", HEADERS, lines)


def report(rows):
    """A line for each part of the storage in each use, and one for all parts of a use."""
    lines = []
    for use, name in USES.items():
        some = {what: group for (what, of), group in groups(rows).items() if of == use}
        lines += [[f"{name}: {what}", *cells(group)] for what, group in some.items()]
        if some:
            lines.append([f"{name}: all", *cells(sum(some.values(), []))])
    print_table(
        f"One flipped bit: {total(rows, 'trials'):,} trials",
        HEADERS,
        lines,
        "detected: by a status, the health, the gate, the checksum or the supervisor within 100 samples.\n"
        "harmless: after these, the model predicts and the loop costs within 10 % of a twin without the flip.\n"
        "forever: 3,000 samples later, and for 3,000 more, samples or plans are refused, the gate says refuse,\n"
        "or the supervisor keeps off the online model. unsafe: an input outside its limits.",
    )


def run(out, trials, seed, kinds=KINDS, update=False):
    """Writes flips.json into `out`, and with `update` the table of docs/assurance.md; returns the rows. Refuses where what must hold does not."""
    if not trials >= 1:
        raise UserError(f"--trials {trials:g}: at least 1 is needed")
    if not 0 <= seed < 2**32:
        raise UserError(f"--seed {seed}: from 0 to 2^32 - 1")
    out = output_folder(out)
    campaigns.build("flips")
    each = trials_of_part(trials, kinds)
    with ThreadPoolExecutor(min(2, os.cpu_count() or 1)) as pool:
        done = [pool.submit(rows_of, kind, each, seed) for kind in kinds]
        rows = [row for job in progress(done, "flips") for row in job.result()]
    write_json(out / "flips.json", rows)
    report(rows)
    if wrong := failures(rows):
        raise UserError(f"{len(wrong)} promises do not hold: {wrong[0]}")
    if update:
        pages.update("docs/assurance.md", "flips", page(rows, seed))
    return rows
