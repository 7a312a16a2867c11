"""Tables of the pages, each written by the command that measures it (UPDATE=1), between two markers."""

import re
import shutil

from .checkout import ROOT
from .errors import UserError
from .results import write_bytes


def table(title, headers, lines, others="---:"):
    """Markdown; the first column is text, the others are figures or whatever `others` aligns."""
    cells = [headers, ["---"] + [others] * (len(headers) - 1), *lines]
    rows = ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in cells]
    return "\n".join([f"**{title}**", "", *rows, ""])


def between_markers(text, name, contents):
    """The text of a page with other contents between the two markers of that name."""
    marked = re.compile(rf"(<!-- {name}: begin[^>]*-->\n).*?(<!-- {name}: end -->)", re.S)
    if not marked.search(text):
        raise UserError(f"the page has no markers '{name}: begin' and '{name}: end'")
    return marked.sub(lambda found: f"{found[1]}\n{contents}\n{found[2]}", text)


def update(page, name, contents):
    """Writes contents between the markers of a page, named from the root of the project."""
    path = ROOT / page
    write_bytes(path, between_markers(path.read_text(), name, contents).encode())


def within_line(text, name, value):
    """The text of a page with another value between <!-- NAME --> and <!-- /NAME -->, which stand within one line."""
    marked = re.compile(rf"(<!-- {name} -->).*?(<!-- /{name} -->)")
    if not marked.search(text):
        raise UserError(f"the page has no markers '{name}' and '/{name}'")
    return marked.sub(lambda found: f"{found[1]}{value}{found[2]}", text)


def headline(name, value):
    """Writes one figure of the README."""
    path = ROOT / "README.md"
    write_bytes(path, within_line(path.read_text(), name, value).encode())


def facts(title, pairs):
    """A table of (what, figure)."""
    return table(title, ["", "figure"], pairs)


def picture(path):
    """Takes a plot over into docs/."""
    shutil.copy(path, ROOT / "docs")
