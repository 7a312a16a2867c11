"""An FMU for co-simulation, FMI 2.0 or 3.0, by fmpy: each row is set, stepped and read.

Blochwitz et al., "Functional Mockup Interface 2.0", Modelica Conference 2012; Junghanns et al., "The Functional Mock-up Interface
3.0", Modelica Conference 2021.
"""

import ctypes
import shutil
import tempfile
import weakref
import zipfile
from contextlib import chdir
from math import nan

import numpy as np

from ...plumbing.asked import among, package
from ...plumbing.errors import UserError
from ..robot import RunsAway

KEYS = ("states", "inputs", "starts")
WARNING, DISCARD = 1, 2  # statuses of a call: above a warning it has failed
CALLS = "loading a snapshot", "setting states and inputs", "doStep", "reading states"
SAME = 1e-9  # relative difference, up to which two ways to start are one
ADDRESS, COUNT, REAL, FLAG = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_double, ctypes.c_bool


# ---- the calls of both versions, by addresses: fmpy's own take longer than a short step ------------------------------------


def _function(slave, name, *kinds):
    return ctypes.CFUNCTYPE(ctypes.c_int, *kinds)((name, slave.dll))


def _calls2(slave):
    """(load(snapshot), put(references, count, values), advance(dt), get(references, count, values)) of FMI 2.0, with statuses."""
    c = slave.component
    put, get = (_function(slave, f"fmi2{what}Real", ADDRESS, ADDRESS, COUNT, ADDRESS) for what in ("Set", "Get"))
    step = _function(slave, "fmi2DoStep", ADDRESS, REAL, REAL, ctypes.c_int)
    load = _function(slave, "fmi2SetFMUstate", ADDRESS, ADDRESS)
    return (
        lambda snapshot: load(c, snapshot),
        lambda references, count, values: put(c, references, count, values),
        lambda dt: step(c, 0.0, dt, 0),
        lambda references, count, values: get(c, references, count, values),
    )


def _calls3(slave):
    """The same of FMI 3.0; an FMU that asks for the end of the simulation has failed."""
    c, event, ends, early, last = slave.component, FLAG(), FLAG(), FLAG(), REAL()
    put, get = (_function(slave, f"fmi3{what}Float64", ADDRESS, ADDRESS, COUNT, ADDRESS, COUNT) for what in ("Set", "Get"))
    step = _function(slave, "fmi3DoStep", ADDRESS, REAL, REAL, FLAG, *[ctypes.POINTER(FLAG)] * 3, ctypes.POINTER(REAL))
    load = _function(slave, "fmi3SetFMUState", ADDRESS, ADDRESS)
    return (
        lambda snapshot: load(c, snapshot),
        lambda references, count, values: put(c, references, count, values, count),
        lambda dt: step(c, 0.0, dt, False, event, ends, early, last) or (DISCARD if ends else 0),
        lambda references, count, values: get(c, references, count, values, count),
    )


# ---- rows ------------------------------------------------------------------------------------------------------------------


class Fmu:
    """An instance that is put to time 0 for each row: from a snapshot, with the row set behind it, where that does what a fresh
    start with the row as start values does; else by a fresh start."""

    def __init__(self, place):
        self.place, self.said = place, []
        self.run = self.snapshot = self.held = None

    def open(self, fmpy, description, path, folder):
        """Unpacks the FMU into a folder and instantiates it."""
        said = self.said
        try:
            fmpy.extract(path, folder)
            with chdir("."):  # fmpy stays in another folder where a library does not load
                self.slave = fmpy.instantiate_fmu(folder, description, "CoSimulation", logger=lambda *words: said.append(words[-1]))
        except Exception as error:
            raise UserError(f"{self.place}: cannot be loaded: {_line(error)}") from error
        weakref.finalize(self, self.slave.freeInstance)
        self.load, self.put, self.advance, self.get = (_calls2 if description.fmiMajorVersion == 2 else _calls3)(self.slave)
        self.can_load, self.refused = description.coSimulation.canGetAndSetFMUstate, fmpy.fmi1.FMICallException

    def use(self, states, starts, inputs, parameters):
        """Variables of the FMU in the robot's order; `starts` set what `states` show."""
        self.names, self.values = [v.name for v in states], {v.name: float(v.start or nan) for v in parameters}
        self.shown, self.given = _references(states), _references([*states, *inputs])
        self.parameters = _references(parameters), np.arange(len(parameters))
        first, when = _references([*starts, *inputs]), np.array([_when(v) for v in (*starts, *inputs)])
        group = lambda *kinds: (first[np.isin(when, kinds)], np.flatnonzero(np.isin(when, kinds)))  # noqa: E731
        self.before, self.during, self.behind = group("exact", "approx"), group("exact", "input"), group("calculated")

    def value(self, field):
        """Of a parameter, as the FMU has it."""
        return self.values[field]

    # ---- one start -----------------------------------------------------------------------------------------------

    def _check(self, status, call):
        if status > WARNING:
            raise self.refused(call, status)

    def _told(self, error):
        """What failed, and what the FMU said of it."""
        return ": ".join([self.place, _line(error), *map(_line, self.said[-1:])])

    def _set(self, group, row):
        references, at = group
        values = np.ascontiguousarray(row[at], float)
        self._check(self.put(references.ctypes.data, len(values), values.ctypes.data) if len(values) else 0, CALLS[1])

    def _start(self, params, row=None):
        """At time 0, with the states and commands of a row (n + m,) or with the FMU's own."""
        slave, given = self.slave, (lambda group: None) if row is None else (lambda group: self._set(group, row))
        slave.reset()
        if hasattr(slave, "setupExperiment"):  # of FMI 2.0 alone
            slave.setupExperiment()
        self._set(self.parameters, params)
        given(self.before)
        slave.enterInitializationMode()
        given(self.during)
        slave.exitInitializationMode()
        given(self.behind)

    def _read(self):
        out = np.empty(len(self.shown))
        self._check(self.get(self.shown.ctypes.data, len(out), out.ctypes.data), CALLS[3])
        return out

    def _takes(self, row, params):
        """Refuses where a state does not take its start from a row."""
        remedy = 'name the parameter that it starts from: [simulator] starts = {STATE = "PARAMETER"}'
        asked = row[: len(self.names)]
        try:
            self._start(params, row)
            seen = self._read()
        except self.refused as error:
            late = [self.names[i] for i in self.behind[1]] or self.names
            raise UserError(f"{self._told(error)}; {', '.join(late)} cannot be set; {remedy}") from error
        off = np.abs(seen - asked) > SAME * np.maximum(np.abs(asked), 1.0)
        if off.any():
            i = int(np.argmax(off))
            raise UserError(f"{self.place}: {self.names[i]} is {seen[i]:g} after it was set to {asked[i]:g}; {remedy}")

    def _choose(self, given, dt, params):
        """The way to run rows, by a try of both on two of them."""
        rows = given[[len(given) // 2, -1]]
        for row in rows:
            self._takes(row, params)
        if self.can_load:
            try:
                if np.allclose(self._quick(rows, dt, params), self._fresh(rows, dt, params), SAME, SAME**2):
                    return self._quick
            except self.refused:
                self.held = None
        return self._fresh

    # ---- many rows -----------------------------------------------------------------------------------------------

    def _fresh(self, given, dt, params):
        """States (B, n) `dt` behind the states and commands of rows (B, n + m)."""
        after = np.empty((len(given), len(self.shown)))
        for k, row in enumerate(given):
            self._start(params, row)
            self._check(self.advance(dt), CALLS[2])
            after[k] = self._read()
        return after

    def _quick(self, given, dt, params):
        """The same from a snapshot."""
        self._hold(params)
        after, snapshot = np.empty((len(given), len(self.shown))), self.snapshot
        (into, width), (shown, count) = ((references.ctypes.data, len(references)) for references in (self.given, self.shown))
        at, to, load, put, advance, get = given.ctypes.data, after.ctypes.data, self.load, self.put, self.advance, self.get
        for _ in range(len(given)):
            statuses = load(snapshot), put(into, width, at), advance(dt), get(shown, count, to)
            if max(statuses) > WARNING:
                raise self.refused(CALLS[np.argmax(statuses)], max(statuses))
            at, to = at + 8 * width, to + 8 * count
        return after

    def _hold(self, params):
        """A snapshot of an instance that has these parameters."""
        if self.held is None or not np.array_equal(self.held, params):
            self._start(params)
            if self.snapshot is not None:
                self.slave.freeFMUState(self.snapshot)
            self.snapshot, self.held = self.slave.getFMUState(), np.array(params)

    def step(self, x, u, dt, params):
        given, after = np.hstack([x, u]), np.full(x.shape, nan)
        rows = np.isfinite(given).all(1)  # a solver may not come back from others
        if not rows.any():
            return after
        self.said.clear()
        try:
            self.run = self.run or self._choose(given[rows], dt, params)
            after[rows] = self.run(given[rows], dt, params)
        except self.refused as error:
            self.held = None
            raise RunsAway(f"{self._told(error)}, in a step of {dt:.6g} s") from error
        return after


# ---- the file --------------------------------------------------------------------------------------------------------------


def _line(text):
    return " ".join((text.decode(errors="replace") if isinstance(text, bytes) else str(text)).split())[:200].rstrip(".")


def _references(variables):
    return np.array([v.valueReference for v in variables], np.uint32)


def _when(variable):
    """exact, approx, input or calculated: when a variable takes a value. What is calculated may take one after its start."""
    if variable.causality == "input":
        return "input"
    return variable.initial if variable.variability != "constant" and variable.initial in ("exact", "approx") else "calculated"


def _described(fmpy, path, place):
    """The description of an FMU that can be run here."""
    try:
        description = fmpy.read_model_description(str(path), validate=False)
        with zipfile.ZipFile(path) as archive:
            files = archive.namelist()
    except Exception as error:
        raise UserError(f"{place}: cannot be read as an FMU: {_line(error)}; its path begins at the robot's file") from error
    if description.fmiVersion == "1.0":
        raise UserError(f"{place}: is of FMI 1.0; export it as FMI 2.0 or 3.0")
    if description.coSimulation is None:
        raise UserError(f"{place}: does not support co-simulation (no CoSimulation in modelDescription.xml); export it for co-simulation")
    system = fmpy.platform if description.fmiMajorVersion == 2 else fmpy.platform_tuple
    library = f"binaries/{system}/{description.coSimulation.modelIdentifier}{fmpy.sharedLibraryExtension}"
    if library not in files:
        have = sorted({file.split("/")[1] for file in files if file.startswith("binaries/") and file.count("/") > 1})
        raise UserError(f"{place}: has no {library}; it is built for {', '.join(have) or 'no system'}; export it for {system}")
    return description


class _Names:
    """Variables of an FMU by the names of a robot's signals."""

    def __init__(self, place, description):
        self.place = place
        self.variables = {v.name: v for v in description.modelVariables}

    def variable(self, name, what):
        """The variable of a name, which is one real number."""
        among(name, self.variables, f"{self.place}: for {what}", "variable")
        found = self.variables[name]
        if found.type not in ("Real", "Float64") or found.dimensions:
            raise UserError(f"{self.place}: {name} cannot be {what}: it is {'an array' if found.dimensions else found.type}, not one Real")
        return found

    def mapped(self, table, key, signals, defaults):
        """Variables of all signals: as [simulator] `key` maps them, else of their default names."""
        given = table.get(key, {})
        if not isinstance(given, dict) or not all(isinstance(name, str) for name in given.values()):
            raise UserError(f'[simulator] {key}: write {key} = {{{signals[0]} = "VARIABLE"}}')
        unknown = [signal for signal in given if signal not in signals]
        if unknown:
            raise UserError(f"[simulator] {key}: the robot has no {unknown[0]}; there are {', '.join(signals)}")
        return [self.variable(given.get(s, default), f"{s} ([simulator] {key})") for s, default in zip(signals, defaults)]


def _unset(description, states):
    """Names of the FMU's states that none of `states` is."""
    have = {v.valueReference for v in states}
    derivatives = [unknown.variable.derivative for unknown in description.derivatives]
    return [v.name for v in derivatives if v is not None and v.valueReference not in have]


def _allow(place, variables, kinds, what):
    for variable in variables:
        if _when(variable) not in kinds:
            raise UserError(f"{place}: {variable.name} cannot be {what}: it is {variable.causality}, {variable.variability}")


def make(table, folder, names):
    fmpy, place = package("fmpy", "simulators"), table["fmu"]
    states, commands, fields = names
    description = _described(fmpy, folder / place, place)
    of = _Names(place, description)
    shown = of.mapped(table, "states", states, states)
    starts = of.mapped(table, "starts", states, [v.name for v in shown])
    inputs = of.mapped(table, "inputs", commands, commands)
    parameters = [of.variable(field, "a [[parameter]]") for field in fields]
    _allow(place, inputs, ("input",), "an input")
    _allow(place, parameters, ("exact", "approx"), "set")
    if unset := _unset(description, shown):
        raise UserError(f"{place}: has the state {unset[0]}, which the robot lacks; add it to [simulator] hidden and states")
    made, unpacked = Fmu(place), tempfile.mkdtemp(prefix="tinykoop_fmu_")
    weakref.finalize(made, shutil.rmtree, unpacked, ignore_errors=True)
    made.open(fmpy, description, folder / place, unpacked)
    made.use(shown, starts, inputs, parameters)
    return made
