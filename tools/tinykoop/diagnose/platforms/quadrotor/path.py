"""How far the simulated quadrotor is off a flight, under the requests of the log, with any effects."""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from .... import bridge
from ....plumbing.errors import UserError
from ...prediction_errors import ahead
from .baseline import EACH, FIRST, KINDS, SECONDS
from .features import GRAVITY, ROTORS, steady
from .vehicle import follower, observer_gain, predictable

WINDOWS = 300  # predictions at most, spread over steady flight
GAPS = {"attitude": ("rad", (9, 10, 11)), "velocity": ("m/s", (3, 4, 5))}  # unit and columns of a log


@dataclass(frozen=True)
class Path:
    """A flight and the simulated vehicle; base: effects that the healthy vehicle has, too."""

    log: object
    vehicle: object = "crazyflie"
    base: tuple = ()

    @cached_property
    def gaps(self):
        """Those that the log shows anything of."""
        there = np.isfinite(self.log.x).any(axis=0)
        found = {name: (unit, tuple(c for c in columns if there[c])) for name, (unit, columns) in GAPS.items()}
        return {name: gap for name, gap in found.items() if gap[1]} or {"attitude": GAPS["attitude"]}

    @property
    def t(self):
        return np.arange(len(self.log.x)) * self.log.dt

    @cached_property
    def starts(self):
        rows = predictable(self.log)
        rows = rows[steady(self.log)[rows]]
        return rows[:: max(1, len(rows) // WINDOWS)]

    @cached_property
    def _follow(self):
        return follower(self.log, observer_gain(self.log, self.vehicle), self.vehicle)

    def missed(self, active=()):
        """Measured less predicted (S, H, 15), `ahead.HORIZONS` rows after each start; NaN where the observer loses the vehicle."""
        unknown = np.full((len(self.starts), len(ahead.HORIZONS), self.log.x.shape[1]), np.nan)
        try:
            return self._follow(_together([*self.base, *active]), starts=self.starts, steps=ahead.HORIZONS)[1] if len(unknown) else unknown
        except UserError:  # of a log that shows too little of the motion
            return unknown

    def errors(self, active=()):
        """{gap: (S, H)}."""
        missed = self.missed(active)
        return {gap: np.sqrt((missed[..., list(columns)] ** 2).sum(-1)) for gap, (_, columns) in self.gaps.items()}


def _together(active):
    """Effects, what acts twice on a rotor as one."""
    out = {}
    for effect in active:
        there = out.get(effect.name)
        both = (1 + there.parameters[0]) * (1 + effect.parameters[0]) - 1 if there and effect.name.startswith("rotor") else None
        out[effect.name] = effect if both is None else bridge.Effect(effect.name, (both,))
    return list(out.values())


def base_of(healthy, vehicle):
    """Effects by which the simulated vehicle hovers at the requests of healthy flights (Features)."""
    numbers = bridge.quadrotor_vehicle(vehicle)
    asked = np.mean([one.rotors for one in healthy], axis=0)
    volts = np.nanmean([one.volts for one in healthy]) if any(np.isfinite(one.volts) for one in healthy) else numbers["voltage"]
    full = numbers["thrust_full"] * (1 + numbers["voltage_slope"] * (volts - numbers["voltage"]))
    rows = bridge.quadrotor_effects(vehicle)
    out = []
    for i, request in zip(ROTORS, asked):
        name = f"rotor{i}_thrust"
        _, _, low, high, _ = rows[name][1][0]
        out.append(bridge.Effect(name, (float(np.clip(numbers["mass"] * GRAVITY / (4 * full * request) - 1, low, high)),)))
    return tuple(out)


def floor_of(paths, gaps):
    """{gap: (H,)}: RMS errors on healthy flights."""
    errors = [path.errors() for path in paths]
    none = np.full(len(ahead.HORIZONS), np.nan)
    return {gap: ahead.rms(np.concatenate([e[gap] for e in errors if gap in e] or [none[None]])) for gap in gaps}


def of_days(along, spread):
    """{gap: errors (S, H)} of a flight of another day: thrust and trim differ by `spread`, thrust, roll, pitch and yaw, in 1 of the mean
    request."""
    numbers, plain = bridge.quadrotor_vehicle(along.vehicle), along.missed()
    weight, lever = numbers["mass"] * GRAVITY, numbers["arm"] * np.sqrt(0.5)
    moments = np.diag([weight * lever, weight * lever, weight * numbers["torque_per_thrust"]]) @ np.diag(spread[1:4])
    differ = [bridge.Effect("thrust_gain", (float(spread[0]),)), *(bridge.Effect("trim", tuple(map(float, row))) for row in moments)]
    moved = [(along.missed((effect,)) - plain) ** 2 for effect in differ]
    return {gap: np.sqrt(sum(part[..., list(columns)].sum(-1) for part in moved)) for gap, (_, columns) in along.gaps.items()}


@lru_cache(maxsize=4)
def simulated(vehicle):
    """Paths of healthy simulated flights, one of each kind."""
    return tuple(Path(bridge.quadrotor(kind, SECONDS, FIRST + EACH * i, vehicle=vehicle)[0], vehicle) for i, kind in enumerate(KINDS))
