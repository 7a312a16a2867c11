"""Betaflight: an analytic flight is written as blackbox_decode does, with its units and rounding, and must come back.

The header is `loopIteration, time (us), ..`, with a unit in brackets where one was asked for; flags are words.
"""

import numpy as np
import pytest
from test_convert import DEG, T, attitude, check, check_held, command, flight, refused, run, wrap
from tinykoop import convert
from tinykoop.convert import betaflight


def columns_of(t, gyro="deg/s", force="m/s/s", attitude_by="simulate-imu"):
    m = flight(t)
    rates, label = {"deg/s": (1 / DEG, " (deg/s)"), "rad/s": (1.0, " (rad/s)"), "raw": (1 / DEG, "")}[gyro]
    unit, mark = {"m/s/s": (1.0, " (m/s/s)"), "g": (1 / 9.80665, " (g)"), "raw": (2048 / 9.80665, "")}[force]
    columns = {"loopIteration": [8 * k for k in range(len(t))], "time (us)": [round(s * 1e6) for s in t]}
    columns |= {f"setpoint[{i}]": np.round(m["u"] / DEG * (i == 1), 2) for i in range(4)}
    columns |= {f"gyroADC[{i}]{label}": np.round(m[f"g{a}"] * rates, 4) for i, a in enumerate("xyz")}
    columns |= {f"accSmooth[{i}]{mark}": np.round(m[f"a{a}"] * unit, 4) for i, a in enumerate("xyz")}
    if attitude_by == "simulate-imu":
        angles = {"roll": m["roll"], "pitch": m["pitch"], "heading": -m["yaw"] % (2 * np.pi)}
        columns |= {name: np.round(angle / DEG, 2) for name, angle in angles.items()}
    if attitude_by == "quaternion":
        q = attitude(m)
        q = np.round(q * np.where(q[:, :1] < 0, -1, 1) * 32767).astype(int)
        columns |= {f"imuQuaternion[{i}]": q[:, 1 + i] for i in range(3)}
    return columns | {"flightModeFlags (flags)": ["ANGLE_MODE|HORIZON" for _ in t], "failsafePhase (flags)": ["IDLE" for _ in t]}


def write(path, columns):
    rows = [", ".join(columns), *(", ".join(str(cell) for cell in row) for row in zip(*columns.values()))]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("gyro", ("deg/s", "rad/s", "raw"))
@pytest.mark.parametrize("force", ("m/s/s", "g"))
@pytest.mark.parametrize("attitude_by", ("simulate-imu", "quaternion"))
def test_flight(tmp_path, gyro, force, attitude_by):
    log = write(tmp_path / "LOG00001.01.csv", columns_of(T, gyro, force, attitude_by))
    assert convert.detect(log) == "betaflight"
    result = run(log, "fwmav")
    check(result, 0.0, flight, 1e-3)
    check_held(result, 0.0, "u", T, np.round(flight(T)["u"] / DEG, 2) * DEG)
    assert len(result.t) == len(T) and result.log.dt == pytest.approx(0.01)


def test_quaternion_of_betaflight_has_a_positive_scalar_part():
    """An angle of 300 degrees about z is one of -60: the same three numbers, whose fourth is never below zero."""
    parts = betaflight.attitude(*(np.array([v]) for v in (0, 0, round(-0.5 * betaflight.ONE))))
    assert parts["imuQuaternion.w"] == pytest.approx(np.cos(np.pi / 6), abs=1e-4)
    yaw = 2 * np.arctan2(parts["imuQuaternion.z"], parts["imuQuaternion.w"])
    assert wrap(yaw - np.radians(300)) == pytest.approx(0, abs=1e-4)


def test_command_by_name_and_high_resolution(tmp_path):
    """blackbox_high_resolution = ON logs ten times the rate."""
    columns = columns_of(T)
    columns["gyroADC[0] (deg/s)"] = columns["gyroADC[0] (deg/s)"] * 10
    columns["motor[0]"] = np.round(1000 + 500 * flight(T)["u"])
    result = run(write(tmp_path / "1.csv", columns), "fwmav", maps=["gx=gyroADC[0]*0.1", "u=motor[0]*1e-3"])
    check(result, 0.0, flight, 1e-3)
    check_held(result, 0.0, "u", T, columns["motor[0]"] * 1e-3)


def test_what_a_log_lacks_is_named_with_how_to_decode_it(tmp_path):
    log = tmp_path / "1.csv"
    how = r"blackbox_decode --unit-rotation deg/s --unit-acceleration m/s2 --simulate-imu LOG"
    refused(write(log, columns_of(T, attitude_by=None)), "fwmav", r"pitch \(usually imuQuaternion or pitch\).*" + how)
    refused(write(log, columns_of(T, force="raw")), "fwmav", r"nothing for ax, ay, az|nothing for ax.*" + how)
    refused(write(log, columns_of(T)), "ddr", "nothing for px, py, theta, v, omega")
    raw = {name.replace("time (us)", "stamp"): column for name, column in columns_of(T).items()}
    refused(write(log, raw), "fwmav", "no column time; decode the log without --raw")


def test_a_binary_log_is_refused_with_the_program_that_decodes_it(tmp_path):
    log = tmp_path / "LOG00001.BFL"
    log.write_bytes(b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\nI\x00\x01\xff")
    assert convert.detect(log) == "betaflight"
    status, said, error = command(log, tmp_path / "out.csv", "--platform", "fwmav")
    assert status == 2 and not said and error.count("\n") == 1 and "decode it first, with Betaflight's own blackbox_decode" in error


def test_frames_that_could_not_be_decoded_are_left_out(tmp_path):
    """Lost frames leave a gap of time; a cut line is left out when asked for."""
    columns = {name: [c for k, c in enumerate(column) if not 100 <= k < 150] for name, column in columns_of(T).items()}
    log = write(tmp_path / "1.csv", columns)
    result = run(log, "fwmav")
    check(result, 0.0, flight, 1e-3)
    assert result.seg.max() == 1 and len(result.t) == len(T) - 50
    log.write_text(log.read_text()[:-30])
    refused(log, "fwmav", "truncated in this line")
    assert len(run(log, "fwmav", damaged=True).t) == len(T) - 51
