"""ArduPilot logs: an analytic motion is written by the format's documentation, with its units, frames and instances, and must come back.

https://ardupilot.org/dev/docs/code-overview-adding-a-new-log-message.html
"""

import struct
import sys

import numpy as np
import pytest
from test_convert import DEG, TURN, Result, T, check, check_held, command, drive, flight, refused, run, us
from tinykoop import bridge, convert
from tinykoop.convert import ardupilot
from tinykoop.plumbing.errors import UserError

SIZES = {
    "n": "4s",
    "b": "b",
    "B": "B",
    "h": "h",
    "H": "H",
    "c": "h",
    "C": "H",
    "i": "i",
    "L": "i",
    "f": "f",
    "d": "d",
    "Q": "Q",
    "N": "16s",
    "Z": "64s",
}
SCALES = {"c": 100, "C": 100, "L": 1e7}
FMT, FMTU, FIRST = 128, 129, 130


def message(kind, layout, values):
    values = [round(value * SCALES[c]) if c in SCALES else value for c, value in zip(layout, values)]
    return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + "".join(SIZES[c] for c in layout), *values)


def announced(kind, name, layout, columns):
    size = 3 + struct.calcsize("<" + "".join(SIZES[c] for c in layout))
    return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, name.encode(), layout.encode(), columns.encode())


def write(path, topics):
    """topics: [(name, format, {field: values}, number of the field that is the instance, or None)]; time in us first."""
    out = announced(FMT, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
    out += announced(FMTU, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds")
    records, kinds = [], {}
    for name, layout, fields, instance in topics:
        kind = kinds.setdefault(name, FIRST + len(kinds))
        out += announced(kind, name, layout, ",".join(fields))
        units = "".join("#" if i == instance else "-" for i in range(len(layout))).encode()
        out += message(FMTU, "QBNN", [0, kind, units, b"-" * len(layout)])
        records += [(row[0], message(kind, layout, row)) for row in zip(*(np.asarray(v).tolist() for v in fields.values()))]
    path.write_bytes(out + b"".join(record for _, record in sorted(records, key=lambda r: r[0])))
    return path


def attitude(t, m):
    """ATT: hundredths of a degree, FRD in NED; yaw from 0 to 360."""
    zero = 0 * t
    roll, pitch, yaw = m.get("roll", zero), m.get("pitch", zero), m.get("yaw", m.get("theta"))
    angles = {"Roll": roll / DEG, "Pitch": -pitch / DEG, "Yaw": (-yaw / DEG) % 360}
    return "ATT", "QccC", {"TimeUS": us(t)} | angles, None


def drive_log(t, pose="XKF1"):
    m = drive(t)
    where = {"PN": m["px"], "PE": -m["py"]}
    return [
        (pose, "QBff", {"TimeUS": us(t), "C": 0 * us(t)} | where, 1),
        (pose, "QBff", {"TimeUS": us(t), "C": 0 * us(t) + 1, "PN": 99 + 0 * t, "PE": 99 + 0 * t}, 1),
        attitude(t, m),
        ("THR", "Qf", {"TimeUS": us(t + 0.003), "DesSpeed": m["v"]}, None),
        ("STER", "Qhf", {"TimeUS": us(t + 0.003), "SteerIn": 0 * us(t), "DesTurnRate": -m["omega"] / DEG}, None),
    ]


def flight_log(t):
    """Two IMUs at all t, attitude at every second, the output of the rate controller at every fifth."""
    m, c = flight(t), flight(t[::5])
    gyro, force = (np.stack([m[kind + axis] for axis in "xyz"], axis=1) @ TURN for kind in "ga")
    names = [f"{kind}{axis}" for kind in ("Gyr", "Acc") for axis in "XYZ"]
    imu = dict(zip(names, [*gyro.T, *force.T]))
    other = {name: 5 + values for name, values in imu.items()}
    return [
        ("IMU", "QBffffff", {"TimeUS": us(t), "I": 0 * us(t)} | imu, 1),
        ("IMU", "QBffffff", {"TimeUS": us(t), "I": 0 * us(t) + 1} | other, 1),
        attitude(t[::2], flight(t[::2])),
        ("RATE", "Qff", {"TimeUS": us(t[::5]), "PDes": 0 * t[::5], "POut": -c["u"]}, None),
        ("MSG", "QZ", {"TimeUS": us(t[:1]), "Message": np.array([b"ArduCopter V4.5.7"])}, None),
    ]


def test_without_the_reader_the_user_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymavlink.DFReader", None)
    log = write(tmp_path / "1.BIN", drive_log(T))
    with pytest.raises(UserError, match="pymavlink is missing; build/venv/bin/pip install -r tools/requirements-logs.txt"):
        convert.run(log, tmp_path / "out.csv", "ddr")


@pytest.fixture
def pymavlink():
    return pytest.importorskip("pymavlink", reason="no pymavlink here: pip install -r tools/requirements-logs.txt")


@pytest.mark.parametrize("pose", ("XKF1", "NKF1"))
def test_rover(tmp_path, pymavlink, pose):
    result = run(write(tmp_path / "1.BIN", drive_log(T, pose)), "ddr")
    check(result, 0.01, drive, 2e-4)  # a hundredth of a degree
    for column in ("v", "omega"):
        check_held(result, 0.01, column, T + 0.003, drive(T)[column])
    assert result.log.dt == pytest.approx(0.01) and result.ok.all() and result.seg.max() == 0


def test_rover_without_a_filter_by_latitude_and_longitude(tmp_path, pymavlink):
    """POS in 1e-7 degrees on a sphere; the judge goes by great circles."""
    m, south = drive(T), -33.0
    radius = ardupilot.METRES / DEG
    latitude = south + m["px"] / radius / DEG
    longitude = 151.0 - m["py"] / (radius * np.cos(latitude * DEG)) / DEG
    topics = [("POS", "QLL", {"TimeUS": us(T), "Lat": latitude, "Lng": longitude}, None), *drive_log(T)[2:]]
    result = run(write(tmp_path / "1.BIN", topics), "ddr")
    check(result, 0.01, lambda t: drive(t) | {k: drive(t)[k] - drive(np.zeros(1))[k] for k in ("px", "py")}, 0.02)


def test_metres_per_degree_are_those_of_the_earth():
    """The mean radius of WGS 84 is 6371 km, that of the equator 6378 km."""
    assert 6371e3 < ardupilot.METRES / DEG < 6379e3


def test_copter_with_two_imus(tmp_path, pymavlink):
    log = write(tmp_path / "1.BIN", flight_log(T))
    result = run(log, "fwmav")
    check(result, 0.0, lambda t: flight(t), 3e-4)
    check_held(result, 0.0, "u", T[::5], flight(T[::5])["u"])
    second = run(log, "fwmav", maps=["gx=IMU_1.GyrX", "az=IMU_1.AccZ"])
    assert np.allclose(second.columns["gx"], result.columns["gx"] + 5, atol=1e-5)
    assert np.allclose(second.columns["az"], result.columns["az"] - 5, atol=1e-5)  # 5 upwards in FRD is down


def test_commands_in_manual_mode_are_mapped(tmp_path, pymavlink):
    """ThrOut is in percent: 100 % are 2 m/s here."""
    topics = drive_log(T)
    topics[3] = ("THR", "Qff", {"TimeUS": us(T), "ThrOut": 50 * drive(T)["v"], "DesSpeed": np.nan * T}, None)
    log = write(tmp_path / "1.BIN", topics)
    refused(log, "ddr", r"THR\.DesSpeed for v has 0 samples to be trusted; .*--map v=TOPIC\.FIELD")
    check_held(run(log, "ddr", maps=["v=THR.ThrOut*0.02"]), 0.01, "v", T, drive(T)["v"])


def test_each_missing_message_is_named(tmp_path, pymavlink):
    for platform, topics in (("ddr", drive_log(T)), ("fwmav", flight_log(T)[:4])):
        for name in {topic[0] for topic in topics}:
            log = write(tmp_path / "1.BIN", [topic for topic in topics if topic[0] != name])
            message = refused(log, platform, r"nothing for .*\(usually .*LOG_BITMASK.*--map COLUMN=TOPIC\.FIELD; the file has")
            assert f"{name}." in message
    refused(write(tmp_path / "1.BIN", flight_log(T)), "ddr", "nothing for px")


@pytest.mark.parametrize("share", (0.02, 0.3, 0.7, 0.98))
def test_a_log_that_is_cut_off_is_refused_unless_asked_for(tmp_path, pymavlink, share):
    log = write(tmp_path / "1.BIN", drive_log(T))
    whole, data = run(log, "ddr"), log.read_bytes()
    log.write_bytes(data[: int(share * len(data)) + 1])
    refused(log, "ddr", "truncated|damaged")
    if share > 0.1:
        part = run(log, "ddr", damaged=True)
        assert (share - 0.15) * len(T) < len(part.t) < (share + 0.15) * len(T)
        assert np.array_equal(part.columns["px"], whole.columns["px"][: len(part.t)])


def test_what_logging_by_blocks_leaves_empty_is_no_damage(tmp_path, pymavlink):
    log = write(tmp_path / "1.BIN", drive_log(T))
    log.write_bytes(log.read_bytes() + b"\xff" * 200)
    assert len(run(log, "ddr").t) == len(T) - 1


def test_a_hole_of_zeros_is_damage(tmp_path, pymavlink):
    log = write(tmp_path / "1.BIN", drive_log(T))
    data = bytearray(log.read_bytes())
    data[20000:20500] = bytes(500)
    log.write_bytes(data)
    refused(log, "ddr", "truncated or damaged .*--damaged reads what is intact")
    assert len(run(log, "ddr", damaged=True).t) > 200  # those before it


def test_altered_bytes_are_read_or_refused(tmp_path, pymavlink, capfd):
    log, out = write(tmp_path / "1.BIN", drive_log(T)), tmp_path / "out.csv"
    data, random, refusals = log.read_bytes(), np.random.default_rng(3), 0
    for i in range(40):
        text = bytearray(data)
        for at in random.integers(len(text) if i % 2 else 900, size=3):
            text[at] = random.integers(256)
        log.write_bytes(text)
        try:
            convert.run(log, out, "ddr", damaged=bool(i % 3))
            bridge.read_log(out, "ddr")
        except UserError as error:
            assert str(error).isprintable() and len(str(error)) < 4000
            refusals += 1
    assert refusals > 5 and "header" not in capfd.readouterr().err


def test_format_is_told_from_what_is_in_it_and_bad_input_is_one_line(tmp_path, pymavlink):
    log = write(tmp_path / "00000012.log", drive_log(T))
    assert convert.detect(log) == "ardupilot"
    status, said, error = command(log, tmp_path / "out.csv", "--platform", "ddr")
    assert status == 0 and not error and "XKF1.PN" in said and "STER.DesTurnRate" in said
    assert len(Result(tmp_path / "out.csv", "ddr").t) == len(T) - 1
    log.write_bytes(log.read_bytes()[:5000])
    status, said, error = command(log, tmp_path / "other.csv", "--platform", "ddr")
    assert status == 2 and not said.strip() and error.count("\n") == 1
