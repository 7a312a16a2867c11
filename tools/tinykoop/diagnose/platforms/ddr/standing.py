"""The report of a drive that does not answer."""

from dataclasses import replace

import numpy as np

from .... import bridge
from ... import standing
from ...diagnosis import Diagnosis, compare
from ...prediction_errors.answer import answer
from ...prediction_errors.fit import Fitter
from . import links, traction, where
from .path import Path, name

EFFECT = standing.NO_TRACTION


def diagnosis(log, dead, speeds, fresh=None):
    """The Diagnosis of a log in which the link of that name is dead; speeds: of the wheels, if they are known."""
    moving, still = _answers(log)
    evidence = Fitter(moving.path, still.state.noise).fit_of(()).cost - still.fit.cost
    fault = standing.fault(EFFECT, dead, _motion(log, dead, speeds), evidence, log)
    own = {"integrator": moving.path.variants[0], "advice": None}
    report = {"platform": name} | standing.report(moving, still, fault, where.located(moving)) | own
    if fresh is not None:
        compare(report, standing.on_fresh(*_answers(fresh), fault))
    return Diagnosis(report, standing.found(moving, still), {"drive": None, "after": still.path})


def _answers(log):
    """Answers of the simulator and of a robot that stands still."""
    return [answer(Path(one, bridge.effects())) for one in (log, replace(log, u=np.zeros_like(log.u)))]


def _motion(log, dead, speeds):
    """RMS motion in a second that goes into the dead link and that comes out, m and rad, where it is clear."""
    axes = traction.answer(log, speeds["wheels"].u if dead == links.GROUND else log.u)
    return standing.moved(dict(zip(("along", "heading"), axes)))
