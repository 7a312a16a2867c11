"""Flights of the simulated flapping-wing vehicle, as logs for everyone."""

from .. import bridge
from ..plumbing.errors import UserError
from ..plumbing.results import console, output_folder


def _number(text, what):
    try:
        return float(text)
    except ValueError:
        raise UserError(f"{what}: '{text}' is not a number")


def effect(text, platform="fwmav", option="--effect"):
    """The effect that NAME=v,v[@t0,t1] stands for; NAME alone has its usual parameters. option: which one was given."""
    what, _, when = text.partition("@")
    name, given, values = what.partition("=")
    table = bridge.effects(platform)
    if name not in table:
        raise UserError(f"{option} {text}: there is no effect '{name}'; there are {', '.join(table)}")
    times = [_number(t, f"{option} {text}") for t in when.split(",")] if when else [0.0, float("inf")]
    if len(times) != 2 or not times[0] < times[1]:
        raise UserError(f"{option} {text}: after @ come the times from and to, in seconds, as in {name}@5,10")
    if not given:
        return bridge.usual_effect(name, *times, platform=platform)
    parameters = tuple(_number(v, f"{option} {text}") for v in values.split(","))
    rows = table[name][1]
    if len(parameters) != len(rows):
        needed = ", ".join(f"{row[0]} ({row[1]})" for row in rows)
        raise UserError(f"{option} {text}: {name} takes {needed}, and {len(parameters)} numbers are given")
    return bridge.Effect(name, parameters, *times)


def run(manoeuvre, seconds, seed, effects, path):
    """Flies and writes the log; says what it is."""
    active = [effect(text) for text in effects]
    log, _ = bridge.fwmav(manoeuvre, seconds, seed, active)
    output_folder(path.parent)
    bridge.write_log(path, log.x, log.u, log.dt, "fwmav")
    u = "wing twist" if manoeuvre == "yaw" else "dihedral"
    console.print(f"{path}: {manoeuvre}, seed {seed}, {len(log.t)} rows at {1 / log.dt:.0f} Hz, u is the {u} commanded (rad)")
