"""The report of a robot that does not answer: no effect is looked for, since every one that slows a robot down would fit."""

from dataclasses import replace

import numpy as np

from .... import bridge
from ...diagnosis import Diagnosis, report_of
from ...elsewhere import seconds
from ...prediction_errors import ahead
from ...prediction_errors.answer import answer
from ...prediction_errors.fit import Fitter
from . import links, traction, where
from .path import Path, name

EFFECT = "no_traction"


def diagnosis(log, dead, speeds):
    """The Diagnosis of a log in which the link of that name is dead; speeds: of the wheels, if they are known."""
    moving, still = (answer(Path(one, bridge.effects())) for one in (log, replace(log, u=np.zeros_like(log.u))))
    found = replace(still, verdict="known", before=moving.before, small=[])
    report = {"platform": name} | report_of(found, where.located(moving), [], _nothing_left(found)) | {
        "effects": [_effect(found, moving, dead, _motion(log, dead, speeds))], "ranking": [{"name": EFFECT, "score": 1.0}],
        "healthy": {"logs": 0, "effects": []}, "contributions": {}, "integrator": moving.path.variants[0], "advice": None,
    }  # fmt: skip
    return Diagnosis(report, replace(moving, verdict="known", after=found.after, floor=found.floor), {"drive": None, "after": found.path})


def _motion(log, dead, speeds):
    """{axis: {"into", "out"}}: RMS motion in a second that goes into the dead link and that comes out, m and rad, where it is clear."""
    axes = traction.answer(log, speeds["wheels"].u if dead == links.GROUND else log.u)
    return {key: {part: axis[part] for part in ("into", "out")} for key, axis in zip(("along", "heading"), axes) if axis["clear"]}


def _effect(found, moving, dead, motion):
    """The one effect of the report. Its confidence is the share of the motion that is missing."""
    evidence = Fitter(moving.path, found.state.noise).fit_of(()).cost - found.fit.cost
    missing = min(1 - axis["out"] / axis["into"] for axis in motion.values())
    return {
        "name": EFFECT, "link": dead, "params": {}, "units": {}, "params_ci95": {}, "at_bound": [], "formula": "",
        "segments": [[0.0, seconds(found.path.log)]], "evidence": float(evidence), "confidence": float(max(missing, 0.0)), "motion": motion,
    }  # fmt: skip


def _nothing_left(found):
    """The `unexplained` of the report."""
    unit, _ = found.path.gaps["position"]
    before = ahead.rms(found.before["position"])
    return {
        "unit": unit, "gap": 0.0, "of_gap": float(np.append(0.0, before[np.isfinite(before)])[-1]), "smallest_that_matters": found.left.smallest,
        "share": 0.0, "matters": False, "depends_on": [],
    }  # fmt: skip
