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

    def __init__(self, path):
        self.path = path
        self.topics = {}  # topic: its fields
        self.usual = {}  # column: candidates, the best first

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

    def read(self, names, commands):
        """{TOPIC.FIELD: Series}; `commands` are those that count from when they were given, not measured."""
        raise NotImplementedError
