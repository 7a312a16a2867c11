"""The quadrotor of host_sim/."""

import ctypes as ct
import tomllib
from functools import cache
from pathlib import Path

import numpy as np

from ..plumbing.errors import UserError
from .flapping_wing import Flight, flight_rows
from .library import DOUBLES, INTS, call, doubles, ints, raw, reals
from .logs import Log
from .unmodelled import active_effects, effects

# The true state of the quadrotor, one slice of its columns each.
QUADROTOR_STATE = {
    "position": slice(0, 3),  # m, world
    "velocity": slice(3, 6),  # m/s, world
    "attitude": slice(6, 10),  # quaternion w, x, y, z, body to world
    "spin": slice(10, 13),  # rad/s, body
    "rotors": slice(13, 17),  # share of full thrust
    "swing": slice(17, 19),  # horizontal part of the unit vector along the string of a slung load, world
    "swinging": slice(19, 21),  # its rate
}
QUADROTOR_SENSED, QUADROTOR_CORRECTED = 15, 22
_STATES, _COMMANDS, _HZ = 21, 5, 100
_FOLDER = Path(__file__).resolve().parents[1] / "vehicles"


@cache
def quadrotor_parameters():
    """{name: (unit, low, high, value of a Crazyflie 2.1)} of the parameters of a vehicle."""
    table = {}
    while True:
        name, unit = ct.c_char_p(), ct.c_char_p()
        numbers = [ct.c_double() for _ in range(3)]
        if raw("tk_quadrotor_parameter", ct.c_size_t(len(table)), ct.byref(name), ct.byref(unit), *map(ct.byref, numbers)):
            return table
        table[name.value.decode()] = (unit.value.decode(), *(n.value for n in numbers))


def vehicle_names():
    """Vehicles that come with TinyKoop."""
    return ("crazyflie", *sorted(path.stem for path in _FOLDER.glob("*.toml")))


def quadrotor_vehicle(vehicle="crazyflie"):
    """{parameter: value} of a vehicle: one of vehicle_names(), a TOML file with all parameters, or such a dictionary."""
    rows = quadrotor_parameters()
    if isinstance(vehicle, dict):
        return _checked(vehicle, "vehicle")
    if str(vehicle) == "crazyflie":
        return {name: row[3] for name, row in rows.items()}
    path = _FOLDER / f"{vehicle}.toml" if vehicle in vehicle_names() else Path(vehicle)
    if path.suffix != ".toml":
        raise UserError(f"there is no vehicle '{vehicle}': use {', '.join(vehicle_names())} or a TOML file of your own")
    try:
        given = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path")
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: not TOML ({error}); correct it there")
    return _checked(given, path)


def _checked(given, where):
    rows = quadrotor_parameters()
    for name in [*given, *rows]:
        if name not in rows:
            raise UserError(f"{where}: there is no parameter '{name}'; there are {', '.join(rows)}")
        if name not in given:
            raise UserError(f"{where}: '{name}' ({rows[name][0]}) is missing; a vehicle needs {', '.join(rows)}")
        if isinstance(given[name], bool) or not isinstance(given[name], (int, float)):
            raise UserError(f"{where}: '{name}' is {given[name]!r}, it must be a number ({rows[name][0]})")
    return {name: float(given[name]) for name in rows}


def parameters_of(vehicle):
    """A vehicle as C takes it."""
    return reals(list(quadrotor_vehicle(vehicle).values()))


def quadrotor_effects(vehicle="crazyflie"):
    """As effects("quadrotor"), with bounds and usual sizes for this vehicle."""
    chosen, by = parameters_of(vehicle), ct.c_double()

    def scaled(parameter, unit, *sizes):
        call("tk_quadrotor_scale", doubles(chosen), unit.encode(), ct.byref(by))
        return parameter, unit, *(size * by.value for size in sizes)

    return {name: (block, tuple(scaled(*row) for row in rows)) for name, (block, rows) in effects("quadrotor").items()}


def quadrotor(manoeuvre, seconds, seed, active=(), noise=1.0, vehicle="crazyflie"):
    """Simulates a flight of a quadrotor at 100 Hz: hover, legs (there and back, on the ground between) or mixed (steps).

    seed: of the noise. active: the effects that act. noise: factor of turbulence, noise, and what flights differ by. Returns
    the Log, its x and u in the order of platforms.COLUMNS, and the true states (K, 21); QUADROTOR_STATE names them.
    """
    rows = flight_rows(seconds, seed, _HZ)
    x, u, states = np.empty((rows, QUADROTOR_SENSED)), np.empty((rows, _COMMANDS)), np.empty((rows, _STATES))
    call(
        "tk_quadrotor_fly", active_effects(active), ct.c_size_t(len(active)), doubles(parameters_of(vehicle)),
        ct.byref(Flight(manoeuvre.encode(), seed, noise)), ct.c_size_t(rows), doubles(x), doubles(u), doubles(states),
    )  # fmt: skip
    dt = 1 / _HZ
    return Log(np.arange(rows) * dt, x, u, np.ones(rows - 1, bool), dt), states


def hover_request(vehicle="crazyflie"):
    """Share of full thrust at which the rotors carry the vehicle at its voltage."""
    v = quadrotor_vehicle(vehicle)
    return v["mass"] * 9.81 / (4 * v["thrust_full"])


def quadrotor_hover(vehicle="crazyflie"):
    """The true state (21) of a quadrotor that hovers, level and at rest, 1 m above the origin."""
    state = np.zeros(_STATES)
    state[2] = state[6] = 1
    state[QUADROTOR_STATE["rotors"]] = hover_request(vehicle)
    return state


def quadrotor_roll(state, commands, dt, active=(), vehicle="crazyflie"):
    """True states (K+1, 21) of the vehicle without its controller, in still air and far from the ground, from `state`.

    commands (K, 5): four requests (0 to 1) and the battery's voltage (V, NaN: the vehicle's); each held for dt.
    """
    state, commands = reals(state), reals(commands, _COMMANDS)
    if state.shape != (_STATES,):
        raise ValueError(f"expected a state of {_STATES}, got shape {state.shape}")
    states = np.empty((len(commands) + 1, _STATES))
    call(
        "tk_quadrotor_roll", active_effects(active), ct.c_size_t(len(active)), doubles(parameters_of(vehicle)),
        ct.c_double(dt), ct.c_size_t(len(commands)), doubles(state), doubles(commands), doubles(states),
    )  # fmt: skip
    return states


class _Flown(ct.Structure):
    _fields_ = [
        ("rows", ct.c_size_t),
        ("dt", ct.c_double),
        ("x", DOUBLES),
        ("u", DOUBLES),
        ("usable", INTS),
        ("vehicle", DOUBLES),
        ("gain", DOUBLES),
        ("push", DOUBLES),
    ]


_LONGS = ct.POINTER(ct.c_int64)


class _Ahead(ct.Structure):
    _fields_ = [("n_starts", ct.c_size_t), ("n_steps", ct.c_size_t), ("starts", _LONGS), ("steps", _LONGS), ("predicted", DOUBLES)]


def quadrotor_follow(log, gain, active=(), vehicle="crazyflie", starts=(), steps=(), push=None, states=False):
    """An observer of a quadrotor along a log, far from the ground: predicted (K, 15), ahead (S, H, 15) or None.

    Predicted are the columns of log.x in the next row, those that the log lacks (NaN), too; gain (22, 15) takes what was missed
    to corrections of position, velocity (both in axes that turn with the heading), tilt, angular velocity, rotors and the
    accelerations by the air. ahead: predictions `steps` rows after `starts` (both rising) without correction. push (K, 6): further
    accelerations (m/s^2, rad/s^2, body axes). states: also returns the true states (K, 21) as estimated. NaN where there is
    nothing to predict from.
    """
    x, u, gain = reals(log.x, QUADROTOR_SENSED), reals(log.u, _COMMANDS), reals(gain, QUADROTOR_SENSED)
    if gain.shape[0] != QUADROTOR_CORRECTED:
        raise ValueError(f"expected a gain of {QUADROTOR_CORRECTED} rows, got shape {gain.shape}")
    push = None if push is None else reals(push, 6)
    usable, chosen = np.ascontiguousarray(log.usable, np.int32), parameters_of(vehicle)
    starts, steps = np.ascontiguousarray(starts, np.int64), np.ascontiguousarray(steps, np.int64)
    predicted = np.empty((len(x), QUADROTOR_SENSED))
    estimated = np.empty((len(x), _STATES)) if states else None
    ahead = np.empty((len(starts), len(steps), QUADROTOR_SENSED)) if len(starts) else None
    flown = _Flown(len(x), log.dt, doubles(x), doubles(u), ints(usable), doubles(chosen), doubles(gain), doubles(push))
    address = lambda a: a.ctypes.data_as(_LONGS)  # noqa: E731
    on = ahead is not None and _Ahead(len(starts), len(steps), address(starts), address(steps), doubles(ahead))
    call(
        "tk_quadrotor_follow", active_effects(active), ct.c_size_t(len(active)), ct.byref(flown), doubles(predicted),
        doubles(estimated), ct.byref(on) if on else None,
    )  # fmt: skip
    return (predicted, ahead, estimated) if states else (predicted, ahead)
