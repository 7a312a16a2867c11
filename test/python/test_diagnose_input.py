"""The gap diagnoser on bad and strange input, through the command: a report that is valid, or one clear line."""

import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from tinykoop import bridge, cli
from tinykoop.diagnose.robots import new

DT, ROWS = 0.05, 220


def drive(rows=ROWS, seed=0):
    rng = np.random.default_rng(seed)
    return np.repeat(rng.uniform((-0.8, -1.2), (2.2, 1.2), (rows // 20 + 1, 2)), 20, axis=0)[:rows]


def poses(u, names=(), dt=DT, noise=0.004, seed=0):
    x = bridge.simulate(u[:-1], dt, (0.3, -0.2, 2.0), [bridge.usual_effect(name) for name in names], bridge.ARC)
    return x + noise * np.random.default_rng(seed).standard_normal(x.shape)


def write(path, x, u, dt=DT, **columns):
    header = ",".join(["t,px,py,theta,v,omega", *columns])
    table = np.column_stack([np.arange(len(x)) * dt, x, u, *columns.values()])
    np.savetxt(path, table, "%.10g", ",", header=header, comments="")
    return path


@pytest.fixture
def tinykoop(monkeypatch, capsys, tmp_path):
    """(exit status, standard error, report or None) of `tinykoop diagnose`."""

    def run(log, *arguments):
        out = tmp_path / "out"
        given = [] if "--out" in arguments else ["--out", out]
        monkeypatch.setattr(sys, "argv", ["tinykoop", "diagnose", *map(str, (log, *arguments, *given))])
        capsys.readouterr()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            status = cli.main()
        path = out / "report.json"
        return status, capsys.readouterr().err, valid(path) if status == 0 else None

    return run


def valid(path):
    """The report, if it is one as the contract has it."""
    report = json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} in {path.name}"))
    assert report["verdict"] in ("known", "partly", "none", "unknown")
    assert len(report["ranking"]) >= len(report["effects"]) and (report["verdict"] != "none" or not report["effects"])
    table = {**bridge.effects(), "no_traction": ("actuator", ())}
    for effect in report["effects"]:
        assert 0 <= effect["confidence"] <= 1 and effect["segments"]
        for name, _, low, high, _ in table[effect.get("form", effect["name"])][1]:
            assert low <= effect["params"][name] <= high and len(effect["params_ci95"][name]) == 2
        for t0, t1 in effect["segments"]:
            assert 0 <= t0 < t1 <= report["log"]["seconds"] + 1e-6
    for name in ("before", "after", "noise_floor", "closed_fraction", "ci95"):
        assert set(report["gap"][name]) == {"1", "10", "50"}
    for name in ("before", "after", "noise_floor"):
        assert all(value is None or value >= 0 for value in report["gap"][name].values())
    assert set(report["where"]["channels"]) == {"longitudinal", "lateral", "heading"}
    assert (path.parent / "report.html").stat().st_size > 1000
    return report


def refused(answer, *says):
    status, error, _ = answer
    assert status == 2 and error.startswith("tinykoop: ") and error.count("\n") == 1 and len(error) < 500, error
    assert all(word in error for word in says), error


# ---- refused -------------------------------------------------------------------------------------


def table(change):
    rows = [[f"{value:.10g}" for value in row] for row in np.column_stack([np.arange(ROWS) * DT, poses(drive()), drive()])]
    return "\n".join(",".join(row) for row in change([["t", "px", "py", "theta", "v", "omega"], *rows])) + "\n"


def with_cell(row, column, value):
    def change(rows):
        rows[row][column] = value
        return rows

    return change


BAD = {
    "empty": (lambda rows: [], "log.csv"),
    "header only": (lambda rows: rows[:1], "log.csv"),
    "short": (lambda rows: rows[:50], "60"),
    "wrong columns": (lambda rows: [["time", *row[1:]] if i == 0 else row for i, row in enumerate(rows)], "'t'"),
    "no commands": (lambda rows: [row[:4] for row in rows], "'v'"),
    "not a number": (with_cell(5, 2, "nan"), "log.csv:6"),
    "words": (with_cell(9, 4, "fast"), "log.csv:10"),
    "time goes back": (with_cell(100, 0, "0.1"), "log.csv:101"),
    "standing": (lambda rows: [rows[0], *([row[0], "1", "2", "0.5", *row[4:]] for row in rows[1:])], "pose"),
}


@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("fresh", [False, True], ids=["log", "fresh"])
def test_bad_file_is_one_line_and_exit_2(case, fresh, tinykoop, tmp_path):
    change, says = BAD[case]
    bad = tmp_path / "log.csv"
    bad.write_text(table(change))
    if fresh:
        refused(tinykoop(write(tmp_path / "good.csv", poses(drive()), drive()), "--fresh", bad), "log.csv", says)
    else:
        refused(tinykoop(bad), "log.csv", says)


@pytest.mark.parametrize("most, status", [("10", 0), ("1e-6", 1)])
def test_a_gap_larger_than_allowed_is_exit_status_1(most, status, tinykoop, tmp_path):
    good = write(tmp_path / "good.csv", poses(drive()), drive())
    assert tinykoop(good, "--max-gap", most)[0] == status


def test_of_several_logs_one_whose_gap_is_larger_than_allowed_is_exit_status_1(tmp_path, monkeypatch, capsys):
    """All reports and the table are there before; the log is named."""
    logs = [write(tmp_path / f"{name}.csv", poses(drive(), names), drive()) for name, names in (("small", []), ("large", ["speed_gain"]))]
    monkeypatch.setattr(sys, "argv", ["tinykoop", "diagnose", *map(str, logs), "--max-gap", "0.05", "--out", str(tmp_path / "out")])
    assert cli.main() == 1
    said = "".join(capsys.readouterr().out.split())
    assert "large.csv:Thegapis" in said and "small.csv:Thegapis" not in said and "2of2logs" in said
    assert [entry["report"]["verdict"] for entry in json.loads((tmp_path / "out/diagnoses.json").read_text())] == ["none", "known"]


def test_missing_file(tinykoop, tmp_path):
    good = write(tmp_path / "good.csv", poses(drive()), drive())
    refused(tinykoop(tmp_path / "missing.csv"), "missing.csv")
    refused(tinykoop(good, "--fresh", tmp_path / "missing.csv"), "missing.csv")


def test_command_by_itself(tmp_path):
    """In a process of its own: nothing but the line."""
    root = Path(__file__).resolve().parents[2]
    command = [sys.executable, "-m", "tinykoop.cli", "diagnose", "missing.csv", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env={"PYTHONPATH": str(root / "tools")})
    assert done.returncode == 2 and done.stdout == ""
    refused((done.returncode, done.stderr, None), "missing.csv")


def test_all_rows_masked(tinykoop, tmp_path):
    refused(tinykoop(write(tmp_path / "log.csv", poses(drive()), drive(), pose_ok=np.zeros(ROWS))), "log.csv", "usable")


def test_folder_that_cannot_be_written(tinykoop, tmp_path):
    good = write(tmp_path / "good.csv", poses(drive()), drive())
    refused(tinykoop(good, "--out", good), "good.csv")
    refused(tinykoop(good, "--out", good / "below"), "good.csv")


def logs_of_every_robot(folder):
    """{arguments of `tinykoop diagnose`: effects that can be taken out}."""
    log = bridge.fwmav("pitch", 7, 1)[0]
    bridge.write_log(folder / "flight.csv", log.x, log.u, log.dt, "fwmav")
    drove = write(folder / "drive.csv", poses(drive()), drive())
    (folder / "own.csv").write_text(drove.read_text().replace("t,px,py,theta,v,omega", "t,x,y,yaw,v_cmd,w_cmd"))
    (folder / "own.toml").write_text(new.TOML.format(name="own"))
    (folder / "own.py").write_text(new.PYTHON.format(name="own"))
    return {
        (drove,): set(bridge.effects()) - {"measurement_noise"},
        (folder / "flight.csv",): set(bridge.effects("fwmav")),
        (folder / "own.csv", "--robot", folder / "own.toml"): {"lag:speed", "delay:all", "clock", "sensor_bias:px", "drift:yaw"},
    }


@pytest.mark.parametrize("name", ["speed_gian", "", "speed_gain,yaw_gain"])
def test_unknown_name_in_without_is_answered_with_all_names(name, tinykoop, tmp_path):
    for arguments, effects in logs_of_every_robot(tmp_path).items():
        status, error, _ = tinykoop(*arguments, "--without", name)
        assert status == 2 and error.startswith(f"tinykoop: --without '{name}'") and error.count("\n") == 1, error
        assert effects <= set(error.strip().split("there are ")[1].split(", ")), error


@pytest.mark.parametrize("option", ["--robot", "--platform"])
@pytest.mark.parametrize("name", ["bicycle", "", "car.tml"])
def test_unknown_platform(option, name, tinykoop, tmp_path):
    good = write(tmp_path / "good.csv", poses(drive()), drive())
    refused(tinykoop(good, option, name), f"'{name}'", "ddr", "fwmav", "TOML file")


def test_columns_tell_the_platform_unless_it_is_given(tinykoop, tmp_path):
    log, imu = bridge.fwmav("pitch", 2, 1)[0], np.zeros(ROWS)
    flight = tmp_path / "flight.csv"
    bridge.write_log(flight, log.x, log.u, log.dt, "fwmav")
    refused(tinykoop(flight), "flight.csv", "record 6 s at least")
    for option in ("--platform", "--robot"):
        refused(tinykoop(flight, option, "ddr"), "flight.csv", "'px'", "ddr")
    with_imu = write(tmp_path / "log.csv", poses(drive()), drive(), gx=imu, gy=imu, gz=imu)
    assert tinykoop(with_imu)[2]["platform"] == "ddr"


def test_everything_taken_out(tinykoop, tmp_path):
    """A healthy robot still is one; the gap of another is unknown."""
    everything = [word for name in bridge.effects() if name != "measurement_noise" for word in ("--without", name)]
    for names, verdict in (((), "none"), (("speed_gain",), "unknown")):
        log = write(tmp_path / "log.csv", poses(drive(), names), drive())
        assert tinykoop(log, *everything)[2]["verdict"] == verdict


# ---- answered, but never with a confident wrong cause --------------------------------------------


def others(report, name):
    """Effects that are said to be perhaps this one."""
    return [other for other, names in report["ambiguous_with"].items() if name in names]


def sure(report, but=()):
    """Effects claimed with confidence, other than those that are right."""
    return [e["name"] for e in report["effects"] if e["confidence"] >= 0.9 and e["name"] not in but]


@pytest.mark.parametrize("rows", [3, 5, 7, 12])
@pytest.mark.parametrize("fresh", [False, True], ids=["log", "fresh"])
def test_segments_of_few_rows(rows, fresh, tinykoop, tmp_path):
    """A log in segments of a few: a report, or a refusal in one line."""
    log = write(tmp_path / "log.csv", poses(drive()), drive(), seg=np.arange(ROWS) // rows)
    good = write(tmp_path / "good.csv", poses(drive()), drive())
    status, error, report = answer = tinykoop(good, "--fresh", log) if fresh else tinykoop(log)
    if status:
        refused(answer, "log.csv")
    else:
        assert report["verdict"] == "none"


@pytest.mark.parametrize("rows", [62, 100])
@pytest.mark.parametrize("name", ["speed_gain", "yaw_gain"])
def test_short_log(rows, name, tinykoop, tmp_path):
    _, _, report = tinykoop(write(tmp_path / "log.csv", poses(drive(rows), (name,)), drive(rows)))
    assert not sure(report, (name, *others(report, name))), report["effects"]


def test_short_healthy_logs(tinykoop, tmp_path):
    for seed in range(8):
        u = drive(75, seed)
        assert tinykoop(write(tmp_path / "log.csv", poses(u, seed=seed), u))[2]["verdict"] == "none"


@pytest.mark.parametrize("rows", [200, 300])
def test_robot_that_is_told_to_stand(rows, tinykoop, tmp_path):
    u = np.zeros((rows, 2))
    _, _, report = tinykoop(write(tmp_path / "log.csv", poses(u), u))
    assert report["verdict"] == "none"
    assert {"speed_gain", "yaw_gain", "actuator_lag", "dead_band"} <= set(report["not_testable"])


@pytest.mark.parametrize("names", [(), ("speed_gain",)])
def test_robot_that_never_turns(names, tinykoop, tmp_path):
    u = drive() * (1, 0)
    _, _, report = tinykoop(write(tmp_path / "log.csv", poses(u, names), u))
    assert len(report["effects"]) == len(names)
    assert all(e["name"] in (*names, *others(report, *names)) for e in report["effects"])
    assert {"yaw_gain", "lateral_skid"} <= set(report["not_testable"])


@pytest.mark.parametrize("names", [(), ("yaw_gain",)])
def test_robot_that_only_turns(names, tinykoop, tmp_path):
    u = drive() * (0, 1)
    _, _, report = tinykoop(write(tmp_path / "log.csv", poses(u, names), u))
    assert report["verdict"] == ("known" if names else "none") and len(report["effects"]) == len(names)
    # on the spot a slow clock is a slow turn
    assert all(e["name"] in names or e["name"] in others(report, *names) for e in report["effects"])
    assert "speed_gain" in report["not_testable"]


@pytest.mark.parametrize("dt", [1e-4, 1e-2, 1.0, 10.0])
def test_sampling_times(dt, tinykoop, tmp_path):
    """At 0.1 ms the whole log lasts 40 ms: nothing can be seen in it."""
    u = drive(100 if dt < 1e-3 else ROWS)
    _, _, report = tinykoop(write(tmp_path / "log.csv", poses(u, ("speed_gain",), dt), u, dt))
    assert not sure(report, ("speed_gain", *others(report, "speed_gain")))
    assert report["effects"] or dt < 0.1


def test_fresh_log_of_another_sampling_time(tinykoop, tmp_path):
    """Parameters are in seconds: the model is the same."""
    log = write(tmp_path / "log.csv", poses(drive(), ("actuator_lag",)), drive())
    u = drive(seed=2)
    fresh = write(tmp_path / "fresh.csv", poses(u, ("actuator_lag",), 0.1), u, 0.1)
    _, _, report = tinykoop(log, "--fresh", fresh)
    assert report["fresh"]["gap"]["closed_fraction"]["50"] > 0.95


def test_fresh_log_of_a_standing_robot(tinykoop, tmp_path):
    """No percentage where there is no gap."""
    log = write(tmp_path / "log.csv", poses(drive(), ("speed_gain",)), drive())
    u = np.zeros((ROWS, 2))
    gap = tinykoop(log, "--fresh", write(tmp_path / "fresh.csv", poses(u), u))[2]["fresh"]["gap"]
    assert gap["closed_fraction"]["50"] is None and gap["after"]["50"] < 0.02


def test_far_from_the_origin(tinykoop, tmp_path):
    x = poses(drive(), ("speed_gain",))
    report = tinykoop(write(tmp_path / "log.csv", x + (1e6, -1e6, 0), drive()))[2]
    assert [e["name"] for e in report["effects"]] == ["speed_gain"]


def test_ignored_columns(tinykoop, tmp_path):
    x, noise = poses(drive(), ("speed_gain",)), np.random.default_rng(0).normal(size=(ROWS, 2))
    path = tmp_path / "log.csv"
    plain = tinykoop(write(path, x, drive()))[2]
    more = tinykoop(write(path, x, drive(), battery=noise[:, 0], seg=np.zeros(ROWS), gyro=noise[:, 1], pose_ok=np.ones(ROWS)))[2]
    assert plain == more


def jump(x, u, rng):
    x[ROWS // 2 :] += (5, 5, 0)


def random_poses(x, u, rng):
    x[:] = rng.normal(size=x.shape)


def huge_poses(x, u, rng):
    x[:, :2] *= 1e6


def huge_commands(x, u, rng):
    u *= 1e6


def random_commands(x, u, rng):
    u[:] = rng.normal(size=u.shape)


def stuck_pose(x, u, rng):
    x[:] = x[5]
    x[:5] += 0.001


def stuck_heading(x, u, rng):
    x[:, 2] = 0.5


def every_fourth_pose(x, u, rng):
    x[:] = np.repeat(x[::4], 4, axis=0)[: len(x)]


FEIGNED = ("dead_band", "saturation", "backlash", "speed_gain", "yaw_gain", "no_traction")  # a robot that does not do as it is told
STRANGE = {
    jump: (), random_poses: FEIGNED, huge_poses: (), random_commands: (), huge_commands: FEIGNED,
    stuck_pose: FEIGNED, stuck_heading: FEIGNED, every_fourth_pose: ("transport_delay",),
}  # fmt: skip


@pytest.mark.parametrize("change", STRANGE)
def test_strange_log(change, tinykoop, tmp_path):
    """Nothing sure but what may be said of it; and `known` is not said of what nobody believes."""
    x, u = poses(drive()), drive()
    change(x, u, np.random.default_rng(1))
    _, _, report = tinykoop(write(tmp_path / "log.csv", x, u))
    assert not sure(report, STRANGE[change]), report["effects"]
    assert report["verdict"] != "known" or min(e["confidence"] for e in report["effects"]) > 0.1, report["effects"]


def test_pose_that_freezes(tinykoop, tmp_path):
    x, u = poses(drive(600)), drive(600)
    stuck_pose(x, u, None)
    assert not sure(tinykoop(write(tmp_path / "log.csv", x, u))[2], FEIGNED)


# ---- what nobody thought of ----------------------------------------------------------------------


def strange(rng):
    """Poses, commands, and optional columns of a small log, put together at random."""
    rows = int(rng.integers(62, 130))
    names = list(rng.choice([n for n in bridge.effects() if n != "measurement_noise"], rng.integers(0, 3), replace=False))
    u, dt = drive(rows, int(rng.integers(1e6))), float(rng.choice([0.002, 0.02, 0.05, 0.5]))
    x = poses(u, names, dt, float(rng.choice([0, 1e-9, 1e-3, 0.01, 1.0])), int(rng.integers(1e6)))
    columns = {}
    for _ in range(rng.integers(1, 4)):
        at = int(rng.integers(1, rows - 1))
        column = int(rng.integers(3))
        match rng.integers(10):
            case 0:
                x[:, column] = x[at, column]
            case 1:
                u[:, column % 2] = rng.choice([0, u[at, column % 2]])
            case 2:
                x[at:, column] += rng.choice([1e-3, 1, 1e3])
            case 3:
                x[at:] = x[at]
            case 4:
                x[at], u[at] = 1e9, -1e3
            case 5:
                columns["seg"] = np.arange(rows) // rng.integers(2, 40)
            case 6:
                columns["pose_ok"] = (rng.uniform(size=rows) > rng.choice([0.02, 0.2])).astype(int)
            case 7:
                x[:] = np.round(x, int(rng.integers(0, 3)))
            case 8:
                u[:] = np.roll(u, at, axis=0) * rng.choice([-1, 1, 1e4])
            case _:
                x[:] = x[::-1].copy()
    return x, u, dt, columns


@pytest.mark.parametrize("seed", range(30))
def test_any_log_is_answered_or_refused(seed, tinykoop, tmp_path):
    x, u, dt, columns = strange(np.random.default_rng(seed))
    status, error, report = answer = tinykoop(write(tmp_path / "log.csv", x, u, dt, **columns))
    if status:
        refused(answer, "log.csv")
