"""The report as one HTML page that needs nothing but itself."""

import base64
from html import escape
from pathlib import Path

from ..plumbing.results import number
from . import figures, words

STYLE = """
:root { color-scheme: light dark; --ink: #1c1f23; --soft: #5a6270; --paper: #fff; --rule: #d8dce2; --card: #f5f6f8;
  --before: #d9731a; --after: #0b4f9c; --none: #2e7d4f; --unknown: #a32c2c; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e8eb; --soft: #a4abb6; --paper: #15181c; --rule: #3a4049;
  --card: #1e2228; --before: #f0a35e; --after: #78b4ff; --none: #6fcf97; --unknown: #ff8f8f; } }
@media print { :root { color-scheme: light; --ink: #000; --soft: #444; --paper: #fff; --rule: #bbb; --card: #f5f6f8;
  --before: #d9731a; --after: #0b4f9c; --none: #2e7d4f; --unknown: #a32c2c; }
  figure, table, li { break-inside: avoid; } h2 { break-after: avoid; } * { print-color-adjust: exact; } }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1080px; padding: 16px 20px 48px; background: var(--paper); color: var(--ink);
  font: 16px/1.45 system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; overflow-wrap: break-word; }
header { border-left: 6px solid var(--after); padding-left: 14px; }
header.none { border-color: var(--none); } header.unknown { border-color: var(--unknown); }
h1 { font-size: 1.3rem; line-height: 1.35; margin: 4px 0 8px; }
h3 { font-size: .95rem; margin: 14px 0 4px; }
h2 { font-size: 1.15rem; margin: 32px 0 8px; padding-top: 12px; border-top: 1px solid var(--rule); }
p, ul { margin: 6px 0; max-width: 78ch; } ul { padding-left: 20px; } li { margin: 3px 0; }
a { color: var(--after); }
@media (max-width: 500px) { h1 { font-size: 1.12rem; } }
.soft { color: var(--soft); font-size: .9rem; }
.two { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 420px), 1fr)); gap: 12px 36px; align-items: start; }
figure { margin: 12px 0; max-width: 560px; min-width: 0; }
figcaption { font-weight: 600; font-size: .95rem; margin-bottom: 8px; }
svg { width: 100%; height: auto; display: block; font: 13px system-ui, "Segoe UI", Roboto, "DejaVu Sans", sans-serif; }
svg text { fill: var(--ink); paint-order: stroke; stroke: var(--paper); stroke-width: 3px; stroke-linejoin: round; }
svg .tick { fill: var(--soft); font-size: 12px; } svg .label { fill: var(--soft); } svg .strong { font-weight: 600; }
svg path { fill: none; stroke-linejoin: round; } .grid { stroke: var(--rule); stroke-width: .7; }
.measured { stroke: var(--ink); stroke-width: 5; opacity: .28; }
.before { stroke: var(--before); stroke-width: 2; stroke-dasharray: 5 3; }
.after { stroke: var(--after); stroke-width: 1.8; } .thin { stroke-width: 1.2; } .noisy { stroke-dasharray: none; stroke-width: 1.1; }
.command { stroke: var(--after); stroke-width: 1.6; }
.floor { stroke: var(--soft); stroke-width: 1.4; stroke-dasharray: 1.5 2.5; }
.cut { stroke: var(--soft); stroke-width: .8; stroke-dasharray: 3 4; }
.mark { fill: var(--paper); stroke: var(--ink); stroke-width: 1.2; opacity: .9; }
.bar-before { fill: var(--before); } .bar-after { fill: url(#hatch); stroke: var(--after); }
.bar-floor { fill: var(--card); stroke: var(--soft); }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-size: .92rem; margin: 6px 0; }
th, td { text-align: left; white-space: nowrap; padding: 4px 14px 4px 0; border-bottom: 1px solid var(--rule); vertical-align: top; }
th { color: var(--soft); font-weight: 500; } td { font-variant-numeric: tabular-nums; }
"""

# One pattern for all figures; not hidden by display: none, under which browsers do not draw it.
HATCH = (
    '<svg class="defs" aria-hidden="true" style="position:absolute;width:0;height:0"><defs>'
    '<pattern id="hatch" width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
    '<rect width="6" height="6" style="fill:var(--after);fill-opacity:.35"/><rect width="3" height="6" style="fill:var(--after)"/>'
    "</pattern></defs></svg>"
)


def bullets(sentences):
    return (
        "<ul>" + "".join(f"<li>{escape(words.capital(text))}</li>" for text in sentences) + "</ul>" if sentences else ""
    )


def table(headers, rows):
    head = "".join(f"<th>{escape(text)}</th>" for text in headers)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def figure(caption, svg):
    return f"<figure><figcaption>{escape(caption)}</figcaption>{svg}</figure>"


def section(heading, *parts):
    body = "".join(parts)
    return f"<section><h2>{escape(heading)}</h2>{body}</section>" if body else ""


def head(report, of, verdict, asides):
    """The verdict, and what must stand beside it."""
    files = escape(Path(report["log_file"]).name) if report.get("log_file") else of
    if report.get("fresh_file"):
        files += f", fresh log {escape(Path(report['fresh_file']).name)}"
    beside = "".join(f"<p>{escape(text)}</p>" for text in asides)
    body = f'<div class="soft">Sim-to-real gap of {files}</div><h1>{escape(verdict)}</h1>{beside}'
    return f'<header class="{escape(report["verdict"])}">{body}</header>'


def _first(result):
    """What ten seconds are enough for."""
    report = result.report
    gap, size = words.judged(report["gap"], report)
    caption = words.gap_caption(gap, report, size)
    bars = figure(caption, figures.gap(gap, report, caption, size))
    opening = head(report, "log", words.sentence(report), words.asides(report))
    return f'{opening}<div class="two"><div>{bars}{causes(report)}</div>{figure(*figures.path(result))}</div>'


def causes(report, phrases=words.PHRASES):
    """The effects, each with its phrase, where the first sentence has no room for them."""
    if report["verdict"] == "known" and len(report["effects"]) <= words.MOST_PHRASES:
        return ""
    return bullets(
        f"{words.phrase(e, phrases)} ({words.title(e['name'])}, {words.acts(e, report)}, {words.percent(e['confidence'])} sure)"
        for e in report["effects"]
    )


def _contributions(report):
    if len(report["contributions"]) < 2 or not words.horizon(report["gap"]):
        return ""
    caption = words.contribution_caption(report)
    return figure(caption, figures.contributions(report, caption))


def which(report, caption, contributions):
    """The effects with their parameters, and the ranking with its caption beside the figure of what each is worth."""
    ranking = figure(caption, figures.ranking(report, caption))
    effects = ""
    if report["effects"]:
        effects = table(("effect", "parameter", "95 % interval", "sure", "acts", "remark"), words.effect_rows(report))
        evidence = ((words.title(e["name"]), number(words.real(e["evidence"]))) for e in report["effects"])
        effects += '<p class="soft">Evidence (rise of the squared misfit, in units of the noise, without the effect): '
        effects += escape(", ".join(f"{name} {value}" for name, value in evidence)) + ".</p>"
    score = "Above 1: found, and needed beside the others. Below 1: the share of their work that it would do in their place."
    return section(
        "Which effect",
        effects,
        f'<div class="two">{ranking}{contributions}</div><p class="soft">{score}</p>' if report["ranking"] else "",
    )


def _much(report):
    """Tables of all horizons, position and heading, and the fresh log."""
    parts = ["<h3>Position</h3>", table(words.GAP_HEADERS, words.gap_rows(report["gap"], report))]
    fresh = report.get("fresh", {}).get("gap")
    if fresh:
        parts += [
            "<h3>Position, fresh log: nothing fitted again</h3>",
            table(words.GAP_HEADERS, words.gap_rows(fresh, report)),
        ]
    figures_ = []
    heading = report["gap"].get("heading_rad")
    if heading:
        caption = "Heading: " + words.gap_caption(heading, report, words.angle)
        figures_.append(figure(caption, figures.gap(heading, report, caption, words.angle)))
    if fresh:
        gap, size = words.judged(fresh, report)
        caption = words.gap_caption(gap, report, size, " on the fresh log")
        figures_.append(figure(caption, figures.gap(gap, report, caption, size)))
    note = (
        '<p class="soft">RMS error. Closed: share of the gap above the noise floor that is gone, on rows left out of '
        "the fit; none where the gap is about the noise.</p>"
    )
    return section("How much", *parts, note, f'<div class="two">{"".join(figures_)}</div>')


def _where(result):
    report = result.report
    caption = words.time_caption(report)
    right = bullets(words.where(report))
    if words.located(report):
        label = words.channel_caption(report)
        right = figure(label, figures.channels(report, label)) + right
    on = words.depends(report)
    if on:
        right += f"<p>What is left unexplained depends on {escape(on)}.</p>"
    return section(
        "Where and when",
        f'<div class="two">{figure(caption, figures.time_line(result, caption))}<div>{right}</div></div>',
    )


def _csv(advice, dt):
    """The advised commands as a file in a link."""
    rows = "".join(f"{k * dt:.6g},{v:.6g},{w:.6g}\n" for k, (v, w) in enumerate(advice[2]))
    return "data:text/csv;base64," + base64.b64encode(f"t,v,omega\n{rows}".encode()).decode()


def _next(result):
    report, advice = result.report, result.advice
    if not advice or not report["advice"]:
        return ""
    dt = words.real(report["log"]["dt"])
    label = f"Drive this next: {report['advice']['words']}"
    names = result.path.command_names
    commands = figure(label, figures.drive(advice, dt, names, label))
    link = f'<p><a download="next_drive.csv" href="{_csv(advice, dt)}">These commands as CSV</a></p>'
    return section(
        "What to drive next", f'<div class="two">{commands}<div>{bullets(words.advice(report))}{link}</div></div>'
    )


def document(report, *parts):
    """The whole page (bytes)."""
    title = f"Sim-to-real gap: {report['verdict']}"
    meta = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    meta += f"<title>{escape(title)}</title><style>{STYLE}</style>"
    body = "".join((HATCH, *parts))
    return f'<!DOCTYPE html>\n<html lang="en"><head>{meta}</head><body>{body}</body></html>\n'.encode()


def html(result):
    """The whole page (bytes) of a Diagnosis."""
    report = result.report
    open_ends = words.cannot_tell(report) or ["Nothing came up that more data would have to settle."]
    return document(
        report,
        _first(result),
        _where(result),
        which(report, words.ranking_caption(report), _contributions(report)),
        _much(report),
        section("What this log cannot tell", bullets(open_ends)),
        _next(result),
        section("The log and its noise", bullets(words.measured_on(report) + words.noise(report))),
    )
