"""What a report says: sections of sentences, tables and figures, for whoever renders them."""

from dataclasses import dataclass, field

import numpy as np

from .. import figures, words
from ..prediction_errors.ahead import HORIZONS

MOST_RANKED = 8
SURE = 0.9
MOVES = 0.01  # of the usual rate, from which on random motion is told


@dataclass(frozen=True)
class Section:
    heading: str
    sentences: tuple = ()
    tables: tuple = ()  # (caption, headers, rows)
    figures: tuple = ()  # (caption, SVG)


@dataclass(frozen=True)
class Story:
    verdict: str  # of the contract
    sentence: str
    asides: tuple = ()
    sections: tuple = field(default=())


def size_of(unit):
    """How a quantity of this unit is written."""
    return {"m": words.length, "rad": words.angle}.get(unit, lambda value: words.quantity(value, unit))


def effect_text(effect):
    """gain:speed, a = 0.08."""
    values = words.listed(f"{name} = {words.quantity(value, effect['units'][name])}" for name, value in effect["params"].items())
    return f"{effect['name']} ({effect['formula']}), {values}"


def _longest(gap):
    return list(gap["before"])[-1]


def fall(name, gap, ahead=""):
    """How far the error of one gap falls."""
    size, key = size_of(gap["unit"]), _longest(gap)
    before, after, floor = (size(gap[part][key]) for part in ("before", "after", "noise_floor"))
    said = f"{key} steps ahead{ahead} the {name} error is {before}"
    return (
        f"{said}, where noise alone makes {floor}"
        if before == after
        else f"{said} without and {after} with that; noise alone makes {floor}"
    )


def _first_gap(report):
    return next(iter(report["gaps"].items()))


def sentence(report):
    """The verdict in one sentence."""
    named = words.listed(effect_text(e) for e in report["effects"])
    name, gap = _first_gap(report)
    since = report["healthy"]["logs"] > 0
    if report["verdict"] == "none":
        what = "Nothing has changed since the healthy logs" if since else "The simulator explains this log down to its noise"
        return f"{what}: {fall(name, gap)}."
    if report["verdict"] == "known":
        return f"What {'has changed since the healthy logs' if since else 'the simulator lacks'}: {named}. {words.capital(fall(name, gap))}."
    if report["verdict"] == "partly":
        return f"Part of the gap is {named}; something more is left. {words.capital(fall(name, gap))}."
    return f"The simulator lacks something that none of the effects explains: {fall(name, gap)}."


def asides(report):
    said = []
    for effect in report["effects"]:
        others = report["ambiguous_with"].get(effect["name"], [])
        if others:
            said.append(f"On this log {words.listed(others, 'or')} would do the same as {effect['name']}.")
        elif effect["confidence"] < SURE:
            said.append(f"{effect['name']} is {words.percent(effect['confidence'])} sure.")
    for effect in report["best_fit"][:1]:
        said.append(f"The best fit, which is not believed: {words.listed(effect_text(e) for e in report['best_fit'])}.")
    if report["small"]:
        said.append(f"Significant, but too small to matter: {words.listed(effect_text(e) for e in report['small'])}.")
    left = report["unexplained"]
    if left["depends_on"]:
        said.append(
            "What is left goes with " + words.listed(f"{d['on']} (it acts on {d['channel']})" for d in left["depends_on"][:2]) + "."
        )
    if report["time_step"]["matters"]:
        said.append("The simulator's step of time is too long for this log: shorter steps bring it nearer. That is taken into account.")
    if "surrogate" in report:
        said.append(_of_surrogate(report))
    return tuple(said)


def _of_surrogate(report):
    """What stood in the place of a simulator that is known by a recorded run alone."""
    surrogate = report["surrogate"]
    worst = words.percent(max(surrogate["off"].values()))
    return (
        f"The simulator is known only by its run {surrogate['file']}: a surrogate, which was fitted to that run, stood in for it."
        f" {surrogate['rows']} steps ahead, on rows that it was not fitted to, the surrogate is off by {worst} of this log's noise at most."
    )


GAP_HEADERS = ("steps ahead", "before", "after", "noise floor", "closed", "95 % interval")


def gap_rows(gap):
    size, rows = size_of(gap["unit"]), []
    for key in gap["before"]:
        low, high = gap["ci95"][key]
        rows.append(
            (
                key,
                *(size(gap[part][key]) for part in ("before", "after", "noise_floor")),
                words.percent(gap["closed_fraction"][key]),
                words.spread(low, high),
            )
        )
    return rows


def gap_figure(name, gap):
    """Bars of before, after and floor."""
    size, rows = size_of(gap["unit"]), []
    for key in gap["before"]:
        rows.append((f"{key} step{'s' if key != '1' else ''} ahead",))
        for part, text, kind in (
            ("before", "before", "bar-before"),
            ("after", "after", "bar-after"),
            ("noise_floor", "noise floor", "bar-floor"),
        ):
            rows.append((text, words.real(gap[part][key]), size(gap[part][key]), kind))
    caption = words.capital(fall(name, gap))
    return caption, figures.bars(rows, caption)


def effect_table(effects):
    rows = []
    for effect in effects:
        for i, (name, value, interval, _) in enumerate(words.parameters(effect)):
            first, sure, formula = (effect["name"], words.percent(effect["confidence"]), effect["formula"]) if i == 0 else ("", "", "")
            rows.append((first, f"{name} = {value}", interval, sure, formula))
    return ("Effects", ("effect", "parameter", "95 % interval", "sure", "what it does"), rows)


def series_figure(result):
    """The channel with the most of the gap over time: predictions in turn, without and with the effects."""
    path, shares = result.path, result.report["where"]["channels"]
    names = list(shares)
    c = int(np.argmax(list(shares.values())))
    channel = path.robot.channels[c]
    length = max(min(HORIZONS[-1], len(path.rows) // 4), 1)
    starts = np.arange(path.settled, len(path.rows) - length, length)
    t = path.t[starts[:, None] + np.arange(1, length + 1)]
    before, after = (path.ahead(causes, starts, tuple(range(1, length + 1)))[..., c] for causes in ((), result.answer.fit.causes))
    key = (("before", "without"), ("after", "with the effects")) if result.answer.fit.causes else (("before", "simulator"),)
    panel = figures.Panel((56, 40, figures.WIDTH - 66, 180), (0, float(path.t[-1])), figures.extent(np.r_[before.ravel(), after.ravel()]))
    parts = [figures.legend(0, 14, key), panel.frame("time (s)", f"error of {channel.name} ({channel.unit})")]
    for missed, (kind, _) in zip((before, after), key):
        x, y = (np.concatenate([values, np.full((len(values), 1), np.nan)], 1).ravel() for values in (t, missed))
        parts.append(panel.line(x, y, f"{kind} noisy"))
    caption = f"Most of the misfit is in {names[c]}: {words.percent(shares[names[c]])}"
    return caption, figures.svg(260, caption, *parts)


def _where(result):
    report = result.report
    if report["verdict"] == "none":
        return Section("Where and when", ("There is no gap to locate: what is left is noise.",), figures=(series_figure(result),))
    said = [
        f"At {r['variable']} of {words.quantity(r['from'], '1')} to {words.quantity(r['to'], r['unit'])}"
        f" it is {r['times_average']:.1f} times the average."
        for r in report["where"]["regions"]
    ]
    shares = report["where"]["channels"]
    caption = f"Largest part: {max(shares, key=shares.get)}"
    bars = figures.bars([(name, part, words.percent(part), "bar-before") for name, part in shares.items()], caption)
    return Section("Where and when", tuple(said), figures=(series_figure(result), (caption, bars)))


def _which(report):
    found = {e["name"] for e in report["effects"] or report["best_fit"]}
    rows = [r for r in report["ranking"] if r["score"] >= 0.005 or r["name"] in found][:MOST_RANKED]
    if not rows:
        return None
    caption = "Above 1: found, and needed. Below 1: the share of their work that it would do alone"
    bars = figures.bars(
        [(r["name"], r["score"], f"{r['score']:.2f}", "bar-after" if r["name"] in found else "bar-floor") for r in rows], caption
    )
    effects = report["effects"] or report["best_fit"]
    return Section("Which effect", (), (effect_table(effects),) if effects else (), ((caption, bars),))


def _much(report):
    tables, drawn = [], []
    for name, gap in report["gaps"].items():
        tables.append((f"Gap: {name}", GAP_HEADERS, gap_rows(gap)))
        drawn.append(gap_figure(name, gap))
    for name, gap in report.get("fresh", {}).get("gaps", {}).items():
        tables.append((f"Gap on the fresh log, nothing fitted again: {name}", GAP_HEADERS, gap_rows(gap)))
    note = "RMS errors of predictions from measured states, by sizes fitted on the other half of the log."
    closed = "Closed: share of the gap above the noise floor that is gone."
    return Section("How much", (note, closed), tuple(tables), tuple(drawn))


def _open(report):
    said = []
    if report["not_testable"]:
        said.append(f"NOT TESTABLE: {words.listed(report['not_testable'])}. This log would hardly show them, so they may act or not.")
    return Section("What this log cannot tell", tuple(said) or ("Nothing came up that more data would have to settle.",))


def _measured(report):
    log, noise = report["log"], report["noise"]
    said = [
        f"{log['rows']} rows, {words.seconds(log['seconds'])} at {words.plain(1 / log['dt'], 3)} Hz;"
        f" {words.percent(log['usable'])} of the transitions are usable."
    ]
    said.append(
        "Noise (one standard deviation): " + words.listed(f"{name} {size_of(n['unit'])(n['sd'])}" for name, n in noise["sensor"].items()) + "."
    )
    moves = [(name, n) for name, n in noise["process"].items() if n["share"] > MOVES]
    if moves:
        said.append(
            "The robot's own random motion: "
            + words.listed(f"{name} {words.quantity(n['sd'], n['unit'])} ({words.percent(n['share'])} of its usual rate)" for name, n in moves)
            + "."
        )
    said.append(f"The simulator went over the log {report['passes']} times.")
    return Section("The log and its noise", tuple(said))


def story(result):
    """The Story of a Diagnosis."""
    report = result.report
    sections = [_where(result), _which(report), _much(report), _open(report), _measured(report)]
    return Story(report["verdict"], sentence(report), asides(report), tuple(s for s in sections if s))
