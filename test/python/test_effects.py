"""The unmodelled effects and the windows that a diagnoser fits with, against plain NumPy and Python loops.

The second writing here is vectorised over the log where the C code steps, and steps where the C
code takes all windows from one path. Run as a script it prints what a call of windows() costs.
"""

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.plumbing.errors import UserError

# contract, sections 5 and 6; the seed and the parameters at the rim are additions
CONTRACT = {
    "speed_gain": {"a": "1"},
    "yaw_gain": {"b": "1"},
    "wheel_asymmetry": {"c": "rad/m"},
    "yaw_bias": {"d": "rad/s"},
    "actuator_lag": {"tau": "s"},
    "speed_lag": {"tau": "s"},
    "yaw_lag": {"tau": "s"},
    "transport_delay": {"delay": "s"},
    "acceleration_limit": {"a": "m/s2", "alpha": "rad/s2"},
    "dead_band": {"v_db": "m/s", "w_db": "rad/s"},
    "wheel_dead_band": {"v_db": "m/s", "track": "m"},
    "saturation": {"v_max": "m/s", "w_max": "rad/s"},
    "wheel_saturation": {"v_max": "m/s", "track": "m"},
    "pacejka_slip": {"B": "1", "C": "1", "D": "1", "E": "1", "lat": "1"},
    "lateral_skid": {"k": "s"},
    "stribeck_friction": {"Fs": "1", "Fc": "1", "Fv": "s/m", "vs": "m/s"},
    "world_drift": {"wx": "m/s", "wy": "m/s"},
    "sensor_lever_arm": {"lx": "m", "ly": "m"},
    "heading_bias": {"delta": "rad"},
    "battery_sag": {"loss_at_end": "1"},
    "backlash": {"half_width": "rad/s"},
    "clock_scale": {"kappa": "1"},
    "measurement_noise": {"sp": "m", "st": "rad", "seed": "1"},
}
# forms, each under the effect as which it is reported
FORMS = {
    "saturation": {"saturation_soft": {"v_max": "m/s", "w_max": "rad/s", "sharpness": "1"}},
    "dead_band": {"dead_zone_shifted": {"v_db": "m/s", "w_db": "rad/s"}},
    "backlash": {"backlash_angle": {"half_angle": "rad", "half_way": "m"}},
    "actuator_lag": {"second_order_lag": {"tau": "s", "zeta": "1"}},
    "pacejka_slip": {
        "slip_general": {"v_loss": "1", "w_loss": "1", "lateral": "1", "s0": "m/s2", "n": "1"},
        "slip_saturating": {"loss": "1", "lateral": "1", "s0": "m/s2"},
    },
    "stribeck_friction": {
        "friction_coulomb": {"c_v": "m/s", "c_w": "rad/s"},
        "friction_general": {"moving": "1", "extra": "1", "v0": "m/s", "n": "1", "yaw": "1"},
    },
}
VOCABULARY = CONTRACT | {name: units for forms in FORMS.values() for name, units in forms.items()}
FAMILIES = {
    "saturation": {"saturation", "saturation_soft", "wheel_saturation"},
    "dead_band": {"dead_band", "dead_zone_shifted", "wheel_dead_band"},
    "backlash": {"backlash", "backlash_angle"},
    "lag": {"actuator_lag", "speed_lag", "yaw_lag", "second_order_lag"},
    "slip": {"pacejka_slip", "slip_general", "slip_saturating"},
    "friction": {"stribeck_friction", "friction_coulomb", "friction_general"},
}
# the order of action that effects.c documents
ACTUATOR = (
    "saturation", "saturation_soft", "wheel_saturation", "transport_delay", "dead_band", "dead_zone_shifted", "wheel_dead_band",
    "backlash", "backlash_angle", "acceleration_limit", "actuator_lag", "speed_lag", "yaw_lag", "second_order_lag", "speed_gain",
    "battery_sag", "yaw_gain", "wheel_asymmetry", "yaw_bias", "clock_scale",
)  # fmt: skip
PLANT = (
    "pacejka_slip", "slip_general", "slip_saturating", "lateral_skid", "stribeck_friction", "friction_coulomb", "friction_general",
    "world_drift",
)  # fmt: skip
SENSOR = ("sensor_lever_arm", "heading_bias", "measurement_noise")
ORDER = ACTUATOR + PLANT + SENSOR
KNOWN = ORDER[:-1]  # noise has no formula, it has statistics
# whose mean over a step is exact while the command is held, so that steps of any length add up to the same turn and way
EXACT = ("transport_delay", "backlash_angle", "acceleration_limit", "actuator_lag", "speed_lag", "yaw_lag", "second_order_lag")
INTEGRATORS = (bridge.EULER, bridge.MIDPOINT, bridge.ARC, bridge.SEMI_IMPLICIT)
DT = 0.05  # s


def usual(*names):
    return [bridge.usual_effect(name) for name in names]


def commands(steps=400, seed=0):
    """Held random commands of either sign with reversals, standstills and a slow part."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform((-1, -1), (2.5, 1), (steps // 10 + 1, 2)), 10, axis=0)[:steps]
    u += 0.2 * np.sin(np.arange(steps)[:, None] * (0.31, 0.17))
    u[20:30] = 0
    u[40:60] *= 0.05
    return u


# ---- the second writing ------------------------------------------------------------------------


def lagged(u, tau, dt):
    """The command's jumps, each with the step response averaged over every later step."""
    n = np.arange(len(u))
    response = 1 - tau / dt * np.exp(-n * dt / tau) * (1 - np.exp(-dt / tau))
    jumps = np.diff(u, axis=0, prepend=0)
    jumps[0] = 0
    return u[0] + np.stack([np.convolve(j, response)[: len(u)] for j in jumps.T], axis=1)


def swung(u, tau, zeta, dt):
    """As lagged(), by the two roots of the characteristic equation of an actuator of second order."""
    fast, slow = np.roots([tau**2, 2 * zeta * tau, 1]).astype(complex)
    edges = np.arange(len(u) + 1) * dt
    behind = (slow / fast * np.exp(fast * edges) - fast / slow * np.exp(slow * edges)) / (slow - fast)  # its integral
    jumps = np.diff(u, axis=0, prepend=u[:1])
    response = 1 - np.diff(behind).real / dt
    return u[0] + np.stack([np.convolve(j, response)[: len(u)] for j in jumps.T], axis=1)


def ramped(u, rate, dt):
    """Area below a straight line up to the command, and the command from there on, over the step."""
    out, at = [], u[0]
    for command in u:
        needed = min(abs(command - at) / rate, dt)
        end = at + np.sign(command - at) * needed * rate
        out.append((needed * (at + end) / 2 + (dt - needed) * end) / dt)
        at = end
    return np.array(out)


def at_the_rims(u, track, act):
    """Commands (K, 2) of which act() changes the speeds of both rims."""
    to_rims = np.array([[1, 1], [-track / 2, track / 2]])
    return act(u @ to_rims) @ np.linalg.inv(to_rims)


def delayed(u, delay, dt):
    """Differences of the integrated command, read off `delay` earlier."""
    before = int(delay / dt) + 2
    way = np.cumsum(np.concatenate([np.zeros((1, 2)), np.repeat(u[:1], before, axis=0), u]), axis=0) * dt
    t = np.arange(-before, len(u) + 1) * dt
    late = [np.interp(t[before:] - delay, t, column) for column in way.T]
    return np.diff(np.stack(late, axis=1), axis=0) / dt


def played(w, half, at=None):
    out, at = [], w[0] if at is None else at
    for command in w:
        if command - at > half:
            at = command - half
        elif at - command > half:
            at = command + half
        out.append(at)
    return np.array(out)


def played_way(w, half, dt):
    """Play in the integral of a command, taken up at first."""
    way = np.cumsum(w) * dt
    begin = -half * np.sign(w[0])
    return np.diff(played(way, half, begin), prepend=begin) / dt


def falling(moving, extra, v0, n, v):
    """From one plateau to another, half-way where (v / v0)^n = log 2."""
    return np.minimum(moving + extra / np.exp((np.abs(v) / v0) ** n), 1)


def friction(Fs, Fc, Fv, vs, v):
    return Fc + (Fs - Fc) / np.exp(np.square(v / vs)) + Fv * np.abs(v)


def at_the_wheels(name, p, u, passed):
    """Commands (K, 2) after an effect of the actuators."""
    v, w = u.T
    match name:
        case "saturation":
            return np.clip(u, [-p[0], -p[1]], p)
        case "transport_delay":
            return delayed(u, p[0], DT)
        case "dead_band":
            return u * (np.abs(u) >= p)
        case "backlash":
            return np.stack([v, played(w, p[0])], axis=1)
        case "saturation_soft":
            return u / (1 + np.abs(u / p[:2]) ** p[2]) ** (1 / p[2])
        case "wheel_saturation":
            return at_the_rims(u, p[1], lambda rims: np.clip(rims, -p[0], p[0]))
        case "dead_zone_shifted":
            return u - np.clip(u, np.negative(p), p)
        case "wheel_dead_band":
            return at_the_rims(u, p[1], lambda rims: rims * (np.abs(rims) >= p[0]))
        case "backlash_angle":
            return np.stack([played_way(v, p[1], DT), played_way(w, p[0], DT)], axis=1)
        case "acceleration_limit":
            return np.stack([ramped(v, p[0], DT), ramped(w, p[1], DT)], axis=1)
        case "actuator_lag":
            return lagged(u, p[0], DT)
        case "speed_lag":
            return np.stack([lagged(u, p[0], DT)[:, 0], w], axis=1)
        case "yaw_lag":
            return np.stack([v, lagged(u, p[0], DT)[:, 1]], axis=1)
        case "second_order_lag":
            return swung(u, *p, DT)
        case "speed_gain":
            return u + [p[0], 0] * u
        case "battery_sag":
            return u - u * np.stack([p[0] * passed, 0 * v], axis=1)
        case "yaw_gain":
            return u @ np.diag([1, 1 + p[0]])
        case "wheel_asymmetry":
            return u @ np.array([[1, p[0]], [0, 1]])
        case "yaw_bias":
            return u + [0, p[0]]


def over_ground(name, p, u, body):
    """Body velocities and the world's drift (K, 5) after an effect of the plant."""
    v, w = u.T
    forward, left, turn, wx, wy = body.T
    match name:
        case "pacejka_slip":
            B, C, D, E, lateral = p
            slip = 0.18 * B * np.abs(v * w)
            loss = np.clip(D * np.sin(C * np.arctan((1 - E) * slip + E * np.arctan(slip))), 0, 1)
            left = left + lateral * v * loss * np.sign(w)
            forward, turn = forward - 0.3 * loss * forward, turn - 0.7 * loss * turn
        case "slip_general":
            loss = 1 - np.exp(-((np.abs(v * w) / p[3]) ** p[4]))
            left = left + p[2] * v * loss * np.sign(w)
            forward, turn = forward - p[0] * loss * forward, turn - p[1] * loss * turn
        case "slip_saturating":
            loss = 1 - np.exp(-np.abs(v * w) / p[2])
            left = left + p[1] * v * loss * np.sign(w)
            forward, turn = forward - p[0] * loss * forward, turn - p[0] * loss * turn
        case "friction_coulomb":
            forward, turn = (x - np.clip(x, -most, most) for x, most in zip((forward, turn), p))
        case "friction_general":
            turn = turn * (1 - np.minimum(p[4] * falling(*p[:4], turn), 1))
            forward, left = (part - part * falling(*p[:4], part) for part in (forward, left))
        case "lateral_skid":
            left = left + p[0] * forward * turn
        case "stribeck_friction":
            turn = np.sign(turn) * np.clip(np.abs(turn) - 0.1 * friction(*p, turn), 0, None)
            forward, left = (part - part * friction(*p, part) for part in (forward, left))
        case "world_drift":
            wx, wy = wx + p[0], wy + p[1]
    return np.stack([forward, left, turn, wx, wy], axis=1)


def in_order(active):
    return sorted(active, key=lambda effect: ORDER.index(effect.name))


def acting(effect, t):
    return (effect.t0 <= t + 1e-9) & (t + 1e-9 < effect.t1)


def velocities(u, active, duration):
    """Body velocities and the world's drift (K, 5) under commands u, and how long each step truly lasts (K)."""
    u, dt, t = u.copy(), np.full(len(u), DT), np.arange(len(u)) * DT
    body = None
    for effect in in_order(active):
        k = acting(effect, t)
        if not k.any() or effect.name in SENSOR:
            continue
        if effect.name == "clock_scale":
            dt[k] *= 1 + effect.parameters[0]
        elif effect.name in ACTUATOR:
            passed = (t[k] - effect.t0) / (min(effect.t1, duration) - effect.t0)
            u[k] = at_the_wheels(effect.name, effect.parameters, u[k], passed)
        else:
            body = np.insert(u, 1, 0, axis=1)[:, [0, 1, 2, 1, 1]] if body is None else body
            body[k] = over_ground(effect.name, effect.parameters, u[k], body[k])
    return np.insert(u, 1, 0, axis=1)[:, [0, 1, 2, 1, 1]] if body is None else body, dt


def moved(pose, velocity, dt, integrator):
    """One step; positions are complex numbers, arcs go around their centre."""
    z, heading = pose
    forward, left, turn, wx, wy = velocity
    flat = complex(forward, left)
    if integrator == bridge.ARC and abs(turn) > 1e-9:
        way = flat / (1j * turn) * (np.exp(1j * turn * dt) - 1)
    else:
        ahead = {bridge.EULER: 0, bridge.SEMI_IMPLICIT: 1}.get(integrator, 0.5)
        way = flat * dt * np.exp(1j * ahead * turn * dt)
    return z + way * np.exp(1j * heading) + complex(wx, wy) * dt, heading + turn * dt


def measured(pose, t, active):
    z, heading = pose
    for effect in in_order(active):
        if effect.name == "sensor_lever_arm" and acting(effect, t):
            z += complex(*effect.parameters) * np.exp(1j * heading)
    return z, heading + sum(e.parameters[0] for e in active if e.name == "heading_bias" and acting(e, t))


def true(pose, t, active):
    z, heading = pose
    heading -= sum(e.parameters[0] for e in active if e.name == "heading_bias" and acting(e, t))
    arms = [complex(*e.parameters) for e in active if e.name == "sensor_lever_arm" and acting(e, t)]
    return z - sum(arms) * np.exp(1j * heading), heading


def drive(u, active=(), x0=(0.0, 0.0, 0.0), integrator=bridge.EULER):
    """Measured poses (K+1, 3)."""
    pose, rows = (complex(*x0[:2]), x0[2]), []
    for k, (velocity, dt) in enumerate(zip(*velocities(u, active, len(u) * DT))):
        rows.append(measured(pose, k * DT, active))
        pose = moved(pose, velocity, dt, integrator)
    rows.append(measured(pose, len(u) * DT, active))
    return np.array([(z.real, z.imag, heading) for z, heading in rows])


def window(x, u, start, steps, active, usable, integrator):
    """One window by itself, simulated from the start of the log: predicted, residual."""
    if not usable[start : start + steps].all():
        return np.full((2, 3), np.nan)
    pose = true((complex(*x[start, :2]), x[start, 2]), start * DT, active)
    rolled = velocities(u[: start + steps], active, (len(x) - 1) * DT)
    for velocity, dt in list(zip(*rolled))[start:]:
        pose = moved(pose, velocity, dt, integrator)
    z, heading = measured(pose, (start + steps) * DT, active)
    off = (complex(*x[start + steps, :2]) - z) * np.exp(-1j * x[start, 2])
    turned = np.angle(np.exp(1j * (x[start + steps, 2] - heading)))
    return np.array([(z.real, z.imag, heading), (off.real, off.imag, turned)])


# ---- effects -----------------------------------------------------------------------------------


def test_vocabulary_is_the_contracts():
    table = bridge.effects()
    assert tuple(table) == ORDER
    assert {name: {row[0]: row[1] for row in rows} for name, (_, rows) in table.items()} == VOCABULARY
    for _, rows in table.values():
        for _, _, low, high, value in rows:
            assert low <= 0 < high and low <= value <= high
    blocks = [block for block, _ in table.values()]
    assert blocks == ["actuator"] * len(ACTUATOR) + ["plant"] * len(PLANT) + ["sensor"] * len(SENSOR)


def test_forms_are_reported_by_names_of_the_contract():
    found = bridge.families()
    assert list(found) == list(ORDER)
    assert {name: reported for name, (_, reported) in found.items() if reported != name} == {
        form: name for name, forms in FORMS.items() for form in forms
    }
    families = {name: {key for key, (family, _) in found.items() if family == name} for name in FAMILIES}
    assert families == FAMILIES
    alone = set(ORDER) - set().union(*FAMILIES.values())
    assert all(found[name] == (name, name) for name in alone)
    assert all(names == (name, name) for name, names in bridge.families("fwmav").items())


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("names", [(name,) for name in ORDER] + [ORDER])
def test_all_zero_changes_no_bit(names, integrator):
    u = commands()
    zeros = [bridge.Effect(name, (0.0,) * len(VOCABULARY[name])) for name in names]
    nominal = bridge.simulate(u, DT, (1, 2, 3), integrator=integrator)
    assert np.array_equal(bridge.simulate(u, DT, (1, 2, 3), zeros, integrator), nominal)
    zeros = [effect for effect in zeros if effect.name != "measurement_noise"]
    pairs = [bridge.windows(nominal, u, DT, range(380), (1, 20), active, integrator=integrator) for active in ((), zeros)]
    assert np.array_equal(*pairs)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("names", [()] + [(name,) for name in KNOWN] + [KNOWN])
def test_effect_is_its_formula(names, integrator):
    """Each, none and all, over the whole drive and in a part of it; each really acts."""
    u, x0 = commands(), (0.3, -0.2, 2.0)
    for t0, t1 in ((0, np.inf), (5.0, 12.5)):
        active = [bridge.usual_effect(name, t0, t1) for name in names]
        ours = bridge.simulate(u, DT, x0, active, integrator)
        assert np.max(np.abs(ours - drive(u, active, x0, integrator))) < 1e-11
        nominal = bridge.simulate(u, DT, x0, integrator=integrator)
        assert not names or np.max(np.abs(ours - nominal)) > 1e-3
        assert np.array_equal(ours[: round(t0 / DT)], nominal[: round(t0 / DT)])


@pytest.mark.parametrize("delay", [0.01, 0.05, 0.1, 0.15, 0.1234, 2.0])
@pytest.mark.parametrize("tau", [1e-6, 0.02, 1.0])
def test_delay_and_lag_of_any_size(delay, tau):
    active = [bridge.Effect("transport_delay", (delay,)), bridge.Effect("actuator_lag", (tau,))]
    u = commands()
    assert np.max(np.abs(bridge.simulate(u, DT, active=active) - drive(u, active))) < 1e-11


@pytest.mark.parametrize("zeta", [0.0, 0.3, 0.999, 0.9999999, 1.0, 1.0000001, 2.5])
@pytest.mark.parametrize("tau", [1e-6, 0.02, 0.3])
def test_second_order_lag_of_any_damping(tau, zeta):
    """Critical damping, where the two roots meet, against damping next to it."""
    u = commands()
    of = lambda z: bridge.simulate(u, DT, active=[bridge.Effect("second_order_lag", (tau, z))])  # noqa: E731
    if abs(zeta - 1) < 1e-6:
        expected = (of(1 - 1e-4) + of(1 + 1e-4)) / 2
        assert np.max(np.abs(of(zeta) - expected)) < 1e-6
    elif zeta > 0 or tau > 0.01:  # roots on the imaginary axis lose digits of their phase over the log
        assert np.max(np.abs(of(zeta) - drive(u, [bridge.Effect("second_order_lag", (tau, zeta))]))) < 1e-9


def test_second_order_lag_of_two_real_roots_is_two_lags_in_series():
    """With fine steps, in which the mean over a step that the second lag sees is what it would see."""
    fine, first, second = 50, 0.24, 0.1
    u = np.repeat(commands(100), fine, axis=0)
    tau = np.sqrt(first * second)
    x = bridge.simulate(u, DT / fine, active=[bridge.Effect("second_order_lag", (tau, (first + second) / (2 * tau)))])
    twice = [bridge.Effect("actuator_lag", (first,)), bridge.Effect("speed_lag", (second,)), bridge.Effect("yaw_lag", (second,))]
    assert np.max(np.abs(x - bridge.simulate(u, DT / fine, active=twice))) < 1e-5


@pytest.mark.parametrize("name", EXACT)
def test_mean_over_a_step_is_exact_for_held_commands(name):
    u, fine, active = commands(), 8, usual(name)
    turned, way = [], []
    for steps in (1, fine):
        held = np.repeat(u, steps, axis=0)
        turned.append(bridge.simulate(held, DT / steps, active=active)[::steps, 2])
        way.append(bridge.simulate(held * (1, 0), DT / steps, active=active)[::steps, 0])
    assert np.max(np.abs(turned[0] - turned[1])) < 1e-11 and np.max(np.abs(way[0] - way[1])) < 1e-11


@pytest.mark.parametrize("name", KNOWN)
def test_halving_the_step_converges(name):
    u, active = commands(), usual(name)
    rows = [bridge.simulate(np.repeat(u, n, axis=0), DT / n, active=active, integrator=bridge.ARC)[::n] for n in (1, 2, 4, 16)]
    first, second, third = (np.max(np.abs(x - rows[-1])) for x in rows[:-1])
    assert second < 0.6 * first + 1e-9 and third < 0.6 * second + 1e-9


def test_play_loses_twice_its_half_at_each_reversal():
    """Turns to and fro, each longer than the play; the first command has taken it up."""
    u = np.zeros((90, 2))
    u[:, 1] = np.repeat([0.8, -0.8, 0.8], 30)
    x = bridge.simulate(u, DT, active=[bridge.Effect("backlash_angle", (0.05, 0.0))])
    turn = 0.8 * 30 * DT
    assert x[[30, 60, 90], 2] == pytest.approx([turn, 0.1, turn], abs=1e-12)


def test_robot_at_full_speed_accelerates_as_the_limit_allows():
    """A ramp covers v^2 / 2a less than a step, and a t^2 / 2 before its end."""
    u = np.zeros((60, 2))
    u[1:, 0] = 1.23
    x = bridge.simulate(u, DT, active=[bridge.Effect("acceleration_limit", (0.7, 0.0))])
    assert x[-1, 0] == pytest.approx(1.23 * 59 * DT - 1.23**2 / (2 * 0.7), abs=1e-12)
    assert x[11, 0] == pytest.approx(0.7 * (10 * DT) ** 2 / 2, abs=1e-12)


def test_wheel_without_a_track_has_the_speed_of_the_robot():
    u = commands()
    for rims, body in (("wheel_saturation", "saturation"), ("wheel_dead_band", "dead_band")):
        x = bridge.simulate(u, DT, active=[bridge.Effect(rims, (0.7, 0.0))])
        assert np.array_equal(x, bridge.simulate(u, DT, active=[bridge.Effect(body, (0.7, 0.0))]))


def test_wheel_limit_keeps_the_inner_wheel():
    """A bend in which only the outer wheel is too fast: it is cut, and both speed and yaw rate fall."""
    active = [bridge.Effect("wheel_saturation", (1.0, 0.6))]
    x = bridge.simulate(np.array([[0.9, 1.0]]), DT, active=active)
    outer, inner = 1.0, 0.9 - 0.3
    assert x[1] / DT == pytest.approx([(outer + inner) / 2, 0, (outer - inner) / 0.6])


def test_soft_limit_is_nearly_a_hyperbolic_tangent_or_a_hard_one():
    u = np.stack([np.linspace(-4, 4, 81), np.zeros(81)], axis=1)
    way = lambda sharpness: np.diff(bridge.simulate(u, DT, active=[bridge.Effect("saturation_soft", (1.2, 0, sharpness))])[:, 0]) / DT  # noqa: E731
    assert np.max(np.abs(way(2.6) - 1.2 * np.tanh(u[:, 0] / 1.2))) < 0.03
    assert np.max(np.abs(way(20.0) - np.clip(u[:, 0], -1.2, 1.2))) < 0.05


@pytest.mark.parametrize("name", ["actuator_lag", "speed_lag", "yaw_lag", "second_order_lag", "transport_delay", "backlash", "backlash_angle",
                                  "dead_band", "dead_zone_shifted", "wheel_dead_band", "friction_coulomb", "saturation", "wheel_saturation",
                                  "saturation_soft", "acceleration_limit"])  # fmt: skip
def test_effect_goes_to_nominal_with_its_parameters(name):
    """No jump at zero, so that a fit can switch an effect off; limits, off at zero, do so from above."""
    u = commands()
    size = {"saturation": 9.0, "wheel_saturation": 9.0, "saturation_soft": 9.0, "acceleration_limit": 20.0}.get(name, 1e-7)
    parameters = (size,) if name.startswith("wheel") else (size,) * len(VOCABULARY[name])
    parameters += (0.5,) if name.startswith("wheel") else ()
    if name == "acceleration_limit":
        u = np.cumsum(u * 0.001, axis=0)  # changes slowly
    tiny = bridge.Effect(name, parameters)
    assert np.max(np.abs(bridge.simulate(u, DT, active=[tiny]) - bridge.simulate(u, DT))) < 1e-4


def test_order_given_by_the_caller_does_not_matter():
    u, active = commands(), usual(*ORDER)
    expected = bridge.simulate(u, DT, active=active)
    log = (expected, u, DT, range(0, 350, 7), (1, 50))
    windows = bridge.windows(*log, active[:-1])
    for seed in range(5):
        mixed = np.random.default_rng(seed).permutation(len(ORDER))
        assert np.array_equal(bridge.simulate(u, DT, active=[active[i] for i in mixed]), expected)
        known = [active[i] for i in mixed if ORDER[i] in KNOWN]
        assert np.array_equal(bridge.windows(*log, known), windows)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_clock_scale_is_both_gains(integrator):
    """The exact alias, behind a lag and a delay too."""
    u, before = commands(), usual("transport_delay", "actuator_lag", "backlash")
    clock = before + [bridge.Effect("clock_scale", (0.07,))]
    gains = before + [bridge.Effect("speed_gain", (0.07,)), bridge.Effect("yaw_gain", (0.07,))]
    x = bridge.simulate(u, DT, active=clock, integrator=integrator)
    assert np.max(np.abs(x - bridge.simulate(u, DT, active=gains, integrator=integrator))) < 1e-12
    residuals = [bridge.windows(x, u, DT, range(300), (50,), a, integrator=integrator)[1] for a in (clock, gains)]
    assert np.max(np.abs(residuals)) < 1e-12


def test_noise_is_what_it_says_and_repeats():
    u = np.zeros((20000, 2))
    noise = bridge.Effect("measurement_noise", (0.01, 0.002, 5))
    x = bridge.simulate(u, DT, active=[noise])
    assert np.array_equal(x, bridge.simulate(u, DT, active=[noise]))
    other = bridge.simulate(u, DT, active=[bridge.Effect("measurement_noise", (0.01, 0.002, 6))])
    z = np.concatenate([x, other], axis=1) / np.tile([0.01, 0.01, 0.002], 2)
    five_sigma = 5 / np.sqrt(len(z))
    assert np.all(np.abs(z.mean(axis=0)) < five_sigma)
    assert np.all(np.abs((z**2).mean(axis=0) - 1) < five_sigma * np.sqrt(2))
    assert np.all(np.abs((z**4).mean(axis=0) - 3) < five_sigma * np.sqrt(96))
    assert np.all(np.abs((z[1:] * z[:-1]).mean(axis=0)) < five_sigma)
    assert np.all(np.abs(np.corrcoef(z.T) - np.eye(6)) < five_sigma)


def test_sag_in_a_closed_loop_ends_with_the_drive():
    steps, mpc = 40, bridge.Mpc(horizon=5)
    path = bridge.simulate(np.tile([1.5, 0.2], (steps + 6, 1)), DT)
    seen = []
    for active in (usual("battery_sag"), [bridge.usual_effect("battery_sag", 0, steps * DT)]):
        estimator = bridge.Estimator("poly_ddr", "ef", 64)
        trace = estimator.control(mpc, path, DT, steps, path[0], active, solver=lambda *_: (1.0, 0.1))
        assert np.allclose(trace["x"], bridge.simulate(trace["u"], DT, active=active), rtol=0, atol=1e-12)
        seen.append(trace["x"])
    assert np.array_equal(*seen)
    assert np.linalg.norm(seen[0][-1] - bridge.simulate(np.tile([1.0, 0.1], (steps, 1)), DT)[-1]) > 0.01


# ---- windows -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def log():
    """A noisy log of a robot with effects of its own, heading wrapped, with masked rows and gaps."""
    u = commands()
    x = bridge.simulate(u, DT, (1, -2, 3), usual("speed_gain", "actuator_lag", "measurement_noise"), bridge.ARC)
    x[:, 2] = np.angle(np.exp(1j * x[:, 2]))
    masked = np.zeros(len(x), bool)
    masked[[60, 61, 200]] = True
    x[masked] = np.nan
    usable = ~(masked[:-1] | masked[1:])
    usable[[130, 131, 290]] = False
    return x, u, usable


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("names", [(), ("transport_delay", "actuator_lag", "backlash"), KNOWN])
def test_windows_are_simulations_of_their_own(log, names, integrator):
    x, u, usable = log
    starts, steps = [0, 3, 59, 60, 62, 100, 125, 132, 150, 199, 201, 239, 240, 241, 349, 350], (1, 10, 50)
    active = [bridge.usual_effect(name, t0, t1) for name in names for t0, t1 in ((0, 9.0), (12.0, np.inf))]
    predicted, residual = bridge.windows(x, u, DT, starts, steps, active, usable, integrator)
    expected = np.array([[window(x, u, s, h, active, usable, integrator) for h in steps] for s in starts])
    assert predicted.shape == residual.shape == (len(starts), len(steps), 3)
    assert np.array_equal(np.isnan(residual), np.isnan(expected[:, :, 1]))
    assert 5 < np.isnan(residual[:, :, 0]).sum() < 30
    assert np.nanmax(np.abs(predicted - expected[:, :, 0])) < 1e-11
    assert np.nanmax(np.abs(residual - expected[:, :, 1])) < 1e-11


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_true_effects_leave_nothing_and_each_is_needed(integrator):
    """A log of all effects in segments: no residual with them, in any window; some without any one."""
    u = commands()
    active = [bridge.usual_effect(name, 0.5 * i, 15 + 0.5 * i) for i, name in enumerate(KNOWN)]
    x = bridge.simulate(u, DT, (5, -3, 1), active, integrator)
    x[:, 2] = np.angle(np.exp(1j * x[:, 2]))
    starts = range(350)
    residual = bridge.windows(x, u, DT, starts, (1, 10, 50), active, integrator=integrator)[1]
    assert np.max(np.abs(residual)) < 1e-11
    for missing in active:
        others = [effect for effect in active if effect is not missing]
        residual = bridge.windows(x, u, DT, starts, (50,), others, integrator=integrator)[1]
        assert np.max(np.abs(residual)) > 1e-3, missing.name
    for other in set(INTEGRATORS) - {integrator}:
        assert np.max(np.abs(bridge.windows(x, u, DT, starts, (50,), active, integrator=other)[1])) > 1e-6


def test_residual_is_measured_less_predicted_in_the_body_frame():
    """A robot that stands at (1, 2) heading along y and is then seen 0.1 m further along y, turned past pi."""
    x = np.array([[1, 2, np.pi / 2], [1, 2.1, np.pi / 2 + 0.2 - 2 * np.pi]])
    predicted, residual = bridge.windows(x, np.zeros((1, 2)), DT, [0], [1])
    assert predicted[0, 0] == pytest.approx(x[0])
    assert residual[0, 0] == pytest.approx([0.1, 0, 0.2])


def test_last_command_is_not_used(log):
    x, u, usable = log
    more = np.concatenate([u, [[np.nan, np.nan]]])
    pairs = [bridge.windows(x, v, DT, range(0, 350, 5), (1, 50), (), usable) for v in (u, more)]
    assert np.array_equal(*pairs, equal_nan=True)


def test_rollouts_asked_again_answer_as_new_ones(log):
    """Whatever was asked before, a refusal too."""
    x, u, usable = log
    rollouts = bridge.Rollouts(x, u, DT, range(0, 350, 5), (1, 50), usable)
    for names in (KNOWN, (), ("transport_delay",), ("pacejka_slip", "actuator_lag"), ()):
        with pytest.raises(UserError, match="cannot be undone"):
            rollouts.predict(usual("measurement_noise"))
        fresh = bridge.windows(x, u, DT, range(0, 350, 5), (1, 50), usual(*names), usable)
        assert np.array_equal(rollouts.predict(usual(*names)), fresh, equal_nan=True), names


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("name", KNOWN)
def test_steps_end_where_windows_of_one_step_do(log, name, integrator):
    """From some rows; the effect acts for a while, beside a lag that remembers the rows between."""
    x, u = np.nan_to_num(log[0]), log[1]
    rows = np.r_[0, 3:40, 41, 60:200, 340:350]
    active = [bridge.usual_effect(name, 1.0, 12.0), bridge.usual_effect("yaw_lag" if name == "speed_lag" else "speed_lag")]
    off = bridge.windows(x, u, DT, rows, (1,), active, integrator=integrator)[0][:, 0] - x[rows + 1]
    world = off[:, 0] + 1j * off[:, 1]
    body = world * np.exp(-1j * x[rows + 1, 2])
    found = bridge.Steps(x, u, DT, rows, integrator).beside(active)
    assert np.abs(found[:, 0] + 1j * found[:, 1] - body).max() < 1e-11
    assert np.abs(np.exp(1j * (found[:, 2] - off[:, 2])) - 1).max() < 1e-11 and np.abs(found[:, 2]).max() <= np.pi


@pytest.mark.parametrize("names", [KNOWN, ("saturation", "actuator_lag", "yaw_gain"), ("transport_delay",), ("pacejka_slip",)])
def test_steps_asked_again_answer_as_before(log, names):
    """Bit for bit, though the commands behind what remembers are then known."""
    x, u = np.nan_to_num(log[0]), log[1]
    rows = np.r_[0, 3:40, 41, 60:200, 340:350]
    steps, behind = bridge.Steps(x, u, DT, rows), (*usual(*names), bridge.Effect("yaw_bias", (0.3,)))
    first, other = steps.beside(usual(*names)), bridge.Steps(x, u, DT, rows).beside(behind)
    for _ in range(3):
        assert np.array_equal(steps.beside(usual(*names)), first) and np.array_equal(steps.beside(behind), other)


@pytest.mark.parametrize("name", [name for name in KNOWN if not bridge.remembering([bridge.usual_effect(name)])])
def test_steps_under_a_command_that_is_held_are_those_from_each_row_alone(log, name):
    """Bit for bit, though the motion is then not computed again; of effects of the command in the row alone, some of which come and go."""
    x, u = np.nan_to_num(log[0]), np.repeat(log[1][::10], 10, axis=0)[: len(log[1])]
    for t0, t1 in ((0.0, np.inf), (1.03, 9.0)):
        active = [bridge.usual_effect(name, t0, t1), bridge.usual_effect("lateral_skid", 0.0, 4.0)]
        rows = np.arange(len(x) - 1)
        alone = [bridge.Steps(x, u, DT, rows[k : k + 1]).beside(active)[0] for k in rows]
        assert np.array_equal(bridge.Steps(x, u, DT, rows).beside(active), alone)


@pytest.mark.parametrize("rows", [[-1, 4], [4, 4], [7, 3], [10**6]])
def test_steps_from_rows_that_do_not_ascend_or_are_not_there_are_refused(log, rows):
    with pytest.raises(UserError, match="rows must ascend, up to"):
        bridge.Steps(np.nan_to_num(log[0]), log[1], DT, rows).beside()


# ---- bad input -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "effect, message",
    [
        (bridge.Effect("warp_drive", (1.0,)), "no effect named 'warp_drive'"),
        (bridge.Effect("actuator_lag", (-0.1,)), "actuator_lag: tau is -0.1, it must be between 0 and 3"),
        (bridge.Effect("transport_delay", (2.1,)), "transport_delay: delay is 2.1"),
        (bridge.Effect("speed_gain", (np.nan,)), "speed_gain: a is"),
        (bridge.Effect("yaw_gain", (np.inf,)), "yaw_gain: b is"),
        (bridge.Effect("yaw_gain", ()), "yaw_gain: 0 parameters are given, it takes 1"),
        (bridge.Effect("yaw_gain", (0.1,) * 7), "yaw_gain: 7 parameters are given"),
        (bridge.Effect("yaw_gain", (0.1,), np.nan), "yaw_gain: it acts from"),
        (bridge.Effect("yaw_gain", (0.1,), 0, np.nan), "yaw_gain: it acts from"),
    ],
)
def test_bad_effect_is_refused(effect, message):
    u = commands(50)
    with pytest.raises(UserError, match=message):
        bridge.simulate(u, DT, active=[effect])
    with pytest.raises(UserError, match=message):
        bridge.windows(np.zeros((51, 3)), u, DT, [0], [1], [effect])


@pytest.mark.parametrize(
    "change, message",
    [
        ({"x": np.zeros((0, 3)), "u": np.zeros((0, 2))}, "log is empty"),
        ({"x": np.zeros((1, 3)), "u": np.zeros((0, 2))}, "log is empty"),
        ({"dt": -0.05}, "dt is -0.05 s"),
        ({"dt": 0.0}, "dt is 0 s"),
        ({"dt": np.nan}, "dt is"),
        ({"dt": np.inf}, "dt is"),
        ({"steps": [51]}, "window of 51 steps does not fit into a log of 51 rows"),
        ({"steps": [0]}, "window of 0 steps"),
        ({"steps": []}, "steps must be given"),
        ({"starts": [-1]}, "cannot start in row -1"),
        ({"starts": [0, 51], "steps": [1, 2]}, "cannot start in row 51: the last row is 50"),
        ({"integrator": 4}, "no integrator 4"),
        ({"integrator": -1}, "no integrator -1"),
        ({"active": usual("measurement_noise")}, "measurement_noise cannot be undone"),
        ({"u": np.full((50, 2), np.nan)}, "command in row 0 is not finite"),
        ({"x": np.full((51, 3), np.nan)}, "pose in row 0 or 1 is not finite"),
        ({"u": np.full((50, 2), 1e308), "steps": [50]}, "diverged"),
        ({"active": usual("transport_delay"), "dt": 1e-200}, "transport_delay reaches back over too many steps"),
    ],
)
def test_bad_window_is_refused(change, message):
    good = {"x": np.zeros((51, 3)), "u": commands(50), "dt": DT, "starts": [0], "steps": [1]}
    bridge.windows(**good)
    with pytest.raises(UserError, match=message):
        bridge.windows(**(good | change))
