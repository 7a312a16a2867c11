"""Which field of the file makes which column: the usual ones, or what the user says (maps.py)."""

from dataclasses import dataclass

from ..plumbing.asked import near, plain
from ..plumbing.errors import UserError
from .maps import mappings

ANGLES = ("pitch", "roll", "yaw", "theta")
MOST = 60  # names listed in a message


@dataclass
class Field:
    """Where a column comes from: one field, or the four of a quaternion (w, x, y, z)."""

    label: str
    names: tuple
    factor: float = 1.0


def listed(names):
    """Names for a message of one line."""
    names = [plain(name) for name in names]
    return ", ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "") or "nothing"


def choose(log, columns, maps=(), optional=()):
    """{column: Field}, without the optional ones that the file lacks; yaw_rate, where nothing is said, None: it follows from
    gyro and attitude.
    """
    chosen = dict.fromkeys(columns) | said(log, columns, maps)
    missing, several = {}, {}
    for column in (c for c in columns if chosen[c] is None):
        found = usual(log, column)
        if not found and column == "yaw_rate":
            continue
        if not found and column in optional:
            del chosen[column]
            continue
        if not found:
            missing.setdefault(tuple(dict.fromkeys(map(log.words, log.usual.get(column, ())))), []).append(column)
        elif len(found) > 1:
            several.setdefault(tuple(topic for topic, _ in found), []).append(column)
        else:
            chosen[column] = found[0][1]
    if missing:
        what = [", ".join(wanted) + (f" (usually {' or '.join(names)})" if names else "") for names, wanted in missing.items()]
        raise UserError(
            f"{log.path}: nothing for {'; '.join(what)}: {log.mend}, or name the field with --map COLUMN={log.place}; "
            f"the file has {listed(log.names())}"
        )
    for topics, wanted in several.items():
        raise UserError(
            f"{log.path}: {', '.join(wanted)} could be from {' or '.join(topics)}: choose with --map {','.join(wanted)}={topics[0]}"
        )
    return chosen


def said(log, columns, maps):
    """{column: Field} of what the user maps."""
    fields = {}
    for mapping in mappings(log, columns, maps):
        if mapping.column in fields:
            raise UserError(f"--map {mapping.text}: {mapping.column} is mapped twice; leave one out")
        fields[mapping.column] = mapped(log, mapping)
    return fields


def usual(log, column):
    """[(topic, Field)] of the first usual source of a column that the file has; several where it has several."""
    for candidate in log.usual.get(column, ()):
        found = [(topic, field) for topic, name in log.find(candidate) if (field := as_field(log, column, topic, name))]
        if found:
            return found
    return []


def as_field(log, column, topic, name, factor=1.0):
    """Field of a topic: a number, or for an angle a quaternion; None if the file has neither."""
    fields, label = log.topics.get(topic, ()), log.full(topic, name)
    if name in fields:
        return Field(label, (label,), factor)
    parts = [name + part for part in log.quaternion]
    if column in ANGLES and all(part in fields for part in parts):
        return Field(label, tuple(log.full(topic, part) for part in parts), factor)
    return None


def mapped(log, mapping):
    """Field that the user named: a topic's field, or a topic alone for the usual one in it."""
    found = log.split(mapping.name)
    if found is None:
        raise UserError(f"--map {mapping.text}: {log.path} has no topic for {mapping.name!r}; it has {listed(log.names())}")
    topic, name = found
    usual = [wanted for c in log.usual.get(mapping.column, ()) for where, wanted in log.find(c) if where == topic]
    for candidate in [name] if name else usual:
        if field := as_field(log, mapping.column, topic, candidate, mapping.factor):
            return field
    raise UserError(f"--map {mapping.text}: {log.path}: no such field; {topic or 'the file'} has {near(name, log.topics[topic])}")
