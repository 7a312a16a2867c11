"""A flight's report as one HTML page, with the parts of ../page.py."""

from .. import figures as drawn
from .. import words as said
from ..page import bullets, causes, document, figure, head, section, table, which
from . import figures, words


def _first(result):
    """What ten seconds are enough for."""
    report = result.report
    caption = said.gap_caption(report["gap"], report, words.angle)
    bars = figure(caption, drawn.gap(report["gap"], report, caption, words.angle))
    opening = head(report, "flight", words.sentence(report), words.asides(report))
    return f'{opening}<div class="two"><div>{bars}{causes(report, words.PHRASES)}</div>{figure(*figures.follow(result))}</div>'


def _where(result):
    report = result.report
    caption, label, loud = words.time_caption(report), words.channel_caption(report), words.band_caption(report)
    left = figure(caption, figures.time_line(result, caption)) + bullets(words.where(report))
    left += figure(label, figures.channels(report, label))
    right = figure(loud, figures.frequencies(result, loud)) + bullets(words.bands(report))
    return section("Where and when", f'<div class="two"><div>{left}</div><div>{right}</div></div>')


def _contributions(report):
    if not report["contributions"] or not said.horizon(report["gap"]):
        return ""
    caption = words.contribution_caption(report)
    return figure(caption, drawn.contributions(report, caption, words.angle))


def _much(report):
    """Tables of all horizons and channels, and the fresh log."""
    parts = ["<h3>Attitude</h3>", table(said.GAP_HEADERS, said.gap_rows(report["gap"], report, words.angle))]
    bars, fresh = "", report.get("fresh", {}).get("gap")
    if fresh:
        caption = said.gap_caption(fresh, report, words.angle, " on the fresh log")
        parts += ["<h3>Attitude, fresh log: nothing fitted again</h3>", table(said.GAP_HEADERS, said.gap_rows(fresh, report, words.angle))]
        bars = f'<div class="two">{figure(caption, drawn.gap(fresh, report, caption, words.angle))}</div>'
    rows = words.channel_rows(report)
    if rows:
        parts += [f"<h3>Channels, {said.ahead(said.horizon(report['gap']), report)}</h3>", table(words.CHANNEL_HEADERS, rows)]
    note = (
        '<p class="soft">RMS error. Noise floor: that of healthy flights. Closed: share of the gap above it that is gone, on rows '
        "left out of the fit; none where the gap is about the noise.</p>"
    )
    return section("How much", *parts, note, bars)


def html(result):
    """The whole page (bytes) of a Diagnosis."""
    report = result.report
    return document(
        report,
        _first(result),
        _where(result),
        which(report, words.ranking_caption(report), _contributions(report)),
        _much(report),
        section("What this log cannot tell", bullets(words.cannot_tell(report))),
        section("What to fly next", bullets(words.advice(report))),
        section("The log and its noise", bullets(words.measured_on(report) + words.noise(report))),
    )
