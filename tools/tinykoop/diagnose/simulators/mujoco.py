"""A MuJoCo model (MJCF): hinges and slides, many rows at once by its threaded rollout.

Todorov, Erez and Tassa, "MuJoCo: A physics engine for model-based control", IROS 2012.
"""

import os

import numpy as np

from ...errors import UserError

KEYS = ("qpos", "qvel", "ctrl")


def _package():
    try:
        import mujoco
        import mujoco.rollout
    except ImportError:
        raise UserError("[simulator] mujoco: the package is missing; build/venv/bin/pip install -r tools/requirements-simulators.txt") from None
    mujoco.set_mju_user_warning(lambda text: None)  # a run that blows up is told by its states
    return mujoco


class Mujoco:
    def __init__(self, model, place, order, ctrl):
        self.package, self.model, self.place, self.order, self.ctrl = _package(), model, place, order, ctrl
        self.data = [self.package.MjData(model) for _ in range(os.cpu_count() or 1)]
        self.own_step, self.row, self.fields = model.opt.timestep, 0.0, []

    # ---- parameters ------------------------------------------------------------------------------------------

    def _element(self, field):
        """(array of the model, index) of a field such as body/hand/mass."""
        kind, name, what = (*field.split("/"), "", "")[:3]
        try:
            if kind == "option":
                return getattr(self.model.opt, name), 0
            element = getattr(self.model, kind)(name)
            return getattr(element, what), 0
        except (AttributeError, KeyError, TypeError) as error:
            raise UserError(f"[[parameter]] field {field}: {self.place} has no such thing; write body/NAME/mass, joint/NAME/damping, ..") from error

    def value(self, field):
        array, at = self._element(field)
        return float(np.ravel(array)[at])

    def _set(self, params):
        for field, value in zip(self.fields, params):
            array, at = self._element(field)
            before = float(np.ravel(array)[at])
            if before == value:
                continue
            array[at] = value
            kind, name, what = field.split("/")
            if (kind, what) == ("body", "mass") and before > 0:  # a payload scales inertia with mass
                self.model.body(name).inertia[:] *= value / before
            self.package.mj_setConst(self.model, self.data[0])

    # ---- steps -------------------------------------------------------------------------------------------------

    def step(self, x, u, dt, params):
        self._set(params)
        self.row = max(self.row, dt)
        steps = max(1, round(self.row / self.own_step))
        self.model.opt.timestep = dt / steps
        start = np.zeros((len(x), self.package.mj_stateSize(self.model, self.package.mjtState.mjSTATE_FULLPHYSICS)))
        start[:, 1 : 1 + x.shape[1]] = x[:, self.order]
        control = np.repeat(u[:, None, self.ctrl], steps, axis=1)
        states, _ = self.package.rollout.rollout(self.model, self.data, start, control, nstep=steps, persistent_pool=True)
        after = np.empty_like(x)
        after[:, self.order] = states[:, -1, 1 : 1 + x.shape[1]]
        return after


def _order(table, key, count, names, model):
    """Indices of the robot's signals in the order of the model."""
    wanted = table.get(key, [])
    if len(wanted) != count:
        raise UserError(f"[simulator] {key}: {model} has {count}; name a signal of the robot for each")
    unknown = [name for name in wanted if name not in names]
    if unknown:
        raise UserError(f"[simulator] {key}: the robot has no {unknown[0]}; there are {', '.join(names)}")
    return [names.index(name) for name in wanted]


def make(table, folder, names):
    package, place = _package(), table["mujoco"]
    states, commands, fields = names
    try:
        model = package.MjModel.from_xml_path(str(folder / place))
    except ValueError as error:
        raise UserError(f"{place}: {' '.join(str(error).split())[:200]}") from error
    if model.nq != model.nv:
        raise UserError(f"{place}: has free or ball joints; describe the robot by slides and hinges")
    order = [*_order(table, "qpos", model.nq, states, place), *_order(table, "qvel", model.nv, states, place)]
    if sorted(order) != list(range(len(states))):
        raise UserError(f"[simulator] qpos and qvel must name every state once; the states are {', '.join(states)}")
    made = Mujoco(model, place, order, _order(table, "ctrl", model.nu, commands, place))
    for field in fields:
        made.value(field)
    made.fields = fields
    return made
