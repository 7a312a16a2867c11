"""C sources as tokens, and how tokens belong together: enough of C to change one thing at a time.

Comments and preprocessor lines are left out, except the bodies of macros, which are code.
"""

import re
from dataclasses import dataclass
from functools import cached_property

TOKEN = re.compile(
    r"""(?P<blank>(?:\s|\\\n|/\*.*?\*/|//[^\n]*)+)
      |(?P<directive>(?m:^)\#(?:\\\n|/\*.*?\*/|[^\n])*)
      |(?P<string>"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')
      |(?P<number>(?:0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)[uUlLfF]*)
      |(?P<name>[A-Za-z_]\w*)
      |(?P<sign><<=|>>=|\+\+|--|->|&&|\|\||\#\#|[-+*/%&|^=!<>]=|<<|>>|.)""",
    re.S | re.X,
)
DEFINE = re.compile(r"#\s*define\s+(\w+)(?:\([^)]*\))?")

TYPES = set("real const static void char signed unsigned int size_t int32_t uint32_t uint64_t ptrdiff_t typedef struct enum".split())
CONTROL = {"if", "for", "while", "switch"}
KEYWORDS = CONTROL | {"return", "else", "do", "case", "default", "sizeof", "goto"}
PASTED = {"KOOP", "MATH"}  # macros that make a name
ASSIGNMENTS = {"=", "+=", "-=", "*=", "/=", "%=", "&=", "|=", "^=", "<<=", ">>="}
STEPS = {"++": "--", "--": "++"}
OPENING, CLOSING = {"(", "[", "{"}, {")", "]", "}"}
ENDS = {*OPENING, *CLOSING, ",", ";", "?", ":", "return", "", *ASSIGNMENTS}  # of an operand


@dataclass(frozen=True)
class Token:
    kind: str
    text: str
    start: int
    end: int
    macro: str = ""  # in whose body it is


def read_tokens(text, start=0, end=None, macro=""):
    """Tokens that may be mutated; an empty one stands before and after the body of each macro."""
    end = len(text) if end is None else end
    while start < end:
        found = TOKEN.match(text, start, end)
        kind, start = found.lastgroup, found.end()
        if kind == "directive" and (head := DEFINE.match(found[0])):
            body = found.start() + head.end()
            yield Token("edge", "", body, body)
            yield from read_tokens(text, body, start, head[1])
            yield Token("edge", "", start, start)
        elif kind not in ("blank", "directive"):
            yield Token(kind, found[0], found.start(), start, macro)


class Code:
    """Tokens of a C source, and how they belong together. Tokens are meant by their index."""

    def __init__(self, text):
        self.text = text
        self.tokens = list(read_tokens(text))
        self.words = [token.text for token in self.tokens]

    def __len__(self):
        return len(self.tokens)

    def kind(self, i):
        return self.tokens[i].kind

    @cached_property
    def partner(self):
        """{bracket: the one that closes or opens it}."""
        partner, open_ones = {}, []
        for i, word in enumerate(self.words):
            if word in OPENING:
                open_ones.append(i)
            elif word in CLOSING:
                partner[i] = open_ones.pop()
                partner[partner[i]] = i
        return partner

    def called(self, i):
        """The name before the opening parenthesis i, KOOP(name) taken for name; "" where there is none."""
        if i == 0 or self.words[i] != "(":
            return ""
        if self.words[i - 1] == ")" and self.words[self.partner[i - 1] - 1] in PASTED:
            return self.words[i - 2]
        return self.words[i - 1] if self.kind(i - 1) == "name" and self.words[i - 1] not in KEYWORDS | PASTED else ""

    @cached_property
    def functions(self):
        """For each token the macro or function it is in, or ""."""
        names, name, end = [], "", -1
        for i, token in enumerate(self.tokens):
            if token.text == "{" and i > end and not token.macro and self.words[i - 1] == ")":
                name, end = self.called(self.partner[i - 1]), self.partner[i]
            names.append(token.macro or (name if i <= end else ""))
        return names

    def operand(self, i, step, ends):
        """(first, last) of what stands before (step -1) or behind (step 1) the operator i, up to one of `ends`."""
        j = i + step
        while self.words[j] not in ends or (j in self.partner and (self.partner[j] - j) * step > 0):
            j = (self.partner[j] if j in self.partner else j) + step
        return (j + 1, i - 1) if step < 0 else (i + 1, j - 1)

    def is_binary(self, i):
        """Whether the sign i stands between two operands, and not before one or in a declaration."""
        before = self.words[i - 1]
        if before == ")" and self.words[i] == "*" and self.words[self.partner[i - 1] - 1] == "KOOP":
            return False
        names = self.kind(i - 1) == "name" and before not in TYPES | KEYWORDS
        return names or before in (")", "]", *STEPS) or self.kind(i - 1) == "number"

    def is_array_size(self, i):
        """Whether the number i is one in a declaration, such as real sum[4]."""
        if self.words[i - 1] != "[" or self.words[i + 1] != "]":
            return False
        return self.words[i - 3] in TYPES or self.words[i + 2 : i + 4] == ["=", "{"]

    def _is_block(self, i):
        return self.words[i] == "{" and self.words[i - 1] != "="

    def _ends_head(self, i):
        """Whether i closes the head of a control statement, or the call of a macro that no semicolon follows."""
        if self.words[i] != ")":
            return False
        before, after = self.words[self.partner[i] - 1], self.tokens[i + 1]
        return before in CONTROL or (before.isupper() and before not in PASTED and (after.kind == "name" or after.text in ("}", "")))

    def _ends_statement(self, i):
        return self.words[i] in (";", "}", "else", "") or self._is_block(i) or self._ends_head(i)

    def _after(self, i):
        """The next token to look at: of brackets that are no block only the last one, if that can end a statement."""
        return self.partner[i] + (self.words[i] != "(") if self.words[i] in OPENING else i + 1

    @cached_property
    def statements(self):
        """(first, last) of each statement, and of each head of a compound one."""
        found, first = [], 0
        while first < len(self):
            last = first
            while not self._ends_statement(last):
                last = self._after(last)
            if last > first:
                found.append((first, last))
            first = last + 1
        return found
