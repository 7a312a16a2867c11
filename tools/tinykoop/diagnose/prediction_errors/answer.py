"""From a path to what is said of it: the causes that matter, how sure each is, what is left, and how far predictions are off."""

from dataclasses import dataclass, replace

from . import ahead, judge, openset, weighed
from .fit import Fit, Fitter
from .search import Search
from .states import State


@dataclass
class Answer:
    """verdict: the word of the contract. before, after, floor: {gap: errors (S, H)} of predictions from rows `starts` of the path."""

    search: Search
    state: State
    fit: Fit
    sizes: Fitter  # that found the sizes of causes
    proofs: list
    left: judge.Left
    verdict: str
    small: list  # Causes that are significant and do not matter
    starts: object
    before: dict
    after: dict
    floor: dict
    boxed: dict  # as after, with what plain functions predict of the rest
    box: openset.BlackBox

    @property
    def path(self):
        return self.search.path

    @property
    def fitter(self):
        return self.search.fitter


def _by_worth(fitter, fit):
    """(fit, [fit without each cause]), the cause that is worth most first."""
    rests = judge.dropped(fitter, fit)
    order = sorted(range(len(rests)), key=lambda i: -rests[i].cost)
    return fitter.fit_of(fit.causes[i] for i in order), [rests[i] for i in order]


def answer(path):
    """The Answer of a path."""
    search = Search(path)
    whole = search.run()
    search.at(whole)
    path.tell_hidden(whole.noise)
    starts = ahead.starts_of(path)
    whole = search.smoothed(weighed.chosen(search, whole, starts))
    state, small = judge.paying(search, whole, starts) if path.matters_ahead else (whole, [])
    sizes = weighed.sized(search, whole, starts)
    missed = ahead.missed(*sizes, starts)
    found, (boxed, box) = ahead.sizes(path, missed), openset.boxed(search, whole, missed, starts)
    plain = box.rival()
    fitter = search.at(state)
    sizes = sizes if state is whole else weighed.sized(search, state, starts)
    before, after = ahead.errors(path, (), starts), ahead.after(*sizes, starts)
    floor = judge.floors(path, whole.noise, before, found, boxed, starts)
    left = judge.left(search, whole, before, found, boxed, floor, box, starts)
    fit, rests = _by_worth(fitter, state.fit)
    rivals = judge.all_rivals(search, fit, rests)
    named = judge.preferred(search, state, fit, rivals)
    if named is not fit:
        state = replace(state, fit=named)
        fit, rests = _by_worth(search.at(state), named)
        rivals = judge.all_rivals(search, fit, rests)
    proofs = judge.proofs(search, fit, rests, rivals, left, box, plain)
    word = judge.verdict(path, proofs, left)
    if word == "none":
        fit, proofs, after = fitter.fit_of(()), [], before
    sizes, final = weighed.sized(search, replace(state, fit=fit), starts)
    floor = judge.surely(path, box, floor, starts) if fit.causes else floor
    return Answer(search, state, fitter.fit_of(final.causes), sizes, proofs, left, word, small, starts, before, after, floor, boxed, box)
