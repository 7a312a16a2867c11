"""Mutants of a C source: small changes, each of which a test should notice.

Comments, strings and preprocessor lines stay as they are, except the bodies of macros. Array sizes in declarations stay
too, since a larger array changes nothing. Whether a mutant compiles is for the compiler to say.
"""

import re
from dataclasses import dataclass

from .csource import ASSIGNMENTS, ENDS, KEYWORDS, OPENING, PASTED, STEPS, TYPES, Code

# No | for &: it separates the fields of equivalent.txt.
ARITHMETIC = {"+": "-", "-": "+", "*": "/", "/": "*", "%": "*", "<<": ">>", ">>": "<<", "&": "^", "^": "&"}
COMPOUND = {"+=": "-=", "-=": "+=", "*=": "/=", "/=": "*=", "&=": "^=", "^=": "&="}
RELATIONAL = {"<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"), "==": ("!=",), "!=": ("==",)}
# Functions of lib/ that do not care about the order of two neighbouring arguments, with the first of these.
SYMMETRIC = {"max_of": 0, "dot": 0, "clip": 0, "add_products": 1, "add_product": 2, "bits_differ": 0}
LOGICAL = {"&&": ("||", "1"), "||": ("&&", "0")}  # the other one, and what stands for a side that is dropped


@dataclass(frozen=True)
class Mutant:
    """A change of one file: what stands from `start` to `end` becomes `text`."""

    file: str  # from the root of the project
    function: str  # or macro, in which it is
    source: str
    start: int
    end: int
    text: str

    @property
    def place(self):
        return f"{self.file}:{self.source.count(chr(10), 0, self.start) + 1}"

    @property
    def mutated(self):
        return self.source[: self.start] + self.text + self.source[self.end :]

    @property
    def before(self):
        """What changes: the whole line, or the lines as one."""
        return self._line(self.source[self.start : self.end])

    @property
    def after(self):
        return self._line(self.text)

    def _line(self, text):
        first = self.source.rfind("\n", 0, self.start) + 1
        last = self.source.find("\n", self.end)
        whole = self.source[first : self.start] + text + self.source[self.end : last]
        return " ".join(whole.replace("\\\n", " ").split()).removesuffix(" \\")


# ---- the changes: each yields (first token, last token, text) ------------------------------------------------


def replaced_signs(code):
    """Arithmetic, relational and logical operators; boundaries of loops are among them."""
    for i, word in enumerate(code.words):
        others = [STEPS.get(word), COMPOUND.get(word), LOGICAL.get(word, [None])[0], *RELATIONAL.get(word, ())]
        if word in ARITHMETIC and code.is_binary(i):
            others.append(ARITHMETIC[word])
        yield from ((i, i, other) for other in others if other)


def dropped_signs(code):
    """Unary minus, complement and negation."""
    return ((i, i, "") for i, word in enumerate(code.words) if word in ("!", "~") or (word == "-" and not code.is_binary(i)))


def changed_number(text):
    """What takes a number's place: floats doubled, integers one more and one less."""
    digits = text.rstrip("uUlL") if text[:2] in ("0x", "0X") else text.rstrip("uUlLfF")
    suffix = text[len(digits) :]
    if text[:2] not in ("0x", "0X") and re.search("[.eE]", digits):
        return [f"{2 * float(digits)!r}{suffix}"]
    value = int(digits, 0)
    return [f"{near}{suffix}" for near in (value + 1, value - 1) if near >= 0]


def changed_numbers(code):
    """All numbers; but return 1 only becomes return 0, since any other number is as true."""
    for i, word in enumerate(code.words):
        if code.kind(i) == "number" and not code.is_array_size(i):
            others = ["0"] if code.words[i - 1 : i + 2] == ["return", "1", ";"] else changed_number(word)
            yield from ((i, i, other) for other in others)


def next_elements(code):
    """Indices off by one; those that are numbers are changed as such."""
    for i, word in enumerate(code.words):
        last = code.partner[i] - 1 if word == "[" else i
        if last > i and code.kind(last) != "number":
            yield last, last, f"{code.words[last]} + 1"


def dropped_sides(code):
    """One side of && and ||."""
    for i, word in enumerate(code.words):
        if word in LOGICAL:
            ends = ENDS | {"||", word}
            yield from ((*code.operand(i, step, ends), LOGICAL[word][1]) for step in (-1, 1))


def negated_conditions(code):
    for i, word in enumerate(code.words):
        if word == "(" and code.words[i - 1] in ("if", "while"):
            yield i, code.partner[i], f"(!{code.text[code.tokens[i].start : code.tokens[code.partner[i]].end]})"
        if word == "?":
            first, last = code.operand(i, -1, ENDS)
            yield first, last, f"!({code.text[code.tokens[first].start : code.tokens[last].end]})"


def is_declaration(code, i):
    """Whether what begins at token i declares: real *x, KOOP(mpc) *mpc."""
    if code.words[i] in PASTED:
        after = code.partner[i + 1] + 1
        return code.words[after] == "*" or code.kind(after) == "name"
    return code.words[i] in TYPES


def is_droppable(code, first, last):
    """Whether it is a call, an assignment, a step, break or continue."""
    words = code.words[first : last + 1]
    if words[0] in KEYWORDS or is_declaration(code, first) or words[-1] not in (";", ")"):
        return False
    return words[0] in ("break", "continue") or words[-1] == ")" or words[-2] == ")" or any(w in ASSIGNMENTS or w in STEPS for w in words)


def dropped_statements(code):
    return ((first, last, ";") for first, last in code.statements if is_droppable(code, first, last))


def arguments(code, i):
    """(first, last) of each argument in the parentheses that i opens."""
    found, first, j = [], i + 1, i + 1
    while j <= code.partner[i]:
        if code.words[j] == "," or j == code.partner[i]:
            found.append((first, j - 1))
            first = j + 1
        j = (code.partner[j] if code.words[j] in OPENING else j) + 1
    return found


def swapped_arguments(code):
    for i in range(len(code)):
        function = code.called(i)
        given = arguments(code, i) if function else []
        for k, ((a, b), (c, d)) in enumerate(zip(given, given[1:])):
            if k != SYMMETRIC.get(function) and not is_declaration(code, a) and not is_declaration(code, c):
                one, two = (code.text[code.tokens[x].start : code.tokens[y].end] for x, y in ((a, b), (c, d)))
                yield a, d, f"{two}, {one}"


CHANGES = (
    replaced_signs, dropped_signs, changed_numbers, next_elements, dropped_sides, negated_conditions, dropped_statements, swapped_arguments,
)  # fmt: skip


def mutants(file, text):
    """All mutants of one file, in the order of the file; no two are the same text."""
    code = Code(text)
    found = {
        (code.tokens[first].start, code.tokens[last].end, new): code.functions[first]
        for change in CHANGES
        for first, last, new in change(code)
    }
    return [Mutant(file, found[edit], text, *edit) for edit in sorted(found) if text[edit[0] : edit[1]] != edit[2]]
