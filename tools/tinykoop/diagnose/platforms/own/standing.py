"""The report of a robot of your own that does not answer: its actuators, or its motion."""

from dataclasses import replace

from ... import standing
from ...diagnosis import Diagnosis
from ...prediction_errors import noise as noises
from ...prediction_errors.answer import answer
from ...prediction_errors.fit import Fitter
from . import extras, links

EFFECT = standing.NO_ANSWER


def of_actuator(given, located):
    """The Diagnosis of a log in which the first dead Actuator of its Extras does not answer its command; located(Answer): where."""
    actuator = given.dead
    robot, log = extras.driven(given.robot, given.log, [actuator])
    axes = {actuator.signal.name: extras.answer(given.log, actuator)}
    return _diagnosis(given, robot, log, links.to_actuator(given.robot, actuator), axes, located)


def of_motion(given, axes, located):
    """The Diagnosis of a log in which the motion does not answer; axes: {state: as answers.axis() gives them}."""
    robot, log = extras.driven(given.robot, given.log, given.actuators)
    return _diagnosis(given, replace(robot, simulator=links.Stands(), acting=()), log, links.moving(given), axes, located)


def _diagnosis(given, robot, log, link, axes, located):
    """robot, log: of one in which that link is dead."""
    none = lambda effect: False  # noqa: E731
    moving, still = (answer(links.LinkPath(*pair, none)) for pair in (extras.driven(given.robot, given.log, []), (robot, log)))
    sensor = still.state.noise.sensor
    costs = [Fitter(one.path, replace(noises.first(one.path), sensor=sensor)).fit_of(()).cost for one in (moving, still)]
    units = {signal.name: signal.unit for signal in given.robot.channels}
    motion = {name: axis | {"unit": units[name]} for name, axis in standing.moved(axes).items()}
    fault = standing.fault(EFFECT, link, motion, costs[0] - costs[1], given.log)
    fault["window"] = extras.window(given.log) * given.log.dt
    report = (
        {"platform": robot.name} | standing.report(moving, still, fault, located(moving)) | {"time_step": {"matters": False, "share": 0.0}}
    )
    given.work.rows += sum(one.path.log.work.rows for one in (moving, still))
    return Diagnosis(report, standing.found(moving, still))
