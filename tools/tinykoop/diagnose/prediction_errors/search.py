"""Which effects, and when: taken in one by one while the likelihood, less a price, rises."""

from dataclasses import replace

from . import forms, simpler, spans
from .candidates import candidates, first_forms
from .states import MARGIN, States

LIKELY, HIDDEN = 4, 3  # candidates by the noise as it is, and by what the sensor alone makes
TRIED, CLOSE = 2, 0.6  # of these, for which noise is estimated again; of the best one's gain, that the next must have
TURNS = 3  # of more causes and simpler ones


class Search(States):
    def run(self):
        """The State that is worth most; `base` is that without causes."""
        state = self.likeliest(self.fitter.fit_of(()))
        state = self.base = self.moving_alike(self.with_coloured_noise(self.robust(self.referred(state))))
        coarse = self.path.coarse()
        begun = state = self.begun(state, Search(coarse).run()) if coarse else self.hinted(simpler.stepped(self, state))
        for _ in range(TURNS):
            wide = state = self.moving_alike(self.forward(state))
            if coarse and state.fit.names == begun.fit.names:
                state = simpler.swapped(self, state)  # on fewer rows it was made simpler already
                break
            for simpler_ in (
                forms.reformed, simpler.begun_anew, simpler.swapped, simpler.opened, simpler.simplified, simpler.discretised,
            ):  # fmt: skip
                state = simpler_(self, state)
            if state is wide or len(state.causes) == self.path.most_effects or self.path.spent:
                break
        return self.with_coloured_noise(self.robust(state))

    def begun(self, state, coarse):
        """The state on this path from what was found on fewer of its rows."""
        state = replace(state, variant=coarse.variant, motion=coarse.motion, noise=coarse.noise)
        return self.settled(state, self.at(state).fit_of(coarse.causes))

    def hinted(self, state):
        """With the path's hints, if that is worth more."""
        if not self.path.hints:
            return state
        hinted = simpler.reduced(self, self.settled(state, self.refined(state, self.path.hints, 5)))
        return self.referred(hinted) if self.worth(hinted) < self.worth(state) - MARGIN else state

    def forward(self, state):
        """Causes taken in one by one."""
        while len(state.causes) < self.path.most_effects and not self.path.spent:
            better = self.widened(state)
            if better is None or self.worth(better) > self.worth(state) - MARGIN:
                break
            state = self.referred(simpler.reduced(self, simpler.stepped(self, self.timed(better))))
        return state

    def candidates(self, fit):
        """[(promise, Cause)] beside a fit under the fitter's noise, best first."""
        return candidates(self.fitter, fit, margin=MARGIN)

    def widened(self, state):
        """The best state with one cause more: of those likely by the noise as it is, and the likeliest if that hid it."""
        found, *rest = (
            first_forms(self.path.effects, self.candidates(view(state).fit_of(state.causes)), count)
            for view, count in zip(self.views, (LIKELY, HIDDEN))
        )
        hidden = sum(rest, [])
        refined = {cause: self.refined(state, (*state.causes, cause), 5) for cause in dict.fromkeys((*found, *hidden))}
        fits = sorted(refined.values(), key=self.priced)
        close = [f for f in fits[:TRIED] if state.fit.cost - f.cost >= CLOSE * (state.fit.cost - fits[0].cost)]
        close += [refined[cause] for cause in hidden[:1] if not any(refined[cause] is f for f in close)]
        return min((self.settled(state, fit) for fit in close), key=self.worth, default=None)

    def timed(self, state):
        """With stretches of time in which causes act, or do not, while that is worth it."""
        better = state
        while better:
            state = better
            better = next((found for view in self.views if (found := self._toggled(state, view))), None)
        return state

    def _toggled(self, state, fitter_at):
        fitter = fitter_at(state)
        fit = spans.toggled(fitter, fitter.fit_of(state.causes), 2 * self.edge + MARGIN)
        better = fit and self.settled(state, fit)
        return better if better and self.worth(better) < self.worth(state) - MARGIN else None
