"""Many logs at once: each gets the report that it gets by itself, and a log that fails stops no other."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tinykoop import bridge, diagnose
from tinykoop.blind import fleet as campaign
from tinykoop.diagnose import several
from tinykoop.plumbing.errors import UserError

DT, ROWS = 0.05, 400
TABLE = """name = "cart"
[log]
time = {column = "t", unit = "s"}
state = [{name = "x", column = "px", unit = "m"}]
command = [{name = "speed", column = "v", unit = "m/s"}]
[simulator]
python = "cart.py:step"
[effects]
use = ["gain"]
[report]
gap = [{name = "position", unit = "m", states = ["x"]}]
"""
STEP = '''import os

def step(x, u, dt, params):
    if x.max() > 1e3:
        os._exit(3)
    return x + dt * u
'''  # fmt: skip


def log(path, active=(), seed=0, begin=0.0, turn=1.2):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform((-0.8, -turn), (2.2, turn), (ROWS // 20, 2)), 20, axis=0)
    x = bridge.simulate(u[:-1], DT, (begin, 0.0, 0.0), active, bridge.ARC)
    bridge.write_log(path, x + 0.004 * rng.standard_normal(x.shape), u, DT)
    return path


def fleet(folder, *arguments):
    command = [sys.executable, "-m", "tinykoop.cli", "diagnose", "logs", "--out", "all", "--jobs", "2", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    return done, {Path(entry["log"]).name: entry for entry in json.loads((folder / "all/diagnoses.json").read_text())}


def test_a_folder_gives_bit_for_bit_the_reports_that_its_logs_give_one_by_one(tmp_path, monkeypatch):
    (tmp_path / "logs").mkdir()
    for k, names in enumerate(((), ("yaw_gain",), ("actuator_lag",))):
        log(tmp_path / f"logs/{k}.csv", [bridge.usual_effect(name) for name in names], k)
    (tmp_path / "logs/broken.csv").write_text("t,px,py,theta,v,omega\n0,1,2,x,0,0\n")
    (tmp_path / "logs/notes.txt").write_text("no log")
    done, found = fleet(tmp_path)
    assert done.returncode == 2 and "broken.csv" in done.stderr and "Traceback" not in done.stderr and "3 of 4 logs" in done.stdout
    assert list(found) == ["0.csv", "1.csv", "2.csv", "broken.csv"] and found["broken.csv"]["report"] is None
    assert [effect["name"] for k in range(3) for effect in found[f"{k}.csv"]["report"]["effects"]] == ["yaw_gain", "actuator_lag"]
    monkeypatch.chdir(tmp_path)
    for k in range(3):
        diagnose.run(Path(f"logs/{k}.csv"), Path("one"))
        for name in ("report.json", "report.html"):
            assert Path("one", name).read_bytes() == Path("all", str(k), name).read_bytes()


def test_a_log_whose_process_dies_gives_its_line_and_the_others_their_reports(tmp_path):
    """As of a simulator of one's own that crashes, or where memory is short."""
    (tmp_path / "logs").mkdir()
    (tmp_path / "cart.toml").write_text(TABLE)
    (tmp_path / "cart.py").write_text(STEP)
    for k, begin in enumerate((0.0, 1e4, 0.0)):
        log(tmp_path / f"logs/{k}.csv", seed=k, begin=begin, turn=0.0)
    done, found = fleet(tmp_path, "--robot", "cart.toml")
    assert done.returncode == 2 and "logs/1.csv: its process was ended" in done.stderr and "Traceback" not in done.stderr
    assert [entry["report"] is None for entry in found.values()] == [False, True, False]


def test_a_folder_without_logs_is_refused_in_one_line(tmp_path):
    with pytest.raises(UserError, match="no CSV file is in this folder"):
        several.files([tmp_path])


def test_a_fleet_of_generated_drives_has_the_processor_time_of_each(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "ROWS", 300)
    rows = campaign.run(tmp_path, 3, 5, jobs=1)
    assert [row["log"] for row in rows] == ["00000_single", "00001_single_other", "00002_none_white"]
    assert all(row["rows"] == 300 and 0 < row["seconds"] < 60 for row in rows) and (tmp_path / "fleet.json").exists()


def test_cores_of_a_fleet_are_those_that_its_mean_time_takes():
    """10,000 drives of 0.72 s are two hours of one core."""
    rows = [{"log": "a", "rows": 1000, "seconds": 0.36}, {"log": "b", "rows": 2000, "seconds": 1.08}]
    found = dict(campaign.lines(rows, 3))
    assert found["drives that failed"] == 1 and found["rows per drive, mean"] == 1500 and found["drives per hour and core"] == 5000
    assert found["cores for 10000 drives per hour"] == "2"
