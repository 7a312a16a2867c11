"""What has changed since healthy flights: effects with sizes, what else may be the cause, and the smallest change that would show."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from . import causes
from .baseline import Baseline
from .causes import BLOCKS, DELAY, LAG, OTHER, PAYLOAD, SLUNG
from .features import NAMES, ROTORS, Features

# Probability that nothing has changed, below which something is named: beside flights of the vehicle itself, of which few are known, and
# beside the simulated one, whose healthy flights differ by small trims of single rotors
UNCHANGED = {True: 0.5, False: 0.2}
RIVAL, MOST = 0.1, 3  # probability of what is declared beside the causes of a block; causes and these together
SURE = 0.8  # most confidence in a rotor or a weight: they differ by yaw alone, in which flights of one vehicle differ from day to day
SLIGHT, ROUNDS = 0.5, 20  # largest size, in 1 of the mean request, that is looked for as the smallest that shows; halvings
ABOVE = 1.0  # of a rotor's lever: where a payload is, whose smallest mass is told


@dataclass(frozen=True)
class Cause:
    """params: {parameter: (value, [low, high])}, with 95 % intervals."""

    name: str
    probability: float
    evidence: float
    params: dict


@dataclass(frozen=True)
class Changes:
    """flight: Features; baseline: of healthy flights; vehicle: {parameter: value} as of bridge.quadrotor_vehicle(); without: names of
    effects that are ruled out."""

    flight: Features
    baseline: Baseline
    vehicle: dict
    without: tuple = ()

    @property
    def healthy(self):
        return self.baseline.flights

    # ---- what is compared ----------------------------------------------------------------------------

    @cached_property
    def _as_healthy(self):
        rotors = np.mean([one.rotors for one in self.healthy], axis=0)
        return causes.Healthy(float(rotors.mean()), rotors, self.vehicle, self.flight)

    @property
    def spread_of_requests(self):
        """By how much thrust, roll, pitch and yaw (4,) of healthy flights differ, in 1 of the mean request."""
        return self.baseline.spread[:4] / self._as_healthy.mean

    def difference(self, one):
        """(d (F,), its variances (F,)) from a healthy flight."""
        d, variances = self.flight.values - one.values, self.baseline.spread**2 + self.flight.errors**2
        volts, (slope, sd) = np.nan_to_num(self.flight.volts - one.volts) * one.values[0], self.baseline.volts
        d[0] -= slope * volts
        variances[0] += (sd * volts) ** 2
        return d, variances

    @cached_property
    def known(self):
        """{block: indices of its features that flight and healthy flights have}; blocks without any are not in it."""
        there = np.isfinite(self.flight.values) & np.isfinite(self.baseline.spread) & np.isfinite(self.flight.errors)
        found = {block: [i for i in map(NAMES.index, names) if there[i] and self._compared(i)] for block, names in BLOCKS.items()}
        return {block: known for block, known in found.items() if known and (block != "balance" or there[0])}

    def _compared(self, i):
        return any(np.isfinite(one.values[i]) for one in self.healthy)

    def differences(self, block):
        """[(d (f,), its covariance (f, f))] of the known features of a block from each healthy flight that has them."""
        known, out = self.known[block], []
        for d, variances in map(self.difference, self.healthy):
            if np.isfinite(d[known]).all():
                out.append((d[known], np.diag(variances[known])))
        return out

    @cached_property
    def explanations(self):
        every = {block: causes.explanations(self._as_healthy, block) for block in self.known}
        return {block: [e for e in some if not set(e.causes) & set(self.without)] for block, some in every.items()}

    @cached_property
    def posteriors(self):
        """{block: Posterior}."""
        return {b: causes.posterior(self.explanations[b], self.differences(b), self.known[b]) for b in self.known}

    # ---- what is said --------------------------------------------------------------------------------

    @property
    def healthy_probability(self):
        """That nothing has changed."""
        return float(np.prod([p.healthy for p in self.posteriors.values()]))

    @cached_property
    def best(self):
        """{block: Sized}, the most probable explanation of each block that has changed; of something else, if that one does not fit."""
        return {block: self._best(block, p) for block, p in self.posteriors.items() if p.healthy < UNCHANGED[self.baseline.own]}

    def _best(self, block, p):
        fits = causes.fits(p.sized[0], self.differences(block), self.known[block])
        return p.sized[0] if fits else next(one for one in p.sized if one.causes == (OTHER,))

    @property
    def unexplained(self):
        """Blocks that have changed as by nothing that is known."""
        return [block for block, one in self.best.items() if one.causes == (OTHER,)]

    @cached_property
    def named(self):
        """[Cause], the one with most evidence first."""
        out = []
        for block, one in self.best.items():
            p = self.posteriors[block]
            worth = 2 * np.log(max(1 - p.healthy, 1e-300) / max(p.healthy, 1e-300))
            out += [Cause(name, p.of(name), float(worth), params) for name, params in one.params().items() if name != OTHER]
        return sorted(out, key=lambda cause: (-cause.evidence, -cause.probability))

    def rivals(self, name):
        """Names of other effects that may be the cause instead, the most probable first.

        A weight above a rotor and that rotor weak differ by yaw alone, and a load that hangs from one that is fixed in nothing steady.
        """
        block = next(b for b, one in self.best.items() if name in one.causes)
        p, names = self.posteriors[block], self.best[block].causes
        likely = sorted((n for n in _names(p) if n not in names and p.of(n) >= RIVAL), key=lambda n: -p.of(n))
        alike = self._alike(name, block)
        order = [*alike, *likely] if len(names) == 1 else [*likely, *alike]
        open_ = [n for n in dict.fromkeys(order) if n not in (*names, *self.without, OTHER)]
        return open_[: max(MOST - len(names), 0)]

    def _alike(self, name, block):
        """What asks for the same; beside the simulated vehicle, which does not differ in yaw from day to day, rotors and weights do not."""
        if name in (PAYLOAD, SLUNG):
            other = SLUNG if name == PAYLOAD else PAYLOAD
            return [other, causes.rotor(self._corner(self.best[block]))] if self.baseline.own else [other]
        return [PAYLOAD] if name.startswith("rotor") and self.baseline.own else []

    def confidence(self, cause):
        """In one cause: its probability. A weight changes how the vehicle answers, above all one that swings, and no cause of the balance
        that is known changes over the flight."""
        weights, doubted = {PAYLOAD, SLUNG}, cause.name.startswith("rotor") or cause.name in (PAYLOAD, SLUNG)
        late = cause.name in (LAG, DELAY) and any(weights & set(one.causes) for one in self.best.values())
        moves = "course" in self.best and "balance" in self.best and cause.name in self.best["balance"].causes
        return float(min(cause.probability, SURE if late or moves or (doubted and self.baseline.own) else 1.0))

    def decided(self, cause):
        """Probability that it acts, or what may be it instead."""
        block = next(b for b, one in self.best.items() if cause.name in one.causes)
        among = {*self.best[block].causes, *self.rivals(cause.name)}
        return sum(one.probability for one in self.posteriors[block].sized if among & set(one.causes))

    def ranking(self):
        """[(name, probability)], the most probable first."""
        every = [(name, p.of(name)) for p in self.posteriors.values() for name in _names(p) if name != OTHER]
        return sorted(every, key=lambda one: -one[1])

    @staticmethod
    def _corner(one):
        """The rotor that a weight is nearest to."""
        params = one.params()[one.causes[0]]
        front, left = params["x"][0] > 0, params["y"][0] > 0
        return {(True, False): 1, (False, False): 2, (False, True): 3, (True, True): 4}[front, left]

    # ---- what would show -----------------------------------------------------------------------------

    def smallest(self):
        """{effect: size} of the smallest change that this flight would show: share of a rotor's thrust, kg above a rotor."""
        mean, out = self._as_healthy.mean, {}
        for i in ROTORS:
            size = self._shows(causes.rotor(i), lambda H: H[:, 0])
            out[causes.rotor(i)] = float(size / (self._as_healthy.rotors[i - 1] + size))
        out[PAYLOAD] = float(self.vehicle["mass"] * self._shows(PAYLOAD, lambda H: H @ [1, ABOVE, ABOVE]) / mean)
        return out

    def _shows(self, name, pattern):
        """Size of what a cause changes, from which on a flight that differs by it alone would be called changed."""
        if "balance" not in self.known:
            return np.nan
        every, known = self.explanations["balance"], self.known["balance"]
        alone = [e for e in every if e.causes == (name,)]
        if not alone:
            return np.nan
        S = np.mean([S for _, S in self.differences("balance")], axis=0)
        change, low, high = pattern(alone[0].H[known]), 0.0, SLIGHT * self._as_healthy.mean
        limit = UNCHANGED[self.baseline.own]
        for _ in range(ROUNDS):
            middle = 0.5 * (low + high)
            shows = causes.odds(every, name, [(middle * change, S)], known) > (1 - limit) / limit
            low, high = (low, middle) if shows else (middle, high)
        return high


def _names(p):
    return dict.fromkeys(name for one in p.sized for name in one.causes)
