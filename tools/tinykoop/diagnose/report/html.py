"""A Story as one HTML page that needs nothing but itself."""

import base64
import re
from html import escape
from textwrap import wrap

from . import words

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
DEFS = (
    '<defs><pattern id="hatch" width="6" height="6" patternUnits="userSpaceOnUse" patternTransform="rotate(45)">'
    '<rect width="6" height="6" style="fill:var(--after);fill-opacity:.35"/><rect width="3" height="6" style="fill:var(--after)"/>'
    "</pattern></defs>"
)
HATCH = f'<svg class="defs" aria-hidden="true" style="position:absolute;width:0;height:0">{DEFS}</svg>'


def bullets(sentences):
    return "<ul>" + "".join(f"<li>{escape(words.capital(text))}</li>" for text in sentences) + "</ul>" if sentences else ""


def table(headers, rows):
    head = "".join(f"<th>{escape(text)}</th>" for text in headers)
    body = "".join("<tr>" + "".join(f"<td>{escape(str(cell))}</td>" for cell in row) + "</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def figure(caption, svg):
    return f"<figure><figcaption>{escape(caption)}</figcaption>{svg}</figure>"


def _file(text, name, contents):
    """A link that holds its file."""
    data = base64.b64encode(contents.encode()).decode()
    return f'<p><a download="{escape(name)}" href="data:text/csv;base64,{data}">{escape(text)}</a></p>'


def _parts(section):
    tables = "".join(f"<h3>{escape(t.caption)}</h3>{table(t.headers, t.rows)}" for t in section.tables)
    note = f'<p class="soft">{escape(section.note)}</p>' if section.note else ""
    drawn = "".join(figure(*one) for one in section.figures)
    taken = _file(*section.file) if section.file else ""
    return tables + note + (f'<div class="two">{drawn}</div>' if drawn else "") + bullets(section.sentences) + taken


def _head(told):
    """The verdict, and what must stand beside it."""
    beside = "".join(f"<p>{escape(text)}</p>" for text in (*told.asides, *told.glance))
    body = f'<div class="soft">Sim-to-real gap of {escape(told.files)}</div><h1>{escape(told.sentence)}</h1>{beside}'
    return f'<header class="{escape(told.verdict)}">{body}</header>{_parts(told.head)}'


def html(told):
    """The whole page (bytes) of a Story."""
    title = f"Sim-to-real gap: {told.verdict}"
    meta = '<meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
    meta += f"<title>{escape(title)}</title><style>{STYLE}</style>"
    sections = "".join(f"<section><h2>{escape(section.heading)}</h2>{_parts(section)}</section>" for section in told.sections)
    return f'<!DOCTYPE html>\n<html lang="en"><head>{meta}</head><body>{HATCH}{_head(told)}{sections}</body></html>\n'.encode()


# ---- one picture ---------------------------------------------------------------------------------

ROOM, LINE, LONGEST = 24, 20, 58  # px between figures and of a line of text; characters of one


def _caption(x, text, lines):
    return "".join(
        f'<text x="{x}" y="{ROOM + LINE * i}" class="strong">{escape(line)}</text>' for i, line in enumerate(wrap(text, LONGEST)[:lines])
    )


def picture(told):
    """The head of a Story as one SVG image (bytes), for a page elsewhere."""
    shown, lines = told.head.figures, max(len(wrap(caption, LONGEST)) for caption, _ in told.head.figures)
    sizes = [tuple(map(float, re.search(r'viewBox="0 0 (\S+) (\S+)"', svg).groups())) for _, svg in shown]
    top, x, parts = ROOM + LINE * lines, ROOM, []
    for (caption, svg), (width, height) in zip(shown, sizes):
        parts += [_caption(x, caption, lines), svg.replace("<svg ", f'<svg x="{x}" y="{top}" width="{width:g}" height="{height:g}" ', 1)]
        x += round(width) + ROOM
    height = top + max(height for _, height in sizes) + ROOM
    opening = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {x} {height:g}" width="{x}" height="{height:g}">'
    paper = f'<rect width="{x}" height="{height:g}" style="fill: var(--paper)"/>'
    style = re.sub(r"svg \{[^}]*\}", 'text { font: 13px "DejaVu Sans", sans-serif; }', STYLE).replace("svg ", "")
    return f"{opening}<style>{style}</style>{DEFS}{paper}{''.join(parts)}</svg>\n".encode()
