"""What the engine asks of a log and its simulator: a platform says the rest."""

from collections import OrderedDict

import numpy as np

from . import noise


class Kept:
    """Arrays that were asked for last, up to so many bytes: a search asks for the same again and again. The last one is always kept."""

    def __init__(self, most):
        self.most, self.arrays = most, OrderedDict()

    def get(self, key, compute):
        known = self.arrays.pop(key, None)
        self.arrays[key] = array = compute() if known is None else known
        while len(self.arrays) > 1 and len(self.arrays) * array.nbytes > self.most:
            self.arrays.popitem(last=False)
        return array


class Path:
    """A log of K rows, with values and answers that suit a simulator whose steps can be asked for at any time.

    A platform has also: t, dt, rows, breaks, begins, whole, settled (rows and their times); measured, present, finest, alike, channels,
    gaps (what is compared), sensors, pushes (units of noise and random motion); readings (K, c), known (rows that a prediction may begin at), wraps (angles); A, G, C, spread, usual (slopes along the path, for noise); effects, variants, variant; and steps(), ahead(),
    step_by(), most_starts(), smallest_of(), generic().
    """

    filters = variances_ahead = ()  # that noises have kept
    noises = noise  # or another that has first(), whitened(), likeliest() and ahead()
    sensor_scale = 1.0  # from the noise that the engine reckons with to that of a sensor, for the report
    lookalikes: dict = {}  # {effects that together look like something that is no effect here: what}
    tiny = 0.0  # of its usual size: what is less does not matter
    motions, motion = ("at any speed",), 0  # how random motion may depend on the command, and how it is taken to
    calibrated = False  # whether confidence is reckoned from evidence, as it was calibrated for drives
    competes = False  # whether plain functions compete with effects, as it was measured for drives
    partial = 0.5  # confidence of the surest cause, from which on a verdict is partly where something is left
    wanders = True  # whether the robot moves at random, as slipping wheels do; else what looks random is left over
    command_names: tuple = ()
    steered = False  # whether the robot always runs in a closed loop, so that the report need not say so
    steady = False  # whether one command was held throughout
    weighed = False  # whether sizes are fitted to predictions many steps ahead, where the robot moves at random
    spent = False  # whether the simulator was asked so much that no further cause is looked for
    most_effects = 4  # of one explanation
    matters_ahead = True  # whether a cause must close a part of the gap of predictions
    stray = True  # whether rows that stand alone are outliers
    alike_rows = 1  # rows that tell about as much as one
    hints: tuple = ()  # Causes with which a search begins, if these are worth their price
    alias = 1.0  # share of what an effect does, from which on another that does it may be it, however good the fit

    @property
    def signals(self):
        """((name, unit)) of what was measured, for who wants to see it beside what is predicted."""
        return tuple((name, unit) for name, (unit, _) in self.sensors.items())

    def shown(self, causes, starts, steps):
        """Readings as predicted (S, H, c), so many steps after rows `starts`; NaN where there is nothing to compare with."""
        ends = np.minimum(np.add.outer(starts, steps), len(self.readings) - 1)
        return self.readings[ends] - self.ahead(causes, starts, steps)

    def about(self, causes):
        """Makes steps() exact at these causes; whether they were not. Here they are everywhere."""
        return False

    def coarse(self):
        """A path of fewer rows of the same log, on which a search begins; None where the rows are few."""
        return None

    def move_by(self, motion):
        """Takes random motion to depend on the command in another way. Here there is but one."""

    def seen_from(self, starts, ends, deviations):
        """Deviations (S, n) of states in rows `ends`, as ahead() has them of predictions from rows `starts` (S, c)."""
        return deviations @ self.C.T

    def random(self, noise):
        """Noise with no more random motion than this kind of robot makes: the rest may be systematic. Here it may be any."""
        return noise

    def bends(self, causes):
        """Whether causes have the path elsewhere: steps end where they end, whatever a sensor shows."""
        return False

    def refer(self, causes, noise):
        """Looks for the path again with these causes; whether it did. Here it is what was measured."""
        return False

    def smooth(self, causes, noise):
        """Takes as the path what suits steps with causes and readings best; whether it did. Here refer() does."""
        return False

    def tell_hidden(self, noise):
        """Looks for hidden states by this noise: there are none."""

    def unsure(self, noise):
        """Covariances (K, n, n) of states that nothing measures: there are none."""
        return np.zeros_like(self.A)

    @staticmethod
    def doubt(causes):
        """By how much sizes of causes are off beside what noise makes them, of that: by nothing."""
        return 0.0

    def curve(self, cause):
        """(commands (M, n) that were given while a cause acts, its parameters -> what it takes from velocities there (M, c)), of a curve.

        None of other causes.
        """
        return None

    @staticmethod
    def preference(name):
        """Rank of one of the names that an effect may have: none is preferred."""
        return 0

    @staticmethod
    def dependence(name):
        """What a function of generic() is called."""
        return name
