"""Causes with the noise that suits them, and what such a state is worth."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from ..robot import RunsAway
from . import noise as noises
from . import spans
from .fit import Fit, Fitter

OUTLIERS, OUT, USUAL, AROUND = 3, 4.0, 1.5, 11  # turns; standard deviations that stand out, and that they become; rows
MOVES = 5.0  # times what counts as none, from which on random motion may hide that a cause explains all
STILL = 10.0  # times the degrees of freedom, that squares may be for that to be worth a try
FAR = 5.0  # prices, by which a simpler set may be behind before noise is estimated for it
EXACT, TRIFLE = 4, 0.5  # turns of steps that are exact; squares, by which they may have been off before
MARGIN = 4.0  # of -2 log likelihood
SMOOTHED = 2  # turns of a path and sizes along it
LOUDER = 3.0  # times what third differences show, that the sensor's noise may be


@dataclass(frozen=True)
class State:
    """Causes and noise; deviance: -2 log likelihood but for a constant."""

    deviance: float
    fit: Fit
    noise: noises.Noise
    variant: int
    motion: int = 0

    @property
    def causes(self):
        return self.fit.causes


class States:
    """The states of one path. There is one fitter: at() gives it the noise of a state."""

    def __init__(self, path, fitter=None):
        self.path = path
        self.fitter = fitter or Fitter(path, path.noises.first(path))
        self.sensor = self.fitter.noise
        self.digit, self.edge = np.log(self.fitter.degrees / path.alike_rows), np.log(self.fitter.degrees)
        self.price = self.digit + 2 * np.log(max(len(path.effects), 2))

    def worth(self, state):
        """-2 log likelihood and the price of the causes: the less, the better."""
        return state.deviance + self.costs(state.causes)

    def costs(self, causes):
        """Price of causes: of each, of each parameter beyond the first, of each edge in time, which may be in any row.

        A mark that shows in a moment is looked for in every row: it costs another edge.
        """
        edges = sum(np.isfinite(edge) for c in causes for span in c.segments for edge in span)
        edges += sum(self.fitter.effects[c.name].transient for c in causes)
        return self.price * len(causes) + self.digit * 0.5 * sum(len(c.params) - 1 for c in causes) + self.edge * edges

    def at(self, state):
        """The fitter with the noise of a state."""
        self.fitter.noise = state.noise
        self.path.step_by(state.variant)
        self.path.move_by(state.motion)
        self.path.about(state.causes)
        return self.fitter

    def without_motion(self, state):
        """The fitter with what the sensor alone makes: what random motion would hide shows."""
        sensor = np.minimum(state.noise.sensor, LOUDER * self.sensor.sensor)
        return self.at(replace(state, noise=replace(state.noise.quiet(self.path), sensor=sensor)))

    @property
    def views(self):
        """Fitters of a state: by its noise, and by what the sensor alone makes if random motion is in that."""
        return (self.at, self.without_motion) if len(self.path.usual) else (self.at,)

    def refined(self, state, causes, steps=8):
        """The Fit of causes, from their sizes, under the noise of a state."""
        fitter = self.at(state)
        if self.path.bends(causes):
            try:
                self.path.about(causes)
            except RunsAway:
                return Fit(tuple(causes), np.inf, state.fit.left)
        return fitter.refine(fitter.fit_of(causes), steps)

    def priced(self, fit):
        """Squares and the price of the causes, of fits under one noise."""
        return fit.cost + self.costs(fit.causes)

    def rivals(self, state, fit):
        """Whether a fit under the noise of a state may be worth more, once noise is estimated for it."""
        return self.priced(fit) < self.priced(state.fit) + FAR * self.price

    def likeliest(self, fit, rounds=noises.ROUNDS, coloured=None):
        """The State of a fit's causes with the noise that suits them, from the fitter's."""
        D, E = self.path.steps([fit.causes])
        self.fitter.noise, deviance = self.path.noises.likeliest(self.path, self.fitter.noise, D, E, rounds, coloured)
        fit = self.fitter.fit_of(fit.causes)
        return State(deviance + self.fitter.guesses(fit.causes), fit, self.fitter.noise, self.path.variant, self.path.motion)

    def settled(self, state, fit):
        """Sizes and noise in turn, from those of a state; once more from no random motion.

        A cause that explains it all would never get there from noise that made up for it. What a simulator cannot do is worth nothing.
        """
        try:
            return self._settled(state, fit)
        except RunsAway:
            return replace(state, deviance=np.inf, fit=fit)

    def _settled(self, state, fit):
        self.at(state)
        found = self._in_turn(fit)
        if (found.noise.process > MOVES * noises.QUIET * self.path.usual).any():
            still = self.without_motion(found)
            fit = still.refine(still.fit_of(found.causes), 5)
            found = min(found, self._in_turn(fit), key=self.worth) if fit.cost < STILL * still.degrees else found
        return found

    def _in_turn(self, fit):
        state = self.likeliest(self.exact(self.fitter.refine(self.fitter.fit_of(fit.causes))))
        better = self.exact(spans.edges(self.fitter, self.fitter.refine(state.fit, 3)))
        return self.likeliest(better, 6) if state.fit.cost - better.cost > 1 else replace(state, fit=better)

    def exact(self, fit):
        """The fit by steps that are exact at its causes, refined where they were not."""
        for _ in range(EXACT):
            if not self.path.about(fit.causes):
                break
            exact = self.fitter.fit_of(fit.causes)
            if abs(exact.cost - fit.cost) < TRIFLE:
                return exact
            fit = self.fitter.refine(exact, 3)
        return fit

    def referred(self, state):
        """The state along a path that is looked for again with its causes and noise."""
        if not self.path.refer(state.causes, state.noise):
            return state
        return self._in_turn(self.at(state).fit_of(state.causes))

    def smoothed(self, state):
        """The state along the path that suits its causes and readings best, with the sizes that it has there."""
        for _ in range(SMOOTHED):
            if not self.at(state).path.smooth(state.causes, state.noise):
                break
            state = replace(state, fit=self.fitter.refine(self.fitter.fit_of(state.causes), 3))
        return state

    def robust(self, state):
        """With rows that stand alone counted as noisier: a reading that is off, after which the next are not."""
        for _ in range(OUTLIERS if self.path.stray else 0):
            size = np.abs(self.at(state).fit_of(state.causes).left.reshape(self.path.present.shape))
            usual = np.maximum(ndimage.median_filter(size, (AROUND, 1)) / 0.6745, 1.0)
            if not (size > OUT * usual).any():
                break
            self.path.present = self.path.present * np.where(size > OUT * usual, (size / USUAL / usual) ** 2, 1.0)
            self.path.pass_over((self.path.present == 1).all(1))
            state = self.likeliest(self.fitter.fit_of(state.causes))
        return state

    def moving_alike(self, state):
        """With random motion that depends on the command in the way that is likeliest."""
        best = state
        for motion in range(len(self.path.motions)):
            if motion != state.motion:
                fitter = self.at(replace(state, motion=motion))
                found = self.likeliest(fitter.fit_of(state.causes))
                best = found if found.deviance < best.deviance - MARGIN else best
        return best

    def with_coloured_noise(self, state):
        """With coloured sensor noise if that is likelier."""
        if (state.noise.sensor_rho > 0).any():
            return state
        coloured = self.likeliest(self.at(state).fit_of(state.causes), 2 * noises.ROUNDS, coloured=True)
        return coloured if coloured.deviance < state.deviance - MARGIN else state
