"""Whether the pose of a drive answers the speeds that go into a link."""

import numpy as np

from ... import answers
from ...prediction_errors.noise import white

WINDOW = 1.0  # s, over which motion is summed


def short(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def dead(log, u):
    """Whether the pose of a log does not answer speeds u (K, 2): along the robot or in heading, wherever these move it enough to see."""
    return answers.dead(answer(log, u))


def answer(log, u):
    """What is known of each axis, along the robot and heading: RMS motion in a window that goes in and that comes out, and so on."""
    moved, noise = steps(log), _noise(log)
    n = max(round(WINDOW / log.dt), 2)
    starts = answers.windows(log.usable, n)
    into = [answers.sums(u[:-1, i] * log.dt, starts, n, answers.LAGS) for i in (0, 1)]
    return [answers.axis(into[i], answers.sums(moved[:, i], starts, n, 1)[:, 0], noise[i]) for i in (0, 1)]


def steps(log):
    """(K - 1, 2): way along the robot and turn from row to row; zero where it is not known."""
    turn = short(np.diff(log.x[:, 2]))
    middle, way = log.x[:-1, 2] + turn / 2, np.diff(log.x[:, :2], axis=0)
    along = way[:, 0] * np.cos(middle) + way[:, 1] * np.sin(middle)
    return np.where(log.usable[:, None], np.stack([along, turn], 1), 0.0)


def _noise(log):
    """Standard deviations (2,) of position and heading, in white noise."""
    x, good = np.nan_to_num(log.x), log.usable
    x = np.column_stack([x[:, :2], np.unwrap(x[:, 2])])
    whole = good[:-2] & good[1:-1] & good[2:]
    sd = white(x, whole) if whole.any() else np.zeros(3)
    return np.array([np.hypot(*sd[:2]) / np.sqrt(2), sd[2]])
