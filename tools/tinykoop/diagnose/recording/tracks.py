"""What was measured, and what the simulator predicts of it without and with the effects, row by row."""

from dataclasses import dataclass

import numpy as np

from ..prediction_errors.ahead import HORIZONS

KINDS = ("simulator", "with_effects")
POSE = {
    "x": ("px", "x"),
    "y": ("py", "y"),
    "z": ("pz", "z"),
    "yaw": ("yaw", "theta", "psi", "heading"),
    "pitch": ("pitch",),
    "roll": ("roll",),
}


@dataclass
class Tracks:
    """t (K,) as the log has it; measured (K, c) and predicted {kind: (K, c)} of signals [(name, unit)], NaN where there is nothing.

    windows: [(first row, last row)] of the predictions, each from what was measured in its first row.
    """

    t: np.ndarray
    signals: tuple
    wraps: np.ndarray
    measured: np.ndarray
    predicted: dict
    windows: list

    def residuals(self, kind):
        """Measured less predicted (K, c)."""
        missed = self.measured - self.predicted[kind]
        return np.where(self.wraps, (missed + np.pi) % (2 * np.pi) - np.pi, missed)

    @property
    def pose(self):
        """{x, y, ..: column} of a robot whose position is known, or None."""
        names = [name for name, _ in self.signals]
        found = {axis: names.index(name) for axis, some in POSE.items() for name in some if name in names}
        return found if {"x", "y"} <= set(found) else None


def _windows(usable, known, steps):
    """One after the other along each stretch without gaps, from rows at which the robot's state is known."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], usable.astype(int), [0]]))).reshape(-1, 2)
    return [(a, min(a + steps, end)) for start, end in edges for a in range(start, end, steps) if known[a]]


def of(result):
    """The Tracks of a Diagnosis."""
    path, log, steps = result.path, result.log, HORIZONS[-1]
    windows = _windows(log.usable, path.known, steps)
    starts = np.array([a for a, _ in windows], int)
    predicted = {}
    for kind, causes in zip(KINDS, ((), result.fit.causes) if result.fit.causes else ((),)):
        predicted[kind] = np.full(path.readings.shape, np.nan)
        for (a, b), values in zip(windows, path.shown(causes, starts, np.arange(1, steps + 1))):
            predicted[kind][a + 1 : b + 1] = values[: b - a]
            if not np.isfinite(predicted[kind][a]).any():  # of the first; elsewhere the window before has ended there
                predicted[kind][a] = path.readings[a]
    return Tracks(log.t, path.signals, np.array(path.wraps), path.readings, predicted, windows)
