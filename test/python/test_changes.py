"""When something changed: alarms and misses on simulated flights and chance, times, and the real flights.

Run as a program, `build/venv/bin/python test/python/test_changes.py 100`, it prints the rates of docs/flapping-wing.md.
"""

import functools
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import processes
import pytest
from tinykoop import bridge
from tinykoop.logs import changes, replay
from tinykoop.plumbing import pages
from tinykoop.plumbing.errors import UserError

FLIGHTS = Path(__file__).resolve().parents[3] / "shared/data/flapper"
MANOEUVRES = ("hover", "pitch", "yaw")
SECONDS = 40
DRAG = 2 * 17 * 4.3e-3 / 0.026  # acceleration that a wind of 1 m/s gives the simulated vehicle along x, m/s^2


def flight(manoeuvre, seed, active=()):
    return replay.unwrapped(bridge.fwmav(manoeuvre, SECONDS, seed, active)[0], "fwmav")


def held(log, wind, begin, lasts, end=np.inf):
    """The log as if the vehicle were held in place: wind (m/s) pushes it backwards, rising for `lasts` s."""
    x = log.x.copy()
    x[:, 3] -= DRAG * wind * np.clip((log.t - begin) / lasts, 0, 1) * (log.t < end)
    return replace(log, x=x)


def look(log):
    return changes.changes(log, "fwmav")


def real(name):
    path = FLIGHTS / f"{name}.csv"
    if not path.exists():
        pytest.skip(f"{path.name} is not at hand")
    return replay.load(path)[0]


# ---- simulated flights ---------------------------------------------------------------------------


@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_no_change_in_nominal_flights(manoeuvre):
    assert [look(flight(manoeuvre, seed)) for seed in range(300, 308)] == [[]] * 8


def test_a_strong_gust_is_a_jolt_when_it_comes():
    """A free vehicle follows it, so nothing lasting is left. One in ten is lost in manoeuvres: rates() has them all."""
    count = 0
    for manoeuvre in MANOEUVRES:
        for seed, t0 in ((310, 8.37), (311, 21.52), (312, 30.2)):
            found = look(flight(manoeuvre, seed, [bridge.Effect("gust", (2.0, 0.0), t0)]))
            assert all(c["kind"] == "jolt" and c["time"] == pytest.approx(t0, abs=0.5) for c in found)
            count += len(found)
    assert 7 <= count <= 9


@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_wind_on_a_held_vehicle_is_a_lasting_change(manoeuvre):
    for seed, t0, lasts in ((320, 7.5, 0.1), (321, 19.1, 1.0), (322, 31.3, 2.0)):
        found = look(held(flight(manoeuvre, seed), 1.0, t0 - lasts / 2, lasts))
        assert [(c["kind"], c["channels"][0]) for c in found] == [("lasting", "accel. x")]
        assert found[0]["time"] == pytest.approx(t0, abs=0.5)
        assert found[0]["from"] <= t0 <= found[0]["to"]


def test_wind_that_grows_twice_is_two_changes():
    log = held(held(flight("hover", 330), 0.8, 12, 1), 0.8, 26, 1)
    assert [c["time"] for c in look(log) if c["kind"] == "lasting"] == pytest.approx([12.5, 26.5], abs=0.5)


@pytest.mark.parametrize("manoeuvre", MANOEUVRES)
def test_what_is_over_after_two_seconds_is_no_lasting_change(manoeuvre):
    log = held(flight(manoeuvre, 331), 1.0, 18, 0.5, end=20)
    assert not any(c["kind"] == "lasting" for c in look(log))


def test_missing_samples():
    calm, random = flight("hover", 332), np.random.default_rng(0)
    rows = np.concatenate([first + np.arange(random.integers(1, 30)) for first in random.integers(0, 3950, 25)])
    usable = calm.usable.copy()
    usable[np.concatenate([rows, np.maximum(rows - 1, 0)])] = False
    for nothing in (np.nan, 50.0):
        for log, times in ((calm, []), (held(calm, 1.0, 22, 1), [22.5])):
            x = log.x.copy()
            x[rows] = nothing
            assert [c["time"] for c in look(replace(log, x=x, usable=usable))] == pytest.approx(times, abs=0.5)
    usable[1500:] = False
    with pytest.raises(UserError, match="at least 20 s"):
        look(replace(calm, usable=usable))


def test_a_dead_channel_hides_nothing():
    log = held(flight("hover", 334), 1.0, 22, 1)
    log.x[:, 8] = 0.0
    (found,) = look(log)
    assert found["time"] == pytest.approx(22.5, abs=0.5)


def test_innovations_are_those_of_ridge_regression():
    log = flight("pitch", 333)
    x, u = (a.reshape(400, 10, -1).mean(axis=1) for a in (log.x, log.u))
    g, (sp, cp, sr, cr) = x[:, :3].T, (f(x[:, c]) for c in (6, 7) for f in (np.sin, np.cos))
    psi = np.column_stack([x, *g**2, g[0] * g[1], g[1] * g[2], g[2] * g[0], sp, cp, sr, cr])
    z, y = np.column_stack([psi, u])[:-1], x[1:]
    second = np.arange(399) // 10
    zc, yc = (a - np.stack([a[second == s].mean(axis=0) for s in range(40)])[second] for a in (z, y))
    left = y - z @ np.linalg.solve(zc.T @ zc + np.eye(21) / changes.INVERSE_RIDGE["lasting"], zc.T @ yc)
    ours = changes.innovations(log, "lasting")[1]
    assert np.abs(ours - (left - np.median(left, axis=0))).max() < 1e-9 * np.abs(left).max()


# ---- thresholds ----------------------------------------------------------------------------------


def test_random_walks_give_the_false_alarms_that_are_asked_for():
    logs, channels = 400, 10
    for count in (30, 75, 150):
        walks = np.cumsum(np.random.default_rng(count).normal(size=(count, logs * channels)), axis=0)
        largest = changes.gaps(walks).max(axis=0).reshape(logs, channels).max(axis=1)
        alarms = np.mean(largest > changes.lasting_threshold(count, channels))
        assert alarms == pytest.approx(0.05, abs=0.035)  # three standard deviations


def test_white_noise_gives_hardly_any():
    lasting = jolt = 0
    for seed in range(200):
        left = np.random.default_rng(seed).normal(size=(399, 10))
        lasting += changes.lasting_score(left)[1].max() > 1
        jolt += np.nanmax(changes.jolt_score(left)[0]) > 1
    assert lasting == 0 and jolt <= 2


# ---- real flights --------------------------------------------------------------------------------


def test_wind_step_when_the_airspeed_rises():
    log = real("pitch_wind_step_fan500")
    table = np.genfromtxt(FLIGHTS / "pitch_wind_step_fan500_aux.csv", delimiter=",", names=True)
    t, speed = table["t"], table["airspeed_src"]
    near = range(500, 1500)
    split = min(near, key=lambda k: speed[:k].var() * k + speed[k:2000].var() * (2000 - k))
    (found,) = look(log)
    assert found["kind"] == "lasting" and found["time"] == pytest.approx(t[split], abs=1)


@pytest.mark.parametrize("name", ["hover_no_wind", "yaw_turn_takeoff"])
def test_no_change_without_wind(name):
    assert look(real(name)) == []


# ---- command -------------------------------------------------------------------------------------


def test_command_prints_and_writes(tmp_path):
    log = held(flight("hover", 340), 1.0, 20, 1)
    bridge.write_log(tmp_path / "gale.csv", log.x, log.u, log.dt, "fwmav")
    done = processes.tinykoop("changes", tmp_path / "gale.csv", "--out", tmp_path)
    assert done.returncode == 0 and "20.5 s" in done.stdout and "permanent change" in done.stdout and len(done.stdout.splitlines()) == 1
    assert (tmp_path / "changes_gale.json").exists() and (tmp_path / "changes_gale.png").exists()


def test_bad_input_is_one_line(tmp_path):
    log = flight("hover", 341)
    bridge.write_log(tmp_path / "short.csv", log.x[:900], log.u[:900], log.dt, "fwmav")
    x = np.cumsum(np.full((400, 3), 0.01), axis=0)
    bridge.write_log(tmp_path / "drive.csv", x, x[:, :2], 0.05)
    for name, words in (("short.csv", "at least 11 s"), ("drive.csv", "tinykoop diagnose"), ("none.csv", "cannot be opened")):
        done = processes.tinykoop("changes", tmp_path / name, "--out", tmp_path)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
        assert name in done.stderr and words in done.stderr


# ---- rates, for the docs -------------------------------------------------------------------------


def rates(count, update):
    """Prints the share of flights with a false alarm, and of changes that are found, with the error of their time."""

    lines = []

    def show(what, found, truth):
        errors = [min((c["time"] - t for c in answer), key=abs, default=np.inf) for answer, t in zip(found, truth)]
        near = [e for e in errors if abs(e) <= 1]
        false = sum(abs(c["time"] - t) > 1 for answer, t in zip(found, truth) for c in answer)
        spread = f"{np.median(near):+.2f} s, 90 % within {np.quantile(np.abs(near), 0.9):.2f} s" if near else "-"
        print(f"{what:<40} found {100 * len(near) / count:4.0f} %, time {spread}, elsewhere {false}", flush=True)
        lines.append([what, f"{100 * len(near) / count:.0f}", f"{np.quantile(np.abs(near), 0.9):.2f}" if near else "-", false])

    random = np.random.default_rng(10)
    nominal = [flight(MANOEUVRES[i % 3], 40_000 + i) for i in range(3 * count)]
    false_alarms = sum(bool(look(log)) for log in nominal)
    print(f"nominal flights with a false alarm: {false_alarms} of {len(nominal)}")
    for speed in (0.5, 0.75, 1.0, 1.5, 2.0):
        times, angles = random.uniform(6, 34, count), random.uniform(0, 2 * np.pi, count)
        gusts = [bridge.Effect("gust", (speed * np.cos(a), speed * np.sin(a)), t) for t, a in zip(times, angles)]
        show(f"gust of {speed} m/s", [look(flight(MANOEUVRES[i % 3], 50_000 + i, [g])) for i, g in enumerate(gusts)], times)
    for speed in (0.2, 0.4, 0.6, 0.8):
        times, lasts = random.uniform(7, 33, count), random.uniform(0.1, 2, count)
        found = [look(held(log, speed, t - rise / 2, rise)) for log, t, rise in zip(nominal, times, lasts)]
        show(f"held vehicle, wind of {speed} m/s", found, times)
    for name, size in (
        ("gain", -0.5), ("gain", 1.0), ("damping", -0.8), ("damping", 2.0), ("vibration", 2.0), ("asymmetry", 0.05), ("asymmetry", 0.1),
        ("asymmetry", 0.2), ("trim_bias", 0.03), ("trim_bias", 0.06), ("trim_bias", 0.1),
    ):  # fmt: skip
        times = random.uniform(6, 34, count)
        effect = functools.partial(bridge.Effect, name, (size,) * len(bridge.effects("fwmav")[name][1]))
        show(f"{name} {size}", [look(flight(MANOEUVRES[i % 3], 60_000 + i, [effect(t)])) for i, t in enumerate(times)], times)
    headers = ["change", "found (%)", "90 % within (s)", "alarms elsewhere"]
    table = pages.table(f"{count} flights of each; {false_alarms} of {len(nominal)} nominal flights have a false alarm", headers, lines)
    if update:
        pages.update("docs/flapping-wing.md", "changes", table)


if __name__ == "__main__":
    rates(int(sys.argv[1]), "--update" in sys.argv)
