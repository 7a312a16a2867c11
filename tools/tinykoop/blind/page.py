"""The tables of docs/diagnose.md, docs/flapping-wing.md and docs/own-robot.md, from the rows of a blind evaluation."""

import numpy as np

from ..plumbing import pages
from ..plumbing.errors import UserError
from ..plumbing.results import number
from . import score

HEALTHY = "healthy robots recognised as healthy: all kinds of noise, random slip, tiny gaps"
NOTHING = 1e-9
HEADERS = ["", "found", "of", "95 % interval from", "to"]


def _share(words, rows, mark, right=True):
    """A line: how many rows have the mark, or lack it where `right` is false."""
    found = score.figure(rows, mark)
    if not found["n"]:
        return [words, "-", "-", "-", "-"]
    count, (low, high) = round(found["value"] * found["n"]), found["ci95"]
    if not right:
        count, low, high = found["n"] - count, 1 - high, 1 - low
    return [words, count, found["n"], number(low, 2), number(high, 2)]


def _figure(value):
    """Two digits that people read: no power of ten, and no rounding error of what is nothing."""
    return f"{float(f'{value:.2g}'):g}" if abs(value) > NOTHING else "0"


def _typical(words, rows, mark, scale=1):
    """A line: the median, or the mean where `score` has one, of a mark."""
    found = score.figure(rows, mark)
    if found["value"] is None:
        return [words, "-", "-", "-", "-"]
    return [words, _figure(scale * found["value"]), found["n"], *(_figure(scale * edge) for edge in found["ci95"])]


def _all_covered(row):
    return row | {"covered_rest": row.get("covered_rest", {}) | row.get("covered_curves", {})}


def _calibration(words, rows):
    found = score.calibration_error(rows)
    if found["value"] is None:
        return [words, "-", "-", "-", "-"]
    return [words, number(found["value"], 2), found["n"], *(number(edge, 2) for edge in found["ci95"])]


def drive_lines(rows):
    """The lines of one diagnoser of drives."""
    of = lambda *names: score.of(rows, *names)  # noqa: E731
    other = of("single_other")
    known = [row | {"unknown": row["verdict"] in ("known", "partly")} for row in other]
    return [
        _share("single effect: its family named first", of("single"), "family1"),
        _share("single effect named first", of("single"), "top1"),
        _typical("its parameters are off by, median (%)", of("single"), "parameter_errors", 100),
        _share(HEALTHY, of(*score.HEALTHY), "false_alarm", False),
        _share("of these with random slip of 1 to 10 %", of("none_slip"), "false_alarm", False),
        _share("effect on a robot that slips at random by 1 to 5 %: its family named first", of("slipping"), "family1"),
        _share("lags of one or both axes, lag and gain: exact set of families", of("lags"), "family_set"),
        _share("log with odometry: the effect's family named first", of("odometry"), "family1"),
        _typical("pairs: F1, mean", of("pair"), "f1"),
        _typical("switched effect: onset off by, median (s)", of("switch"), "onset"),
        _typical("switched effect: IoU, median", of("switch"), "iou"),
        _typical("five phases: IoU, median", of("five_phase"), "iou"),
        _share("effect taken out of the library: `unknown`, exact aliases aside", of("left_out"), "unknown"),
        _share("effect that was never in it: `unknown`", of("never"), "unknown"),
        _share("known effect in another form than the library's: its family named first", other, "family1"),
        _share("the same: exact set of families", other, "family_set"),
        _share("the same: `known` or `partly`", known, "unknown"),
        _share("the same: claimed over 0.1 more than realised, 50 steps", other, "overclaims_50"),
        _share("all logs with an effect: claimed over 0.1 more than realised, 50 steps", rows, "overclaims_50"),
        _typical("gap closed on a fresh drive, 50 steps, median (%)", of("single"), "realised_50", 100),
        _typical("claimed against realised, 50 steps, median (points)", of("single"), "claim_error_50", 100),
        _share("short or poor drives: named first", of("poor"), "top1"),
        _share("true parameters inside their 95 % intervals, without slip and friction", rows, "covered_rest"),
        _share("the same of slip and friction", rows, "covered_curves"),
        _typical("commands at which the 95 % band holds the true curve, mean (%)", rows, "covered_bands", 100),
        _share("the same of all, short or poor drives", [_all_covered(row) for row in of("poor")], "covered_rest"),
        _calibration("expected calibration error of the confidence of all effects named", rows),
        _share("wrong with a confidence of 0.9 or more", rows, "confident_wrong"),
    ]


def peer_lines(by):
    """A line for each diagnoser; by: {who: rows}."""
    lines = []
    for who, rows in by.items():
        closed = score.figure(score.of(rows, "single"), "realised_50")["value"]
        poor = score.figure(score.of(rows, "poor"), "top1")
        other = score.figure(score.of(rows, "single_other"), "family1")
        counts = [round((found["value"] or 0) * found["n"]) for found in (poor, other)]
        lines.append([who, number(score.open_set(rows), 2), *counts, number(None if closed is None else 100 * closed)])
    return lines


def drives(results):
    """Writes the tables of docs/diagnose.md, that of the peers if they were asked, and the two figures of the README."""
    seal, by = results["seal"], {}
    for row in results["rows"]:
        by.setdefault(row["who"], []).append(row)
    ours = by[score.OURS]
    lines = drive_lines(ours)
    command = f"`make blind N={seal['n']} SEED={seal['seed']}{'' if len(by) > 1 else ' PEERS=no'}`"
    headers = [
        "",
        "balanced accuracy, known or unknown",
        f"poor drives named first, of {len(score.of(ours, 'poor'))}",
        f"family of other forms named first, of {len(score.of(ours, 'single_other'))}",
        "gap closed, fresh drive (%)",
    ]
    pages.update("docs/diagnose.md", "blind", pages.table(f"{command}: {len(ours)} drives", HEADERS, lines))
    if len(by) > 1:
        pages.update("docs/diagnose.md", "blind-peers", pages.table(f"{command}, by peers", headers, peer_lines(by)))
    by_words = {cells[0]: cells for cells in lines}
    for name, line in (("blind-single", by_words["single effect named first"]), ("blind-healthy", by_words[HEALTHY])):
        pages.headline(name, f"{line[1]} of {line[2]}")


FLIGHTS = {
    "healthy": ("none",),
    "one effect, throughout or from some time on": ("single", "switch"),
    "two effects": ("pair",),
    "one effect, taken out of the library": ("left_out",),
}


def flights(rows, n, seed):
    """Writes the table of docs/flapping-wing.md."""
    lines = []
    for words, names in FLIGHTS.items():
        some = [row for row in rows if row["tier"] in names]
        counts = [sum(bool(row.get(key)) for row in some) for key in ("right", "held", "held_but")]
        wrong = sum(any(c > score.SURE and name not in row["truth"] for name, c in row.get("confidence", {}).items()) for row in some)
        lines.append([words, len(some), *counts, wrong])
    headers = ["", "flights", "right", "or ambiguous with it", "or not testable", f"wrong, confidence over {score.SURE}"]
    edges = [row["edge_error"] for row in rows if row["tier"] == "switch" and "edge_error" in row]
    inside = [i for row in rows for i in row.get("inside_ci95", ())]
    pairs = [("onset off by, median (s)", number(float(np.median(edges)), 2) if edges else "-"),
             ("sizes with a 95 % interval", len(inside)), ("inside it", sum(inside))]  # fmt: skip
    command = f"`make blind PLATFORM=fwmav N={n} SEED={seed}`"
    pages.update("docs/flapping-wing.md", "blind-fwmav", pages.table(command, headers, lines) + "\n" + pages.facts("Onset and size", pairs))


def robot(plant, rows, words, n, seed):
    """Writes the table of docs/own-robot.md of one robot; words: {tier: what it is called}."""
    if all(row["error"] for row in rows):
        raise UserError(f"docs/own-robot.md stays as it is: every diagnosis failed, the first with {rows[0]['error']}")
    lines = []
    for tier, name in words.items():
        some = [row for row in rows if row["tier"] == tier]
        if some:
            errors = [e for row in some for e in row["errors"]]
            off, seconds = (
                number(100 * float(np.median(errors)), 2) if errors else "-",
                number(float(np.median([row["seconds"] for row in some])), 2),
            )
            lines.append([name, len(some), sum(row["right"] for row in some), sum(row["sure_wrong"] for row in some), off, seconds])
    headers = ["effects", "logs", "right", f"wrong, confidence over {score.SURE}", "size off, median (%)", "time, median (s)"]
    pages.update(
        "docs/own-robot.md", f"blind-{plant.NAME}", pages.table(f"`make blind ROBOT={plant.NAME} N={n} SEED={seed}`", headers, lines)
    )
