"""The quadrotor against a second writing of its equations and against free-body diagrams.

The second writing follows the vehicle, a weight fixed to it and a load on its string as points and a rotation matrix
in the world's axes: it solves for all accelerations and the string's tension at once, and takes many small steps.
"""

import sys

import numpy as np
import processes
import pytest
from conftest import ROOT
from scipy.spatial.transform import Rotation
from tinykoop import bridge, cli, platforms
from tinykoop.convert import usd
from tinykoop.plumbing.errors import UserError

S = bridge.QUADROTOR_STATE
# the order of action that effects.c documents, and the parameters' units
VOCABULARY = {
    "transport_delay": {"delay": "s"},
    "motor_lag": {"tau": "s"},
    **{f"rotor{i}_thrust": {"a": "1"} for i in (1, 2, 3, 4)},
    "thrust_gain": {"a": "1"},
    "battery_sag": {"loss_at_end": "1"},
    "payload": {"mass": "kg", "x": "m", "y": "m"},
    "slung_load": {"mass": "kg", "length": "m", "x": "m", "y": "m"},
    "trim": {"roll": "N m", "pitch": "N m", "yaw": "N m"},
    "wind": {"wx": "m/s", "wy": "m/s"},
    "drag": {"k": "1/s"},
    "gyro_bias": {"bx": "rad/s", "by": "rad/s", "bz": "rad/s"},
    "accel_bias": {"bx": "m/s^2", "by": "m/s^2", "bz": "m/s^2"},
    "vibration": {"a": "1"},
}
BLOCKS = ["actuator"] * 2 + ["plant"] * 11 + ["sensor"] * 3
MANOEUVRES = ("hover", "legs", "mixed")
VEHICLES = ("crazyflie", "iris", "racing")

# docs/quadrotor.md
G, MASS, INERTIA, FULL, KAPPA, LAG = 9.81, 0.033, np.array([1.66e-5, 1.67e-5, 2.93e-5]), 0.132, 0.00596, 0.06
DRAG, VOLTAGE, SLOPE, HALF, SWING_DAMPING = np.array([0.23, 0.23, 0.26]), 3.5, -0.1, 0.046 / np.sqrt(2), 0.2
PLACES = HALF * np.array([[1, -1, 0], [-1, -1, 0], [-1, 1, 0], [1, 1, 0]])  # x forward, y left
TURNS = np.array([-1, 1, -1, 1])
HOVER = MASS * G / (4 * FULL)


def usual(*names):
    return [bridge.usual_effect(name, platform="quadrotor") for name in names]


def rotations(states):
    return Rotation.from_quat(np.roll(states[..., S["attitude"]], -1, axis=-1))


def angles(states):
    """Roll, pitch, yaw (K, 3) of true states."""
    return rotations(states).as_euler("ZYX")[:, ::-1]


# ---- the second writing ------------------------------------------------------------------------


def skew(v):
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


class Vehicle:
    """Centre of mass, its velocity, rotation and angular velocity (world), rotors, place and velocity of a load."""

    def __init__(self, state, factors=(1, 1, 1, 1), payload=None, load=None, moment=(0, 0, 0), wind=(0, 0), drag=0.0):
        self.p, self.v = state[:3].copy(), state[3:6].copy()
        self.R = rotations(state).as_matrix()
        self.w = self.R @ state[S["spin"]]
        self.rotors = state[S["rotors"]].copy()
        self.factors, self.moment, self.wind, self.drag = np.array(factors), np.array(moment), np.array([*wind, 0]), drag
        bodies = [(MASS, np.zeros(3))] + ([(payload[0], np.array([*payload[1:], 0]))] if payload else [])
        self.mass = sum(m for m, _ in bodies)
        self.centre = sum(m * r for m, r in bodies) / self.mass
        self.J = np.diag(INERTIA) - sum(m * skew(r - self.centre) @ skew(r - self.centre) for m, r in bodies)
        self.load = load
        if load:
            self.at = np.array([*load[2:], 0]) - self.centre
            s, rate = state[S["swing"]], state[S["swinging"]]
            d = np.array([*s, -np.sqrt(1 - s @ s)])
            self.q = self.hook() + load[1] * d
            self.qv = self.hook_velocity() + load[1] * np.array([*rate, -(s @ rate) / d[2]])

    def hook(self):
        return self.p + self.R @ self.at

    def hook_velocity(self):
        return self.v + np.cross(self.w, self.R @ self.at)

    def accelerations(self, power):
        """Of the centre of mass, angular, and of the load."""
        R, w = self.R, self.w
        thrust = FULL * power * self.rotors * self.factors
        torque = np.cross(PLACES - self.centre, thrust[:, None] * [0, 0, 1]).sum(axis=0) + [0, 0, KAPPA * TURNS @ thrust]
        air = R.T @ (self.v - self.wind)
        force = R @ ([0, 0, thrust.sum()] - MASS * (DRAG + self.drag) * air) - [0, 0, self.mass * G]
        J = R @ self.J @ R.T
        moment = R @ (torque + self.moment) - np.cross(w, J @ w)
        if not self.load:
            return force / self.mass, np.linalg.solve(J, moment), None
        m, length = self.load[:2]
        r = R @ self.at
        d = (self.q - self.hook()) / length
        rate = (self.qv - self.hook_velocity()) / length
        # unknown: a, alpha, b (of the load), tension
        A, y = np.zeros((10, 10)), np.zeros(10)
        A[:3, :3], A[:3, 9], y[:3] = self.mass * np.eye(3), -d, force
        A[3:6, 3:6], A[3:6, 9], y[3:6] = J, -np.cross(r, d), moment
        A[6:9, 6:9], A[6:9, 9], y[6:9] = m * np.eye(3), d, [0, 0, -m * G]
        A[9, :3], A[9, 3:6], A[9, 6:9] = -d, -np.cross(r, d), d
        y[9] = d @ np.cross(w, np.cross(w, r)) - length * rate @ rate
        solved = np.linalg.solve(A, y)
        solved[6:9] -= SWING_DAMPING * length * rate
        return solved[:3], solved[3:6], solved[6:9]

    def go(self, asked, power, dt, parts=30):
        """dt on by the midpoint rule."""
        h = dt / parts
        for _ in range(parts):
            kept = [np.copy(x) for x in (self.p, self.v, self.R, self.w, self.rotors)]
            load = [np.copy(x) for x in (self.q, self.qv)] if self.load else None
            self.move(kept, load, *self.slopes(asked, power), h / 2)
            self.move(kept, load, *self.slopes(asked, power), h)
        return self

    def slopes(self, asked, power):
        a, alpha, b = self.accelerations(power)
        return self.v.copy(), a, self.w.copy(), alpha, (asked - self.rotors) / LAG, self.qv.copy() if self.load else None, b

    def move(self, kept, load, v, a, w, alpha, rotors, qv, b, h):
        p0, v0, R0, w0, m0 = kept
        self.p, self.v, self.w, self.rotors = p0 + h * v, v0 + h * a, w0 + h * alpha, m0 + h * rotors
        self.R = Rotation.from_rotvec(h * w).as_matrix() @ R0
        if load:
            self.q, self.qv = load[0] + h * qv, load[1] + h * b

    def state(self):
        """In the order of the C code."""
        q = np.roll(Rotation.from_matrix(self.R).as_quat(canonical=True), 1)
        swing = np.zeros(4)
        if self.load:
            swing[:2] = (self.q - self.hook())[:2] / self.load[1]
            swing[2:] = (self.qv - self.hook_velocity())[:2] / self.load[1]
        return np.concatenate([self.p, self.v, q, self.R.T @ self.w, self.rotors, swing])


def difference(ours, theirs):
    """Largest one of states, quaternions as angles."""
    turned = (rotations(ours) * rotations(theirs).inv()).magnitude()
    rest = np.delete(ours - theirs, np.arange(6, 10), axis=-1)
    return max(np.abs(rest).max(), np.max(turned))


def tumbling(swing=False):
    """A state that hovers nowhere, and commands (24, 5) of 10 ms: as long as a string stays taut."""
    random = np.random.default_rng(0)
    state = bridge.quadrotor_hover()
    state[S["velocity"]], state[S["spin"]] = (0.6, -0.4, 0.2), (1, -2, 1.5)
    if swing:
        state[S["swing"]], state[S["swinging"]] = (0.2, -0.1), (0.5, 1)
    asked = np.repeat(random.uniform(0.5, 0.7, (6, 4)), 4, axis=0)
    return state, np.column_stack([asked, np.linspace(3.9, 3.3, 24)])


@pytest.mark.parametrize(
    "effects, air",
    [
        ((), {}),
        ([("rotor2_thrust", (-0.3,)), ("rotor4_thrust", (0.2,))], {"factors": (1, 0.7, 1, 1.2)}),
        ([("payload", (0.008, -0.04, 0.03))], {"payload": (0.008, -0.04, 0.03)}),
        ([("slung_load", (0.006, 0.4, -0.03, 0.02))], {"load": (0.006, 0.4, -0.03, 0.02)}),
        (
            [("payload", (0.005, 0.03, 0.01)), ("slung_load", (0.004, 0.3, 0.02, 0.03))],
            {"payload": (0.005, 0.03, 0.01), "load": (0.004, 0.3, 0.02, 0.03)},
        ),
        ([("trim", (1e-3, -8e-4, 1e-4))], {"moment": (1e-3, -8e-4, 1e-4)}),
        ([("wind", (2.0, -1.0)), ("drag", (0.7,))], {"wind": (2.0, -1.0), "drag": 0.7}),
        ([("thrust_gain", (0.15,))], {"factors": (1.15,) * 4}),
    ],
    ids=lambda part: "+".join(name for name, _ in part) if isinstance(part, list) else "",
)
def test_vehicle_and_what_acts_on_it_are_the_equations(effects, air):
    active = [bridge.Effect(*effect) for effect in effects]
    state, commands = tumbling("load" in air)
    vehicle = Vehicle(state, **air)
    theirs = [vehicle.state()]
    for command in commands:
        theirs.append(vehicle.go(command[:4], 1 + SLOPE * (command[4] - VOLTAGE), 0.01).state())
    ours = bridge.quadrotor_roll(state, commands, 0.01, active)
    assert difference(ours, np.array(theirs)) < 1e-4
    assert np.abs(ours[:, S["spin"]]).max() > 2
    if effects:
        assert difference(ours, bridge.quadrotor_roll(state, commands, 0.01)) > 2e-3


# ---- the vehicle -------------------------------------------------------------------------------


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_hover_is_an_equilibrium_where_thrust_is_the_weight(vehicle):
    v = bridge.quadrotor_vehicle(vehicle)
    request = v["mass"] * G / (4 * v["thrust_full"])
    commands = np.tile([request] * 4 + [v["voltage"]], (200, 1))
    states = bridge.quadrotor_roll(bridge.quadrotor_hover(vehicle), commands, 0.01, vehicle=vehicle)
    assert np.abs(states - bridge.quadrotor_hover(vehicle)).max() < 1e-9
    assert bridge.hover_request(vehicle) == pytest.approx(request)
    commands[:, 4] = np.nan  # a voltage that is not known is the vehicle's
    assert np.array_equal(bridge.quadrotor_roll(bridge.quadrotor_hover(vehicle), commands, 0.01, vehicle=vehicle), states)


def test_a_body_in_free_fall_keeps_momentum_and_energy():
    """With a weight beside its centre, so that the axes of inertia are not its own."""
    weight = 0.01, 0.05, -0.03
    still = {**bridge.quadrotor_vehicle(), "drag_xy": 0.0, "drag_z": 0.0}
    state = bridge.quadrotor_hover()
    state[S["rotors"]], state[S["spin"]], state[S["velocity"]] = 0, (3, 5, -4), (1, 2, 3)
    commands = np.zeros((300, 5))
    states = bridge.quadrotor_roll(state, commands, 0.01, [bridge.Effect("payload", weight)], still)
    J, spin = Vehicle(state, payload=weight).J, states[:, S["spin"]]
    momentum, energy = rotations(states).apply(spin @ J), np.einsum("ki,ij,kj->k", spin, J, spin)
    assert np.abs(momentum - momentum[0]).max() < 1e-5 * np.linalg.norm(momentum[0])
    assert np.abs(energy / energy[0] - 1).max() < 1e-5
    assert np.ptp(spin, axis=0).max() > 2  # it tumbles
    t = np.arange(301)[:, None] * 0.01
    assert np.abs(states[:, S["velocity"]] - ([1, 2, 3] - t * [0, 0, G])).max() < 1e-9


def test_a_load_swings_with_the_period_of_a_pendulum_from_a_vehicle_that_gives_way():
    """sqrt(g / L (1 + m / M)), of a string from the centre of a vehicle that is held level by its symmetry."""
    m, length = 0.006, 0.5
    state = bridge.quadrotor_hover()
    state[17] = 0.02
    state[S["rotors"]] = request = (MASS + m) * G / (4 * FULL)
    commands = np.tile([request] * 4 + [VOLTAGE], (600, 1))
    swing = bridge.quadrotor_roll(state, commands, 0.005, [bridge.Effect("slung_load", (m, length, 0, 0))])[:, 17]
    crossings = np.flatnonzero(np.diff(np.sign(swing)))
    at = crossings + swing[crossings] / (swing[crossings] - swing[crossings + 1])
    period = 2 * np.mean(np.diff(at)) * 0.005
    assert period == pytest.approx(2 * np.pi / np.sqrt(G / length * (1 + m / MASS)), rel=0.005)


def test_a_rotor_turns_the_body_by_its_lever():
    """More of M3, rear left: left side up, front down, and by its drag to the right."""
    state = bridge.quadrotor_hover()
    state[15] += 0.01
    spin = bridge.quadrotor_roll(state, np.tile([HOVER, HOVER, HOVER + 0.01, HOVER, VOLTAGE], (1, 1)), 1e-3)[-1, S["spin"]]
    expected = 0.01 * FULL * np.array([HALF, HALF, -KAPPA]) / INERTIA * 1e-3
    assert np.allclose(spin, expected, rtol=1e-3)


# ---- in closed loop, by free-body diagrams -----------------------------------------------------------

PAYLOAD, TRIM = (0.003, -0.02, 0.025), (3e-4, -2e-4, 4e-5)


def carried(mass, x, y):
    """Thrust (4) of the rotors that carry a weight at (x, y) beside the vehicle."""
    return (MASS + mass) * G / 4 + mass * G * (PLACES @ [x, y, 0]) / (4 * HALF**2)


STATIC = {
    "nominal": ([], np.full(4, MASS * G / 4)),
    "rotor3_thrust": ([("rotor3_thrust", (-0.1,))], MASS * G / 4 / np.array([1, 1, 0.9, 1])),
    "rotor1_thrust": ([("rotor1_thrust", (0.08,))], MASS * G / 4 / np.array([1.08, 1, 1, 1])),
    "thrust_gain": ([("thrust_gain", (-0.08,))], np.full(4, MASS * G / 4 / 0.92)),
    "payload": ([("payload", PAYLOAD)], carried(*PAYLOAD)),
    "slung_load": ([("slung_load", (0.003, 0.3, -0.02, 0.025))], carried(*PAYLOAD)),
    "trim": (
        [("trim", TRIM)],
        MASS * G / 4 + (-TRIM[0] * PLACES[:, 1] + TRIM[1] * PLACES[:, 0]) / (4 * HALF**2) - TRIM[2] * TURNS / (4 * KAPPA),
    ),
    "battery_sag": ([("battery_sag", (0.1,))], np.full(4, MASS * G / 4 / (1 - 0.1 * 18 / 20))),
}


@pytest.mark.parametrize("name", STATIC)
def test_requests_in_hover_carry_what_the_free_body_diagram_shows(name):
    effects, thrust = STATIC[name]
    active = [bridge.Effect(*effect) for effect in effects]
    log, states = bridge.quadrotor("hover", 20, 1, active, noise=0)
    rows = slice(1750, 1850)  # about 18 s
    expected = thrust / (FULL * (1 + SLOPE * (log.u[rows, 4].mean() - VOLTAGE)))
    assert np.abs(log.u[rows, :4].mean(axis=0) - expected).max() < 3e-4
    assert np.abs(states[rows, 2] - 0.5).max() < 0.02 and np.all(np.abs(angles(states[rows])).max(axis=0) < [1e-3, 1e-3, 5e-3])


def test_a_weak_rear_left_rotor_has_the_signs_of_the_labelled_flights():
    """More thrust, roll, yaw and less pitch are asked for, all by the same share (the battery sags more, too)."""
    log, _ = bridge.quadrotor("hover", 15, 1, [bridge.Effect("rotor3_thrust", (-0.1,))], noise=0)
    healthy, _ = bridge.quadrotor("hover", 15, 1, noise=0)
    more = (log.u - healthy.u)[1000:, :4].mean(axis=0)
    modes = np.array([[1, 1, 1, 1], [-1, -1, 1, 1], [1, -1, -1, 1], [1, -1, 1, -1]]) @ more
    assert np.allclose(modes / modes[0], [1, 1, -1, 1], atol=0.05) and modes[0] > 0.05


@pytest.mark.parametrize("more", [0.0, 0.5])
def test_wind_is_leant_into_by_its_drag(more):
    w = 2.0
    active = [bridge.Effect("wind", (w, -w)), bridge.Effect("drag", (more,))]
    log, states = bridge.quadrotor("hover", 25, 1, active, noise=0)
    lean = np.arctan((DRAG[0] + more) * w / G)
    roll, pitch, _ = angles(states[2300:]).mean(axis=0)
    assert pitch == pytest.approx(-lean, rel=0.03) and roll == pytest.approx(-lean, rel=0.03)
    assert np.abs(states[2300:, S["velocity"]]).max() < 0.01


@pytest.mark.parametrize(
    "manoeuvre, vehicle", [*((manoeuvre, "crazyflie") for manoeuvre in MANOEUVRES), ("mixed", "iris"), ("mixed", "racing")]
)
def test_all_effects_can_be_flown_at_their_usual_sizes(manoeuvre, vehicle):
    for name, (_, rows) in bridge.quadrotor_effects(vehicle).items():
        active = [bridge.Effect(name, tuple(row[4] for row in rows))]
        log, states = bridge.quadrotor(manoeuvre, 11, 3, active, vehicle=vehicle)
        assert np.abs(angles(states)[:, :2]).max() < 0.6, name
        assert np.abs(states[:, :2]).max() < 3 and states[:, 2].max() < 2.5, name


def test_effects_on_the_requests_are_their_formulas():
    """Delay and lag of the requests; what is done to the requests by hand gives the same."""
    state, commands = tumbling()
    dt, n = 0.01, np.arange(24)

    def rolled(name, *parameters):
        return bridge.quadrotor_roll(state, commands, dt, [bridge.Effect(name, parameters)])

    def by_hand(columns):
        return bridge.quadrotor_roll(state, np.column_stack([*columns, commands[:, 4]]), dt)

    requests = commands[:, :4].T
    late = [np.diff(np.interp(np.arange(25) - 2.5, np.arange(-3, 25), np.cumsum([0, u[0], u[0], u[0], *u]))) for u in requests]
    assert difference(rolled("transport_delay", 0.025), by_hand(late)) < 1e-9
    tau = 0.03
    response = 1 - tau / dt * np.exp(-n * dt / tau) * (1 - np.exp(-dt / tau))
    lagged = [u[0] + np.convolve(np.diff(u, prepend=u[0]), response)[:24] for u in requests]
    assert difference(rolled("motor_lag", tau), by_hand(lagged)) < 1e-8
    assert difference(by_hand(requests), by_hand(lagged)) > 1e-3


def test_sensor_effects_are_what_the_first_row_shows():
    """The first row, before the controller answers; the vehicle is level there, so that body and world agree."""
    first = lambda *active: bridge.quadrotor("hover", 1, 1, active, noise=0)[0].x[0]  # noqa: E731
    gyro, felt = (0.1, -0.05, 0.02), (0.5, -0.3, 0.2)
    off = first(bridge.Effect("gyro_bias", gyro), bridge.Effect("accel_bias", felt)) - first()
    expected = np.zeros(15)
    expected[12:], expected[6:9] = gyro, felt
    assert np.allclose(off, expected, atol=1e-12)
    names = platforms.COLUMNS["quadrotor"][5:]
    assert [names[i] for i in np.flatnonzero(expected)] == ["ax", "ay", "az", "gx", "gy", "gz"]
    rough = [
        np.diff(bridge.quadrotor("hover", 20, 1, [bridge.Effect("vibration", (a,))])[0].x[:, 6:9], axis=0).std(axis=0) for a in (1.0, 0.0)
    ]
    assert np.allclose(rough[0] / rough[1], 2, rtol=0.08)


# ---- the flight --------------------------------------------------------------------------------------


def test_a_seed_is_a_flight():
    for manoeuvre in MANOEUVRES:
        (log, states), (again, same), (other, _) = [bridge.quadrotor(manoeuvre, 5, seed) for seed in (1, 1, 2)]
        assert np.array_equal(log.x, again.x) and np.array_equal(log.u, again.u) and np.array_equal(states, same)
        assert np.std(log.x - other.x, axis=0).min() > 1e-4
    assert np.array_equal(bridge.quadrotor("mixed", 2, 1)[0].x, bridge.quadrotor("mixed", 4, 1)[0].x[:200])


def test_legs_go_there_and_back_as_the_labelled_flights_do():
    log, states = bridge.quadrotor("legs", 30, 1)
    x, u = log.x, log.u
    assert np.abs(x[:, 0] - [0] * len(x)).max() == pytest.approx(2, abs=0.05) and abs(x[-1, 0]) < 0.05
    assert x[:, 2].max() == pytest.approx(0.53, abs=0.04) and np.abs(x[:, 1]).max() < 0.1
    resting = u[:, :4].max(axis=1) == 0
    assert np.abs(states[resting & (log.t < 3), 2]).max() == 0 and np.abs(x[resting & (log.t < 3), 6:9]).max() < 0.5
    assert 0.3 < resting.mean() < 0.5
    there = (log.t > 6) & (log.t < 11)
    assert x[there, 3].mean() == pytest.approx(0.37, abs=0.06)
    assert u[there, 4].mean() < u[resting & (log.t < 3), 4].mean() - 0.2  # the battery sags under load


def test_mixed_excites_all_axes_and_depends_on_the_seed():
    flights = [bridge.quadrotor("mixed", 26, seed)[0].x for seed in (1, 2, 3)]
    for x in flights:
        assert np.ptp(np.unwrap(x[:, 11])) > 0.5 and np.ptp(x[:, 2]) > 0.5 and np.abs(x[:, 9:11]).max() > 0.15
        assert np.ptp(x[:, :2], axis=0).max() > 0.4
    assert np.std(flights[0] - flights[1], axis=0)[:3].min() > 0.05


def test_the_battery_runs_down_and_differs_between_flights():
    volts = [bridge.quadrotor("hover", 20, seed)[0].u[:, 4] for seed in range(8)]
    assert all(v[:200].mean() > v[-200:].mean() + 0.02 for v in volts)
    assert 0.05 < np.std([v.mean() for v in volts]) < 0.2


def test_requests_differ_between_healthy_flights_as_much_as_repeats_of_the_labelled_ones():
    means = np.array([bridge.quadrotor("hover", 20, seed)[0].u[300:, :4].mean(axis=0) for seed in range(12)])
    modes = means @ np.array([[-1, -1, 1, 1], [1, -1, -1, 1], [1, -1, 1, -1]]).T / 4
    assert np.all(np.std(modes, axis=0) > 0.0008) and np.all(np.std(modes, axis=0) < 0.006)


# ---- effects -----------------------------------------------------------------------------------------


def test_vocabulary():
    table = bridge.effects("quadrotor")
    assert {name: {row[0]: row[1] for row in rows} for name, (_, rows) in table.items()} == VOCABULARY
    assert tuple(table) == tuple(VOCABULARY) and [block for block, _ in table.values()] == BLOCKS
    for _, rows in table.values():
        for _, _, low, high, value in rows:
            assert low <= 0 < high and low <= value <= high and value != 0
    assert all(bridge.formulas("quadrotor").values())


def test_sizes_of_effects_go_with_mass_and_size_of_the_vehicle():
    small, large = bridge.effects("quadrotor"), bridge.quadrotor_effects("iris")
    v = bridge.quadrotor_vehicle("iris")
    by = {"kg": v["mass"] / MASS, "m": v["arm"] / 0.046, "N m": v["mass"] / MASS * v["arm"] / 0.046}
    for name, (_, rows) in small.items():
        for ours, theirs in zip(rows, large[name][1]):
            assert theirs[:2] == ours[:2] and np.allclose(theirs[2:], np.array(ours[2:]) * by.get(ours[1], 1))
    heavy = [bridge.Effect("payload", (0.3, 0.1, 0.0))]
    assert len(bridge.quadrotor("hover", 1, 1, heavy, vehicle="iris")[1]) == 100
    with pytest.raises(UserError, match=r"payload: mass is 0\.3, it must be between 0 and"):
        bridge.quadrotor("hover", 1, 1, heavy)


@pytest.mark.parametrize("names", [(name,) for name in VOCABULARY] + [tuple(VOCABULARY)], ids="+".join)
def test_all_zero_changes_no_bit(names):
    zeros = [bridge.Effect(name, (0.0,) * len(VOCABULARY[name])) for name in names]
    for nominal, ours in zip(bridge.quadrotor("mixed", 4, 3), bridge.quadrotor("mixed", 4, 3, zeros)):
        nominal, ours = (getattr(part, "x", part) for part in (nominal, ours))
        assert np.array_equal(nominal, ours)


@pytest.mark.parametrize("name", VOCABULARY)
def test_effect_acts_in_its_time(name):
    nominal, _ = bridge.quadrotor("mixed", 9, 4)
    log, _ = bridge.quadrotor("mixed", 9, 4, [bridge.usual_effect(name, 5.0, 8.0, "quadrotor")])
    assert np.array_equal(log.x[:500], nominal.x[:500]) and np.array_equal(log.u[:500], nominal.u[:500])
    assert np.abs(log.x - nominal.x)[500:800].max() > 1e-3


def test_order_given_by_the_caller_does_not_matter():
    active = usual(*VOCABULARY) + [bridge.usual_effect("wind", 1.0, 2.0, "quadrotor")]
    expected = bridge.quadrotor("mixed", 4, 1, active)[0].x
    for seed in range(3):
        mixed = np.random.default_rng(seed).permutation(len(active))
        assert np.array_equal(bridge.quadrotor("mixed", 4, 1, [active[i] for i in mixed])[0].x, expected)


# ---- what is refused -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("roll", 4, 1), "no manoeuvre named 'roll': use hover, legs or mixed"),
        (("hover", 301, 1), "the battery lasts 300 s"),
        (("hover", 4, -1), "seed is -1"),
        (("hover", 4, 1, (), -1), "noise is -1"),
        (("hover", 4, 1, [bridge.Effect("rotor1_thrust", (2.0,))]), "a is 2, it must be between"),
        (("hover", 4, 1, [bridge.Effect("gain", (0.1,))]), "no effect named 'gain'"),
        (("hover", 4, 1, (), 1.0, "kite"), "no vehicle 'kite': use crazyflie, iris, racing or a TOML file"),
        (("hover", 4, 1, (), 1.0, "kite.toml"), "kite.toml: cannot be read"),
        (("hover", 4, 1, (), 1.0, {"mass": 1.0}), "'arm' .m. is missing"),
        (("hover", 4, 1, (), 1.0, {"weight": 1.0}), "no parameter 'weight'; there are mass, arm"),
    ],
)
def test_bad_flight_is_refused(arguments, message):
    with pytest.raises(UserError, match=message):
        bridge.quadrotor(*arguments)


def test_a_vehicle_that_cannot_fly_is_refused():
    vehicle = bridge.quadrotor_vehicle()
    with pytest.raises(UserError, match="do not carry 0.2 kg"):
        bridge.quadrotor("hover", 1, 1, vehicle={**vehicle, "mass": 0.2})
    with pytest.raises(UserError, match="motor_lag is 9 s, it must be between"):
        bridge.quadrotor("hover", 1, 1, vehicle={**vehicle, "motor_lag": 9})
    with pytest.raises(UserError, match="'mass' is 'heavy', it must be a number"):
        bridge.quadrotor("hover", 1, 1, vehicle={**vehicle, "mass": "heavy"})


# ---- the command -----------------------------------------------------------------------------------------


def test_fly_writes_what_was_flown(tmp_path):
    given = "mixed", "--platform", "quadrotor", "--vehicle", "iris", "--seconds", "3", "--seed", "7", "--effect", "payload", "a/b.csv"
    done = processes.tinykoop("fly", *given, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "0.52 of full thrust in hover" in done.stdout.replace("\n", " ")
    log = bridge.read_log(tmp_path / "a/b.csv", "quadrotor")
    rows = bridge.quadrotor_effects("iris")["payload"][1]
    flown, _ = bridge.quadrotor("mixed", 3, 7, [bridge.Effect("payload", tuple(row[4] for row in rows))], vehicle="iris")
    assert np.array_equal(log.x, flown.x) and np.array_equal(log.u, flown.u) and log.usable.all()


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("pitch", "--platform", "quadrotor"), "no manoeuvre named 'pitch': use hover, legs or mixed"),
        (("legs",), "no manoeuvre named 'legs': use hover, pitch or yaw"),
        (("hover", "--vehicle", "iris"), "--vehicle: only for quadrotors; add --platform quadrotor"),
        (("hover", "--platform", "quadrotor", "--effect", "gain"), "no effect 'gain'; there are transport_delay"),
    ],
)
def test_bad_command_gets_one_line(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.setattr(sys, "argv", ["tinykoop", "fly", *arguments, str(tmp_path / "x.csv")])
    assert cli.main() == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_help_names_the_vehicles_that_there_are():
    assert all(name in cli.VEHICLES for name in bridge.vehicle_names())
    assert bridge.vehicle_names() == VEHICLES


# ---- beside real ones ------------------------------------------------------------------------------------


def test_statistics_are_of_the_size_of_the_labelled_flights():
    """Of a healthy Crazyflie, flown the same way: requests, battery, place, velocity, attitude within a factor of two."""
    file = ROOT.parent / "shared/data/crazyflie/flights/d021.usd"
    if not file.is_file():
        pytest.skip("the labelled flights are not there (../shared/data/crazyflie)")
    samples = {name: values for name, (_, values) in usd.open_log(file, False).samples.items()}
    real = np.column_stack(
        [np.mean([samples[f"motor.m{i}"] for i in (1, 2, 3, 4)], axis=0) / 65535, samples["pm.vbatMV"] / 1000]
        + [samples[f"stateEstimate.{name}"] * by for name, by in (("z", 1), ("vx", 1), ("vy", 1), ("ay", 9.81), ("roll", np.pi / 180))]
    )
    log, _ = bridge.quadrotor("legs", 26, 1)
    ours = np.column_stack([log.u[:, :4].mean(axis=1), log.u[:, 4], log.x[:, [2, 3, 4, 7, 9]]])
    real, ours = (rows[(rows[:, 2] > 0.4) & (np.abs(rows[:, 3]) > 0.15)] for rows in (real, ours))
    assert np.allclose(ours[:, :3].mean(axis=0) / real[:, :3].mean(axis=0), 1, atol=0.06)
    ratio = np.std(ours[:, 3:], axis=0) / np.std(real[:, 3:], axis=0)
    assert np.all(np.abs(np.log2(ratio)) < 1), ratio
