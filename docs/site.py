"""What mkdocs adds to these pages: the README as the first one, guides from the root, and the reference, made of the C headers."""

import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[1]
HEADERS = ("tinykoop.h", "tinykoop_api.h", "tinykoop_guard_api.h")
FROM_ROOT = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}


def _prose(comment):
    """The text of a C comment; indented lines stay as they are."""
    return "\n".join(re.sub(r"^ ?\*? ?", "", line) for line in comment.strip("\n -").splitlines()).strip()


def _section(text):
    """Markdown of one block of a header: declarations, then what their comment says."""
    comment, _, code = text.partition("*/")
    about = _prose(comment.removeprefix("/*"))
    heading = re.fullmatch(r"-{4} (.*?) -{4,}", re.sub(r"\s+", " ", comment.removeprefix("/*").strip()))
    if heading:
        return f"## {heading[1]}\n"
    code = code.strip("\n")
    return (f"```c\n{code}\n```\n\n" if code else "") + f"{about}\n"


def _blocks(header):
    """Comments at the left margin with the declarations that follow them."""
    body = header.split('extern "C" {', 1)[-1]
    return re.findall(r"^/\*.*?\*/(?:\n(?!/\*)[^\n]*)*", body, re.S | re.M)


def reference():
    """All public declarations with their comments."""
    first = (ROOT / "lib/include" / HEADERS[0]).read_text()
    parts = ["# Reference of the C interface\n", _section(re.match(r"/\*.*?\*/", first, re.S)[0])]
    for name in HEADERS:
        parts.append(f"\n# {name}\n")
        parts += [_section(block) for block in _blocks((ROOT / "lib/include" / name).read_text())]
    return "\n".join(parts)


def _moved(text):
    """A page of the root as a page of docs/: links lead to where things are from there."""
    text = re.sub(r"\]\(docs/", "](", text)
    for page, source in FROM_ROOT.items():
        text = text.replace(f"]({source})", f"]({page})")
    return re.sub(r"\[([^\]]+)\]\((?:CITATION\.cff|SECURITY\.md|targets/[^)]*|examples/[^)]*)\)", r"\1", text).replace('src="docs/', 'src="')


def on_files(files, config):
    for page, source in FROM_ROOT.items():
        files.append(File.generated(config, page, content=_moved((ROOT / source).read_text())))
    files.append(File.generated(config, "reference.md", content=reference()))
    return files


def on_page_markdown(markdown, page, **_):
    """Links to files of the repository that are no pages become their names."""
    return re.sub(r"\[([^\]]+)\]\(\.\./[^)]*\)", r"\1", markdown)
