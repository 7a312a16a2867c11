"""Flights of the simulated vehicles, as logs for everyone."""

from .. import bridge
from ..plumbing.errors import UserError
from ..plumbing.results import console, output_folder


def _number(text, what):
    try:
        return float(text)
    except ValueError:
        raise UserError(f"{what}: '{text}' is not a number")


def effect(text, table, option="--effect"):
    """The effect of the table that NAME=v,v[@t0,t1] stands for; NAME alone has its usual parameters. option: which one was given."""
    what, _, when = text.partition("@")
    name, given, values = what.partition("=")
    if name not in table:
        raise UserError(f"{option} {text}: there is no effect '{name}'; there are {', '.join(table)}")
    times = [_number(t, f"{option} {text}") for t in when.split(",")] if when else [0.0, float("inf")]
    if len(times) != 2 or not times[0] < times[1]:
        raise UserError(f"{option} {text}: after @ come the times from and to, in seconds, as in {name}@5,10")
    rows = table[name][1]
    if not given:
        return bridge.Effect(name, tuple(row[4] for row in rows), *times)
    parameters = tuple(_number(v, f"{option} {text}") for v in values.split(","))
    if len(parameters) != len(rows):
        needed = ", ".join(f"{row[0]} ({row[1]})" for row in rows)
        raise UserError(f"{option} {text}: {name} takes {needed}, and {len(parameters)} numbers are given")
    return bridge.Effect(name, parameters, *times)


def _flapping_wing(manoeuvre, seconds, seed, effects, _):
    active = [effect(text, bridge.effects("fwmav")) for text in effects]
    u = "wing twist" if manoeuvre == "yaw" else "dihedral"
    return bridge.fwmav(manoeuvre, seconds, seed, active)[0], f"u is the {u} commanded (rad)"


def _quadrotor(manoeuvre, seconds, seed, effects, vehicle):
    active = [effect(text, bridge.quadrotor_effects(vehicle)) for text in effects]
    told = f"{bridge.hover_request(vehicle):.2f} of full thrust in hover"
    return bridge.quadrotor(manoeuvre, seconds, seed, active, vehicle=vehicle)[0], told


FLIERS = {"fwmav": _flapping_wing, "quadrotor": _quadrotor}
MANOEUVRES = {"fwmav": ("hover", "pitch", "yaw"), "quadrotor": ("hover", "legs", "mixed")}


def run(manoeuvre, seconds, seed, effects, path, platform="fwmav", vehicle=None):
    """Flies and writes the log; says what it is. vehicle: of a quadrotor, as bridge.quadrotor_vehicle() takes it."""
    if vehicle and platform != "quadrotor":
        raise UserError("--vehicle: only for quadrotors; add --platform quadrotor")
    log, told = FLIERS[platform](manoeuvre, seconds, seed, effects, vehicle or "crazyflie")
    output_folder(path.parent)
    bridge.write_log(path, log.x, log.u, log.dt, platform)
    console.print(f"{path}: {manoeuvre}, seed {seed}, {len(log.t)} rows at {1 / log.dt:.0f} Hz, {told}")
