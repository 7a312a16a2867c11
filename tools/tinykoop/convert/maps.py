"""What the user says of columns: COLUMN=FIELD[UNIT]*FACTOR, or the [log] of a TOML file, as a robot's own has it."""

import re
from dataclasses import dataclass

from .. import platforms, units
from ..plumbing.errors import UserError

# Brackets around a number are an index. The shortest name counts, so that a name may have brackets of its own.
SOURCE = re.compile(r"(?P<name>.+?)\s*(?:\[(?P<unit>[^][\d][^][]*)\])?(?:\*(?P<factor>[^*]+))?")


@dataclass(frozen=True)
class Mapping:
    column: str
    name: str  # of the field
    factor: float  # to the column's unit
    text: str  # what the user wrote


def mappings(log, columns, maps):
    """The Mappings of all that the user gave."""
    for text in maps:
        yield from of_file(text, columns) if text.endswith(".toml") and "=" not in text else of_text(log, text, columns)


def of_file(path, columns):
    """Those of a TOML file; signals that are no columns here are not needed."""
    from ..diagnose.robots import toml  # with all simulators, which take their time

    for signal in toml.columns(path):
        if signal.name in columns:
            wanted = platforms.UNITS[signal.name]
            # Without a unit a value is in that of the column.
            units.factor(wanted if signal.unit == "1" else signal.unit, wanted, f"{path}: [log] {signal.name}")
            yield Mapping(signal.name, signal.column, signal.scale, str(path))


def of_text(log, text, columns):
    """Those of COLUMN,COLUMN=FIELD[UNIT]*FACTOR."""
    left, _, right = text.partition("=")
    found = SOURCE.fullmatch(right)
    if not left or not found:
        example = next((log.full(topic, fields[0]) for topic, fields in log.topics.items() if fields), log.place)
        raise UserError(f"--map {text}: write COLUMN={log.place}, as in {columns[0]}={example}; or name a .toml file")
    for column in left.split(","):
        if column not in columns:
            raise UserError(f"--map {text}: no column {column!r} here; there are {', '.join(columns)}")
        yield Mapping(column, whole(log, right, found), scale(column, found, text), text)


def whole(log, right, found):
    """The name, which in a table may end with its unit: the column 'x [mm]' is named so."""
    name = right.rpartition("*")[0] if found["factor"] else right
    return name if name in log.topics.get("", ()) else found["name"]


def scale(column, found, text):
    """What a field's value is multiplied with."""
    try:
        times = float(found["factor"] or 1)
    except ValueError:
        raise UserError(f"--map {text}: the factor {found['factor']!r} is not a number")
    wanted = platforms.UNITS[column]
    return times * units.factor(found["unit"] or wanted, wanted, f"--map {text}")
