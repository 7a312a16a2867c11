"""trial"""
import numpy as np
from dataclasses import replace
from . import ahead, judge
from .fit import ALWAYS
from .search import Search

def diagnose(path, make_fresh=None):
    search = Search(path)
    state = search.run()
    starts = ahead.starts_of(path)
    whole = state
    state, small = judge.paying(search, state, starts)
    fitter = search.at(state)
    before = ahead.errors(path, (), starts)
    left = judge.left(path, min(whole.noise, state.noise, key=lambda n: float((n.process / path.usual).sum())), before, starts)
    rests = judge.dropped(fitter, state.fit)
    order = sorted(range(len(rests)), key=lambda i: -rests[i].cost)
    fit = fitter.fit_of([state.fit.causes[i] for i in order]); rests = [rests[i] for i in order]
    proved = judge.proofs(search, fit, rests, left)
    base = fitter.fit_of(())
    after = ahead.after(fitter, fit, starts); least = ahead.floor(path, state.noise.quiet(path), starts)
    word = "unknown" if left.matters else "known" if fit.causes else "none"
    iv = judge.intervals(fitter, fit); out = []; i = 0
    end = (len(path.begins) - 1) * path.dt
    for c, p in zip(fit.causes, proved):
        e = path.effects[c.name]; lim = {}
        for k, q in enumerate(e.parameters):
            lo, hi = np.clip(iv[i + k], e.bounds[0][k], e.bounds[1][k]) * e.scale[k]; lim[q.name] = [float(lo), float(hi)]
        i += len(e.parameters)
        out.append({"name": c.name, "evidence": p.worth, "confidence": p.confidence, "params": dict(zip((q.name for q in e.parameters), c.params)), "params_ci95": lim, "segments": [[float(max(a, 0)), float(min(b, end))] for a, b in c.segments]})
    report = {"verdict": word, "effects": out, "ranking": ([{"name": "measurement_noise", "score": 1.0}] if word == "none" else []) + [{"name": n, "score": float(s)} for n, s in judge.ranking(search, base, fit, proved)],
              "ambiguous_with": {c.name: list(p.others) for c, p in zip(fit.causes, proved) if p.others}, "small": [c.name for c in small],
              "gap": ahead.summary(before["position"], after["position"], least["position"]), "unexplained": {"share": left.share, "gap": left.gap, "smallest": left.smallest}, "q": (state.noise.process / path.usual).tolist(), "variant": state.variant}
    if make_fresh is not None:
        p2 = make_fresh()
        from ..pem import noise as N
        p2._set_variant(state.variant)
        s2 = Search(p2)
        from itertools import product
        carried = []
        for c in fit.causes:
            params = c.params
            if c.name == "battery_sag":
                own = np.mean([min(b, end) - max(a, 0) for a, b in c.segments]); params = (float(np.clip(params[0] * (len(p2.begins) - 1) * p2.dt / own, 0, .9)),)
            carried.append((replace(c, params=params, segments=ALWAYS), c.segments == ALWAYS))
        best = None
        for acts in product(*((True,) if al else (True, False) for _, al in carried)):
            cs = tuple(c for (c, _), a in zip(carried, acts) if a); f = s2.fitter.fit_of(cs)
            if best is None or f.cost < best[0]: best = (f.cost, cs, acts)
        st2 = s2.likeliest(s2.fitter.fit_of(best[1])); ss = ahead.starts_of(p2)
        b, a = ahead.errors(p2, (), ss), ahead.errors(p2, best[1], ss)
        report["fresh"] = {"gap": ahead.summary(b["position"], a["position"], ahead.floor(p2, st2.noise.quiet(p2), ss)["position"]), "effects": [{"name": c.name, "params": dict(zip((q.name for q in path.effects[c.name].parameters), c.params)), "acts": bool(x)} for (c, _), x in zip(carried, best[2])]}
    return report
