#!/usr/bin/env python3
"""Writes the library as one pair of files, tinykoop.c and tinykoop.h, to drop into a firmware.

lib/ is written once and compiled twice, with `real`, MATH() and KOOP() standing for one precision. Here both
precisions are written out, so that what is read, searched for and stepped through is plain C. Names that are private
to a file of lib/ get the precision's prefix too, since all of them now stand in one file.

Needs nothing but Python.
"""

import argparse
import hashlib
import io
import os
import re
import sys
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LIB = ROOT / "lib"
PRECISIONS = (("float32", "KOOP_NO_FLOAT", "koopf"), ("float64", "KOOP_NO_DOUBLE", "koopd"))
UNITS = ("", "_supervisor")  # of each precision: koopf.c and koopf_supervisor.c
HEADERS = ("tinykoop", "tinykoop_supervisor")
TAB, COLUMNS = 4, 110

COMMENT_OR_STRING = re.compile(r'/\*.*?\*/|"(?:\\.|[^"\\\n])*"', re.S)
STATIC_FUNCTION = re.compile(r"^(?:OUT_OF_LINE )?static [^;={}()]*?\b(?!KOOP\b)(\w+)\((?!\()", re.M)
STATIC_OBJECT = re.compile(r"^static [^(){}]*[;=]", re.M)
SHARED_ENUM = re.compile(r"^enum \{[^}]*\};\n\n?", re.M)
TABLE = re.compile(r"^(?:(?:static )?const KOOP\(\w+\) KOOP\(\w+\)|\tstatic const KOOP\(\w+\) \w+) = \{.*?\};", re.M | re.S)

# What the comments of the headers say of the files of lib/, and what holds here.
FILE_TALK = (
    (
        "both can be linked into one program. Compile lib/koopf.c,\n * lib/koopd.c, or both. In tinykoop_api.h, "
        "KOOP(name) stands for koopf_name or\n * koopd_name and KOOP_REAL for float or double.\n",
        "both can be linked into one program.\n",
    ),
    (
        "Optional: compile\n * lib/koopf_supervisor.c or lib/koopd_supervisor.c beside koopf.c or koopd.c.\n",
        "Optional.\n",
    ),
)

ABOUT = """\
/* TinyKoop {version}, the whole library in two files: {name}.c and {name}.h.
 *
 * Made by tools/amalgamate.py from lib/ (SHA-256 of its files {digest}); change it there.
 * Licence: MIT, see the end of {name}.h.
 *
 * Use: compile {name}.c, as C99 or as C++11, and include {name}.h. It needs sqrt and fabs
 * of libm, and memcpy, memset, memcmp and strlen, nothing else. With -ffunction-sections
 * -fdata-sections and the linker's --gc-sections only what you call takes flash.
 * Any flags will do: {name}.c asks for strict arithmetic itself. Call koopf_self_test() once at boot.
 *
 * Options, for the whole build:
 *     KOOP_NO_DOUBLE         leaves out float64 (koopd_): what a microcontroller wants
 *     KOOP_NO_FLOAT          leaves out float32 (koopf_)
 *     KOOP_MPC_MAX_GRADIENT  see below
 */
"""
CPP_OPEN = '#ifdef __cplusplus\nextern "C" {\n#endif\n'
CPP_CLOSE = "#ifdef __cplusplus\n}\n#endif\n"
NOTHING_LEFT = (
    "#if defined(KOOP_NO_FLOAT) && defined(KOOP_NO_DOUBLE)\n"
    '#error "KOOP_NO_FLOAT and KOOP_NO_DOUBLE together leave nothing of TinyKoop: drop one of them."\n#endif\n'
)
RESTRICT = "#ifdef __cplusplus\n#define restrict __restrict\n#endif\n"


class Surprise(Exception):
    """lib/ or the arguments are not as this tool expects."""


# ---- Text of C ----------------------------------------------------------------


def width(text):
    """Columns that the text takes from the start of a line."""
    return len(text.expandtabs(TAB))


def pieces(text):
    """(is_code, piece) for each stretch of code and each comment or string."""
    at = 0
    for found in COMMENT_OR_STRING.finditer(text):
        yield True, text[at : found.start()]
        yield False, found.group()
        at = found.end()
    yield True, text[at:]


def open_brackets(line, columns):
    """The stack of columns behind the brackets that are still open after the line."""
    columns = list(columns)
    code = COMMENT_OR_STRING.sub(lambda found: "_" * len(found.group()), line)
    for at, letter in enumerate(code):
        if letter in "([{":
            columns.append(width(line[: at + 1]))
        elif letter in ")]}" and columns:
            columns.pop()
    return columns


def realigned(before, after):
    """The lines of `after` indented as those of `before`: what stood behind an open bracket stands there again."""
    out, was, now = [], [], []
    for old, new in zip(before.split("\n"), after.split("\n"), strict=True):
        indent = old[: len(old) - len(old.lstrip())]
        if was and " " in indent and width(indent) == was[-1]:
            tabs = re.match(r"\t*", indent).group()
            new = tabs + " " * (now[-1] - width(tabs)) + new.lstrip()
        elif " " in indent and width(indent) in was:
            new = indent + new.lstrip()
        if new.endswith("\\"):
            new = new[:-1].rstrip()
            new += " " * max(1, COLUMNS - 1 - width(new)) + "\\"
        was, now = open_brackets(old, was), open_brackets(new, now)
        out.append(new)
    return "\n".join(out)


# ---- One precision ----------------------------------------------------------------


def macros_of(text):
    """Names that the text defines as macros, in order."""
    return list(dict.fromkeys(re.findall(r"^\s*#\s*define (\w+)", text, re.M)))


def included(name, seen):
    """A source of lib/src with what it includes in place, and the system headers it wants into `seen`."""
    text = (LIB / name).read_text()
    seen.update(re.findall(r"^#include (<.*>)$", text, re.M))
    text = re.sub(r"^#include <.*>\n\n?", "", text, flags=re.M)
    return re.sub(
        r'^#include "(.*)"\n',
        lambda found: f"/* ---- {found[1]} ---- */\n\n{included(f'src/{found[1]}', seen)}\n",
        text,
        flags=re.M,
    )


def expanded(text, macros, private, unit):
    """The text with `real`, MATH() and KOOP() written out and private names made the unit's own."""
    real, math, prefix = macros

    def names(piece):
        if piece.startswith('"'):
            return piece
        piece = re.sub(r"\bKOOP\(([\w#]+)\)", rf"{prefix}_\1", piece)
        return re.sub(rf"(?<![.>\w])({'|'.join(private)})\(", rf"{unit}_\1(", piece) if private else piece

    def code(piece):
        piece = re.sub(r"\b(?:real|KOOP_REAL)\b", real, piece)
        return re.sub(r"\bMATH\((\w+)\)", rf"\1{math}", piece)

    def table(found):
        return re.sub(rf"\b({'|'.join(private)})\b", rf"{unit}_\1", found.group())

    out = TABLE.sub(table, text) if private else text
    out = "".join(names(code(piece) if is_code else piece.replace("`real`", real)) for is_code, piece in pieces(out))
    return realigned(text, out)


def unit_text(precision, part, seen, enums):
    """One unit of lib/ (koopf.c, koopd_supervisor.c, ...) in plain C; enumerations go to `enums`, once for all."""
    unit = f"koop{precision[-1]}{part}"
    source = (LIB / f"{unit}.c").read_text()
    seen.update(re.findall(r"^#include (<.*>)$", source, re.M))
    settings = re.findall(r"^#define .*$", source, re.M)
    (root,) = re.findall(r'^#include "src/(.*)"$', source, re.M)
    text = included(f"src/{root}", seen)
    if root == "all.h":
        text = text[text.index("*/") + 2 :].lstrip()  # it speaks of macros that are gone

    real = re.search(r"^#define real (\w+)", source, re.M)[1]
    math = re.search(r"^#define MATH\(function\) function(?:##(\w+))?", source, re.M)[1] or ""
    for enum in SHARED_ENUM.findall(text):
        if enum not in enums:
            enums.append(enum)
    text = SHARED_ENUM.sub("", text)
    found = STATIC_OBJECT.search(text)
    if found:
        raise Surprise(f"a static object outside functions, which this tool does not rename: {found.group()}")
    private = sorted(set(STATIC_FUNCTION.findall(text)))
    public = set(re.findall(r"\bKOOP\((\w+)\)", text))
    for name in private:
        if f"{unit}_{name}" in {f"{precision}_{other}" for other in public}:
            raise Surprise(f"{name}() would get the name of something public in {unit}")

    kept = [line for line in settings if not re.match(r"#define (real|MATH|KOOP)\b", line)]
    undefine = "".join(f"#undef {name}\n" for name in macros_of("\n".join(kept) + "\n" + text))
    head = "\n".join(kept) + "\n\n" if kept else ""
    return f"{head}{expanded(text, (real, math, precision), private, unit).rstrip()}\n\n{undefine}"


# ---- The two files --------------------------------------------------------------


def banner(text):
    """A line that is found when leafing through."""
    return f"/* {'=' * 20} {text} {'=' * 20} */\n"


def api_text(name, precision):
    """The interface of tinykoop_api.h or tinykoop_supervisor_api.h in one precision."""
    text = (LIB / f"include/{name}.h").read_text()
    text = text[text.index("*/") + 2 :].strip("\n") + "\n"
    return expanded(text, ("float" if precision == "koopf" else "double", "", precision), (), precision)


def header_parts(name):
    """Opening comment and what both precisions share of a public header."""
    text = (LIB / f"include/{name}.h").read_text()
    for old, new in FILE_TALK:
        if name == ("tinykoop_supervisor" if "supervisor" in old else "tinykoop"):
            if old not in text:
                raise Surprise(f"{name}.h no longer says '{old.split(' ')[0]} ...' of the files: mend FILE_TALK")
            text = text.replace(old, new)
    comment = text[: text.index("*/") + 2]
    shared = text[text.index("#define", text.index('extern "C"')) if name == "tinykoop" else text.index("/*", text.index('extern "C"')) :]
    return comment, shared[: shared.index("#define KOOP_REAL")].rstrip() + "\n"


def header(about):
    """tinykoop.h"""
    (intro, shared), (supervisor_intro, supervisor_shared) = map(header_parts, HEADERS)
    out = [about, intro + "\n", "#ifndef TINYKOOP_H\n#define TINYKOOP_H\n", NOTHING_LEFT]
    out += ["#include <stddef.h>\n#include <stdint.h>\n", CPP_OPEN, shared, supervisor_intro + "\n", supervisor_shared]
    for title, without, precision in PRECISIONS:
        out += [banner(title), f"#ifndef {without}\n"]
        out += [api_text(f"{name}_api", precision) for name in HEADERS]
        out += [f"#endif /* {without} */\n"]
    licence = "".join(f" * {line}".rstrip() + "\n" for line in (ROOT / "LICENSE").read_text().splitlines())
    return "\n".join([*out, CPP_CLOSE, "#endif\n", "/*\n" + licence + " */\n"])


def source(about):
    """tinykoop.c"""
    seen, enums, body = set(), [], []
    for title, without, precision in PRECISIONS:
        body += [f"#ifndef {without}\n"]
        for part in UNITS:
            body += [banner(title + part.replace("_", ", "))]
            body += [unit_text(precision, part, seen, enums)]
        body += [f"#endif /* {without} */\n"]
    includes = '#include "tinykoop.h"\n\n' + "".join(f"#include {name}\n" for name in sorted(seen))
    return "\n".join([about, includes, RESTRICT, CPP_OPEN, *(enum.rstrip() + "\n" for enum in enums), *body, CPP_CLOSE])


def prefixed(text, prefix):
    """The text with the prefix before every name that the library has in a program."""
    text = re.sub(r"\b(?=koop[fd]?_|tinykoop\.[ch])", prefix, text)
    return re.sub(r"\b(?=KOOP[FD]?_|TINYKOOP_H\b)", prefix.upper(), text)


def digest():
    """What the files of lib/ hash to."""
    whole = hashlib.sha256()
    for path in sorted(LIB.rglob("*.[ch]")):
        whole.update(path.relative_to(LIB).as_posix().encode() + b"\0" + path.read_bytes())
    return whole.hexdigest()[:16]


def write_whole(path, data):
    """Writes the file, or none of it when this is killed."""
    beside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        beside.write_bytes(data)
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def arduino(pair):
    """An Arduino library to install from a file: the pair and what stands in arduino/."""
    files = {f"src/{name}": text for name, text in pair.items()}
    for extra in sorted((ROOT / "arduino").rglob("*.*")):
        files[extra.relative_to(ROOT / "arduino").as_posix()] = extra.read_text()
    files["LICENSE"] = (ROOT / "LICENSE").read_text()
    image = io.BytesIO()
    with zipfile.ZipFile(image, "w") as archive:
        for name, text in sorted(files.items()):
            entry = zipfile.ZipInfo(f"TinyKoop/{name}")  # of a fixed date
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, text, zipfile.ZIP_DEFLATED)
    return image.getvalue()


def run(out, prefix=""):
    """Writes the pair into `out`, and beside it the Arduino library unless the names have a prefix."""
    if not re.fullmatch(r"([A-Za-z_]\w*)?", prefix, re.A):
        raise Surprise(f"a prefix is letters, digits and _, as in my_; not '{prefix}'")
    version = re.search(r'KOOP_VERSION "(.*)"', (LIB / "include/tinykoop.h").read_text())[1]
    about = ABOUT.format(version=version, name="tinykoop", digest=digest())
    pair = {"tinykoop.c": source(about), "tinykoop.h": header(about)}
    pair = {prefix + name: prefixed(text, prefix) for name, text in pair.items()}
    out.mkdir(parents=True, exist_ok=True)
    for name, text in pair.items():
        write_whole(out / name, text.encode())
        print(f"{out / name}: {text.count(chr(10))} lines")
    if not prefix:
        write_whole(out / "TinyKoop-arduino.zip", arduino(pair))
        print(f"{out / 'TinyKoop-arduino.zip'}: to install in the Arduino IDE")


def main():
    """Exit status 2 and one line on standard error for what the user can mend."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=ROOT / "build/out/amalgamated", help="folder for the files")
    parser.add_argument("--prefix", default="", help="goes before every name of the library, as in my_")
    arguments = parser.parse_args()
    try:
        run(arguments.out, arguments.prefix)
    except (Surprise, OSError) as error:
        print(f"amalgamate: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
