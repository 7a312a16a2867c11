"""What a fit says: which causes are established, which other names they may have, and whether something is left."""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from . import openset
from .finder import ALIKE

LONG = 6  # passes of a fit of another explanation, since slopes about the first one may be poor there
SAME = 6.0  # of cost, by which two explanations may differ and still be one class
TINY = 0.05  # of the usual size: what is less is significant perhaps, but does not matter
EXPLAINS = 0.75  # of the misfit above the noise, which causes must take away beside something that is left
OWN = 0.2  # of it, that each of them must
DOUBT = 0.85  # of a confidence stays where something is left
FURTHER = 0.9  # of it for each further cause: what is not in the library is mimicked by several that are
MOVES = 0.25  # of its size, by which a cause may move when generic pushes enter, and still be established
ORDER = (
    "parameter",
    "gain",
    "bias",
    "lag",
    "delay",
    "saturation",
    "dead_band",
    "rate_limit",
    "backlash",
    "damping",
    "force",
    "sag",
    "cross",
)


@dataclass(frozen=True)
class Proof:
    """Of one cause: what it takes away, how sure it is (0 to 1), and which names it may have instead."""

    gain: float
    confidence: float
    others: tuple
    established: bool


def preference(name):
    """The user's own parameters first, then what is simplest at the commands; outputs and the clock last."""
    kind = name.partition(":")[0]
    return ORDER.index(kind) if kind in ORDER else len(ORDER)


def _rivals(finder, fit, i):
    """[fits with another effect in the place of cause i that do as well]."""
    problem = finder.problem
    rest = fit.causes[:i] + fit.causes[i + 1 :]
    have = problem.columns([fit.causes, rest]) @ [1.0, -1.0]
    J = finder.jacobian(fit)
    spec = [len(problem.effects[c.name].parameters) for c in fit.causes]
    mine = slice(sum(spec[:i]), sum(spec[: i + 1]))
    Q = np.linalg.svd(np.delete(J, np.r_[mine], 1), full_matrices=False)[0] if len(rest) else np.zeros((len(fit.left), 0))
    free = lambda c: c - Q @ (Q.T @ c)  # noqa: E731
    have, best, base = free(have), {}, problem.fit_of(rest)
    for c in finder.candidates(base):
        column = free(c.column)
        cosine = column @ have / max(np.linalg.norm(column) * np.linalg.norm(have), 1e-12)
        usable = cosine > 0 or problem.effects[c.name].parameters[0].low < 0
        if c.name not in fit.names and usable and abs(cosine) > best.get(c.name, (0.9,))[0]:
            best[c.name] = abs(cosine), c
    close = sorted(best.values(), key=lambda b: -b[0])[:4]
    trials = [finder.refine(finder.add(base, (c,)), LONG) for cosine, c in close if cosine > ALIKE - 0.03]
    return [t for t in trials if t.cost < fit.cost + SAME]


def named(finder, fit):
    """(fit with the preferred name of each class, [names that each cause may have instead])."""
    others = []
    for i in range(len(fit.causes)):
        rivals = _rivals(finder, fit, i)
        choice = min([fit, *rivals], key=lambda f: preference(f.causes[-1].name if f is not fit else fit.causes[i].name))
        names = {f.causes[-1].name for f in rivals} | {fit.causes[i].name}
        if choice is not fit:
            ordered = (*choice.causes[:i], choice.causes[-1], *choice.causes[i:-1])
            fit = finder.problem.fit_of(ordered)
        others.append(tuple(sorted(names - {fit.causes[i].name}, key=preference)))
    return fit, others


def _moved(finder, fit, jacobian):
    """By how much of itself each cause moves when generic pushes enter."""
    problem = finder.problem
    G = problem.whiten(problem.generic())
    size = np.linalg.norm(G, axis=0)
    G = G[:, size > 1e-6] / size[size > 1e-6]
    both = np.concatenate([jacobian, G], 1)
    chosen, weights = openset.forward(both.T @ both, both.T @ fit.left)
    J = both[:, sorted({*range(jacobian.shape[1]), *chosen})]
    move = np.linalg.lstsq(J, fit.left, rcond=1e-9)[0][: jacobian.shape[1]]
    return np.abs(move) / np.maximum(np.abs(finder.vector(fit.causes)[0]), 1e-12)


def judge(finder, fit):
    """(fit, [Proof], Left)."""
    fit, others = named(finder, fit)
    J = finder.jacobian(fit)
    left = openset.left(finder.problem, fit, J)
    moved = _moved(finder, fit, J) if fit.causes else []
    proofs, at = [], 0
    most = max(finder.base.cost - finder.problem.degrees, 1e-9)
    explains = (finder.base.cost - fit.cost) / most > EXPLAINS
    for i, cause in enumerate(fit.causes):
        rest = finder.refine(finder.problem.fit_of(fit.causes[:i] + fit.causes[i + 1 :]), 1)
        gain = max(rest.cost - fit.cost, 0.0)
        count = len(cause.params)
        established = not left.matters or (explains and moved[at : at + count].max() < MOVES and gain > OWN * most)
        at += count
        sure = float(stats.norm.cdf((gain / max(fit.cost / finder.problem.degrees, 1.0) - finder.price) / (2 * np.sqrt(finder.price))))
        sure = min(sure, 0.99) * FURTHER ** (len(fit.causes) - 1) * (DOUBT if left.matters else 1.0) / (1 + len(others[i]))
        proofs.append(Proof(float(gain), sure, others[i], bool(established)))
    return fit, proofs, left


def is_small(finder, cause):
    """Whether all parameters of a cause are a small part of their usual sizes."""
    spec = finder.problem.effects[cause.name].parameters
    return all(abs(v) < TINY * abs(p.usual) for v, p in zip(cause.params, spec))


def verdict(proofs, left):
    """The word of the contract, of the Proofs of what matters."""
    if not proofs:
        return "unknown" if left.matters else "none"
    if not left.matters:
        return "known"
    return "partly" if all(p.established for p in proofs) else "unknown"
