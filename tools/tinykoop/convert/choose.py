"""Which field of the file makes which column: the usual ones, or what the user says."""

from dataclasses import dataclass

from ..plumbing.errors import UserError

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
    names = ["".join(c if c.isprintable() else "?" for c in str(name))[:80] for name in names]
    return ", ".join(names[:MOST]) + (f" and {len(names) - MOST} more" if len(names) > MOST else "") or "nothing"


def choose(log, columns, maps=()):
    """{column: Field}; yaw_rate, where nothing is said, None: it follows from gyro and attitude."""
    chosen = dict.fromkeys(columns) | said(log, columns, maps)
    missing, several = {}, {}
    for column in (c for c in columns if chosen[c] is None and c != "yaw_rate"):
        found = usual(log, column)
        if not found:
            missing.setdefault(tuple(dict.fromkeys(map(log.words, log.usual.get(column, ())))), []).append(column)
        elif len(found) > 1:
            several.setdefault(tuple(topic for topic, _ in found), []).append(column)
        else:
            chosen[column] = found[0][1]
    if missing:
        what = [", ".join(wanted) + f" (usually {' or '.join(names)})" for names, wanted in missing.items()]
        raise UserError(
            f"{log.path}: nothing for {'; '.join(what)}: {log.mend}, or name the field with --map COLUMN=TOPIC.FIELD; "
            f"the file has {listed(log.names())}"
        )
    for topics, wanted in several.items():
        raise UserError(
            f"{log.path}: {', '.join(wanted)} could be from {' or '.join(topics)}: "
            f"choose with --map {','.join(wanted)}={topics[0]}"
        )
    return chosen


def said(log, columns, maps):
    """{column: Field} of what the user maps."""
    fields = {}
    for text in maps:
        left, _, right = text.partition("=")
        if not left or not right:
            raise UserError(f"--map {text}: say COLUMN=TOPIC.FIELD, as in {columns[0]}={example(log)}")
        for column in left.split(","):
            if column not in columns:
                raise UserError(f"--map {text}: no column {column!r} here; there are {', '.join(columns)}")
            fields[column] = mapped(log, column, right, text)
    return fields


def example(log):
    """Some TOPIC.FIELD of the file."""
    return next((f"{topic}.{fields[0]}" for topic, fields in log.topics.items() if fields), "TOPIC.FIELD")


def usual(log, column):
    """[(topic, Field)] of the first usual source of a column that the file has; several where it has several."""
    for candidate in log.usual.get(column, ()):
        found = [(topic, field) for topic, name in log.find(candidate) if (field := as_field(log, column, topic, name))]
        if found:
            return found
    return []


def as_field(log, column, topic, name, factor=1.0):
    """Field of a topic: a number, or for an angle a quaternion; None if the file has neither."""
    fields = log.topics.get(topic, ())
    if name in fields:
        return Field(f"{topic}.{name}", (f"{topic}.{name}",), factor)
    parts = [name + part for part in log.quaternion]
    if column in ANGLES and all(part in fields for part in parts):
        return Field(f"{topic}.{name}", tuple(f"{topic}.{part}" for part in parts), factor)
    return None


def mapped(log, column, right, text):
    """Field that the user named: TOPIC.FIELD, or TOPIC alone for the usual one in it."""
    name, star, factor = right.partition("*")
    try:
        factor = float(factor) if star else 1.0
    except ValueError:
        raise UserError(f"--map {text}: the factor {factor!r} is not a number")
    topic = max((t for t in log.topics if f"{name}.".startswith(f"{t}.")), key=len, default=None)
    if topic is None:
        raise UserError(f"--map {text}: {log.path} has no topic for {name!r}; it has {listed(log.names())}")
    if name == topic:
        candidates = [wanted for c in log.usual.get(column, ()) for where, wanted in log.find(c) if where == topic]
    else:
        candidates = [name[len(topic) + 1 :]]
    for candidate in candidates:
        if field := as_field(log, column, topic, candidate, factor):
            return field
    raise UserError(f"--map {text}: {log.path} has no such field; {topic} has {listed(log.topics[topic])}")
