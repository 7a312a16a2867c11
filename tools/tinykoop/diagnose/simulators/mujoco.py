"""A MuJoCo model (MJCF) of hinges and slides, many rows at once by its threaded rollout.

Todorov, Erez and Tassa, "MuJoCo: A physics engine for model-based control", IROS 2012.
"""

import copy
import os

import numpy as np

from ...plumbing.asked import among, package
from ...plumbing.errors import UserError

KEYS = ("qpos", "qvel", "act", "ctrl", "sensordata")
COUNTS = {
    "body": "nbody", "joint": "njnt", "geom": "ngeom", "actuator": "nu", "site": "nsite", "tendon": "ntendon",
    "equality": "neq", "sensor": "nsensor",
}  # fmt: skip
MODELS = 16  # with other parameters, that are kept


def _named(model, kind):
    """Names of all bodies, joints, .. of a model."""
    return [getattr(model, kind)(i).name for i in range(getattr(model, COUNTS[kind]))]


# ---- parameters ----------------------------------------------------------------------------------------------


class Field:
    """Where a model keeps a parameter: KIND/NAMES/WHAT/INDICES; an option has no name, and the first number needs no index."""

    def __init__(self, model, text):
        self.text, self.where, pieces = text, f"[[parameter]] field {text}", text.split("/")
        self.at = [int(part) for part in pieces.pop().split(",")] if pieces[-1].replace(",", "").isdecimal() else [0]
        self.kind, self.what = pieces[0], pieces[-1]
        if len(pieces) < (2 if self.kind == "option" else 3):
            raise UserError(f"{self.where}: write KIND/NAME/WHAT, such as body/hand/mass, geom/left,right/friction or option/wind/0")
        among(self.kind, [*COUNTS, "option"], self.where, "kind")
        self.names = "/".join(pieces[1:-1]).split(",") if self.kind != "option" else []
        for name in self.names:
            among(name, [n for n in _named(model, self.kind) if n], self.where, self.kind)
        self._check(model)

    def _check(self, model):
        owner = self._owners(model)[0]
        numbers = {name: np.atleast_1d(getattr(owner, name)) for name in dir(owner) if name[0] != "_"}
        among(self.what, [name for name, held in numbers.items() if held.dtype == float], self.where, "number")
        if self.what == "timestep":
            raise UserError(f"{self.where}: is no parameter; every diagnosis tests shorter time steps")
        size = numbers[self.what].size
        if max(self.at) >= size:
            raise UserError(f"{self.where}: {self.what} has {size} numbers; the last is {self.what}/{size - 1}")
        if np.ptp(self._values(model)) > 0:
            raise UserError(f"{self.where}: refers to different numbers, {self._values(model)}; make a [[parameter]] of each")

    def _owners(self, model):
        return [getattr(model, self.kind)(name) for name in self.names] or [model.opt]

    def _values(self, model):
        return [float(np.ravel(getattr(owner, self.what))[i]) for owner in self._owners(model) for i in self.at]

    def value(self, model):
        return self._values(model)[0]

    def write(self, model, value):
        for owner in self._owners(model):
            held = getattr(owner, self.what)
            if (self.kind, self.what) == ("body", "mass"):  # a payload has inertia, too
                owner.inertia[:] *= value / held[0]
            if isinstance(held, float):
                setattr(owner, self.what, value)
            else:
                held.reshape(-1)[self.at] = value


# ---- steps ---------------------------------------------------------------------------------------------------


class Mujoco:
    """state, ctrl, sensed: which of the robot's states and commands stand where in those of the model."""

    def __init__(self, model, state, ctrl, sensed, addresses, fields, threads=None):
        self.package, self.model = package("mujoco", "simulators"), model
        self.state, self.ctrl, self.sensed, self.addresses = state, ctrl, sensed, addresses
        self.fields, self.own_step, self.models = fields, model.opt.timestep, {}
        self.velocities, self.moved = state[model.nq : model.nq + model.nv], state[: model.nq]
        model.opt.disableflags |= self.package.mjtDisableBit.mjDSBL_AUTORESET  # what blows up shall be seen to
        self.data = [self.package.MjData(model) for _ in range(threads or os.cpu_count() or 1)]
        self.pool = None

    def value(self, field):
        return next(f for f in self.fields if f.text == field).value(self.model)

    def finer(self, times):
        """The same with steps of time so much shorter."""
        other = copy.copy(self)
        other.own_step = self.own_step / times
        return other

    def _with(self, params):
        """The model with these parameters."""
        if params not in self.models:
            model = copy.copy(self.model)
            for field, value in zip(self.fields, params):
                if value != field.value(model):
                    field.write(model, value)
            self.package.mj_setConst(model, self.data[0])
            if len(self.models) >= MODELS:
                self.models.clear()
            self.models[params] = model
        return self.models[params]

    def step(self, x, u, dt, params, push=None):
        """push (B, n): rates of states besides. Those of velocities are forces, as large as they must be where the model is at rest."""
        model, steps, count = self._with(tuple(map(float, params))), max(1, round(dt / self.own_step)), len(self.state)
        model.opt.timestep = dt / steps
        start = np.zeros((len(x), 1 + count))  # time, then the state
        start[:, 1:] = x[:, self.state]
        last = steps + bool(self.sensed)  # sensors are read as a step begins
        inputs = u[:, self.ctrl] if push is None else np.hstack([u[:, self.ctrl], push[:, self.velocities] / model.dof_invweight0])
        states, readings = self._rollout(model, start, np.repeat(inputs[:, None], last, axis=1), last)
        after = np.empty_like(x)
        after[:, self.state] = states[:, steps - 1, 1:]
        after[:, self.sensed] = readings[:, -1, self.addresses]
        if push is not None:
            after += dt * np.where(np.isin(np.arange(x.shape[1]), self.velocities), 0.0, push)
        return after

    def _threads(self):
        """As many as there is data for; they are kept, since to start them takes longer than a step."""
        if self.pool is None or self.pool[0] != len(self.data):
            self.pool = len(self.data), package("mujoco.rollout", "simulators").Rollout(nthread=len(self.data))
        return self.pool[1]

    def _rollout(self, model, start, control, steps):
        before, given = self.package.get_mju_user_warning(), self.package.mjtState
        kinds = given.mjSTATE_CTRL if control.shape[2] == model.nu else given.mjSTATE_CTRL | given.mjSTATE_QFRC_APPLIED
        self.package.set_mju_user_warning(lambda text: None)  # else it writes a file, for each step that blows up
        try:
            return self._threads().rollout(model, self.data, start, control, control_spec=kinds, nstep=steps)
        finally:
            self.package.set_mju_user_warning(before)


# ---- from a robot's file ---------------------------------------------------------------------------------------


def _order(table, key, wanted, names):
    """Indices of the robot's signals that [simulator] KEY names, one for each of what the model has."""
    where, given = f"[simulator] {key}", table.get(key, [])
    if not isinstance(given, list) or len(given) != len(wanted):
        raise UserError(f"{where}: the model has {len(wanted)} ({', '.join(wanted)}); name a signal of the robot for each")
    for name in given:
        among(name, names, where, "signal")
    return [names.index(name) for name in given]


def _load(mujoco, path):
    if not path.is_file():
        raise UserError(f"[simulator] mujoco: there is no file {path}; the place is relative to the robot's file")
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise UserError(f"{path}: {' '.join(str(error).split())[:200]}") from error
    turning = [model.joint(i).name or "unnamed" for i in range(model.njnt) if model.joint(i).qpos0.size > 1]
    if turning:
        raise UserError(f"{path}: joint {turning[0]} is free or a ball; replace it by three slides and three hinges")
    if mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS) != 1 + model.nq + model.nv + model.na:
        raise UserError(f"{path}: has delays, plugins or plasticity, whose states no log has; remove them")
    return model


def _address(model, place):
    """Where SENSOR or SENSOR/INDEX stands in the sensor data."""
    where, (name, _, at) = f"[simulator] sensordata {place}", place.partition("/")
    among(name, _named(model, "sensor"), where, "sensor")
    sensor = model.sensor(name)
    if not (at or "0").isdecimal() or int(at or 0) >= sensor.dim[0]:
        raise UserError(f"{where}: {name} has {sensor.dim[0]} numbers; the last is {name}/{sensor.dim[0] - 1}")
    return int(sensor.adr[0]) + int(at or 0)


def make(table, folder, names):
    states, commands, fields = names
    model = _load(package("mujoco", "simulators"), folder / table["mujoco"])
    joints = _named(model, "joint")
    state = [*_order(table, "qpos", joints, states), *_order(table, "qvel", joints, states)]
    state += _order(table, "act", [a.name for a in map(model.actuator, range(model.nu)) for _ in range(a.actnum[0])], states)
    places = table.get("sensordata", {})
    if not isinstance(places, dict) or not all(isinstance(place, str) for place in places.values()):
        raise UserError('[simulator] sensordata: write {STATE = "SENSOR"}, or "SENSOR/INDEX" where it has several numbers')
    for name in places:
        among(name, states, "[simulator] sensordata", "state")
    sensed, addresses = [states.index(name) for name in places], [_address(model, place) for place in places.values()]
    if sorted([*state, *sensed]) != list(range(len(states))):
        raise UserError(f"[simulator] qpos, qvel, act and sensordata must name every state once; the states are {', '.join(states)}")
    ctrl = _order(table, "ctrl", _named(model, "actuator"), commands)
    return Mujoco(model, state, ctrl, sensed, addresses, [Field(model, field) for field in fields])
