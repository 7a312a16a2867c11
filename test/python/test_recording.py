"""`tinykoop diagnose --mcap`: the file read again by the mcap package, by Foxglove's own definitions, and by Rerun."""

import csv
import importlib.util
import json
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import processes
import pytest
from test_diagnose_input import DT, drive, poses, write
from tinykoop import bridge
from tinykoop.diagnose import recording
from tinykoop.diagnose.platforms import own
from tinykoop.diagnose.prediction_errors.fit import Cause
from tinykoop.diagnose.recording import messages, tracks
from tinykoop.diagnose.robots import toml
from tinykoop.plumbing.errors import UserError

reader = pytest.importorskip("mcap.reader", reason="no mcap here: pip install -r tools/requirements-mcap.txt")
CAR = Path(__file__).resolve().parents[2] / "examples/own_robot/car"
LATER = 100.0  # s, at which the log begins
ROWS = 420  # no multiple of the 50 rows of a prediction
KINDS = ("measured", "simulator", "with_effects")


def read(path):
    """{topic: (schema, [(ns, message)])}."""
    found = defaultdict(lambda: (None, []))
    with open(path, "rb") as file:
        for schema, channel, message in reader.make_reader(file, validate_crcs=True).iter_messages():
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            rows = found[channel.topic][1]
            found[channel.topic] = json.loads(schema.data), [*rows, (message.log_time, json.loads(message.data))]
            assert schema.name == found[channel.topic][0]["title"]
    return dict(found)


def array(channel, *names):
    return np.array([[message[name] for name in names] for _, message in channel[1]])


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """(the log's rows, what the file has, the report, the file) of a drive that begins at 100 s and is slow and turns too much."""
    folder = tmp_path_factory.mktemp("recording")
    table = np.genfromtxt(write(folder / "log.csv", poses(drive(ROWS), ["speed_gain", "yaw_gain"]), drive(ROWS)), delimiter=",", names=True)
    table["t"] += LATER
    np.savetxt(folder / "log.csv", table, "%.10g", ",", header=",".join(table.dtype.names), comments="")
    done = processes.tinykoop("diagnose", "log.csv", "--out", "out", "--mcap", "new/out.mcap", cwd=folder)
    assert done.returncode == 0 and "out.layout.json" in done.stdout, done.stderr
    return table, read(folder / "new/out.mcap"), json.loads((folder / "out/report.json").read_text()), folder / "new/out.mcap"


def test_the_file_has_what_was_measured_at_the_log_s_own_time(recorded):
    table, found, *_ = recorded
    np.testing.assert_allclose([ns * 1e-9 for ns, _ in found["/measured/signals"][1]], table["t"], atol=1e-9)
    np.testing.assert_allclose(
        array(found["/measured/signals"], "px", "py", "theta"), np.stack([table[n] for n in ("px", "py", "theta")], 1)
    )
    for (ns, message), row in zip(found["/measured/pose"][1], table):
        assert message["timestamp"]["sec"] * 10**9 + message["timestamp"]["nsec"] == ns
        position, turned = message["pose"]["position"], message["pose"]["orientation"]
        np.testing.assert_allclose([position[axis] for axis in "xyz"], [row["px"], row["py"], 0])
        half = row["theta"] / 2
        assert abs(turned["w"] * np.cos(half) + turned["z"] * np.sin(half)) == pytest.approx(1) and turned["x"] == turned["y"] == 0


def test_the_simulator_s_path_is_simulated_from_every_fiftieth_measured_pose(recorded):
    table, found, *_ = recorded
    x, u = (np.stack([table[name] for name in names], 1) for names in (("px", "py", "theta"), ("v", "omega")))
    expected = x[:1]
    for a in range(0, ROWS - 1, 50):
        expected = np.vstack([expected, bridge.simulate(u[a : min(a + 50, ROWS - 1)], DT, x[a], integrator=bridge.ARC)[1:]])
    np.testing.assert_allclose(array(found["/simulator/signals"], "px", "py"), expected[:, :2], atol=1e-8)
    missed = array(found["/simulator/residuals"], "px", "py", "theta")
    np.testing.assert_allclose(missed[:, :2], x[:, :2] - expected[:, :2], atol=1e-8)
    assert np.abs(missed[:, 2]).max() < 0.5  # no turn too much


def test_residuals_with_the_effects_are_smaller(recorded):
    missed = [np.hypot(*array(recorded[1][f"/{kind}/residuals"], "px", "py").T) for kind in KINDS[1:]]
    assert missed[1].max() < 0.2 * missed[0].max()


def test_lines_of_each_prediction_begin_together(recorded):
    for _, message in recorded[1]["/predictions"][1]:
        assert tuple(entity["id"] for entity in message["entities"]) == KINDS
        first = [entity["lines"][0]["points"][0] for entity in message["entities"]]
        lengths = {len(entity["lines"][0]["points"]) for entity in message["entities"]}
        assert len(lengths) == 1 and max(lengths) <= 51
        assert first[0].keys() == {"x", "y", "z"}
    begun = [entity["lines"][0]["points"][0] for entity in recorded[1]["/predictions"][1][0][1]["entities"]]
    assert begun[0] == begun[1] == begun[2]


def test_effects_and_places_of_the_gap_are_events_in_the_log_s_own_time(recorded):
    _, found, report, _ = recorded
    said = [(ns * 1e-9, message["message"]) for ns, message in found["/events"][1]]
    assert said[0] == (LATER, f"Verdict: {report['verdict']}")
    for effect in report["effects"]:
        times = [at for at, text in said if text.split()[0] == effect["name"]]
        np.testing.assert_allclose(times, effect["segments"][0])
    assert sum("of the gap lies" in text for _, text in said) == len(report["where"]["segments"])


def test_messages_are_valid_by_the_schemas_in_the_file(recorded):
    jsonschema = pytest.importorskip("jsonschema")
    for schema, rows in recorded[1].values():
        validator = jsonschema.Draft202012Validator(schema)
        for _, message in rows[:20]:
            validator.validate(message)


def test_messages_are_valid_by_foxglove_s_own_definitions(recorded):
    """Its protobuf messages know these fields; their time is written in another way."""
    schemas = pytest.importorskip(
        "foxglove_schemas_protobuf", reason="no foxglove-schemas-protobuf here: pip install -r tools/requirements-test.txt"
    )
    from google.protobuf.json_format import ParseDict

    def without_times(value):
        """The message, and its times apart: in protobuf's JSON they are texts."""
        if isinstance(value, dict):
            return {k: without_times(v) for k, v in value.items() if not (isinstance(v, dict) and v.keys() == {"sec", "nsec"})}
        return [without_times(v) for v in value] if isinstance(value, list) else value

    seen = set()
    for schema, rows in recorded[1].values():
        name = schema["title"].removeprefix("foxglove.")
        if name != schema["title"]:
            kind = getattr(importlib.import_module(f"{schemas.__name__}.{name}_pb2"), name)
            seen.add(name)
            for _, message in rows:
                ParseDict(without_times(message), kind())
                for field in (f for f in kind.DESCRIPTOR.fields if f.message_type and f.message_type.name == "Timestamp"):
                    assert message[field.name].keys() == {"sec", "nsec"}
    assert seen == {"PoseInFrame", "SceneUpdate", "Log"}


def test_the_layout_shows_topics_and_signals_that_the_file_has(recorded):
    _, found, _, file = recorded
    layout = json.loads(file.with_suffix(".layout.json").read_text())
    panels, text = layout["configById"], json.dumps(layout["layout"])
    assert all(f'"{panel}"' in text for panel in panels)
    shown = [topic for panel in panels.values() for topic in panel.get("topics", {})]
    assert "/predictions" in shown and set(shown) <= set(found) and panels["RosOut!events"]["topicToRender"] in found
    paths = [path["value"].rsplit(".", 1) for panel in panels.values() for path in panel.get("paths", [])]
    assert len(paths) == 6 and all(signal in found[topic][0]["properties"] for topic, signal in paths)


def test_rerun_opens_the_file(recorded):
    pytest.importorskip("rerun", reason="no rerun-sdk here: pip install rerun-sdk")
    done = subprocess.run([Path(sys.executable).with_name("rerun"), "mcap", "check", "--full", recorded[3]], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.count("ok ") == len(recorded[1])


def test_predictions_of_one_s_own_robot_are_those_of_its_simulator_with_the_effect(tmp_path):
    """The car with slow steering: what the true lag leaves is noise."""
    spec = importlib.util.spec_from_file_location("make_car", CAR / "make_log.py")
    true = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(true)
    for name in ("car.toml", "car.py"):
        shutil.copy(CAR / name, tmp_path)
    with open(tmp_path / "car.csv", "w", newline="") as file:
        csv.writer(file).writerows([("t", "x", "y", "psi", "v_cmd", "delta"), *true.drive(7)[:400]])
    path = own.Path(*toml.read_both(tmp_path / "car.toml", tmp_path / "car.csv"))
    shown = tracks.of(SimpleNamespace(path=path, log=path.log, fit=SimpleNamespace(causes=(Cause("lag:steering", (true.LAG,)),))))
    assert shown.pose == {"x": 0, "y": 1, "yaw": 2}
    late = [np.abs(shown.residuals(kind))[99:].max(0) for kind in tracks.KINDS]
    assert (late[1] < 0.5 * late[0]).all() and (late[1] < 12 * np.array(true.NOISE)).all()


def test_a_robot_without_a_position_has_signals_and_no_poses():
    """What was not measured is left out, and names are made such that paths of messages can have them."""
    values = np.array([[0.1, np.nan], [np.nan, np.nan], [0.3, 0.4]])
    shown = tracks.Tracks(
        np.array([-1.0, 0.0, 1.0]), (("q1", "rad"), ("gyro z", "rad/s")), np.array([True, False]), values, {"simulator": values}, [(0, 2)]
    )
    report = {"verdict": "none", "effects": [], "log": {"seconds": 2.0}, "where": {"segments": []}}
    found = messages.channels(shown, report)
    assert list(found) == ["/measured/signals", "/simulator/signals", "/simulator/residuals", "/events"]
    assert found["/measured/signals"][1] == [(0, {"q1": 0.1}), (2 * 10**9, {"q1": 0.3, "gyro_z": 0.4})]
    assert recording.layout.of(found)["layout"]["second"]["first"] == "Plot!q1"


def test_without_the_package_one_line_says_how_to_install_it_before_anything_is_diagnosed(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(UserError, match="--mcap: the package mcap is missing; build/venv/bin/pip install -r tools/requirements-mcap.txt"):
        recording.prepare(tmp_path / "out.mcap")


def test_several_logs_have_no_common_recording(tinykoop_in, tmp_path):
    done = tinykoop_in(tmp_path, "diagnose", "a.csv", "b.csv", "--mcap", "out.mcap")
    assert done.returncode == 2 and "--mcap: the recording of one log; give one log" in done.stderr
