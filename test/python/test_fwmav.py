"""The flapping-wing vehicle against a second writing of its equations, integrated by SciPy, and against formulas.

The second writing works in the world's axes with a rotation matrix and angular momentum where the C code
takes a quaternion and Euler's equations in body axes, and has an adaptive integrator of eighth order.
"""

from itertools import combinations

import numpy as np
import processes
import pytest
from conftest import ROOT
from scipy.integrate import solve_ivp
from scipy.signal import welch
from scipy.spatial.transform import Rotation
from tinykoop import bridge
from tinykoop.plumbing.errors import UserError

S = bridge.FWMAV_STATE
# the order of action that effects.c documents, and the parameters' units
VOCABULARY = {
    "delay": {"delay": "s"},
    "lag": {"tau": "s"},
    "gain": {"a": "1"},
    "trim_bias": {"pitch": "rad", "yaw": "rad"},
    "battery_sag": {"loss_at_end": "1"},
    "asymmetry": {"c": "1"},
    "damping": {"a": "1"},
    "vibration": {"a": "1"},
    "gust": {"wx": "m/s", "wy": "m/s"},
    "gyro_bias": {"bx": "rad/s", "by": "rad/s", "bz": "rad/s"},
}
MANOEUVRES = ("hover", "pitch", "yaw")
STILL = bridge.Effect("vibration", (-1.0,))

# docs/flapping-wing.md
MASS, G, INERTIA, F0 = 0.026, 9.81, np.array([6.4e-5, 3.9e-5, 4.1e-5]), 17.0
ARM, HEIGHT, DRAG = 0.080, 0.027, np.array([4.3e-3, 2.7e-3, 1.0e-3])
MOTOR, BAND, ZETA, DISCHARGE = 0.08, 40.0, 0.63, 0.0005
# shaking: complex amplitudes [harmonic, axis], the real part of which goes with the cosine
SHAKE = np.array(
    [
        [-0.5 - 1.9j, -2.6 - 8.6j, 2.9 - 0.9j],
        [0.9 - 0.9j, 3.7 - 3.7j, 4.0 + 4.0j],
        [1.1 + 0.8j, -1.8 - 1.8j, 2.4 - 2.4j],
    ]
)
SWAY = np.array(
    [
        [1.2 - 0.4j, 0.1 + 0.3j, 2.6 - 1.0j],
        [-0.4 - 1.2j, 0.3 - 0.1j, -1.5 - 1.4j],
        [0.5 - 0.4j, -0.1 - 0.1j, 1.0 + 2.6j],
    ]
)
HARMONICS = np.arange(1, 4)[:, None]
_, Y, Z = np.eye(3)


def usual(*names):
    return [bridge.usual_effect(name, platform="fwmav") for name in names]


def euler(states):
    """Pitch, roll, yaw (K, 3) of true states."""
    q = np.atleast_2d(states)[:, S["attitude"]]
    return Rotation.from_quat(np.roll(q, -1, axis=1)).as_euler("ZYX")[:, [1, 2, 0]]


# ---- the second writing ------------------------------------------------------------------------


def cross(a, b):
    """np.cross() of two vectors, in a tenth of the time."""
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def turned(vector, axis, angle):
    """`vector` about a unit `axis`, by Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    return c * vector + s * cross(axis, vector) + (1 - c) * (axis @ vector) * axis


class Vehicle:
    """Position, velocity, angular momentum (3 each, world), rotation (3 x 3), beat, phase, three servos (2 each)."""

    def __init__(self, state):
        R = Rotation.from_quat(np.roll(state[S["attitude"]], -1)).as_matrix()
        L = R @ (INERTIA * state[S["spin"]])
        self.y = np.concatenate([state[:6], L, R.ravel(), state[13:]])
        self.t = 0.0

    def forces(self, y, damping=1.0, shaking=1.0, thrust=(1.0, 1.0), wind=(0.0, 0.0)):
        """Force and moment about the centre of mass, world."""
        v, L, R = y[3:6], y[6:9], y[9:18].reshape(3, 3)
        f, phase, dihedral, twist, share = y[18], y[19], y[20], y[22], y[24]
        w = R @ ((R.T @ L) / INERTIA)
        tones = (f / F0) ** 2 * np.exp(1j * HARMONICS * phase) * shaking
        # the sway's derivative at the nominal beat
        turn = np.sum(tones * 2j * np.pi * HARMONICS * F0 * SWAY, axis=0).real
        force, moment = R @ (MASS * np.sum(tones * SHAKE, axis=0).real), R @ (INERTIA * turn)
        for side, factor in zip((1, -1), thrust):
            at = R @ (turned(side * ARM * Y, Z, side * dihedral) + HEIGHT * Z)
            size = MASS * G / 2 * (f / F0) ** 2 * (1 + side * share) * factor
            lean = turned(size * Z, Y, -side * twist)
            wing = R @ (lean - damping * f * DRAG * (R.T @ (v - [*wind, 0] + cross(w, at))))
            force, moment = force + wing, moment + cross(at, wing)
        return force, moment

    def slope(self, y, command, voltage, **air):
        force, moment = self.forces(y, **air)
        R = y[9:18].reshape(3, 3)
        w = R.T @ y[6:9] / INERTIA
        turning = R @ [cross(axis, w) for axis in np.eye(3)]
        servos = [
            part for asked, (angle, rate) in zip(command[1:], y[20:].reshape(3, 2))
            for part in (rate, BAND**2 * (asked - angle) - 2 * ZETA * BAND * rate)
        ]  # fmt: skip
        return np.concatenate(
            [y[3:6], force / MASS - [0, 0, G], moment, turning.ravel(),
             [(command[0] * voltage - y[18]) / MOTOR, 2 * np.pi * y[18]], servos]
        )  # fmt: skip

    def go(self, command, dt, **air):
        """dt on under a held command; the voltage is that of the beginning."""
        voltage = 1 - DISCHARGE * self.t
        result = solve_ivp(lambda t, y: self.slope(y, command, voltage, **air), (0, dt), self.y, "DOP853", rtol=1e-9, atol=1e-10)
        self.y, self.t = result.y[:, -1], self.t + dt
        return self

    def state(self):
        """In the order of the C code."""
        R = self.y[9:18].reshape(3, 3)
        q = np.roll(Rotation.from_matrix(R).as_quat(canonical=True), 1)
        return np.concatenate([self.y[:6], q, R.T @ self.y[6:9] / INERTIA, self.y[18:]])

    def felt(self):
        """By an accelerometer in the centre of mass."""
        return self.y[9:18].reshape(3, 3).T @ self.forces(self.y)[0] / MASS


def difference(ours, theirs):
    """Largest one of states, quaternions and phases as angles."""
    difference = ours - theirs
    attitude = [Rotation.from_quat(np.roll(s[..., S["attitude"]], -1, axis=-1)) for s in (ours, theirs)]
    difference[..., S["phase"]] = np.angle(np.exp(1j * difference[..., S["phase"]]))
    difference[..., S["attitude"]] = 0
    return max(np.abs(difference).max(), np.max((attitude[0] * attitude[1].inv()).magnitude()))


class Pilot:
    """The flight controller, with matrices: Mahony's estimate, three PID loops, height hold. No manoeuvre."""

    def __init__(self):
        self.R, self.bias, self.sums, self.rates = np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3)

    def look(self, gyro, accelerometer):
        """Takes in a measurement; returns pitch, roll, yaw, yaw rate as estimated."""
        off = np.cross(accelerometer / np.linalg.norm(accelerometer), self.R[2])
        self.bias += 0.001 * off * 0.002
        self.rate = gyro + self.bias
        # an Euler step of the unit quaternion turns by twice the arctangent of half the angle
        turn = (self.rate + 0.4 * off) * 0.002
        half = np.linalg.norm(turn) / 2
        self.R = self.R @ Rotation.from_rotvec(turn * np.arctan(half) / half).as_matrix()
        yaw, self.pitch, self.roll = Rotation.from_matrix(self.R).as_euler("ZYX")
        self.yaw = yaw
        yaw_rate = self.rate[1] * np.sin(self.roll) / np.cos(self.pitch)
        yaw_rate += self.rate[2] * np.cos(self.roll) / np.cos(self.pitch)
        return self.pitch, self.roll, yaw, yaw_rate

    def command(self, state):
        """Beat (Hz), dihedral, twist (rad), share."""
        cutoff, rate = np.array([20, 5, 20]), self.rate[[1, 2, 0]]
        self.rates += (1 - np.exp(-2 * np.pi * cutoff * 0.002)) * (rate - self.rates)
        off, most = -np.array([self.pitch, self.yaw, self.roll]), np.array([0.31, 0.5, 0.3])
        self.sums = np.clip(self.sums + np.array([0.1, 0.1, 0.5]) * off * 0.002, -most / 2, most / 2)
        servos = np.clip([0.25, 0.3, 0.4] * off + self.sums - [0.04, 0.01, 0.05] * self.rates, -most, most)
        share = np.clip(1 - 0.4 * state[2] - 0.3 * state[5], 0.6, 1.4)
        return [F0 * np.sqrt(share), *servos]


# ---- the vehicle -------------------------------------------------------------------------------


def tumbling():
    """A state that hovers nowhere, and commands (200, 4) of 10 ms."""
    random = np.random.default_rng(0)
    state = bridge.fwmav_hover()
    state[S["velocity"]], state[S["spin"]], state[S["phase"]] = (0.3, -0.2, 0.1), (1, -2, 3), 1.2
    commands = np.column_stack([random.uniform(15, 19, 20), random.uniform(-0.2, 0.2, (20, 3))])
    return state, np.repeat(commands, 10, axis=0)


def test_vehicle_is_its_equations():
    """2 s of tumbling, at up to 20 rad/s."""
    state, commands = tumbling()
    vehicle = Vehicle(state)
    theirs = np.array([vehicle.state()] + [vehicle.go(command, 0.01).state() for command in commands])
    assert difference(bridge.fwmav_roll(state, commands, 0.01), theirs) < 1e-5
    assert np.abs(theirs[:, S["spin"]]).max() > 10


@pytest.mark.parametrize(
    "effect, air",
    [
        (bridge.Effect("damping", (0.4,)), {"damping": 1.4}),
        (bridge.Effect("vibration", (0.7,)), {"shaking": 1.7}),
        (bridge.Effect("asymmetry", (0.1,)), {"thrust": (1.1, 0.9)}),
        (bridge.Effect("gust", (0.7, -0.4)), {"wind": (0.7, -0.4)}),
    ],
)
def test_effect_of_the_air_is_its_formula(effect, air):
    state, commands = tumbling()
    vehicle, commands = Vehicle(state), commands[:30]
    theirs = np.array([vehicle.state()] + [vehicle.go(command, 0.01, **air).state() for command in commands])
    ours = bridge.fwmav_roll(state, commands, 0.01, [effect])
    assert difference(ours, theirs) < 1e-5
    assert difference(ours, bridge.fwmav_roll(state, commands, 0.01)) > 1e-2


def test_controller_in_the_loop_is_its_equations():
    """2 s of a flight without chance, in wind and out of trim, sample by sample: measured, estimated, commanded, true."""
    wind, trim = (0.6, -0.4), (0.05, 0.03)
    active = [bridge.Effect("gust", wind), bridge.Effect("trim_bias", trim)]
    log, states = bridge.fwmav("hover", 2, 5, active, noise=0)
    vehicle, pilot = Vehicle(states[0]), Pilot()
    for tick in range(1000):
        state = vehicle.state()
        felt = vehicle.y[9:18].reshape(3, 3).T @ vehicle.forces(vehicle.y, wind=wind)[0] / MASS
        angles = pilot.look(state[S["spin"]], felt)
        command = pilot.command(state)
        if tick % 5 == 0:
            k = tick // 5
            assert np.abs(log.x[k] - [*state[S["spin"]], *felt, *angles]).max() < 1e-5
            assert abs(log.u[k, 0] - command[1]) < 1e-5
            assert difference(states[k], state) < 1e-5
        command[1], command[2] = command[1] + trim[0], command[2] + trim[1]
        vehicle.go(command, 0.002, wind=wind)
    assert np.abs(log.x[:, 6:8]).max() > 0.05


def test_a_body_without_wing_beat_keeps_momentum_and_energy():
    state = bridge.fwmav_hover()
    state[S["beat"]], state[S["spin"]], state[S["velocity"]] = 0, (3, 5, -4), (1, 2, 3)
    states = bridge.fwmav_roll(state, np.zeros((1000, 4)), 0.01)
    spin = states[:, S["spin"]]
    q = Rotation.from_quat(np.roll(states[:, S["attitude"]], -1, axis=1))
    momentum, energy = q.apply(INERTIA * spin), np.sum(INERTIA * spin**2, axis=1)
    assert np.abs(momentum / np.linalg.norm(momentum[0]) - momentum[0] / np.linalg.norm(momentum[0])).max() < 1e-6
    assert np.abs(energy / energy[0] - 1).max() < 1e-6
    assert np.ptp(spin, axis=0).max() > 5  # it tumbles
    t = np.arange(1001)[:, None] * 0.01
    assert np.abs(states[:, S["velocity"]] - ([1, 2, 3] - t * [0, 0, G])).max() < 1e-9


def held_beat(steps, dt, f=F0):
    """Commands that hold the wing-beat frequency while the battery goes down."""
    commands = np.zeros((steps, 4))
    commands[:, 0] = f / (1 - DISCHARGE * np.arange(steps) * dt)
    return commands


def test_hover_is_an_equilibrium():
    states = bridge.fwmav_roll(bridge.fwmav_hover(), held_beat(200, 0.01), 0.01, [STILL])
    states[:, S["phase"]] = 0
    assert np.abs(states - bridge.fwmav_hover()).max() < 1e-9


@pytest.mark.parametrize("f", [10.0, F0, 24.0])
def test_damping_has_the_time_constant_of_the_linearised_vehicle(f):
    """Of yaw and of climbing; both go with the wing-beat frequency."""
    dt = 0.001
    state = bridge.fwmav_hover()
    state[S["beat"]] = f
    for index, rate in ((12, 2 * f * DRAG[0] * ARM**2 / INERTIA[2]), (5, 2 * f * DRAG[2] / MASS)):
        moved = state.copy()
        moved[index] += 1e-3
        pair = [bridge.fwmav_roll(s, held_beat(100, dt, f), dt, [STILL])[:, index] for s in (moved, state)]
        assert np.allclose((pair[0] - pair[1]) / 1e-3, np.exp(-rate * dt * np.arange(101)), rtol=1e-4)


def test_speed_pushes_the_nose_up():
    """Drag acts above the centre of mass: what makes such vehicles unstable without control."""
    state = bridge.fwmav_hover()
    state[S["velocity"]] = 0.5, 0, 0
    pitch_rate = bridge.fwmav_roll(state, held_beat(1, 0.001), 0.001, [STILL])[-1, 11]
    assert pitch_rate == pytest.approx(-2 * F0 * DRAG[0] * 0.5 * HEIGHT / INERTIA[1] * 0.001, rel=0.01)


@pytest.mark.parametrize("command, axis, arm", [(1, 1, ARM), (2, 2, ARM), (3, 0, ARM)])
def test_a_servo_turns_its_axis(command, axis, arm):
    """Positive dihedral tips forward, positive twist turns left, positive share rolls right; by thrust times arm."""
    commands = held_beat(10, 0.01)
    commands[:, command] = 0.01
    states = bridge.fwmav_roll(bridge.fwmav_hover(), commands, 0.01, [STILL])
    index = S[("dihedral", "twist", "share")[command - 1]]
    damping = [2 * F0 * (DRAG[2] * ARM**2 + DRAG[1] * HEIGHT**2), 2 * F0 * DRAG[0] * HEIGHT**2, 2 * F0 * DRAG[0] * ARM**2]
    rate, expected = 0.0, []
    fine = np.repeat(states[:-1, index], 10)  # 1 ms, the servo's own response taken as it is
    servo = np.interp(np.arange(len(fine)) * 0.001, np.arange(len(states)) * 0.01, states[:, index])
    for angle in servo:
        rate += 0.001 * (MASS * G * arm * angle - damping[axis] * rate) / INERTIA[axis]
        expected.append(rate)
    assert states[-1, 10 + axis] == pytest.approx(expected[-1], rel=0.1)
    others = [i for i in range(3) if i != axis]
    assert np.all(np.abs(states[:, 10:13][:, others]) < 0.02 * rate)


# ---- the flight --------------------------------------------------------------------------------


def test_a_seed_is_a_flight():
    for manoeuvre in MANOEUVRES:
        (log, states), (again, same), (other, _) = [bridge.fwmav(manoeuvre, 5, seed) for seed in (1, 1, 2)]
        assert np.array_equal(log.x, again.x) and np.array_equal(log.u, again.u) and np.array_equal(states, same)
        assert np.abs(np.corrcoef(log.x[:, 3], other.x[:, 3])[0, 1]) < 0.9
        assert np.std(log.x - other.x, axis=0).min() > 1e-3
    assert np.array_equal(bridge.fwmav("pitch", 2, 1)[0].x, bridge.fwmav("pitch", 4, 1)[0].x[:200])


def test_the_manoeuvre_changes_with_the_seed():
    flights = [euler(bridge.fwmav(manoeuvre, 20, seed)[1]) for manoeuvre in MANOEUVRES for seed in (1, 2, 3)]
    pitch, yaw = np.array([f[:, 0] for f in flights]), np.unwrap([f[:, 2] for f in flights], axis=1)
    assert np.all(np.abs(pitch[3:6]).max(axis=1) > 0.12) and np.all(np.abs(pitch[:3]).max(axis=1) < 0.12)
    assert np.all(np.ptp(yaw[6:], axis=1) > 0.5) and np.all(np.ptp(yaw[:6], axis=1) < 0.4)
    for rows in (pitch[3:6], yaw[6:]):
        assert all(np.std(a - b) > 0.05 for a, b in combinations(rows, 2))
    climbed = [bridge.fwmav(manoeuvre, 20, 1)[1][-1, 2] for manoeuvre in MANOEUVRES]
    assert climbed[1] > 3 and abs(climbed[0]) < 0.5 and abs(climbed[2]) < 0.5


def test_the_command_answers_the_attitude():
    log, _ = bridge.fwmav("hover", 40, 1)
    assert np.corrcoef(log.u[:, 0], log.x[:, 6])[0, 1] < -0.2
    assert 0.002 < log.u.std() < 0.1
    log, _ = bridge.fwmav("yaw", 40, 1)
    speed = np.convolve(log.x[:, 9], np.ones(25) / 25, "same")
    lagged = [np.corrcoef(log.u[: -20 or None, 0], np.roll(speed, -k)[:-20])[0, 1] for k in range(20)]
    assert max(lagged) > 0.4


@pytest.mark.parametrize("manoeuvre", ["hover", "pitch"])
def test_shaking_folds_down_to_where_it_must(manoeuvre):
    """Harmonics of the wing beat, at |f - k fs| in the spectrum of a 100-Hz log."""
    log, states = bridge.fwmav(manoeuvre, 40, 1, noise=0)
    beat = states[300:, S["beat"]].mean()
    frequency, power = welch(log.x[300:, 2], 100, nperseg=1000)
    for harmonic in (1, 2, 3):
        folded = abs(harmonic * beat - 100 * round(harmonic * beat / 100))
        near = np.abs(frequency - folded) < 6
        assert frequency[near][np.argmax(power[near])] == pytest.approx(folded, abs=0.4)
        assert power[near].max() > 100 * np.median(power)
    assert 3 * beat > 50  # so one of them does fold


@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_the_estimate_stays_near_the_truth(manoeuvre):
    for seed in (1, 2, 3):
        log, states = bridge.fwmav(manoeuvre, 40, seed)
        error = log.x[:, 6:9] - euler(states)
        assert np.abs(error[:, :2]).max() < 0.15
        # yaw is the gyro's integral: it drifts as its bias does
        drift = np.polyfit(log.t, np.unwrap(error[:, 2]), 1)[0]
        assert abs(drift) < 0.03 and np.abs(error[:, :2]).max() > 1e-4


def test_a_gyro_bias_tilts_the_estimate_by_its_share_of_the_gain():
    """Mahony's filter: bias / gain (0.4 per second), before its integral has learned much."""
    for axis, angle in ((1, 0), (0, 1)):
        bias = np.zeros(3)
        bias[axis] = 0.03
        (log, states), (still, _) = [
            bridge.fwmav("hover", 30, 1, [STILL, bridge.Effect("gyro_bias", tuple(b))], noise=0) for b in (bias, 0 * bias)
        ]
        error = log.x[1500:, 6:8] - euler(states)[1500:, :2]
        assert error[:, angle].mean() == pytest.approx(0.03 / 0.4, rel=0.1)
        assert np.abs(error[:, 1 - angle]).max() < 0.01
        first = np.zeros(6)
        first[axis] = 0.03
        assert np.allclose(log.x[0, :6] - still.x[0, :6], first, rtol=0, atol=1e-15)


# ---- effects -----------------------------------------------------------------------------------


def test_vocabulary():
    table = bridge.effects("fwmav")
    assert {name: {row[0]: row[1] for row in rows} for name, (_, rows) in table.items()} == VOCABULARY
    assert tuple(table) == tuple(VOCABULARY)
    assert [block for block, _ in table.values()] == ["actuator"] * 4 + ["plant"] * 5 + ["sensor"]
    for _, rows in table.values():
        for _, _, low, high, value in rows:
            assert low <= 0 < high and low <= value <= high and value != 0
    with pytest.raises(UserError, match="no platform named 'boat'"):
        bridge.effects("boat")


@pytest.mark.parametrize("names", [(name,) for name in VOCABULARY] + [tuple(VOCABULARY)])
def test_all_zero_changes_no_bit(names):
    zeros = [bridge.Effect(name, (0.0,) * len(VOCABULARY[name])) for name in names]
    for manoeuvre in MANOEUVRES:
        for nominal, ours in zip(bridge.fwmav(manoeuvre, 4, 3), bridge.fwmav(manoeuvre, 4, 3, zeros)):
            nominal, ours = (getattr(part, "x", part) for part in (nominal, ours))
            assert np.array_equal(nominal, ours)


@pytest.mark.parametrize("name", VOCABULARY)
def test_effect_acts_in_its_time_and_can_be_flown(name):
    nominal, states = bridge.fwmav("pitch", 20, 4)
    log, _ = bridge.fwmav("pitch", 20, 4, [bridge.usual_effect(name, 5.0, 8.0, "fwmav")])
    assert np.array_equal(log.x[:500], nominal.x[:500]) and np.array_equal(log.u[:500], nominal.u[:500])
    gap = np.abs(log.x - nominal.x)[:, 6:9].max(axis=1)
    assert gap[500:800].max() > 1e-3
    always, true = bridge.fwmav("pitch", 20, 4, usual(name))
    assert np.abs(euler(true)[:, :2]).max() < 0.6  # its controller copes


@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_order_given_by_the_caller_does_not_matter(manoeuvre):
    active = usual(*VOCABULARY) + [bridge.usual_effect("gust", 1.0, 2.0, "fwmav")]
    expected = bridge.fwmav(manoeuvre, 4, 1, active)[0].x
    for seed in range(4):
        mixed = np.random.default_rng(seed).permutation(len(active))
        assert np.array_equal(bridge.fwmav(manoeuvre, 4, 1, [active[i] for i in mixed])[0].x, expected)


@pytest.mark.parametrize("yaw", [False, True])
def test_effects_of_the_command_are_their_formulas(yaw):
    """Gain, delay and lag act on the command that the log holds, trim on both; then what is done to the command
    by hand gives the same."""
    state, commands = tumbling()
    axis, dt = (2 if yaw else 1), 0.01

    def rolled(name, *parameters):
        return bridge.fwmav_roll(state, commands, dt, [bridge.Effect(name, parameters)], yaw)

    def by_hand(column):
        changed = commands.copy()
        changed[:, axis] = column
        return bridge.fwmav_roll(state, changed, dt)

    u = commands[:, axis]
    assert difference(rolled("gain", -0.3), by_hand(0.7 * u)) < 1e-9
    late = np.interp(np.arange(201) - 2.5, np.arange(-3, 201), np.cumsum([0, u[0], u[0], u[0], *u]))
    assert difference(rolled("delay", 0.025), by_hand(np.diff(late))) < 1e-9
    n, tau = np.arange(200), 0.03
    response = 1 - tau / dt * np.exp(-n * dt / tau) * (1 - np.exp(-dt / tau))
    assert difference(rolled("lag", tau), by_hand(u[0] + np.convolve(np.diff(u, prepend=u[0]), response)[:200])) < 1e-8
    trimmed = bridge.fwmav_roll(state, commands + [0, 0.04, -0.02, 0], dt)
    assert difference(rolled("trim_bias", 0.04, -0.02), trimmed) < 1e-9
    part = [bridge.Effect("trim_bias", (0.04, -0.02), 0.5, 1.0)]
    now = ((np.arange(200) >= 50) & (np.arange(200) < 100))[:, None]
    trimmed = bridge.fwmav_roll(state, commands + now * [0, 0.04, -0.02, 0], dt)
    assert difference(bridge.fwmav_roll(state, commands, dt, part, yaw), trimmed) < 1e-9
    assert difference(by_hand(u), by_hand(0.7 * u)) > 0.01


def test_sag_lowers_the_beat_and_with_its_square_the_thrust():
    """The command held, the voltage falls linearly: by DISCHARGE, and by the share at the end."""
    steps, dt, loss = 1000, 0.01, 0.1
    commands = np.tile([F0, 0, 0, 0], (steps, 1))
    states = bridge.fwmav_roll(bridge.fwmav_hover(), commands, dt, [STILL, bridge.Effect("battery_sag", (loss,))])
    t = np.arange(steps + 1) * dt - MOTOR  # a ramp passes the motor's lag late by its time constant
    expected = F0 * (1 - DISCHARGE * t) * (1 - loss * t / (steps * dt))
    assert np.abs(states[100:, S["beat"]] - expected[100:]).max() < 0.005 * F0
    climb = states[:, 5]
    thrust = np.gradient(climb, dt) + G + 2 * states[:, 13] * DRAG[2] / MASS * climb  # per mass
    assert np.allclose(thrust[100:-1] / G, (states[100:-1, 13] / F0) ** 2, rtol=1e-3)
    # in flight the height hold asks for more, and gets it at the price of height
    sets = ([STILL], [STILL, *usual("battery_sag")])
    heights = [bridge.fwmav("hover", 30, 1, active, noise=0)[1][-1, 2] for active in sets]
    voltage = 1 - DISCHARGE * 30
    for height, left in zip(heights, (voltage, voltage * (1 - usual("battery_sag")[0].parameters[0]))):
        assert height == pytest.approx(-(left**-2 - 1) / 0.4, rel=0.05)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("roll", 4, 1), "no manoeuvre named 'roll'"),
        (("hover", 301, 1), "the battery lasts 300 s"),
        (("hover", float("nan"), 1), "cannot be flown"),
        (("hover", 4, -1), "seed is -1"),
        (("hover", 4, 1, (), -1), "noise is -1"),
        (("hover", 4, 1, [bridge.Effect("gain", (9.0,))]), "a is 9, it must be between"),
        (("hover", 4, 1, [bridge.Effect("gain", ())]), "0 parameters are given, it takes 1"),
        (("hover", 4, 1, [bridge.Effect("speed_gain", (0.1,))]), "no effect named 'speed_gain'"),
    ],
)
def test_bad_flight_is_refused(arguments, message):
    with pytest.raises(UserError, match=message):
        bridge.fwmav(*arguments)


# ---- the command -------------------------------------------------------------------------------


def fly(folder, *arguments):
    return processes.tinykoop("fly", *arguments, cwd=folder)


def test_fly_writes_what_was_flown(tmp_path):
    done = fly(tmp_path, "yaw", "--seconds", "3", "--seed", "7", "--effect", "gust=0.5,0.1@1,2", "--effect", "lag", "a/b.csv")
    assert done.returncode == 0, done.stderr
    log = bridge.read_log(tmp_path / "a/b.csv", "fwmav")
    active = [bridge.Effect("gust", (0.5, 0.1), 1, 2), *usual("lag")]
    flown, _ = bridge.fwmav("yaw", 3, 7, active)
    assert np.array_equal(log.x, flown.x) and np.array_equal(log.u, flown.u) and np.allclose(log.t, flown.t)
    assert log.usable.all() and log.dt == pytest.approx(0.01)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("--effect", "gain=x"), "'x' is not a number"),
        (("--effect", "foo"), "there is no effect 'foo'; there are delay"),
        (("--effect", "gust=1"), "gust takes wx (m/s), wy (m/s), and 1 numbers are given"),
        (("--effect", "gain=5"), "a is 5, it must be between"),
        (("--effect", "gain@3"), "after @ come the times"),
        (("--effect", "gain@9,3"), "after @ come the times"),
        (("--seconds", "-1"), "cannot be flown"),
    ],
)
def test_bad_command_gets_one_line(tmp_path, arguments, message):
    done = fly(tmp_path, "pitch", *arguments, "x.csv")
    assert done.returncode == 2 and message in done.stderr and done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


# ---- beside a real one -------------------------------------------------------------------------


def test_statistics_are_of_the_size_of_a_real_vehicles():
    """A 103-g vehicle of this kind: shaking, attitude and command within a factor of two."""
    folder = ROOT.parent / "shared/data/flapper"
    if not folder.is_dir():
        pytest.skip("the real flights are not there (../shared/data/flapper)")
    real = bridge.read_log(folder / "hover_no_wind.csv", "fwmav")
    ours, _ = bridge.fwmav("hover", 40, 1)
    ratio = np.append(np.std(ours.x, axis=0), ours.u.std()) / np.append(np.std(real.x, axis=0), real.u.std())
    yaw = 8  # the real one's wraps
    assert np.all(np.abs(np.log2(np.delete(ratio, yaw))) < 1), ratio
