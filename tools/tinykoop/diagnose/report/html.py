"""A Story as one HTML page that needs nothing but itself."""

from html import escape

from .. import page


def _section(section):
    tables = "".join(f"<h3>{escape(caption)}</h3>{page.table(headers, rows)}" for caption, headers, rows in section.tables)
    drawn = "".join(page.figure(caption, svg) for caption, svg in section.figures)
    return page.section(section.heading, page.bullets(section.sentences), tables, f'<div class="two">{drawn}</div>' if drawn else "")


def html(told, report):
    """The whole page (bytes)."""
    first = page.head(report, "log", told.sentence, told.asides)
    return page.document(report, first, *(_section(section) for section in told.sections))
