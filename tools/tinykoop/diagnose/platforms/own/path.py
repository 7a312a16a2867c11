"""A robot of the user's: the path that its simulator takes nearest to the log, and what effects do beside that, by its slopes.

Slopes of one step to states, commands, parameters, clock and pushes are taken at every row of the path, so that an effect of
any size costs no further pass of the simulator over the log. about() makes what they say exact for the causes that matter.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.signal import savgol_filter

from ....plumbing.errors import UserError
from ...prediction_errors import noise as noises
from ...prediction_errors import path, smooth
from ...prediction_errors.fit import Cause
from ...robot import RunsAway
from ...robots import features
from ...robots.actions import Stepper, idle
from ...robots.library import Context, library, preference
from ...robots.log import continued, windows

SETTLE = 50  # rows at the beginning, and behind a gap: how actuators stood before them is not known
ENOUGH = 0.85  # of the rows must be left then
STEP = 1e-4  # of a signal's reach, by which slopes are taken
FAR = 0.2  # of a command's reach, by which it is seen how slopes change with it
STILL = 1e-6  # of slopes: what is less is none
TRIED = 500  # rows, at which a simulator is asked twice
FINER = 4  # steps instead of one, by which it is seen whether the simulator's own are short enough
# By which share of what FINER changes shorter steps are reckoned: the error goes with the step.
VARIANTS = (("its own steps of time", 0.0), ("steps of time half as long", 2 / 3), ("short steps of time", 4 / 3))
CUT_VARIANTS = (VARIANTS[0], ("steps of time a quarter as long", 1.0))  # of a path that is cut: those are taken
TURNS, SETTLED = 6, 0.02  # of a path; share of its misfit that a turn must take to be followed by another
WHOLE = 0.98  # of a channel that is there, from which on its readings may be shifted by rows
ACTIONS = 16  # that are kept: trials of a search begin alike
BUDGET = 120  # passes over the log, after which no further cause is looked for: to prove those found takes some 50 more
SAME = 0.25  # of its size, by which a sensor's effect may be another and have the path in the same place
SLOPE, LED, LEADS = 9, 50, 2  # rows, of which a slope is taken; of windows in which a simulator runs; runs
FEW = 250  # rows, at which slopes are taken while there is no path
TRIFLE = 1.0  # squares, by which a turn may gain and slopes stay
HARD = 10.0  # times the readings, that a path may cost and not be cut into windows
PARTS = (1.0, 0.25, 0.06)  # of a turn, that are tried
MOVING = 0.3  # of the usual rate, that random motion is while a path is first looked for
EXACT = 1e-3  # of what a state moves in a row, by which a step may be off that nothing pushes
LEAST = 1e-6  # of a state's reach, in any case; per second, of what pushes it
AWAY = 1e3  # times the reach of a signal, beyond which a path has left the log
COVERED = 2.0  # times that the longest predictions go over the log
SMALLEST, SMALLEST_NOISE = 0.002, 0.5  # of the way that a gap's states go, and of the noise of a reading: a smaller gap does not matter
TINY = 0.05  # of its usual size: what is less may be significant, and does not matter
CORNERS = 1.5  # the same, of a path that is cut: what still shorter steps would change at contacts looks like random motion
LATE = 2.0  # of what noise makes of lags and delays, that they are off beside it: RMS of 44, in logs of blind/own
PARTIAL = 0.64  # confidence where a fifth of the gap is left: on logs of blind/own, effects that leave more are wrong more often than not
STEADY = 0.02  # share that commands of one kind vary by


class Path(path.Path):
    """The log as the engine takes it. Deviations are in the states' own axes.

    before, added: Causes that belong to the simulator, and those of them that its file does not have.
    """

    tiny = TINY
    calibrated, partial, wanders = True, PARTIAL, False

    @property
    def variants(self):
        return CUT_VARIANTS if self.cut else VARIANTS

    @property
    def share(self):
        """Of what FINER changes, that counts."""
        return self.variants[self.variant][1]

    def __init__(self, robot, log, without=(), before=(), settle=SETTLE):
        self.robot, self.log, self.dt, self.before, self.variant, self.cut = robot, log, log.dt, (), 0, False
        self.stepper, self.context, self.everything = Stepper(robot, log), Context(robot, log), {}
        self._acted = lru_cache(ACTIONS)(self._act)
        self._rows(settle)
        self._channels()
        self._first_path()
        self.everything = library(self.context, self.velocities, self.reach)
        self.order = {name: rank for rank, name in enumerate(self.everything)}
        self.effects = {name: effect for name, effect in self.everything.items() if name not in without}
        self.before, self.added = (*self._acting(), *before), tuple(before)
        if self.before:  # the path was looked for without them
            self.at_causes, self._known = None, {}
            self.about(())
        late = frozenset(f"sensor_delay:{channel.name}" for channel in robot.channels)
        self.lookalikes = {late: "commands that come late"} if len(late) > 1 else {}

    def _acting(self):
        """Causes of the effects that belong to the simulator, as the robot's file has them."""
        for name, params in self.robot.acting:
            effect = self.everything.get(name)
            known = [p.name for p in effect.parameters] if effect else []
            if sorted(known) != sorted(params):
                there = f"its parameters are {', '.join(known)}" if effect else "`tinykoop effects --robot` lists what there is"
                raise UserError(f"{self.robot.file}: [[effect]] {name}: {there}")
            yield Cause(name, tuple(params[key] for key in known))

    # ---- rows and channels ---------------------------------------------------------------------------------

    def _rows(self, settle):
        K = len(self.log.t)
        self.rows, self.t = np.arange(K), self.log.t - self.log.t[0]
        self.breaks = np.concatenate([[True], ~self.log.usable])
        self.begins = self.breaks.astype(np.int32)
        self.known = self._settled(settle)
        self.settled = int(self.known.argmax())
        self.begins[1:] |= self.known[1:] & ~self.known[:-1]
        good = self.log.usable
        self.on = np.flatnonzero(good)
        self.whole = good[:-2] & good[1:-1] & good[2:]
        size = np.abs(self.log.u).max(0)
        self.steady = bool(np.all(np.std(self.log.u, axis=0) <= STEADY * (size + 1e-9)))

    def _settled(self, settle):
        """Rows (K,) before which commands are known for so many rows; all, where that would leave too little."""
        since = np.arange(len(self.t)) - np.maximum.accumulate(np.where(self.begins, np.arange(len(self.t)), 0))
        known = since >= settle
        return known if known.mean() > ENOUGH else np.ones(len(known), bool)

    def _channels(self):
        robot, y = self.robot, self.log.y
        seen, n = np.isfinite(y), len(robot.states)
        self.measured = np.stack([continued(values, c.wraps) for values, c in zip(y.T, robot.channels)], 1)
        self.present = np.where(seen & self.known[:, None], 1.0, np.inf)
        self.channels = tuple(s.name for s in robot.states)
        self.alike = np.arange(len(robot.channels))
        self.finest = np.maximum(1e-6 * np.abs(self.measured).max(0), 1e-12)
        self._C = self.C = robot.sense(np.eye(n), np.zeros((n, len(robot.commands)))).T
        names = [c.name for c in robot.channels]
        self.sensors = {c.name: (c.unit, i) for i, c in enumerate(robot.channels)}
        self.gaps = {g.name: (g.unit, tuple(names.index(s) for s in g.states if s in names)) for g in robot.gaps}

    @property
    def readings(self):
        """What was measured, as the log has it."""
        return np.where(np.isfinite(self.log.y), self.measured, np.nan)

    @property
    def command_names(self):
        return [command.name for command in self.robot.commands]

    @property
    def wraps(self):
        return [channel.wraps for channel in self.robot.channels]

    # ---- the path --------------------------------------------------------------------------------------------

    def _first_path(self):
        """From where the robot was by what was measured; hidden states begin at zero."""
        robot = self.robot
        self.X = np.zeros((len(self.t), len(robot.states)))
        self.X[:, robot.measured] = self.measured[:, : len(robot.measured)]
        self.reach, self.u_reach = (np.array([_reach(x) for x in values.T]) for values in (self.X, self.log.u))
        self.still, self._known, self._shift, self.curved = None, {}, None, None
        self._at(())
        self.stepper.tried(self.X[self.on[:TRIED]], self.on[:TRIED], self.at)
        whole, self.on = self.on, self.on[:: max(1, len(self.on) // FEW)]
        self._step()
        self._slope()
        self.rates, free = _rates(robot.simulator, self.A[self.on], self.dt)
        self.on, self.velocities = whole, list(self.rates)
        shown = [v for v, i in self.rates.items() if i in robot.measured]
        self.pushed = sorted({*shown, *free}) or self.velocities
        self.pushes = {robot.states[i].name: f"{robot.states[i].unit}/s" for i in self.pushed}
        self._settle()
        if self._misfit(self._weights) > HARD * len(self.on) * len(robot.channels):
            self._cut()
            self._settle()
        self._slopes()
        self._hidden = self.X

    def _settle(self):
        """The path from hidden states as they follow from what was measured."""
        robot = self.robot
        hidden = [i for i in range(len(robot.states)) if i not in robot.measured]
        if hidden:
            self._go(self._led(hidden))
            self.reach[hidden] = [_reach(x) for x in self.X[:, hidden].T]
        else:
            self._go(self.X)
        self._slope()
        self.F = np.tile(self.dt * np.eye(len(robot.states)), (len(self.X), 1, 1))
        self._push()
        self._turn(replace(noises.first(self), process=MOVING * self.usual))
        self.reach[hidden] = [_reach(x) for x in self.X[:, hidden].T]

    def _led(self, hidden):
        """States (K, n) when the simulator is led along what was measured. Rates of that are its slopes, unless the path is cut."""
        led, X = list(self.robot.measured), np.zeros_like(self.X)
        X[:, led] = self.measured[:, : len(led)]
        for v in hidden if not self.cut else ():
            if self.rates.get(v) in self.robot.measured:
                X[:, v] = savgol_filter(X[:, self.rates[v]], SLOPE, 2, deriv=1, delta=self.dt, mode="interp")
                led.append(v)
        starts = windows(self.begins[1:] == 0, LED) if not self.cut else np.flatnonzero(self.begins)
        for _ in range(LEADS if len(led) < X.shape[1] else 0):
            for now, ends in self._along(X, starts):
                ends[:, led] = X[now + 1][:, led]
                X[now + 1] = np.where(np.isfinite(ends), ends, 0.0)
            follows = starts[(starts > 0) & (self.log.usable[starts - 1])]
            ends = self.stepper.step(X[follows - 1], follows - 1, self.at)
            free = [i for i in hidden if i not in led]
            X[np.ix_(follows, free)] = np.where(np.isfinite(ends), ends, 0.0)[:, free]
        return X

    def _along(self, X, starts):
        """[(rows, where one step from X there ends)], row by row of the windows that begin in `starts`, while X is changed."""
        now, here = starts, np.append(self.begins[1:] == 0, False)
        for _ in range(LED):
            now = now[here[now]]
            if not len(now):
                break
            with np.errstate(all="ignore"):
                yield now, self.stepper.step(X[now], now, self.at, self.parts)
            now = now + 1

    def _cut(self):
        """A path that the simulator takes by itself in windows: where a small change of states is a large force, as at contacts."""
        self.cut, self.begins = True, self.begins.copy()
        run = 0
        for k in range(len(self.begins)):
            run = 0 if self.begins[k] or run == LED - 1 else run + 1
            self.begins[k] |= run == 0

    def _go(self, X):
        """Has the path at X, or, if it is cut, where the simulator goes from X at the beginnings of windows."""
        self.X = X.copy()
        if not self.cut:
            self._step()
            return
        for now, ends in self._along(self.X, np.flatnonzero(self.begins)):
            self.X[now + 1] = ends
        if not np.isfinite(self.X).all():
            raise RunsAway(f"the simulator of {self.robot.name} runs away from the log within {LED} rows")
        self._D, self._ends, self._own = np.zeros_like(self.X), None, self.at  # the simulator's own steps end on its path
        self._known[self.at_causes] = self.X, self._D

    def _coarse(self):
        """Where steps of the path's own causes end that are not shortened."""
        if self._ends is None:
            self._ends = self.stepper.step(self.X[self.on], self.on, self._own)
        return self._ends

    def _push(self):
        """Where random motion acts: on rates of what is measured, and on what no rate moves."""
        self.G = np.ascontiguousarray(self.F[:, :, self.pushed])
        from_, to = self.X[self.on], self.X[self.on + 1]
        rate = _rms(to - from_) / self.dt
        if self._ends is not None:
            rate = np.maximum(rate, _rms(self._ends - from_) / self.dt)
        self.usual = np.maximum(rate, LEAST * self.reach)[self.pushed]
        self.exact = np.maximum(EXACT * rate * self.dt, LEAST * self.reach)
        self.spread = self.reach

    def refer(self, causes, noise):
        """The path again, with these causes and that noise, and slopes along it."""
        if self.cut and tuple(causes) == self.at_causes == ():
            return False  # its windows do not depend on random motion
        self._at(causes)
        self._go(self.X)
        self._turn(noise)
        self._slopes()
        return True

    def pass_over(self, good):
        """Outliers count less in `present` already; a path is looked for again by refer()."""

    def _turn(self, noise):
        """The path turned to where it costs least, each time by slopes of its own."""
        self._known, self._shift = {}, None
        weights = self._weights = smooth.weights(self, noise.quiet(self) if self.cut else noise)
        for _ in range(TURNS):
            before = self._misfit(weights)
            if not self._turned(weights, before):
                break
            after = self._misfit(weights)
            if before - after > TRIFLE:
                self._slope()
            if after > (1 - SETTLED) * before:
                break
        far = np.abs(self.X - self.X.mean(0)) > AWAY * self.reach
        off = np.abs(self._D) > AWAY * self.reach
        if (far | off)[:, self.robot.measured].any():
            raise RunsAway(f"the simulator of {self.robot.name} runs away from the log")

    def heeded(self):
        """Variances of readings (K, c) over those of the sensor, from the first row on."""
        return np.where(self.known[:, None], self.present, np.where(np.isfinite(self.log.y), 1.0, np.inf))

    def _misfit(self, weights):
        with np.errstate(all="ignore"):
            return smooth.misfit(self, weights, self._D, self._missed(self.at))

    def _turned(self, weights, before, parts=PARTS):
        """One turn, or a part of it that gains; whether there is one."""
        X, move = self.X, smooth.better(self, weights, self._D, self._missed(self.at))
        for part in parts:
            self._go(X + part * move)
            if self._misfit(weights) < before:
                return True
        self._go(X)
        return False

    def _step(self):
        """What one step from each row ends beside the path (K, n), by one pass."""
        with np.errstate(all="ignore"):
            ends = self.stepper.step(self.X[self.on], self.on, self.at)
        if not np.isfinite(ends).all():
            raise RunsAway(f"the simulator of {self.robot.name} runs away from the log within a row")
        if self.cut:
            self._D = np.zeros_like(self.X)
            self._D[self.on] = ends - self._coarse()
        else:
            self._ends, self._D = ends, self._beside(ends)
        self._known[self.at_causes] = self.X, self._D

    def _beside(self, ends):
        D = np.zeros_like(self.X)
        D[self.on] = ends - self.X[self.on + 1]
        for i, signal in enumerate(self.robot.states):
            if signal.wraps:
                D[:, i] = short(D[:, i])
        return D

    # ---- slopes ----------------------------------------------------------------------------------------------

    def _slope(self):
        """Of one step along the path to states, A (K, n, n)."""
        at, (K, n) = self.at, self.X.shape
        unit = np.eye(n)
        self.A = np.tile(unit, (K, 1, 1))
        for i in range(n):
            if not (self.still and i in self.still) or at.pushes:
                h = STEP * self.reach[i]
                self.A[self.on, :, i] = self._by(at, h, h * unit[i])[self.on]
        if self.still is None:
            self.still = np.flatnonzero(np.abs(self.A - unit).max((0, 1)) < STILL).tolist()

    def _slopes(self):
        """To commands B (m, n, K), parameters P (p, n, K), clock T (1, n, K): NumPy is fast along the last axis; and to pushes F (K, n, n)."""
        at, self._now, (K, n) = self.at, None, self.X.shape
        unit = np.eye(n)
        self._u, self.B = at.u, _columns(n, K, [self._by(replace(at, u=at.u + h * e), h) for h, e in _each(STEP * self.u_reach)])
        steps = np.array([STEP * abs(p.usual) for p in self.robot.parameters])
        self.P = _columns(n, K, [self._by(replace(at, params=at.params + h * e), h) for h, e in _each(steps)])
        self.T = _columns(n, K, [self._by(replace(at, clock=at.clock + STEP), STEP)])
        self.F = np.tile(self.dt * unit, (K, 1, 1))
        for i in getattr(self.robot.simulator, "velocities", ()):
            h = STEP * self.reach[i] / self.dt
            self.F[:, :, i] = self._by(at.pushed(lambda x, u, h=h, i=i: h * unit[i]), h)
        if self.curved is None:
            self._curve()
        self._push()

    def _curve(self):
        """What pairs of commands (i, j) do to a step beyond their slopes, over the product of their changes. Contacts have corners."""
        at, self.curved, self._now, alone = self.at, {}, None, {}
        for j, (h, e) in enumerate(_each(FAR * self.u_reach)) if not self.cut else ():
            alone[j] = self._by(replace(at, u=at.u + h * e), h).T - self.B[j]
            self.curved[j, j] = alone[j] / h
            for i in range(j):
                k, d = FAR * self.u_reach[i], np.eye(len(e))[i]
                both = self._by(replace(at, u=at.u + h * e + k * d), h * k).T
                self.curved[i, j] = both - (self.B[j] + alone[j]) / k - (self.B[i] + alone[i]) / h

    def _by(self, action, h, moved=0.0):
        """(K, n): by how much a step moves, over h."""
        out = np.zeros_like(self.X)
        ends = self.stepper.step((self.X + moved)[self.on], self.on, action)
        out[self.on] = (ends - (self._coarse() if self.cut else self._ends)) / h
        return out

    @property
    def parts(self):
        """Of each step of the simulator: a path that is cut has corners, so shorter steps are taken, not reckoned from slopes."""
        return FINER if self.cut and self.variant else 1

    def step_by(self, variant):
        """Takes another of the variants."""
        if variant != self.variant:
            self.variant = variant
            if self.cut:
                self._known = {}
                self._go(self.X)

    def shift(self):
        """What shorter steps of time change of a step (K, n)."""
        share = 0.0 if self.cut else self.share
        if share and self._shift is None:
            self._shift = self._beside(self.stepper.step(self.X[self.on], self.on, self.at, FINER)) - self._D
        return share * self._shift if share else 0.0

    # ---- what the engine asks ----------------------------------------------------------------------------------

    def action(self, causes):
        """What the simulator is given: effects act in the library's order, whichever was found first."""
        return self._acted(tuple(sorted((*self.before, *causes), key=lambda cause: self.order[cause.name])))

    def _act(self, causes):
        """The last cause of some acts behind the others."""
        if not causes:
            return idle(self.robot, self.log)
        return self.everything[causes[-1].name].on(causes[-1], self._acted(causes[:-1]), self.context)

    def about(self, causes):
        """Makes steps() exact at these causes, by a pass if they are new; whether it was another set before.

        With other sensors the path is elsewhere: it is turned there by the slopes as they are.
        """
        causes = tuple(causes)
        if causes == self.at_causes:
            return False
        self._at(causes)
        if causes in self._known:
            self.X, self._D = self._known[causes]
            return True
        known = next((X for done, (X, _) in self._known.items() if self.cut or self._near(done, causes)), None)
        if known is not None:
            self.X = known
            self._step()
        else:
            self._follow_sensors()
        return True

    @property
    def spent(self):
        """Whether the simulator was asked so much that no further cause is looked for."""
        return self.log.passes > BUDGET

    def bends(self, causes):
        """Whether causes are of sensors that have the path elsewhere."""
        return not (self.cut or self._near(self.at_causes, causes))

    def _near(self, causes, others):
        """Whether the same sensors are off, and by about as much."""
        some, rest = ({(c.name, c.segments): c for c in many if self.everything[c.name].block == "output"} for many in (causes, others))
        return set(some) == set(rest) and all(
            abs(c.params[0] - rest[key].params[0]) <= SAME * abs(rest[key].params[0]) for key, c in some.items()
        )

    def _follow_sensors(self):
        for reading, on in self.at.readings:
            i = self._of(reading.c)[0]
            if i is not None:
                self.X = self.X.copy()
                self.X[:, i] = np.where(on, reading.back(self.X[:, i]), self.X[:, i])
        self._go(self.X)
        self._turned(self._weights, self._misfit(self._weights), (1.0,))

    def _at(self, causes):
        self.at_causes, self.at, self._now = tuple(causes), self.action(causes), None
        self.C = self._C * self._gains(self.at)[:, None]

    def steps(self, trials):
        """What one step with each trial's causes ends beside the path (K, n, trials), and by how much it misses readings (K, c, trials)."""
        return self.changed([self.action(causes) for causes in trials])

    def changed(self, actions):
        """steps() of actions."""
        D, E = zip(*map(self._trial, actions))
        return np.stack(D, -1).swapaxes(0, 1) + np.reshape(self.shift(), (*np.shape(self.shift()), 1)), np.stack(E, -1)

    def _trial(self, action):
        """By the slopes (n, K), (K, c)."""
        at, out = self.at, self._D.T.copy()
        if action.u is not at.u:
            if self._now is None:
                self._now = self._commanded(at.u)
            out += self._commanded(action.u) - self._now
        for slope, new, old in ((self.P, action.params, at.params), (self.T, action.clock, at.clock)):
            by = (new - old).reshape(len(new), -1).T if new is not old else ()
            for change, moves in zip(by, slope):
                if change.any():
                    out += moves * change
        for sign, some in ((1, action), (-1, at)):
            if some.pushes:
                out += sign * (self.F @ self.stepper.push(self.X, self.rows, some)[..., None])[..., 0].T
        return out, self._missed(action)

    def _commanded(self, u):
        """What other commands (K, m) than those of the slopes make of a step (n, K), to second order."""
        by, out = (u - self._u).T.copy(), np.zeros(self.X.T.shape)
        for j in np.flatnonzero(by.any(1)):
            out += self.B[j] * by[j]
            for i in range(j + 1):
                if (i, j) in self.curved:
                    out += self.curved[i, j] * (by[i] * by[j])
        return out

    def read(self, action):
        """What sensors read of the path (K, c)."""
        Y = self.robot.sense(self.X, action.u)
        for reading, on in action.readings:
            Y[:, reading.c] = np.where(on, reading.read(Y[:, reading.c]), Y[:, reading.c])
        return Y

    def _of(self, c):
        """(state, None) or (None, command) that channel c measures."""
        states, commands = ([s.name for s in some] for some in (self.robot.states, self.robot.commands))
        channel = self.robot.channels[c]
        name = channel.measures or channel.name
        return (states.index(name), None) if name in states else (None, commands.index(name))

    def _gains(self, action):
        """By how much readings (c,) grow with what they are of."""
        gains, y = np.ones(len(self.robot.channels)), self.t
        for reading, on in action.readings:
            line = np.diff(reading.read(y)) / np.diff(y) if reading.grows else np.ones(1)
            gains[reading.c] *= 1 + on.mean() * (np.median(line) - 1)
        return gains

    def _missed(self, action):
        """Measured less read (K, c)."""
        E = self.measured - self.read(action)
        for c, channel in enumerate(self.robot.channels):
            if channel.wraps:
                E[:, c] = short(E[:, c])
        seen = np.isfinite(self.log.y)
        E = np.where(seen, E, 0.0)
        for reading, on in action.readings:
            if reading.late and seen[:, reading.c].mean() > WHOLE:  # what is read late is told of the row that it is of
                column = E[:, reading.c]
                E[:, reading.c] = np.where(on, np.append(column[reading.late :], np.full(reading.late, column[-1])), column)
        return E

    # ---- predictions -------------------------------------------------------------------------------------------

    def tell_hidden(self, noise):
        """Takes hidden states as all of the log tells them by this noise, for predictions. A path that is cut is the simulator's own."""
        self._hidden = (
            self.X if self.cut else self.X + smooth.better(self, smooth.weights(self, noise), self._D + self.shift(), self._missed(self.at))
        )

    def unsure(self, noise):
        """Covariances (K, n, n) of states that nothing measures, by what the whole log tells of them."""
        out, hidden = np.zeros_like(self.A), [i for i in range(self.X.shape[1]) if i not in self.robot.measured]
        if hidden:
            rows, columns = np.ix_(hidden, hidden)
            out[:, rows, columns] = smooth.spread(self, smooth.weights(self, noise))[:, rows, columns]
        return out

    def most_starts(self, horizon):
        return max(int(COVERED / np.sqrt(self.parts) * len(self.rows) / horizon), 1)

    def ahead(self, causes, starts, horizons):
        """Measured less predicted (S, H, c), from what was measured in these rows; NaN where nothing can be compared."""
        return self.ahead_by(self.action(causes), starts, horizons)

    def ahead_by(self, action, starts, horizons):
        """ahead() of an action."""
        moved = self.read(action) - self.robot.sense(self.X, action.u)  # what sensors make of a path
        x, seen = self._hidden[starts].copy(), self.robot.measured
        there = np.isfinite(self.log.x[starts][:, seen])
        x[:, seen] = np.where(there, self.measured[starts][:, : len(seen)] - moved[starts][:, : len(seen)], x[:, seen])
        ends = starts[:, None] + np.arange(max(horizons) + 1)
        rows = np.minimum(ends, len(self.rows) - 1)
        X = self.stepper.run(x, rows, action, self.parts)
        Y = self.robot.sense(X + self._shifted(rows), action.u[rows]) + moved[rows]
        there = np.isfinite(self.log.y[rows]) & (ends < len(self.rows))[..., None]
        missed = np.where(there, self.measured[rows] - Y, np.nan)
        for c, channel in enumerate(self.robot.channels):
            if channel.wraps:
                missed[..., c] = short(missed[..., c])
        return missed[:, list(horizons)]

    def _shifted(self, rows):
        """What shorter steps of time make of predictions of these rows (S, H + 1), by the slopes (S, H + 1, n)."""
        out, shift = np.zeros((*rows.shape, self.X.shape[1])), self.shift()
        for k in range(rows.shape[1] - 1) if np.ndim(shift) else ():
            now = rows[:, k]
            out[:, k + 1] = (self.A[now] @ out[:, k, :, None])[..., 0] + shift[now]
        return out

    def smallest_of(self, gap, noise, rows=50):
        """A gap that matters, in its unit, that many rows ahead."""
        axes = list(self.gaps[gap][1])
        way = np.sqrt((np.diff(self.robot.sense(self.X, self.at.u)[:, axes], axis=0)[self.on] ** 2).sum(1)).mean() * rows
        return max(SMALLEST * way, (CORNERS if self.cut else SMALLEST_NOISE) * np.sqrt(np.mean(noise.sensor[axes] ** 2)))

    @staticmethod
    def doubt(causes):
        """Commands act as their mean over a row: those that come late do not quite, and what is found beside that makes up for it."""
        return LATE if any(c.name.partition(":")[0] in ("lag", "delay") for c in causes) else 0.0

    preference = staticmethod(preference)

    def generic(self, left):
        """[((function, state))], pushes (K, n, q) by plain functions of states and commands."""
        names, columns = [], []
        for title, values in features.functions(self.robot, self.X, self.at.u, self.reach, self.u_reach):
            for j, i in enumerate(self.pushed):
                names.append((title, i))
                columns.append(self.G[:, :, j] * values[:, None])
        return names, np.stack(columns, -1)


# ---- signals -----------------------------------------------------------------------------------------------------


def short(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _reach(values):
    """How far a signal goes from its mean: never 0, as steps are taken in parts of it."""
    seen = values[np.isfinite(values)]
    return float(np.abs(seen - seen.mean()).max(initial=0.0)) or 1.0


def _rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


def _each(steps):
    """[(step, that direction)]."""
    return list(zip(steps, np.eye(len(steps))))


def _columns(n, K, columns):
    """Columns (K, n) of slopes, rows last."""
    return np.stack([column.T for column in columns]) if columns else np.zeros((0, n, K))


def _rates(simulator, A, dt):
    """({state that is the rate of another: that one}, [states that are no rate and that no rate moves]). A: (rows, n, n).

    One step moves a state by dt per unit of its rate, whatever the states.
    """
    n = A.shape[2]
    if hasattr(simulator, "velocities"):
        return dict(sorted(zip(simulator.velocities, simulator.moved))), []
    moves = (np.mean(np.abs(A / dt - 1) < 0.2, axis=0) > 0.8) & ~np.eye(n, dtype=bool)  # [moved, by]
    rates = {int(v): int(np.flatnonzero(moves[:, v])[0]) for v in np.flatnonzero(moves.any(0))}
    return rates, [i for i in range(n) if i not in rates and not moves[i].any()]
