"""The page and the summary of a flight: what they say and draw, for every kind of report."""

import copy
import json
import math
import re
from xml.etree import ElementTree

import numpy as np
import pytest
from test_report import Reader
from tinykoop import bridge
from tinykoop.diagnose.platforms import fwmav
from tinykoop.diagnose.platforms.fwmav import diagnose, figures, told, vehicle
from tinykoop.diagnose.recording import tracks
from tinykoop.diagnose.report.html import html
from tinykoop.diagnose.report.terminal import show
from tinykoop.plumbing import results

SECONDS, FROM = 9, 4.0
TRIM = (0.03, 0.05)
HOSTILE = "flights/<b onload='x'>&\".csv"


@pytest.fixture(scope="module")
def trim():
    """A flight whose servos are off from some time on, and a fresh one that has that throughout."""
    log = bridge.fwmav("pitch", SECONDS, 21, [bridge.Effect("trim_bias", TRIM, FROM)])[0]
    fresh = bridge.fwmav("pitch", 8, 22, [bridge.Effect("trim_bias", TRIM)])[0]
    result = diagnose(log, fresh)
    result.report = {"log_file": HOSTILE, "fresh_file": "flights/fresh.csv", **result.report}
    return result


def changed(result, **keys):
    """A copy of a result with other keys in its report."""
    other = copy.copy(result)
    other.report = {**copy.deepcopy(result.report), **keys}
    return other


def foreign(result, vehicle="simulated"):
    """As if nothing but another vehicle had been found."""
    left = {**result.report["unexplained"], "another_vehicle": True, "times_noise": 12.6, "matters": True, "share": 1.0}
    left["depends_on"] = [{"on": "always", "channel": "along x", "share": 0.4}, {"on": "yaw", "channel": "about z", "share": 0.3}]
    return changed(result, verdict="unknown", effects=[], contributions={}, unexplained=left, vehicle=vehicle)


def near(result):
    """As if the gap were about the noise everywhere."""
    return changed(result, gaps={"attitude": result.report["gap"] | {"closed_fraction": dict.fromkeys(("1", "10", "50"), math.nan)}})


def shaken(result):
    """As if the flight were only shaken more than others."""
    a = {"name": "vibration", "evidence": 900.0, "confidence": 0.99, "params": {"a": 0.5}, "params_ci95": {"a": [0.45, 0.55]}}
    a |= {"segments": [[0.0, SECONDS]], "units": {"a": "1"}, "at_bound": [], "formula": ""}
    return changed(
        near(result), effects=[a], contributions={}, ranking=[{"name": "vibration", "score": 2.0}, {"name": "gain", "score": 0.3}]
    )


def nothing_found(result):
    return changed(near(result), verdict="none", effects=[], contributions={}, fresh=result.report["fresh"])


KINDS = {"known": lambda r: r, "near": near, "shaken": shaken, "foreign": foreign, "none": nothing_found}


def tell(result):
    return fwmav.Teller(result)


def page(result):
    return html(tell(result).story()).decode()


def read(result):
    return Reader(page(result))


# ---- the page ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_page_of_every_kind_of_report(trim, kind):
    result = KINDS[kind](trim)
    text = page(result)
    reader = Reader(text)
    assert all(address.startswith(("data:", "#")) for address in reader.addresses)
    assert "script" not in reader.tags and not re.search(r"@import|url\((?!#)|https?://", text) and len(text) < 1.5e6
    figures_ = re.findall(r"<svg.*?</svg>", text, re.S)
    assert len(figures_) >= 6
    for figure in figures_:
        ElementTree.fromstring(figure)
    assert not re.search(r"\b(nan|inf|NaN|Infinity)\b", text) and not re.search(r"\bNone\b", text)
    assert tell(result).sentence() in reader.text
    for said in (*tell(result).asides(), *tell(result).cannot_tell(), *tell(result).noise()):
        assert said in reader.text


def test_effect_that_sets_in_acts_on_a_fresh_flight_all_along(trim):
    (effect,) = trim.report["fresh"]["effects"]
    assert effect == {"name": "trim_bias", "params": trim.report["effects"][0]["params"], "acts": True}
    assert trim.report["fresh"]["gap"]["closed_fraction"]["50"] > 0.5
    assert "On the fresh log trim bias is assumed to act throughout" in read(trim).text


def test_effect_that_set_in_is_left_out_of_a_healthy_fresh_flight():
    report = diagnose(
        bridge.fwmav("pitch", SECONDS, 21, [bridge.Effect("trim_bias", TRIM, FROM)])[0], bridge.fwmav("pitch", 8, 23)[0]
    ).report
    assert [(e["name"], e["acts"]) for e in report["fresh"]["effects"]] == [("trim_bias", False)]
    assert report["fresh"]["gap"]["after"] == report["fresh"]["gap"]["before"]


def test_page_says_what_was_done_to_the_flight(trim):
    report, text = trim.report, read(trim).text
    assert report["verdict"] == "known" and "(trim bias)" in tell(trim).sentence()
    assert "tips forward" in text and "turns left" in text
    assert "fresh.csv" in text and "On the fresh log" in text


def test_names_of_files_are_escaped(trim):
    text = page(trim)
    assert "<b " not in text and "&lt;b onload=" in text


def test_page_of_a_report_read_back(trim, tmp_path):
    results.write_json(tmp_path / "r.json", trim.report)
    again = changed(trim)
    again.report = json.loads((tmp_path / "r.json").read_text())
    assert page(again) == page(trim)


# ---- figures -------------------------------------------------------------------------------------


def test_predictions_drawn_are_those_of_the_gap(trim):
    axis, rows, before, after = figures.predictions(trim)
    y = vehicle.measured(trim.log)
    assert np.allclose(before[:, 0], y[rows[:, 0]])
    compared = 0
    for k, row in enumerate(rows):
        (at,) = np.nonzero(trim.found.starts == row[0])
        if len(at):
            missed = trim.more["missed"][0][at[0], -1, vehicle.ANGLES]
            assert np.allclose(vehicle.wrapped(y[row[-1]] - before[k, -1])[vehicle.ANGLES], missed)
            compared += 1
    assert compared >= 1
    # the twist that is off turns the vehicle: that is what is drawn, where it acts, and mended
    assert figures.AXES[axis] == "yaw" and trim.log.t[rows[-1, 0]] >= FROM
    ends = y[rows[:, -1], 8]
    assert np.abs(after[:, -1, 8] - ends).max() < 0.5 * np.abs(before[:, -1, 8] - ends).max()


def test_spectra_keep_the_power(trim):
    """Parseval: the amplitudes drawn hold the variance of what was missed (healthy flights have the same)."""
    f, amplitude = figures._spectra(trim)
    missed = trim.more["innovations"][0][trim.path.known]
    for channel in (0, 1, 4):
        power = np.sum(amplitude[0, :, channel] ** 2) * (f[1] - f[0])
        assert power == pytest.approx(np.var(missed[:, channel]), rel=0.15)


# ---- words ---------------------------------------------------------------------------------------


def test_every_effect_has_words(trim):
    known = bridge.effects("fwmav")
    assert set(told.PHRASES) == set(known)
    for name, (_, spec) in known.items():
        for factor in (1.0, -1.0, 0.0):
            effect = {"name": name, "params": {row[0]: factor * row[4] for row in spec}}
            assert " acts (" not in tell(trim).phrase(effect) and "nan" not in tell(trim).phrase(effect)


@pytest.mark.parametrize("name, params, spin, said", [
    ("trim_bias", (0.05, 0.0), 1, "tips forward"),
    ("trim_bias", (0.0, -0.05), -2, "turns right"),
    ("asymmetry", (0.05,), 0, "left wing pushes 5.0 % more"),
])  # fmt: skip
def test_words_turn_the_vehicle_as_the_simulator_does(trim, name, params, spin, said):
    """Spin about x (left wing up), y (forward) and z (left) after a moment; a minus: the other way."""
    commands = np.tile([[17.0, 0.0, 0.0, 0.0]], (10, 1))
    states = bridge.fwmav_roll(bridge.fwmav_hover(), commands, 0.01, [bridge.Effect(name, params)])
    still = bridge.fwmav_roll(bridge.fwmav_hover(), commands, 0.01)
    turned = (states - still)[-1, bridge.FWMAV_STATE["spin"]]
    assert np.argmax(np.abs(turned)) == abs(spin) and np.sign(turned[abs(spin)]) == (1 if spin >= 0 else -1)
    names = [row[0] for row in bridge.effects("fwmav")[name][1]]
    assert said in tell(trim).phrase({"name": name, "params": dict(zip(names, params))})


def test_no_percentage_near_the_noise(trim):
    said = tell(near(trim)).sentence()
    assert "no percentage" in said and "moves the predicted attitude by" in said and "closes" not in said
    assert "closes" in tell(trim).sentence()


def test_another_vehicle_is_told_what_to_do(trim):
    says = tell(foreign(trim))
    assert "13 times the variance of healthy simulated flights" in says.sentence()
    beside = " ".join(says.asides())
    assert "--healthy HEALTHY.csv" in beside
    assert "an acceleration along x that is always there and an acceleration about z that goes with yaw" in beside
    assert "--healthy" not in " ".join(tell(foreign(trim, "own")).asides())


def test_effects_that_make_it_worse_are_not_praised(trim):
    gap = copy.deepcopy(trim.report["gap"])
    gap["after"]["50"] = 3 * gap["before"]["50"]
    gap["closed_fraction"]["50"] = -2.0
    assert "makes the prediction worse" in tell(changed(trim, gaps={"attitude": gap})).sentence()
    other = changed(foreign(trim), gaps={"attitude": gap}, effects=trim.report["effects"], contributions=trim.report["contributions"])
    other.report["unexplained"]["share"] = 0.2
    assert "would explain" not in tell(other).sentence() and "gets worse" in " ".join(tell(other).asides())


def test_vibration_is_no_cause_that_others_stand_in_for(trim):
    says = tell(shaken(trim))
    assert "shaken 50 % more" in says.sentence() and "changes no prediction" in says.sentence()
    assert "Next comes" not in says.ranking_caption() and "Next comes" in tell(trim).ranking_caption()


def test_bands_are_named(trim):
    loud = [{"channel": "pitch", "from_hz": 3.0, "to_hz": 8.0, "times_noise": 1.47}]
    says = tell(changed(trim, where={**trim.report["where"], "frequencies": loud}))
    assert says.band_caption().startswith("Pitch at 3 to 8 Hz (control loop): 1.5 times")
    assert says.bands() == ["At 3 to 8 Hz (control loop) errors are larger than on healthy flights: pitch (1.5 times)."]


# ---- terminal ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_summary_fits_on_a_screen(trim, kind):
    story = tell(KINDS[kind](trim)).story()
    with results.console.capture() as caught:
        show(story, "out/[red]report.html")
    text = caught.get()
    assert " ".join(story.sentence.split()) in " ".join(text.split()) and "out/[red]report.html" in text
    assert len([line for line in text.splitlines() if line.strip()]) <= 45


def test_a_recording_has_attitudes_as_predicted_without_and_with_the_effects(trim):
    """The angles that the report compares: with the effect less is missed, half a second after each row that a prediction begins at."""
    shown = tracks.of(trim)
    ends = [b for a, b in shown.windows if b - a == 50]
    missed = [np.sqrt(np.nanmean(shown.residuals(kind)[ends, 6:] ** 2)) for kind in tracks.KINDS]
    assert shown.pose is None and shown.signals[7] == ("pitch", "rad") and missed[1] < missed[0]
