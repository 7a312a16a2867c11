"""What every source format gives."""

from dataclasses import dataclass

import numpy as np


@dataclass
class Series:
    """Samples of one field, in SI units, x forward, y left, z up; times in seconds on the file's own clock."""

    t: np.ndarray
    x: np.ndarray
    trusted: np.ndarray | None = None  # per sample: the source itself stands by it
    epoch: np.ndarray | None = None  # per sample: changes where the estimate was set again, which is no motion


class Log:
    """An opened file. A format fills `topics`, `usual` and `mend`, and says how to read and to scale."""

    quaternion = (".w", ".x", ".y", ".z")  # what follows the name of a quaternion
    mend = "log it"
    place = "TOPIC.FIELD"  # how the user names a field
    timed = ()  # "t", where the time is a field like others

    def __init__(self, path):
        self.path = path
        self.topics = {}  # topic: its fields
        self.usual = {}  # column: candidates, the best first
        self.notes = []  # what the user should know of the columns

    def quadrotor(self):
        """What a quadrotor has from other sources, as in `usual`: its accelerations are not those of an accelerometer."""
        return dict.fromkeys(("ax", "ay", "az"), ())

    def split(self, name):
        """(topic, field) of what the user names, without a field where it is a topic; None where there is no such topic."""
        topic = max((t for t in self.topics if f"{name}.".startswith(f"{t}.")), key=len, default=None)
        return None if topic is None else (topic, name[len(topic) + 1 :])

    def clocked(self, chosen):
        """The chosen fields, without the time."""
        return chosen

    def find(self, candidate):
        """[(topic, field)] of the file that a usual source stands for."""
        topic, _, field = candidate.partition(".")
        return [(topic, field)] if topic in self.topics else []

    def words(self, candidate):
        """A usual source, as a message says it."""
        return candidate

    def names(self):
        """What the file has, as a message says it."""
        return list(self.topics)

    def full(self, topic, field):
        """A field, as messages and read() name it."""
        return f"{topic}.{field}"

    def read(self, names, commands):
        """{TOPIC.FIELD: Series}; `commands` are those that count from when they were given, not measured."""
        raise NotImplementedError

    def thrust(self, name, series):
        """The thrust asked for, of full thrust, in a field that is the command of a motor; other fields as they are."""
        return series.x


class FlatLog(Log):
    """Columns of a table, which have no topics."""

    place = "COLUMN[UNIT]"

    def __init__(self, path, names):
        super().__init__(path)
        self.topics = {"": list(names)}

    def split(self, name):
        return "", name

    def find(self, candidate):
        return [("", candidate)]

    def names(self):
        return self.topics[""]

    def full(self, topic, field):
        return field
