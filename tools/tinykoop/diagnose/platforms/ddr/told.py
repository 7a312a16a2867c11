"""What a report says of a drive: its phrases, the path with predictions beside it, and the drive to take next."""

import numpy as np

from .... import bridge
from ...prediction_errors.ahead import HORIZONS
from ...report import figures, words
from ...report.figures import WIDTH, Panel, extent
from ...report.links import Linked
from ...report.story import Section
from ...report.words import angle, length, listed, percent_of, quantity, real, signed
from . import links, told_links

MOST_POINTS, MOST_DRAWN = 1500, 100  # of a path, and predictions: more are not seen
ZOOMS = 3
SHORTEST = 2  # steps of a prediction worth drawing


def _acting(p, *parts):
    """[phrase] for the parameters that are not zero; parts: (parameter, unit, phrase with a place for its size)."""
    return [phrase.format(quantity(p[key], unit)) for key, unit, phrase in parts if p[key]]


def _limits(p):
    cut = _acting(p, ("v_max", "m/s", "drive faster than {}"), ("w_max", "rad/s", "turn faster than {}"))
    return f"the robot cannot {listed(cut, 'nor')}" if cut else "speed and turning are cut at a limit"


def _rates(p):
    cut = _acting(p, ("a", "m/s2", "its speed changes by {} at most"), ("alpha", "rad/s2", "its yaw rate changes by {} at most"))
    return f"the robot accelerates slowly: {listed(cut)}" if cut else "acceleration is limited"


def _play(p):
    lost = [
        f"{quantity(2 * real(p[key]), unit)} of {what}"
        for key, unit, what in (("half_angle", "rad", "turning"), ("half_way", "m", "the way"))
        if p[key]
    ]
    return f"play in the drive swallows {listed(lost)} at every reversal" if lost else "the drive has play"


def _offset(p):
    ahead = f"{length(abs(p['lx']))} {signed(p['lx'], 'ahead of', 'behind')}"
    return f"the position is measured {ahead} and {length(abs(p['ly']))} to the {signed(p['ly'], 'left', 'right')} of the robot's centre"


PHRASES = {
    "speed_gain": lambda p: f"the robot drives {percent_of(p['a'])} {signed(p['a'], 'faster', 'slower')} than commanded",
    "yaw_gain": lambda p: f"the robot turns {percent_of(p['b'])} {signed(p['b'], 'faster', 'slower')} than commanded",
    "wheel_asymmetry": lambda p: (
        f"driving straight turns the robot {signed(p['c'], 'left', 'right')} by {angle(abs(p['c']))} per metre"
    ),
    "yaw_bias": lambda p: f"the robot turns {signed(p['d'], 'left', 'right')} by itself, by {angle(abs(p['d']))} per second",
    "actuator_lag": lambda p: f"speed and turning follow their commands sluggishly, with a time constant of {quantity(p['tau'], 's')}",
    "transport_delay": lambda p: f"commands act {quantity(p['delay'], 's')} late",
    "dead_band": lambda p: f"commands below {quantity(p['v_db'], 'm/s')} and {quantity(p['w_db'], 'rad/s')} do nothing",
    "saturation": _limits,
    "saturation_soft": lambda p: f"{_limits(p)}, and approaches that limit smoothly",
    "wheel_saturation": lambda p: f"no wheel turns faster than {quantity(p['v_max'], 'm/s')} at its rim, so fast bends are slower and wider",
    "dead_zone_shifted": lambda p: (
        f"commands below {quantity(p['v_db'], 'm/s')} and {quantity(p['w_db'], 'rad/s')} do nothing, and larger ones lose as much"
    ),
    "wheel_dead_band": lambda p: f"a wheel commanded below {quantity(p['v_db'], 'm/s')} at its rim stands still",
    "backlash_angle": _play,
    "acceleration_limit": _rates,
    "speed_lag": lambda p: f"the speed follows its command sluggishly, with a time constant of {quantity(p['tau'], 's')}",
    "yaw_lag": lambda p: f"turning follows its command sluggishly, with a time constant of {quantity(p['tau'], 's')}",
    "second_order_lag": lambda p: (
        f"speed and turning follow their commands as a second-order system, with a time constant of {quantity(p['tau'], 's')} and a "
        f"damping ratio of {quantity(p['zeta'], '1')}"
    ),
    "backlash": lambda p: f"play of {quantity(p['half_width'], 'rad/s')} to either side holds the yaw rate back at every reversal",
    "battery_sag": lambda p: f"the robot gets slower over the log, by {percent_of(p['loss_at_end'])} at the end",
    "clock_scale": lambda p: f"a logged second lasts {quantity(1 + real(p['kappa']), 's')}",
    "pacejka_slip": lambda p: f"the wheels slip in fast bends (peak D = {quantity(p['D'], '1')}, sideways {quantity(p['lat'], '1')})",
    "slip_general": lambda p: (
        f"the wheels slip in fast bends: up to {percent_of(p['v_loss'])} of the speed and {percent_of(p['w_loss'])} of the yaw rate are lost"
    ),
    "slip_saturating": lambda p: f"the wheels slip in fast bends: up to {percent_of(p['loss'])} of speed and yaw rate are lost",
    "lateral_skid": lambda p: (
        f"in bends the robot slides {signed(p['k'], 'inwards', 'outwards')}, at {quantity(abs(p['k']), 's')} times v omega"
    ),
    "stribeck_friction": lambda p: (
        f"friction takes {percent_of(p['Fs'])} of the speed near standstill and {percent_of(p['Fc'])} and more in motion"
    ),
    "friction_coulomb": lambda p: (
        f"dry friction takes {quantity(p['c_v'], 'm/s')} from the speed and {quantity(p['c_w'], 'rad/s')} from the yaw rate, however fast"
    ),
    "friction_general": lambda p: (
        f"friction takes {percent_of(p['moving'] + p['extra'])} of the speed near standstill and {percent_of(p['moving'])} at high speed"
    ),
    "world_drift": lambda p: (
        f"something carries the robot along, at {quantity(p['wx'], 'm/s')} in x and {quantity(p['wy'], 'm/s')} in y"
    ),
    "sensor_lever_arm": _offset,
    "heading_bias": lambda p: f"the heading is measured {angle(abs(p['delta']))} too far {signed(p['delta'], 'left', 'right')}",
}  # fmt: skip


class Drive(Linked):
    phrases = PHRASES
    experiment = "What to drive next"

    links_note, beside, link_figure = told_links.NOTE, (links.HEADING,), told_links.figure
    fault, motion = staticmethod(told_links.fault), staticmethod(told_links.motion)

    # ---- predictions beside the path -----------------------------------------------------------------

    def predictions(self):
        rows, before, after = predicted(self.result)
        measured = self.result.log.x[rows][..., :2]
        error = [np.hypot(*np.moveaxis(p[:, -1] - measured[:, -1], -1, 0)) for p in (before, after)]
        shown, kinds = ([before, after], ("before", "after")) if self.fitted else ([before], ("before",))
        steps = rows.shape[1] - 1
        worst = np.sort(np.argsort(-np.nan_to_num(error[0]), kind="stable")[: ZOOMS if steps >= SHORTEST else 0])
        most = [np.nanmax(e) for e in error]
        size = words.common_size("m", most)
        caption = f"Predicted {steps} steps ahead, the simulator is {size(most[0])} off at worst"
        caption += f", with the effects {size(most[1])}" if self.fitted else ""
        caption += f"; the worst start at {'the circle' if len(worst) == 1 else 'the circles'}" if len(worst) else ""
        keys = [("measured", "measured"), ("before", "simulator"), ("after", "with effects")]
        parts = [figures.legend(0, 14, keys[: 1 + len(shown)]), self._whole(shown, kinds, measured, worst)]
        parts += [self._zoom(i, rows[k, 0], measured[k], [p[k] for p in shown], kinds, len(worst)) for i, k in enumerate(worst)]
        return caption, figures.svg(322 + (WIDTH - 44) / ZOOMS if len(worst) else 310, caption, *parts)

    def _whole(self, shown, kinds, measured, worst):
        """The measured path with all predictions beside it; the worst are numbered."""
        path = self.result.log.x[:, :2].copy()
        path[:-1][~self.result.log.usable] = np.nan
        path = path[:: max(1, len(path) // MOST_POINTS)]
        reach = [extent(np.r_[path[:, i], shown[0][..., i].ravel()]) for i in (0, 1)]
        panel = Panel((44, 44, WIDTH - 54, 220), *reach, True)
        parts = [panel.frame("x (m)", "y (m)"), panel.line(*path.T, "measured")]
        for (x, y), text in zip(path[np.isfinite(path).all(1)][[0, -1]], ("start", "end")):
            parts.append(figures.note(panel.px(x), panel.py(y) - 6, text, "label", "middle"))
        thin = max(1, (measured.shape[1] - 1) // 10)
        for k in range(0, len(measured), max(1, len(measured) // MOST_DRAWN)):
            parts += [panel.line(*p[k, ::thin].T, f"{kind} thin") for p, kind in zip(shown, kinds)]
        for i, k in enumerate(worst):
            x, y = panel.px(measured[k, 0, 0]), panel.py(measured[k, 0, 1])
            parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" class="mark"/>{figures.note(x, y + 4, i + 1, "strong", "middle")}')
        return "".join(parts)

    def _zoom(self, i, row, measured, shown, kinds, count):
        """One prediction by itself."""
        each = (WIDTH - 44) / ZOOMS
        lines, together = [measured, *shown], np.concatenate([measured, *shown])
        zoom = Panel((44 + i * each, 322, each - 40, each - 40), extent(together[:, 0]), extent(together[:, 1]), True)
        t = self.result.log.t
        heading = figures.note(zoom.left, 314, f"{i + 1}: from {words.seconds(t[row] - t[0])}", "strong")
        drawn = "".join(zoom.line(*line.T, kind) for line, kind in zip(lines, ("measured", *kinds)))
        return zoom.frame("x (m)" if i == 1 or count == 1 else "", "", 3, 3) + heading + drawn

    # ---- the next drive ------------------------------------------------------------------------------

    def advice(self):
        drive, (told, hidden) = self.report["advice"], self.settles()
        more = f"It does not decide {listed(hidden)}: that takes higher speeds or smaller commands than this log has."
        said = [f"Drive {drive['words']} ({drive['drive']}), at your own safe speeds.", *told]
        return [*said, *([more] if hidden else []), self.record]

    def next(self):
        if not self.report["advice"]:
            return Section(self.experiment)
        caption, u, dt = f"Drive this next: {self.report['advice']['words']}", self.result.more["drive"], real(self.report["log"]["dt"])
        rows = "".join(f"{k * dt:.6g},{v:.6g},{w:.6g}\n" for k, (v, w) in enumerate(u))
        commands = (caption, _commands(u, dt, self.result.path.command_names, caption))
        file = "These commands as CSV", "next_drive.csv", f"t,v,omega\n{rows}"
        return Section(self.experiment, figures=(commands,), sentences=tuple(self.advice()), brief=1, file=file)

    # ---- the log -------------------------------------------------------------------------------------

    def compared(self):
        rule = f"The nominal simulator integrates by this rule: {self.report['integrator']}."
        return [*super().compared(), rule, *self.searched()]

    def searched(self):
        """Of a long log, what the search has seen."""
        rows = self.report["log"].get("searched_rows")
        return [] if rows is None else [
            f"The log is long: the search of effects looked at {rows:,} of its rows, in pieces evenly spread over it, and followed the "
            f"actuators from {words.seconds(bridge.WARM_UP)} before each."
        ]  # fmt: skip


def predicted(result):
    """(rows (W, n + 1), before, after (W, n + 1, 2)): one after the other along the log, each from a measured pose."""
    log = result.log
    runs = np.flatnonzero(np.diff(np.concatenate([[0], log.usable.astype(int), [0]]))).reshape(-1, 2)
    steps = min(HORIZONS[-1], int((runs[:, 1] - runs[:, 0]).max()))
    starts = np.concatenate([np.arange(a, b - steps + 1, steps) for a, b in runs])
    rows = starts[:, None] + np.arange(steps + 1)
    out = []
    for path, causes in ((result.path, ()), (result.more.get("after", result.path), result.fit.causes)):
        poses, _ = path.predicted(causes, starts, np.arange(1, steps + 1))
        out.append(np.concatenate([log.x[starts][:, None, :2], poses[..., :2]], axis=1))
    return rows, *out


def _commands(u, dt, names, label):
    """The advised commands over time."""
    t, parts = np.repeat(np.arange(len(u) + 1) * dt, 2)[1:-1], []
    for i, (name, unit) in enumerate(zip(names, ("m/s", "rad/s"))):
        held = np.repeat(u[:, i], 2)
        low, high = extent(held, 0.15)
        panel = Panel((44, 26 + 145 * i, WIDTH - 60, 92), (0, t[-1]), (min(low, 0), max(high, 0)))
        parts += [panel.frame("time (s)" if i else "", f"{name} ({unit})", 5, 3), panel.line(t, held, "command")]
    return figures.svg(302, label, *parts)
