"""GCC's call graph of the library (-fcallgraph-info=su): what may call what, and how deep the stack gets.

A call through member m of a table, as its source line shows, may reach every function of the tables that
is named m_* or *_m.
"""

import functools
import re
from pathlib import Path

_TITLE = r'"(?:[^"]*:)?([^":]+)"'
INDIRECT = "__indirect_call"
USERS = ("adjust", "memory", "reshape")  # calls that only a user's regulator has, as long as no regulator of the library has them


def held_in_tables(relocations):
    """The functions whose addresses lie in constant data (dictionaries, regulators, forms), by objdump -r."""
    sections = re.split(r"RELOCATION RECORDS FOR \[(.*)\]:", relocations)
    data = [text for name, text in zip(sections[1::2], sections[2::2]) if re.match(r"\.s?(ro)?data", name)]  # .s: small, on RISC-V
    return set(re.findall(r"\s(?:\.text\.(?:unlikely\.|hot\.)?)?([a-z]\w+)(?:[+-]0x\w+)?$", "".join(data), re.MULTILINE))


def who_could_be(path, line, tables):
    """The functions that the call through a table in this source line may reach."""
    text = Path(path).read_text().splitlines()[line - 1]
    (member,) = re.findall(r"->(\w+)\(", text)
    found = {name for name in tables if re.match(rf"{member}_|.*_{member}$", name)}
    if not found and member not in USERS:
        raise LookupError(f"who is {member}?")
    return found


def calls(graph, tables):
    """{function: functions it may call}."""
    functions = set(re.findall(rf"node: {{ title: {_TITLE}", graph)) - {INDIRECT}
    reached = {name: set() for name in functions}
    edge = rf'sourcename: {_TITLE} targetname: {_TITLE}(?: label: "([^"]*):(\d+):\d+")?'
    for source, target, path, line in re.findall(edge, graph):
        reached[source] |= who_could_be(path, int(line), tables) if target == INDIRECT else {target}
    return reached


def cycle(reached):
    """A function that is recursive, or None."""
    state = {}

    def visit(function):
        if state.get(function) == "open":
            return function
        if function in state:
            return None
        state[function] = "open"
        found = next(filter(None, map(visit, sorted(reached.get(function, ())))), None)
        state[function] = "done"
        return found

    return next(filter(None, map(visit, sorted(reached))), None)


def deepest(graph, tables, others=()):
    """{function: (bytes of stack with all that it calls, the calls)} of the public ones and `others`; libm is not counted."""
    frames = {name: int(size) for name, size in re.findall(rf'title: {_TITLE} label: "[^"]*?(\d+) bytes \(', graph)}
    reached = calls(graph, tables)

    @functools.cache
    def depth(name):
        below = max(map(depth, reached.get(name, ())), default=(0, []))
        return frames.get(name, 0) + below[0], [name, *below[1]]

    return {name: depth(name) for name in frames if name.startswith("koop") or name in others}
