"""How many small faults put into lib/ the C tests find: the mutation score.

A mutant is tried in float32, then in float64, with vector registers and then without, until a test fails or exceeds its
time. One that compiles to the same objects everywhere is equivalent; others are where test/mutants/equivalent.txt
argues so, in one line each:

    lib/src/file.c:function | line before | line after | reason
"""

import random
from collections import Counter
from functools import partial

from ..firmware.targets import side_by_side
from ..plumbing import pages
from ..plumbing.command import need
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, write_json
from .mutation import mutants as mutants_of
from .trial import LIB, ROOT, judge, prepare

EQUIVALENT = ROOT / "test/mutants/equivalent.txt"
MIN_SCORE = 97.0  # percent


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
                raise UserError(f"test/mutants/equivalent.txt:{line}: not a mutant of lib/ any more; remove the line: {entry}")
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
    """Survivors that are argued equivalent become so; what a test kills stays killed, whatever is argued."""
    return [(m, "equivalent" if verdict == "survived" and key(m) in reasons else verdict) for m, verdict in tried]


def disproved(tried, reasons):
    """Keys that are argued for and that a test kills."""
    return [key(mutant) for mutant, verdict in tried if verdict == "killed" and key(mutant) in reasons]


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


def page(total, seed):
    """The table of docs/assurance.md."""
    pairs = [("mutants drawn", total.total()), ("killed", total["killed"]), ("change nothing, with reason", total["equivalent"])]
    pairs += [("survived", total["survived"]), ("killed, of those that change anything (%)", number(score(total)))]
    return pages.facts(f"`make mutants N={total.total()} SEED={seed}`", pairs)


def run(out, n, seed, file=None, update=False):
    """Writes mutants.json into `out`, and with `update` the table of docs/assurance.md; raises where the score is too low."""
    need({"gcc": "gcc", "cmake": "cmake", "prlimit": "util-linux"})
    out = output_folder(out)
    known, chosen, n = choose(file, n)
    reasons = read_equivalent(EQUIVALENT.read_text(), {key(mutant) for mutant in known})
    tried = with_reasons(try_all(draw(chosen, seed), n, prepare()), reasons)
    survivors = [mutant for mutant, verdict in tried if verdict == "survived"]
    rows = [{"place": m.place, "function": m.function, "before": m.before, "after": m.after} for m in survivors]
    total = report(tried)
    write_json(
        out / "mutants.json",
        {"mutants": total.total(), "killed": total["killed"], "equivalent": total["equivalent"], "survivors": rows},
    )
    lines = ["no test fails for:", *map(key, survivors)] if survivors else []
    wrong = disproved(tried, reasons)
    if wrong:
        raise UserError("\n".join(["test/mutants/equivalent.txt: a test kills these; remove their lines:", *wrong, *lines]))
    if score(total) < MIN_SCORE:
        raise UserError("\n".join([f"{number(score(total))} % of the mutants are killed, less than {MIN_SCORE:g} %", *lines]))
    print("\n".join(lines))
    if update:
        pages.update("docs/assurance.md", "mutants", page(total, seed))
    return total
