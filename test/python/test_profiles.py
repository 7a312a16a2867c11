"""Intervals of the diagnoser that slopes alone do not give: sizes that make up for one another."""

from types import SimpleNamespace

import numpy as np
import pytest
from test_diagnose import drive, log_of, usual
from test_prediction_errors import LONG, fitter_of
from tinykoop import bridge
from tinykoop.diagnose.diagnosis import limits
from tinykoop.diagnose.prediction_errors.fit import Cause, Effect, Fitter
from tinykoop.diagnose.prediction_errors.profiles import Profile
from tinykoop.diagnose.robot import Parameter


class Valley(Fitter):
    """Squares with a valley b = a^2 + c^2 that bends and is 10,000 times as narrow as it is long; a, c and b are known to `along`."""

    along, narrow = 0.3, 3e-5

    def __init__(self):
        sizes = tuple(Parameter(name, "1", low, 9.0, 1.0) for name, low in (("a", -9.0), ("c", -9.0), ("b", 0.0)))
        effect = Effect("valley", "plant", sizes, ((1.0, 1.0, 2.0),), curve=True)
        super().__init__(SimpleNamespace(effects={"valley": effect}, present=np.ones((3, 1))), None)

    def lefts(self, trials):
        a, c, b = np.transpose([cause.params for (cause,) in trials])
        return np.stack([(b - a**2 - c**2) / self.narrow, (a - 1) / self.along, (c - 1) / self.along])


@pytest.mark.parametrize("begin", [(1.0, 1.0, 2.0), (1.2, 0.9, 2.25), (0.5, 1.3, 1.9)])
def test_profile_follows_a_narrow_valley_that_bends(begin):
    """b is |(a, c)|^2: by its nearest and farthest point, within a tenth of their distance. By slopes it would be 2 +- 1.66."""
    valley = Valley()
    low, high = Profile(valley, valley.fit_of([Cause("valley", begin)])).interval(2)
    reach = 1.96 * Valley.along
    assert low == pytest.approx((np.sqrt(2) - reach) ** 2, abs=0.1) and high == pytest.approx((np.sqrt(2) + reach) ** 2, abs=0.2)


def test_profile_ends_at_a_bound_where_squares_do_not_rise():
    valley = Valley()
    valley.along = 30.0
    assert Profile(valley, valley.fit_of([Cause("valley", (1.0, 1.0, 2.0))])).interval(2) == (0.0, 9.0)


def test_profiles_of_two_curves_in_five_phases_hold_the_truth():
    """Slip, friction and both, of the paper: 95 % of 36 would be 34."""
    held = []
    for seed in range(4):
        slip, friction = usual("pacejka_slip", "stribeck_friction")
        parts = LONG * 0.05 / 5
        acts = [((slip, 1), (slip, 3)), ((friction, 2), (friction, 3))]
        active = [bridge.Effect(e.name, e.parameters, k * parts, (k + 1) * parts) for some in acts for e, k in some]
        fitter = fitter_of(log_of(drive(LONG, seed), active, "white", seed))
        causes = [Cause(some[0][0].name, some[0][0].parameters, tuple((k * parts, (k + 1) * parts) for _, k in some)) for some in acts]
        fit = fitter.refine(fitter.fit_of(causes))
        for interval, e in zip(limits(fitter, fit), (slip, friction)):
            held += [low <= value <= high for (low, high), value in zip(interval.values(), e.parameters)]
    assert sum(held) >= 33, held
