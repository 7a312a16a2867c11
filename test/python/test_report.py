"""The page and the terminal summary: what they say, for every kind of report, and that the page needs nothing else."""

import base64
import copy
import dataclasses
import json
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.platforms.ddr import diagnose, told
from tinykoop.diagnose.report import figures, words
from tinykoop.diagnose.report.html import html
from tinykoop.diagnose.report.terminal import show
from tinykoop.plumbing import results

DT = 0.05
VOID = {"meta", "link", "br", "img", "input", "hr"}


def make_log(rows, effects, seed, noise=0.005):
    rng = np.random.default_rng(seed)
    u = np.repeat(np.column_stack([rng.uniform(0, 1.6, rows // 20), rng.uniform(-1, 1, rows // 20)]), 20, axis=0)
    x = bridge.simulate(u[:-1], DT, active=effects, integrator=bridge.ARC)
    x += noise * rng.standard_normal(x.shape)
    return bridge.Log(np.arange(len(x)) * DT, x, u, np.ones(len(x) - 1, bool), DT)


@pytest.fixture(scope="module")
def lag():
    """A log with a lag, and a fresh one."""
    effects = [bridge.usual_effect("actuator_lag")]
    result = diagnose(make_log(400, effects, 1), fresh=make_log(300, effects, 2))
    result.report = {"log_file": "drives/<b>&.csv", "fresh_file": "drives/fresh.csv", **result.report}
    return result


@pytest.fixture(scope="module")
def healthy():
    return diagnose(make_log(300, [], 3))


@pytest.fixture(scope="module")
def spot():
    """A robot that turns on the spot, less than commanded, and a fresh log."""
    logs = [turning_log(400, seed) for seed in (1, 2)]
    return diagnose(logs[0], fresh=logs[1])


def turning_log(rows, seed):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.2, 1.2, (rows // 20, 1)), 20, axis=0) * (0.0, 1.0)
    x = bridge.simulate(u[:-1], DT, active=[bridge.usual_effect("yaw_gain")], integrator=bridge.ARC)
    return bridge.Log(np.arange(rows) * DT, x + 0.004 * rng.standard_normal(x.shape), u, np.ones(rows - 1, bool), DT)


class Reader(HTMLParser):
    """Collects text and addresses; fails on tags that do not close in order."""

    def __init__(self, html):
        super().__init__()
        self.open, self.text, self.addresses, self.tags = [], [], [], []
        self.feed(html)
        self.close()
        assert not self.open
        self.text = " ".join(" ".join(self.text).split())

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.addresses += [value for name, value in attributes if name in ("src", "href", "xlink:href", "action", "data")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open.pop() == tag, tag

    def handle_data(self, data):
        if self.open and self.open[-1] != "style":
            self.text.append(data)


def page(result):
    return html(ddr.Teller(result).story()).decode()


def read(result):
    return Reader(page(result))


def changed(result, **keys):
    """A copy of a result with other keys in its report."""
    other = copy.copy(result)
    other.report = {**copy.deepcopy(result.report), **keys}
    return other


# ---- the page ------------------------------------------------------------------------------------


def test_page_needs_nothing_else(lag, healthy):
    for result in (lag, healthy):
        text = page(result)
        reader = Reader(text)
        assert all(address.startswith(("data:", "#")) for address in reader.addresses)
        assert not re.search(r"@import|url\((?!#)|https?://", text)
        assert "script" not in reader.tags and len(text) < 1.5e6


def test_page_says_verdict_effects_and_fresh_log(lag, healthy):
    for result in (lag, healthy):
        text = read(result).text
        assert ddr.Teller(result).sentence() in text
        for aside in ddr.Teller(result).asides():
            assert aside in text
    assert lag.report["verdict"] == "known" and healthy.report["verdict"] == "none"
    text = read(lag).text
    assert "actuator lag" in text and "fresh.csv" in text and "On the fresh log" in text
    assert "without refitting" not in read(healthy).text


def test_names_of_files_are_escaped(lag):
    text = page(lag)
    assert "&lt;b&gt;&amp;.csv" in text and "<b>" not in text


def test_page_of_every_verdict_and_of_a_report_read_back(lag, healthy, tmp_path):
    for result in (lag, healthy):
        for word in ("known", "partly", "none", "unknown"):
            assert ddr.Teller(changed(result, verdict=word)).sentence() in read(changed(result, verdict=word)).text
        results.write_json(tmp_path / "r.json", result.report)
        again = changed(result)
        again.report = json.loads((tmp_path / "r.json").read_text())
        assert page(again) == page(result)


def test_page_without_figures_to_give(lag):
    nothing = dict.fromkeys(("1", "10", "50"))
    gap = {**lag.report["gap"], **dict.fromkeys(("before", "after", "noise_floor", "closed_fraction"), nothing)}
    gap["ci95"] = dict.fromkeys(nothing, [None, None])
    gaps = {"position": gap, "heading": gap | {"unit": "rad"}}
    contributions = {"actuator_lag": nothing, "yaw_gain": nothing}
    for word in ("known", "partly", "none", "unknown"):
        bare = changed(
            lag,
            verdict=word,
            gap=gap,
            gaps=gaps,
            fresh={"gap": gap, "gaps": gaps},
            contributions=contributions,
            advice=None,
            not_testable=[],
        )
        nan = {name: np.full_like(errors, np.nan) for name, errors in lag.found.before.items()}
        bare.found = dataclasses.replace(lag.found, before=nan)
        text = read(bare).text
        assert not re.search(r'="[^"]*\bnan', page(bare))
        assert "nan" not in re.findall(r"[a-z]+", text.lower()) and "too broken up" in text + "too broken up" * (word == "unknown")


def test_masked_log_is_drawn_with_gaps(lag):
    masked, search, path, log = (copy.copy(part) for part in (lag, lag.found.search, lag.path, lag.log))
    search.path, path.log, log.usable = path, log, lag.log.usable.copy()
    log.usable[::30] = False
    masked.found = dataclasses.replace(lag.found, search=search)
    rows, before, after = told.predicted(masked)
    assert rows.shape[1] == 30 and np.isfinite(before).all() and np.isfinite(after).all()
    assert all(masked.log.usable[row[0] : row[-1]].all() for row in rows)
    read(masked)


def test_predictions_are_the_simulators(lag):
    rows, before, after = told.predicted(lag)
    for k in (0, len(rows) // 2):
        start, u = lag.log.x[rows[k, 0]], lag.log.u[rows[k, :-1]]
        assert np.allclose(before[k], bridge.simulate(u, DT, start, integrator=bridge.ARC)[:, :2], atol=1e-9)
    end = lag.log.x[rows[:, -1], :2]
    assert np.linalg.norm(after[:, -1] - end, axis=1).max() < 0.3 * np.linalg.norm(before[:, -1] - end, axis=1).max()


def test_advised_drive_can_be_taken_from_the_page(lag):
    advised = changed(lag, advice={"drive": "steps", "words": "steps of speed", "separation": {"a_b or c": 2.0, "d or not": 1e-9}})
    advised.more = {"drive": np.tile([[0.5, -0.2]], (40, 1))}
    reader = read(advised)
    (address,) = [a for a in reader.addresses if a.startswith("data:text/csv")]
    lines = base64.b64decode(address.split(",")[1]).decode().splitlines()
    assert lines[0] == "t,v,omega" and lines[-1] == "1.95,0.5,-0.2" and len(lines) == 41
    assert "It decides a b or c (2)" in reader.text and "does not decide d or not" in reader.text


# ---- words ---------------------------------------------------------------------------------------


def test_every_effect_of_the_library_has_words(lag):
    effects = ddr.effects(np.ones((2, 2)))
    assert set(told.PHRASES) == set(effects)
    for name, known in effects.items():
        for factor in (1.0, -1.0, 0.0):
            effect = {"name": name, "params": {p.name: factor * p.usual for p in known.parameters}}
            assert " acts (" not in ddr.Teller(lag).phrase(effect) and "nan" not in ddr.Teller(lag).phrase(effect)


def test_effect_without_words_is_named_with_its_parameters(lag):
    effect = {"name": "loose_screw", "params": {"play": 0.0123456, "n": 2.0}, "units": {"play": "m"}}
    assert ddr.Teller(lag).phrase(effect) == "loose screw acts (play = 0.0123 m, n = 2.00)"
    assert ddr.Teller(lag).phrase({"name": "actuator_lag", "params": {"other": 1.0}}).startswith("actuator lag acts")


@pytest.mark.parametrize(
    "value, text",
    [
        (0.4512, "0.45 m"),
        (0.01513, "15 mm"),
        (0.00996, "10 mm"),
        (12.34, "12 m"),
        (0.0, "0 mm"),
        (None, "-"),
        (math.nan, "-"),
    ],
)
def test_length(value, text):
    assert words.length(value) == text


@pytest.mark.parametrize("part, text", [(0.994, "99 %"), (1.0, "over 99 %"), (0.001, "under 1 %"), (-0.3, "-30 %"), (None, "-")])
def test_percent_does_not_claim_all(part, text):
    assert words.percent(part) == text


def test_parameters_are_rounded_by_their_interval():
    effect = {"params": {"tau": 0.300012, "B": 8.94, "C": 1.7, "D": 2.0}, "units": {"tau": "s"}, "at_bound": ["D"],
              "params_ci95": {"tau": [0.29874, 0.30130], "B": [-5.0, 30.0], "C": [None, None], "D": [1.9, 2.0]}}  # fmt: skip
    assert words.parameters(effect) == [
        ("tau", "0.3000 s", "[0.2987, 0.3013]", []),
        ("B", "9", "[-5, 30]", ["undetermined"]),
        ("C", "1.70", "no interval", ["undetermined"]),
        ("D", "2.00", "[1.90, 2.00]", ["at its bound"]),
    ]


def test_noise_is_said_with_the_robots_own_motion(lag):
    noise = lag.report["noise"]
    assert "too small to matter" in " ".join(ddr.Teller(lag).noise())
    axes = {name: axis | {"share": 0.034, "seconds": 0.3} for name, axis in noise["process"].items()}
    said = " ".join(ddr.Teller(changed(lag, noise=noise | {"process": axes, "outliers": 7})).noise())
    assert "correlated over 0.300 s" in said and "longitudinal, 3 % of its usual rate" in said and "7 rows are outliers" in said


def unknown(result):
    """The same with effects that are a best fit and not established."""
    return changed(result, verdict="unknown", effects=[], best_fit=result.report["effects"])


def test_what_is_open_is_said(lag):
    one = {**lag.report["effects"][0], "segments": [[3.0, 8.5]], "at_bound": ["tau"], "confidence": 0.6}
    left = {
        **lag.report["unexplained"],
        "matters": True,
        "depends_on": [{"on": "v omega", "channel": "lateral", "share": 0.6}],
    }
    result = changed(
        lag,
        verdict="partly",
        effects=[one],
        unexplained=left,
        not_testable=["dead_band"],
        ambiguous_with={"actuator_lag": ["transport_delay", "transport_delay"]},
    )
    says = ddr.Teller(result)
    said, beside, open_ends = says.sentence(), " ".join(says.asides()), " ".join(says.cannot_tell())
    assert "in part" in said and "3.00 to 8.50 s" in said and said.count("transport delay") == 1 and "cannot separate" in said
    assert "actuator lag 60 %" in beside and "The rest depends on v omega (lateral error)" in said
    assert "Not testable: dead band" in open_ends and "tau is at the bound" in open_ends and "transport delay" in open_ends
    assert "v omega (lateral error) and matches none of the known effects" in ddr.Teller(unknown(result)).sentence()
    assert (
        ddr.Teller(changed(result, verdict="unknown", effects=[]))
        .sentence()
        .startswith("Cause not identified. Beyond noise the simulator is off by")
    )


def test_effects_too_small_to_matter_are_told(lag):
    small = {**lag.report["effects"][0], "name": "dead_band", "params": {"v_db": 0.002, "w_db": 0.003}, "units": {}}
    (said,) = ddr.Teller(changed(lag, small=[small])).small()
    assert said.startswith("Significant, but too small to matter on this log: commands below 0.00200 m/s")


METRES = re.compile(r"[0-9] m?m\b")


def test_gap_of_a_robot_on_the_spot_is_an_angle(spot):
    assert spot.report["unexplained"]["unit"] == "rad" and spot.report["verdict"] == "known"
    left = {**spot.report["unexplained"], "gap": 0.1, "of_gap": 0.2, "smallest_that_matters": 0.3}
    for verdict, matters in (("known", False), ("known", True), ("unknown", True), ("none", False)):
        for effects in (spot.report["effects"], []):
            told = changed(spot, verdict=verdict, effects=effects, unexplained=left | {"matters": matters})
            says = ddr.Teller(unknown(told) if verdict == "unknown" else told)
            said = " ".join([says.sentence(), *says.asides(), *says.unmeasured()])
            assert not METRES.search(said) and " deg" in said, said


def test_gap_of_a_robot_on_the_spot_is_that_of_its_heading(spot):
    """Against the simulator's own predictions; the summary, the first figure and the page say the same."""
    log = spot.log
    _, off = bridge.windows(log.x, log.u, DT, range(50, len(log.x) - 50), [50], integrator=bridge.ARC)
    before = math.degrees(np.sqrt(np.mean(off[:, 0, 2] ** 2)))
    heading = spot.report["gaps"]["heading"]
    assert math.degrees(heading["before"]["50"]) == pytest.approx(before, rel=0.05)
    off, after, least = (heading[part]["50"] for part in ("before", "after", "noise_floor"))
    assert heading["closed_fraction"]["50"] == pytest.approx((off - after) / (off - min(least, after)))
    with results.console.capture() as caught:
        show(ddr.Teller(spot).story(), "out/report.html")
    for text in (ddr.Teller(spot).sentence(), caught.get(), read(spot).text):
        assert words.angle(off) in text
    assert "Gap, heading" in caught.get()


@pytest.mark.parametrize("left", [{"matters": False}, {"matters": True, "depends_on": []}], ids=["small", "no trace"])
def test_what_depends_on_nothing_is_told_in_whole_sentences(lag, left):
    result = changed(lag, unexplained={**lag.report["unexplained"], **left})
    assert not any("depends" in aside for aside in ddr.Teller(result).asides())
    result = unknown(result)
    assert ddr.Teller(result).sentence().endswith(" What they leave matches none of the known effects.")
    result.report["best_fit"] = []
    assert ddr.Teller(result).sentence().endswith(" The gap matches none of the known effects.")


def test_no_percentage_near_the_noise(lag):
    gap = {**lag.report["gap"], "closed_fraction": dict.fromkeys(("1", "10", "50"), math.nan)}
    assert "no percentage" in ddr.Teller(changed(lag, gaps={"position": gap})).sentence()


def test_unknown_does_not_claim_more_than_it_explains(lag):
    gap = {**lag.report["gap"], "closed_fraction": {"1": 1.0, "10": 1.0, "50": 1.0}}
    left = {**lag.report["unexplained"], "share": 0.4, "matters": True}
    said = ddr.Teller(unknown(changed(lag, gaps={"position": gap}, unexplained=left))).sentence()
    assert (
        said.startswith("Cause not identified. The best fit among the known effects (actuator lag) lets the error fall from ")
        and "%" not in said
    )


def test_effects_that_harm_on_the_fresh_log_are_not_recommended(lag):
    fresh = copy.deepcopy(lag.report["fresh"])
    fresh["gaps"]["position"]["closed_fraction"]["50"] = -0.2
    assert "do not use them" in " ".join(ddr.Teller(changed(lag, fresh=fresh)).asides())


# ---- terminal ------------------------------------------------------------------------------------


def test_summary_fits_on_a_screen(lag, healthy):
    for result, least in ((lag, 12), (healthy, 6)):
        with results.console.capture() as caught:
            show(ddr.Teller(result).story(), "out/[red]report.html")
        text = caught.get()
        flat = " ".join(text.split())
        assert " ".join(ddr.Teller(result).sentence().split()) in flat and "out/[red]report.html" in flat
        assert least <= len([line for line in text.splitlines() if line.strip()]) <= 30


def test_dense_line_keeps_what_is_seen_of_it():
    X, Y = np.linspace(0, 99.99, 100000), np.random.default_rng(1).normal(size=100000)
    Y[70_000:70_500] = np.nan
    good = np.isfinite(Y)
    shown = figures.drawn(X, Y, good)
    assert shown.sum() <= 4 * 100 + 6
    for column in range(100):
        inside = (X >= column) & (X < column + 1)
        for extreme in (np.nanmin, np.nanmax):
            assert extreme(Y[inside & shown]) == extreme(Y[inside])
    assert shown[[0, 69_999, 70_500, -1]].all() and (shown & ~good)[70_000:70_500].any(), "the gap stays one"


def test_thin_line_is_drawn_point_by_point():
    assert figures.drawn(np.arange(50.0), np.ones(50), np.ones(50, bool)).all()
    assert len(figures.drawn(np.zeros(0), np.zeros(0), np.zeros(0, bool))) == 0


# ---- numbers -------------------------------------------------------------------------------------


def test_every_axis_has_two_numbers_at_least():
    """One does not tell how large anything is."""
    rng = np.random.default_rng(3)
    for low, span in zip(rng.normal(size=2000), 10 ** rng.uniform(-4, 4, 2000)):
        for most in (4, 5):
            ticks, _ = figures.round_numbers(low * span, low * span + span, most)
            assert 2 <= len(ticks) <= most + 3
            assert low * span - 1e-6 * span <= min(ticks) and max(ticks) <= low * span + span * (1 + 1e-6)


LONG = re.compile(r"[0-9][0-9,.]{12,}")  # more than anyone reads


@pytest.mark.parametrize("value", [1e150, -1e150, 1.23456789e12, 1e-12, -1.23456789e-150, 0.0, 123456.789])
def test_no_number_is_printed_with_more_digits_than_anyone_reads(value):
    said = [words.plain(value), words.plain(value, 5), words.length(value), words.angle(value), words.percent(value), words.seconds(value)]
    for width in (0, 1e-3, 1.0):
        places = words.places_of(value, value - width * abs(value), value + width * abs(value))
        said.append(words.quantity(value, "m", places))
    ticks, places = figures.round_numbers(value - abs(value), value + abs(value))
    said += [figures.tick(t, places) for t in ticks]
    assert not [text for text in said if LONG.search(text)]


def test_page_of_a_log_at_the_limits_of_the_reader_has_no_long_numbers():
    """A pose that is off by as much as can be read, and a robot as small as can be."""
    for scale in (1e-9, 1.0):
        log = make_log(300, [], 4)
        log.x[:, :2] *= scale
        if scale == 1:
            log.x[150:, 0] += 1e8 - 100
        result = diagnose(log)
        text = re.sub(r'<path[^>]*>|href="data:[^"]*"', "", page(result))
        assert not LONG.findall(text)
