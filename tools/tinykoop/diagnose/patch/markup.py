"""An XML file as elements that know their places in its text: a number changes, and all else stays as it was written."""

import re
import xml.parsers.expat
from dataclasses import dataclass, field

from ...plumbing.errors import UserError

TAG = re.compile(r"""<[^\s/>]+(?:\s+[^\s=]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?>""")


@dataclass
class Element:
    """start, opened: of its first tag; closed: where its last tag begins, or None without one."""

    tag: str
    attributes: dict
    parent: "Element | None" = None
    start: int = 0
    opened: int = 0
    closed: int | None = None
    children: list = field(default_factory=list)

    def all(self, *tags):
        """Elements of these tags, or of any, anywhere inside, in the order of the file."""
        for child in self.children:
            if not tags or child.tag in tags:
                yield child
            yield from child.all(*tags)

    def child(self, tag):
        """The first child of a tag, or None."""
        return next((child for child in self.children if child.tag == tag), None)


class Reader:
    """Makes an Element of a file's root."""

    def __init__(self, text, path):
        self.data, self.text, self.top = text.encode(), text, Element("", {})
        self.at, self.parser = self.top, xml.parsers.expat.ParserCreate("utf-8")
        self.parser.StartElementHandler, self.parser.EndElementHandler = self._begin, self._end
        try:
            self.parser.Parse(self.data, True)
        except xml.parsers.expat.ExpatError as error:
            raise UserError(f"{path}: is no XML ({error})") from error

    def _place(self):
        return len(self.data[: self.parser.CurrentByteIndex].decode())

    def _begin(self, tag, attributes):
        start = self._place()
        self.at.children.append(Element(tag, attributes, self.at, start, TAG.match(self.text, start).end()))
        self.at = self.at.children[-1]

    def _end(self, tag):
        self.at.closed = None if self.text[self.at.opened - 2] == "/" else self._place()
        self.at = self.at.parent


def read(text, path):
    """The Element around the root of a file."""
    return Reader(text, path).top


def at(text, start, path):
    """The element that begins there: what is changed inside an element, or behind it, does not move its beginning."""
    return next(element for element in read(text, path).all() if element.start == start)


# ---- changes: each gives the text with it --------------------------------------------------------------------


def number(value):
    return f"{value:.6g}"


def with_attributes(text, element, values):
    """With attributes {name: value}: in place of those that are there, or as the last ones."""
    tag = text[element.start : element.opened]
    for name, value in values.items():
        found = re.search(rf"""\s{re.escape(name)}\s*=\s*(["'])(.*?)\1""", tag, re.S)
        end = len(tag) - (2 if tag.endswith("/>") else 1)
        tag = tag[: found.start(2)] + value + tag[found.end(2) :] if found else f'{tag[:end].rstrip()} {name}="{value}"{tag[end:]}'
    return text[: element.start] + tag + text[element.opened :]


def with_child(text, element, made):
    """With one more child at an element's end, on a line of its own where its others are."""
    if element.closed is None:
        end = element.opened - 2
        return f"{text[:end].rstrip()}>{made}</{element.tag}>{text[element.opened :]}"
    last = element.children[-1] if element.children else None
    line = re.compile(r"\n[ \t]*\Z").search(text[: last.start]) if last else None
    end = len(text[: element.closed].rstrip())
    return f"{text[:end]}{line[0] if line else ''}{made}{text[end:]}"


def with_content(text, element, tags, value):
    """With the number in the element that tags lead to, made where it is not there."""
    child = element.child(tags[0])
    if child is None:
        return with_child(text, element, "".join(f"<{tag}>" for tag in tags) + value + "".join(f"</{tag}>" for tag in reversed(tags)))
    if len(tags) > 1:
        return with_content(text, child, tags[1:], value)
    if child.closed is None:
        return f"{text[: child.start]}<{child.tag}>{value}</{child.tag}>{text[child.opened :]}"
    return text[: child.opened] + value + text[child.closed :]


def content(text, element, path):
    """The number between the tags of an element."""
    return as_number(text[element.opened : element.closed], element, path)


def as_number(written, element, path):
    try:
        return float(written)
    except ValueError:
        raise UserError(f"{path}: <{element.tag}> has '{written.strip()}' where a number is needed; write the number itself") from None
