"""Logs of quadrotors: an analytic flight is written as each autopilot logs it, and must come back in the contract's columns.

Where the rotors are is written here by the airframe pages of the autopilots, and the pulse widths by the firmwares'
laws from thrust to output, of which the converter has the inverse.
"""

import csv

import numpy as np
import pytest
from test_convert import (
    DEG,
    ROOT,
    TURN,
    attitude,
    check,
    check_held,
    crazyflie_variables,
    flight,
    refused,
    ros,
    us,
    usd_event,
    wrap,
    write_bag,
    write_crazyflie,
    write_ulog,
    write_usd,
)
from test_convert_ardupilot import attitude as att
from test_convert_ardupilot import write as write_bin
from tinykoop import bridge, convert, platforms
from tinykoop.convert import crazyflie, usd
from tinykoop.plumbing.errors import UserError

G = 9.80665
T = np.arange(600) / 100
MOTORS = ("m1", "m2", "m3", "m4")
PLACES = ("front right", "rear right", "rear left", "front left")  # of m1 .. m4
PX4 = ("front right", "rear left", "front left", "rear right")  # of its motors 1 .. 4, in its quadrotor X; ArduPilot's too
NOT_STATES = (*MOTORS, "vbat")
DATA = ROOT.parent / "shared/data/crazyflie"

# ---- the flight ------------------------------------------------------------------------------------


def quad(t):
    """Position and its derivatives in the world, attitude and body rates; motors step every 0.23 s, the battery every 0.5 s."""
    m = flight(t)
    n, b = np.floor(t / 0.23 + 0.0137), np.floor(t / 0.5 + 0.0137)
    motors = {motor: 0.5 + 0.4 * np.sin(1.7 * n + k) for k, motor in enumerate(MOTORS)}
    return {name: m[name] for name in ("roll", "pitch", "yaw", "gx", "gy", "gz")} | motors | {
        "px": 2 * np.sin(0.5 * t), "vx": np.cos(0.5 * t), "ax": -0.5 * np.sin(0.5 * t),
        "py": 3 * np.cos(0.4 * t), "vy": -1.2 * np.sin(0.4 * t), "ay": -0.48 * np.cos(0.4 * t),
        "pz": 1 + 0.5 * np.sin(t), "vz": 0.5 * np.cos(t), "az": -0.5 * np.sin(t),
        "vbat": 12.5 - 0.1 * b,
    }  # fmt: skip


def in_order(m, places):
    """(rows, 4): the thrust of the motors in the order of their places."""
    return np.stack([m[MOTORS[PLACES.index(place)]] for place in places], axis=1)


def quad_variables(m):
    """As the Crazyflie logs them; its accelerations are in g and without gravity, its thrust is of 65535."""
    return {
        **{f"stateEstimate.{a}": m[f"p{a}"] for a in "xyz"},
        **{f"stateEstimate.v{a}": m[f"v{a}"] for a in "xyz"},
        **{f"stateEstimate.a{a}": m[f"a{a}"] / G for a in "xyz"},
        "stateEstimate.roll": m["roll"] / DEG, "stateEstimate.pitch": -m["pitch"] / DEG, "stateEstimate.yaw": wrap(m["yaw"]) / DEG,
        **{f"gyro.{a}": m[f"g{a}"] / DEG for a in "xyz"},
        **{f"motor.{motor}": m[motor] * 65535 for motor in MOTORS},
        **{f"pwm.{motor}_pwm": 0 * m[motor] + 77 for motor in MOTORS},
        "pm.vbatMV": m["vbat"] * 1e3,
    }  # fmt: skip


def ulog_quad(t, **given):
    """Position, attitude and rates of PX4, in NED and FRD, with a command of the motors 3 ms later."""
    m = quad(t)
    rates = np.stack([m[f"g{a}"] for a in "xyz"], axis=1) @ TURN
    where = {f"float {k}{a}": m[f"{c}{a}"] * s for k, c in (("", "p"), ("v", "v"), ("a", "a")) for a, s in zip("xyz", (1, -1, -1))}
    return [
        ("vehicle_local_position", 0, {"uint64_t timestamp": us(t)} | where | given),
        ("vehicle_attitude", 0, {"uint64_t timestamp": us(t), "float[4] q": attitude(m, TURN)}),
        ("vehicle_angular_velocity", 0, {"uint64_t timestamp": us(t), "float[3] xyz": rates}),
        ("battery_status", 0, {"uint64_t timestamp": us(t[::50]), "float voltage_v": m["vbat"][::50]}),
    ]


def px4_motors(t, places=PX4, late=0.003):
    return "actuator_motors", 0, {"uint64_t timestamp": us(t + late), "float[4] control": in_order(quad(t), places)}


def px4_outputs(t, factor, low, high, at=(1, 2, 3, 4)):
    """Pulses from the model of THR_MDL_FAC, thrust = f x^2 + (1 - f) x, on the channels that the four motors have."""
    x = ((factor - 1) + np.sqrt((1 - factor) ** 2 + 4 * factor * in_order(quad(t), PX4))) / (2 * factor)
    pulses = np.full((len(t), 16), 900.0)
    for k, channel in enumerate(at):
        pulses[:, channel - 1] = low[k] + x[:, k] * (high[k] - low[k])
    return "actuator_outputs", 0, {"uint64_t timestamp": us(t), "float[16] output": pulses}


def bin_quad(t):
    """Filter, attitude, one IMU and battery of ArduPilot."""
    m = quad(t)
    rates = np.stack([m[f"g{a}"] for a in "xyz"], axis=1) @ TURN
    where = {f"{k}{end}": m[f"{c}{a}"] * s for k, c in (("V", "v"), ("P", "p")) for end, a, s in zip("NED", "xyz", (1, -1, -1))}
    force = dict.fromkeys(("AccX", "AccY", "AccZ"), 5 + 0 * t)
    return [
        ("XKF1", "QBffffff", {"TimeUS": us(t), "C": 0 * us(t)} | where, 1),
        att(t, m),
        ("IMU", "QBffffff", {"TimeUS": us(t), "I": 0 * us(t)} | dict(zip(("GyrX", "GyrY", "GyrZ"), rates.T)) | force, 1),
        ("BAT", "QBf", {"TimeUS": us(t[::50]), "Inst": 0 * us(t[::50]), "Volt": m["vbat"][::50]}, 1),
    ]


SPIN = {"MOT_PWM_MIN": 1050, "MOT_PWM_MAX": 1950, "MOT_SPIN_MIN": 0.15, "MOT_SPIN_MAX": 0.95, "MOT_THST_EXPO": 0.65}


def rcou(t, places=PX4, at=(1, 2, 3, 4), voltage=1.0, expo=0.65):
    """Pulses of ArduPilot by SPIN, in whole us: compensated voltage, thrust curve, range of the motors."""
    lift = voltage * (1 - expo) + expo * voltage**2
    thrust = in_order(quad(t), places) * np.reshape(lift, (-1, 1))
    speed = thrust if expo == 0 else ((expo - 1) + np.sqrt((1 - expo) ** 2 + 4 * expo * thrust)) / (2 * expo)
    pulses = 1050 + 900 * (0.15 + 0.8 * speed / np.reshape(voltage, (-1, 1)))
    columns = {f"C{n}": us(0 * t) + 1100 for n in range(1, 9)}
    columns |= {f"C{n}": np.round(pulses[:, k]).astype(int) for k, n in enumerate(at)}
    return "RCOU", "QHHHHHHHH", {"TimeUS": us(t)} | columns, None


def parm(**values):
    names = np.array([name.encode() for name in values])
    return (
        "PARM",
        "QNff",
        {"TimeUS": np.arange(len(names)), "Name": names, "Value": list(values.values()), "Default": [0] * len(names)},
        None,
    )


# ---- the judges ------------------------------------------------------------------------------------


class Result:
    """A converted file by NumPy; the project's reader takes it, too."""

    def __init__(self, path):
        table = np.genfromtxt(path, delimiter=",", names=True)
        self.names = table.dtype.names[1:-2]
        assert table.dtype.names == ("t", *(c for c in platforms.COLUMNS["quadrotor"] if c in self.names), "seg", "pose_ok")
        assert platforms.of_log(path) == "quadrotor"
        assert len(bridge.read_log(path, "quadrotor").t) == len(table)
        self.t, self.seg, self.ok = table["t"], table["seg"].astype(int), table["pose_ok"] == 1
        self.columns = {name: table[name] for name in self.names}


def run(source, **options):
    out = source.parent / "out.csv"
    convert.run(source, out, "quadrotor", **options)
    return Result(out)


def check_motors(result, t, tolerance=1e-6):
    """Each motor is at its place, and each row has its last command."""
    for name in MOTORS:
        index = np.searchsorted(t, result.t + 1e-7, side="right") - 1
        assert np.abs(result.columns[name] - quad(t)[name][index]).max() < tolerance, name


# ---- Crazyflie -------------------------------------------------------------------------------------


def test_usd_has_every_column_and_takes_the_thrust_that_is_asked_for(tmp_path):
    result = run(write_usd(tmp_path / "log00", [usd_event(T, quad_variables(quad(T)))]))
    assert set(result.names) == set(platforms.COLUMNS["quadrotor"])
    check(result, 0.0, quad, 3e-6, but=NOT_STATES)
    check_motors(result, T)
    check_held(result, 0.0, "vbat", T, quad(T)["vbat"])


@pytest.mark.parametrize(
    "without", (["stateEstimate.pitch", "gyro.x", "gyro.y", "gyro.z"], ["stateEstimate.x"], ["pm.vbatMV", "stateEstimate.az"])
)
def test_what_a_log_lacks_is_not_in_the_csv(tmp_path, capsys, without):
    some = {name: values for name, values in quad_variables(quad(T)).items() if name not in without}
    result = run(write_usd(tmp_path / "log00", [usd_event(T, some)]))
    assert len(result.names) == 20 - len(without) and len(result.t) == len(T)
    check(result, 0.0, quad, 3e-6, but=NOT_STATES)
    absent = [c for c in platforms.COLUMNS["quadrotor"] if c not in result.names]
    assert f"The log lacks {', '.join(absent)}." in capsys.readouterr().out


def test_cfclient_session_of_several_blocks(tmp_path):
    folder, every = tmp_path / "session", quad_variables(quad(T))
    folder.mkdir()
    names = list(every)
    for i in range(0, len(names), 6):
        write_crazyflie(folder / f"{i}.csv", np.round(T * 1e3), {name: every[name] for name in names[i : i + 6]})
    result = run(folder)
    check(result, 0.0, quad, but=NOT_STATES)
    check_motors(result, T)


def test_compressed_state_of_a_crazyflie_has_no_vertical_acceleration(tmp_path):
    """stateEstimateZ.az includes gravity, and the others are in mm/s^2."""
    m = quad(T)
    some = {name: values for name, values in quad_variables(m).items() if not name.startswith("stateEstimate.")}
    some |= {f"stateEstimateZ.{k}{a}": 1e3 * m[f"{c}{a}"] for k, c in (("", "p"), ("v", "v"), ("a", "a")) for a in "xyz"}
    result = run(write_usd(tmp_path / "log00", [usd_event(T, some)]))
    assert "az" not in result.names and {"ax", "ay", "pz", "vz"} <= set(result.names)
    check(result, 0.0, quad, 3e-6, but=NOT_STATES)


@pytest.mark.parametrize("form", ("crazyflie", "usd"))
def test_crazyflie_without_a_motor_is_told_what_to_log(tmp_path, form):
    some = {name: values for name, values in quad_variables(quad(T)).items() if name != "motor.m3"}
    if form == "usd":
        path = write_usd(tmp_path / "log00", [usd_event(T, some)])
    else:
        path = write_crazyflie(tmp_path / "log.csv", np.round(T * 1e3), some)
    message = refused(path, "quadrotor", r"nothing for m3 \(usually motor\.m3\): .*--map COLUMN=TOPIC\.FIELD; the file has")
    assert (crazyflie.MEND if form == "crazyflie" else usd.MEND) in message


def test_factor_of_motors_is_not_applied_to_other_columns(tmp_path):
    """`u=motor.m1*1.5e-5` of a flapping wing means what it meant."""
    every = crazyflie_variables(flight(T)) | {"motor.m1": np.full(len(T), 30000.0)}
    path = write_usd(tmp_path / "log00", [usd_event(T, every)])
    out = tmp_path / "out.csv"
    convert.run(path, out, "fwmav", maps=["u=motor.m1*1.5e-5"])
    assert np.allclose(np.genfromtxt(out, delimiter=",", names=True)["u"], 0.45)


def test_motors_in_another_unit_or_without_any_state_are_refused(tmp_path):
    m = quad_variables(quad(T))
    path = write_usd(tmp_path / "log00", [usd_event(T, m | {"pwm.raw": 500 + 0 * T})])
    refused(path, "quadrotor", r"pwm\.raw for m2 is from 500 to 500, but a thrust is from 0 to 1; scale it with --map", maps=["m2=pwm.raw"])
    assert np.allclose(run(path, maps=["m2=pwm.raw*1e-3"]).columns["m2"], 0.5)
    commands = {name: values for name, values in m.items() if name.startswith(("motor", "pm"))}
    refused(write_usd(tmp_path / "log01", [usd_event(T, commands)]), "quadrotor", "has commands only; log at least one of px, ")


# ---- PX4 -------------------------------------------------------------------------------------------


def test_px4_motors_and_frames(tmp_path):
    result = run(write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_motors(T)]))
    assert set(result.names) == set(platforms.COLUMNS["quadrotor"])
    check(result, 0.01, quad, 3e-6, but=NOT_STATES)
    for name in MOTORS:
        check_held(result, 0.01, name, T + 0.003, quad(T)[name])


def test_px4_motor_that_is_off_is_zero(tmp_path):
    name, instance, fields = px4_motors(T, late=0)
    fields["float[4] control"] = np.where(T[:, None] < 1, np.nan, fields["float[4] control"])
    result = run(write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), (name, instance, fields)]))
    off = result.t < 1 - 1e-6
    assert off.sum() == 100 and all((result.columns[m][off] == 0).all() and (result.columns[m][~off] > 0).all() for m in MOTORS)


def rotors(places, count=4):
    """CA_ROTOR parameters of rotors at places, x forward, y right."""
    xy = {"front right": (0.1, 0.2), "rear right": (-0.1, 0.2), "rear left": (-0.1, -0.2), "front left": (0.1, -0.2), "front": (0.2, 0.0)}
    named = {f"CA_ROTOR{i}_P{a}": xy[place][j] for i, place in enumerate(places) for j, a in enumerate("XY")}
    return {"CA_ROTOR_COUNT": count} | named


@pytest.mark.parametrize("places", (PX4, PLACES, ("rear right", "front right", "rear left", "front left")))
def test_px4_rotors_are_where_its_parameters_say(tmp_path, places):
    path = write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_motors(T, places, 0)], rotors(places))
    check_motors(run(path), T)


@pytest.mark.parametrize("parameters", (rotors((*PX4, "front", "front"), 6), rotors((*PX4[:3], "front")), rotors((*PX4[:3], PX4[0]))))
def test_px4_vehicle_that_is_no_quadrotor_in_x_is_mapped_by_hand(tmp_path, parameters):
    path = write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_motors(T, late=0)], parameters)
    refused(path, "quadrotor", r"nothing for m1, m2, m3, m4: the rotors \(CA_ROTOR0_PX \.\.\) are not one at each corner")
    maps = [f"{motor}=actuator_motors.control[{PX4.index(place)}]" for motor, place in zip(MOTORS, PLACES)]
    check_motors(run(path, maps=maps), T)


@pytest.mark.parametrize("factor", (0.3, 1.0))
def test_px4_pulses_are_thrust_by_range_and_model(tmp_path, factor):
    low, high = (1000, 1050, 1100, 1075), (1900, 2000, 1950, 1975)
    names = {f"PWM_MAIN_{end}{k + 1}": values[k] for end, values in (("MIN", low), ("MAX", high)) for k in range(4)}
    path = write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_outputs(T, factor, low, high)], {"THR_MDL_FAC": factor} | names)
    check_motors(run(path), T, 1e-5)


def test_px4_channels_are_where_its_functions_say_and_common_limits_apply(tmp_path):
    at, low, high = (7, 5, 8, 6), (1075,) * 4, (1950,) * 4
    names = {f"PWM_AUX_FUNC{channel}": 101 + k for k, channel in enumerate(at)} | {"PWM_AUX_FUNC1": 201}
    names |= {"PWM_MIN": 1075, "PWM_MAX": 1950, "PWM_AUX_MIN5": -1, "THR_MDL_FAC": 0.5}
    path = write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_outputs(T, 0.5, low, high, at)], names)
    check_motors(run(path), T, 1e-5)
    del names["PWM_MAX"]
    path = write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_outputs(T, 0.5, low, high, at)], names)
    refused(path, "quadrotor", r"output\[6\] cannot be scaled, for PWM_AUX_MIN7 and PWM_AUX_MAX7 are not in the log; log actuator_motors")


def test_px4_motors_are_preferred_to_outputs(tmp_path):
    path = write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_outputs(T, 0.5, (1000,) * 4, (2000,) * 4), px4_motors(T, late=0)])
    check_motors(run(path), T)


def test_px4_without_motors_is_told_what_to_log(tmp_path):
    path = write_ulog(tmp_path / "log.ulg", ulog_quad(T))
    message = refused(path, "quadrotor", r"nothing for m1 .*SDLOG_PROFILE")
    assert "actuator_motors.control[0] or actuator_outputs.output[0]" in message


def test_px4_each_part_of_the_position_has_its_own_validity_and_resets(tmp_path):
    """Indoors there is height but no position: that is left out, and the height is trusted. Its reset begins a new segment."""
    none, every = np.zeros(len(T), bool), np.ones(len(T), bool)
    topics = ulog_quad(T, **{
        "bool xy_valid": none, "bool v_xy_valid": none, "bool z_valid": T < 4, "bool v_z_valid": every,
        "uint8_t xy_reset_counter": (T > 1).astype(int), "uint8_t z_reset_counter": (T >= 2).astype(int),
    })  # fmt: skip
    result = run(write_ulog(tmp_path / "log.ulg", [*topics, px4_motors(T, late=0)]))
    assert {"pz", "vz", "az", "roll"} <= set(result.names) and not {"px", "py", "vx", "vy", "ax", "ay"} & set(result.names)
    assert np.array_equal(result.ok, T < 4) and np.array_equal(result.seg, (T >= 2).astype(int))
    check(result, 0.0, quad, 3e-6, but=NOT_STATES)


def test_what_is_not_trusted_is_left_out_and_said(tmp_path, capsys):
    topics = ulog_quad(T, **{"bool xy_valid": np.zeros(len(T), bool)})
    run(write_ulog(tmp_path / "log.ulg", [*topics, px4_motors(T)]))
    said = " ".join(capsys.readouterr().out.split())
    assert "The log lacks px, py." in said and "px is left out: vehicle_local_position.x has no samples to be trusted." in said


def test_acceleration_of_the_world_is_never_that_of_an_accelerometer(tmp_path):
    imu = ("sensor_combined", 0, {"uint64_t timestamp": us(T), "float[3] accelerometer_m_s2": 9 + np.zeros((len(T), 3))})
    result = run(write_ulog(tmp_path / "log.ulg", [*ulog_quad(T)[1:], imu, px4_motors(T)]))
    assert not {"ax", "ay", "az"} & set(result.names) and "gx" in result.names
    messages = [(10**9 + int(s * 1e9), ros("Imu", stamp=10**9 + int(s * 1e9), g=(0, 0, 0), a=(9, 9, 9), q=(1, 0, 0, 0))) for s in T]
    floats = [(10**9 + int(s * 1e9), ros("Float64", data=0.5)) for s in T]
    bag = write_bag(tmp_path / "bag", {"/imu": ("sensor_msgs/Imu", messages), "/u": ("std_msgs/Float64", floats)})
    result = run(bag, maps=["m1,m2,m3,m4,vbat=/u.data"])
    assert not {"ax", "ay", "az"} & set(result.names) and {"gx", "roll"} <= set(result.names)


# ---- ArduPilot -------------------------------------------------------------------------------------


@pytest.fixture
def pymavlink():
    return pytest.importorskip("pymavlink", reason="no pymavlink here: pip install -r tools/requirements-logs.txt")


def test_ardupilot_pulses_are_thrust_by_range_and_curve(tmp_path, pymavlink):
    result = run(write_bin(tmp_path / "1.BIN", [parm(**SPIN), *bin_quad(T), rcou(T)]))
    assert set(platforms.COLUMNS["quadrotor"]) - set(result.names) == {"ax", "ay", "az"}
    check(result, 0.0, quad, 3e-4, but=NOT_STATES)  # a hundredth of a degree
    check_motors(result, T, 2e-3)  # half a microsecond of 720
    check_held(result, 0.0, "vbat", T[::50], quad(T[::50])["vbat"].astype(np.float32))


@pytest.mark.parametrize("expo", (0.0, 0.65, -0.3))
def test_ardupilot_compensation_of_the_voltage_is_undone(tmp_path, pymavlink, capsys, expo):
    """MOTB.BatVolt falls to 0.8: as much more is put out, and nothing more is asked for."""
    voltage = np.linspace(1, 0.8, len(T))
    motb = ("MOTB", "Qff", {"TimeUS": us(T), "LiftMax": 0 * T, "BatVolt": voltage}, None)
    topics = [parm(**SPIN | {"MOT_THST_EXPO": expo, "MOT_BAT_V_MAX": 16.8}), *bin_quad(T), motb, rcou(T, voltage=voltage, expo=expo)]
    check_motors(run(write_bin(tmp_path / "1.BIN", topics)), T, 3e-3)
    assert "compensation" not in capsys.readouterr().out
    run(write_bin(tmp_path / "1.BIN", [topic for topic in topics if topic is not motb]))
    assert "The motors include the compensation of the battery voltage: log MOTB" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    "kind, places",
    [
        (1, PX4),
        (12, ("rear right", "front right", "rear left", "front left")),
        (13, ("front right", "front left", "rear left", "rear right")),
        (14, PLACES),
    ],
)
def test_ardupilot_order_of_the_motors_is_that_of_its_frame(tmp_path, pymavlink, kind, places):
    path = write_bin(tmp_path / "1.BIN", [parm(FRAME_CLASS=1, FRAME_TYPE=kind, **SPIN), *bin_quad(T), rcou(T, places)])
    check_motors(run(path), T, 2e-3)


def test_ardupilot_channels_are_where_its_functions_say(tmp_path, pymavlink):
    at = (5, 8, 2, 6)
    functions = {f"SERVO{channel}_FUNCTION": 33 + k for k, channel in enumerate(at)} | {"SERVO1_FUNCTION": 0}
    path = write_bin(tmp_path / "1.BIN", [parm(**functions, **SPIN), *bin_quad(T), rcou(T, at=at)])
    check_motors(run(path), T, 2e-3)


@pytest.mark.parametrize("frame", ({"FRAME_CLASS": 2, "FRAME_TYPE": 1}, {"FRAME_CLASS": 1, "FRAME_TYPE": 0}))
def test_ardupilot_frame_that_is_no_quadrotor_in_x_is_mapped_by_hand(tmp_path, pymavlink, frame):
    path = write_bin(tmp_path / "1.BIN", [parm(**frame, **SPIN), *bin_quad(T), rcou(T)])
    refused(path, "quadrotor", r"nothing for m1, m2, m3, m4: the frame \(FRAME_CLASS, FRAME_TYPE\)")
    check_motors(run(path, maps=["m1=RCOU.C1", "m2=RCOU.C4", "m3=RCOU.C2", "m4=RCOU.C3"]), T, 2e-3)


def test_ardupilot_without_outputs_or_parameters_is_told_what_to_log(tmp_path, pymavlink):
    refused(write_bin(tmp_path / "1.BIN", bin_quad(T)), "quadrotor", r"nothing for m1 \(usually RCOU\.C1\).*log it \(LOG_BITMASK\)")
    path = write_bin(tmp_path / "1.BIN", [*bin_quad(T), rcou(T)])
    refused(path, "quadrotor", "RCOU.C1 cannot be scaled, for MOT_PWM_MIN and MOT_PWM_MAX are not in the log; log the parameters")
    old = {"MOT_PWM_MIN": 0, "MOT_PWM_MAX": 0, "RC3_MIN": 1050, "RC3_MAX": 1950}
    check_motors(run(write_bin(tmp_path / "1.BIN", [parm(**SPIN | old), *bin_quad(T), rcou(T)])), T, 2e-3)


# ---- other sources ---------------------------------------------------------------------------------


def test_own_csv_with_some_columns(tmp_path):
    m = quad(T)
    columns = {name: m[name] for name in ("m1", "m2", "m3", "m4", "px", "ax")} | {"u_bat": m["vbat"] * 1e3}
    path = tmp_path / "mine.csv"
    np.savetxt(path, np.column_stack([T, *columns.values()]), delimiter=",", header=",".join(["t", *columns]), comments="")
    result = run(path, maps=["vbat=u_bat[mV]"])
    assert set(result.names) == {*MOTORS, "vbat", "px", "ax"}
    check(result, 0.0, quad, but=NOT_STATES)
    check_motors(result, T)


def test_platform_of_a_log_follows_from_the_columns_that_it_must_have(tmp_path):
    path = tmp_path / "log.csv"
    for header, platform in (
        ("t,m1,m2,m3,m4,vbat,ax,ay,az,roll,pitch,yaw,gx,gy,gz", "quadrotor"),
        ("t,m1,m2,m3,m4,vbat,px,py", "quadrotor"),
        ("t,gx,gy,gz,ax,ay,az,pitch,roll,yaw,yaw_rate,u", "fwmav"),
        ("t,px,py,theta,v,omega", "ddr"),
    ):
        path.write_text(header + "\n")
        assert platforms.of_log(path) == platform


@pytest.mark.parametrize("form", ("usd", "ulog", "ardupilot"))
def test_altered_bytes_are_read_or_refused(tmp_path, form):
    """Parameters too: mutations of a good file give a UserError of one line, or rows of numbers."""
    if form == "usd":
        path = write_usd(tmp_path / "log00", [usd_event(T, quad_variables(quad(T)))])
    elif form == "ulog":
        limits = {"PWM_MIN": 1000, "PWM_MAX": 2000, "THR_MDL_FAC": 0.5} | rotors(PX4)
        path = write_ulog(tmp_path / "log.ulg", [*ulog_quad(T), px4_outputs(T, 0.5, (1000,) * 4, (2000,) * 4)], limits)
    else:
        pytest.importorskip("pymavlink", reason="no pymavlink here: pip install -r tools/requirements-logs.txt")
        path = write_bin(tmp_path / "1.BIN", [parm(FRAME_CLASS=1, FRAME_TYPE=1, **SPIN), *bin_quad(T), rcou(T)])
    data, random, refusals = path.read_bytes(), np.random.default_rng(4), 0
    for i in range(40):
        text = bytearray(data)
        for at in random.integers(len(text) if i % 2 else 2000, size=3):
            text[at] = random.integers(256)
        path.write_bytes(text)
        try:
            assert np.isfinite(run(path, damaged=bool(i % 3)).columns["m1"]).all()
        except UserError as error:
            assert str(error).isprintable() and len(str(error)) < 4000
            refusals += 1
    assert 5 < refusals < 40


# ---- real flights ----------------------------------------------------------------------------------


@pytest.mark.skipif(not DATA.exists(), reason="the labelled flights are not here")
def test_every_labelled_flight_converts_and_healthy_motors_ask_for_what_is_known(tmp_path):
    """Means in cruise, of the flights of E8 without a fault: an earlier analysis of them found 0.667, 0.537, 0.687 and 0.554 of full."""
    healthy = []
    for row in csv.DictReader((DATA / "labels.csv").open()):
        out = tmp_path / "out.csv"
        convert.run(DATA / "flights" / row["flight"], out, "quadrotor")
        result = Result(out)
        assert set(platforms.COLUMNS["quadrotor"]) - set(result.names) == {"pitch", "gx", "gy", "gz"}
        c = result.columns
        assert 2000 < len(result.t) < 4000 and np.median(np.diff(result.t)) == pytest.approx(0.01, rel=0.05) and result.ok.all()
        assert 3 < c["vbat"].min() and c["vbat"].max() < 4.3 and np.ptp(c["px"]) > 1.5 and 0.4 < np.median(c["pz"]) < 0.6
        cruise = (np.abs(c["vx"]) > 0.2) & (c["pz"] > 0.4)
        assert abs(c["az"][cruise].mean()) < 0.5  # without gravity
        if (row["vehicle"], row["family"]) == ("E8", "none"):
            healthy.append([c[motor][cruise].mean() for motor in MOTORS])
    assert len(healthy) == 4 and np.allclose(np.mean(healthy, axis=0), (0.667, 0.537, 0.687, 0.554), atol=0.01)
