"""Single effects and pairs by least squares on one-step differences, chosen by the BIC (Schwarz 1978).

Forward selection in the way of stepwise regression. The noise of neighbouring differences is taken to be
independent, as is common, though each measured pose enters two of them.
"""

import numpy as np

from . import common


@common.on_one_core
def peer(log_path, fresh_path=None, without=()):
    data = common.Data.read(log_path)
    noise = common.Noise.of(data)
    library = common.candidates(without)

    def fit(names, begin=None):
        return common.Fit(data, noise, names, steps=1, stride=1, begin=begin)

    def bic(fit):
        return fit.cost_at(fit.z) + len(fit.z) * np.log(max(3 * len(fit.starts), 2))

    nothing = fit(())
    singles = {name: fit((name,)) for name in library}
    scores = {name: (bic(nothing) - bic(single)) / 2 for name, single in singles.items()}
    best = max(scores, key=scores.get)
    chosen, named = nothing, {}
    if scores[best] > 0:
        chosen, named = singles[best], {best: scores}
        # only what helps by itself can be a partner here: that keeps the search short
        partners = [name for name in sorted(scores, key=scores.get)[-6:] if name != best]
        pairs = {n: fit((best, n), singles[best].fitted() | singles[n].fitted()) for n in partners}
        gains = {name: (bic(chosen) - bic(pair)) / 2 for name, pair in pairs.items()}
        second = max(gains, key=gains.get)
        if gains[second] > 0:
            chosen, named[second] = pairs[second], gains
    model = common.simulator(chosen.active())
    verdict = "known" if named else "none"
    if common.left(data, model) > common.MOST_LEFT:
        verdict = "unknown"
    # weight of the winner among its rivals, the null included
    confidence = {
        name: 1 / (np.exp(-rivals[name]) + sum(np.exp(np.minimum(s - rivals[name], 50)) for s in rivals.values()))
        for name, rivals in named.items()
    }
    ranking = dict(scores)
    for name in list(named)[1:]:
        ranking[name] = max(scores.values()) - 1e-9
    return common.report(data, model, fresh_path, verdict, chosen.effects(confidence), ranking)
