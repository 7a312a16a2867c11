"""The report of a robot in which a link is dead: no effect is looked for, since every one that slows a robot down would fit."""

from dataclasses import replace

import numpy as np

from . import cautions
from .diagnosis import gaps, report_of
from .elsewhere import seconds
from .prediction_errors import ahead

NO_TRACTION, NO_ANSWER = "no_traction", "no_answer"  # of a drive, and of your own robot
FAULTS = (NO_TRACTION, NO_ANSWER)  # of the robot, that no simulator shall have


def found(moving, still):
    """The Answer that is drawn: predictions of the simulator beside those of a robot whose link is dead."""
    return replace(moving, verdict="known", after=still.after, floor=still.floor)


def report(moving, still, fault, where):
    """What all platforms say; moving, still: Answers of the simulator and of one whose link is dead; fault: the effect of the report."""
    result = replace(still, verdict="known", before=moving.before, small=[])
    told = report_of(result, where, [], _nothing_left(result)) | {
        "effects": [fault], "ranking": [{"name": fault["name"], "score": 1.0}], "healthy": {"logs": 0, "effects": []}, "contributions": {},
    }  # fmt: skip
    told["log"]["cautions"] = cautions.of_log(moving.path)
    return told


def on_fresh(moving, still, fault):
    """The `fresh` of the report; moving, still: Answers to the fresh log."""
    named = {key: fault[key] for key in ("name", "params")} | {"acts": True}
    floor = {gap: np.fmin(moving.floor[gap], least) for gap, least in still.floor.items()}
    return gaps(still.path, moving.before, still.after, floor) | {"effects": [named]}


def fault(name, link, motion, evidence, log):
    """The one effect of the report. Its confidence is the share of the motion that is missing; motion: {axis: {"into", "out"}}."""
    missing = min(1 - axis["out"] / axis["into"] for axis in motion.values())
    return {
        "name": name, "link": link, "params": {}, "units": {}, "params_ci95": {}, "at_bound": [], "formula": "",
        "segments": [[0.0, seconds(log)]], "evidence": float(evidence), "confidence": float(max(missing, 0.0)), "motion": motion,
    }  # fmt: skip


def moved(axes):
    """{axis: {"into", "out"}} of those in which enough goes in; axes: {name: as answers.axis() gives them}."""
    return {name: {part: axis[part] for part in ("into", "out")} for name, axis in axes.items() if axis["clear"]}


def _nothing_left(found):
    """The `unexplained` of the report."""
    gap, (unit, _) = next(iter(found.path.gaps.items()))
    before = ahead.rms(found.before[gap])
    return {
        "unit": unit, "gap": 0.0, "of_gap": float(np.append(0.0, before[np.isfinite(before)])[-1]), "smallest_that_matters": found.left.smallest,
        "share": 0.0, "matters": False, "depends_on": [],
    }  # fmt: skip
