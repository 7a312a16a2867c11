"""Cycles measured on boards: what examples/self_benchmark.c printed there, one file of targets/boards/ for each board."""

import re

from ..plumbing import pages
from ..plumbing.checkout import ROOT
from ..plumbing.errors import UserError

FOLDER = ROOT / "targets/boards"
LINE = re.compile(r"\bcycles (\w+)" + r" (\d+)" * 6 + r"\s*$", re.M)  # SELF_BENCHMARK_LINE; a console may put its own words before


def measured(text):
    """{(function, N, m, horizon): (min, median, max)}."""
    found = {}
    for function, *numbers in LINE.findall(text):
        n, m, horizon, *cycles = map(int, numbers)
        found[function, n, m, horizon] = tuple(cycles)
    return found


def read(folder=FOLDER):
    """{board: what was measured}."""
    boards = {path.stem: measured(path.read_text(errors="replace")) for path in sorted(folder.glob("*.txt"))}
    for name, figures in boards.items():
        if not figures:
            raise UserError(f"{folder / name}.txt: has no line 'cycles ..'; put what examples/self_benchmark.c prints there")
    return boards


def table(boards):
    """Markdown, with a median and a maximum for each board; nothing without boards."""
    if not boards:
        return ""
    calls = sorted({call for figures in boards.values() for call in figures}, key=lambda call: (*call[1:], call[0]))
    lines = []
    for call in calls:
        function, n, m, horizon = call
        found = [figures.get(call) for figures in boards.values()]
        cells = [cell for cycles in found for cell in ([f"{value:,}" for value in cycles[1:]] if cycles else ["-", "-"])]
        lines.append([f"{function}, N = {n}, m = {m}, horizon {horizon}", *cells])
    headers = ["", *[f"{name} {what}" for name in boards for what in ("median", "max")]]
    return pages.table("Cycles, measured", headers, lines)
