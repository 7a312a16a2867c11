"""Effects in other forms than the one they are named after: found, named, simulated again from the report, and left out."""

import json

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.blind import drives, plant
from tinykoop.diagnose import patch
from tinykoop.diagnose.platforms import ddr
from tinykoop.diagnose.platforms.ddr.told import PHRASES
from tinykoop.diagnose.prediction_errors import candidates
from tinykoop.diagnose.prediction_errors.fit import Cause, Fitter
from tinykoop.diagnose.prediction_errors.noise import first
from tinykoop.plumbing.errors import UserError

DT, SP = 0.05, 0.003  # s; m and rad
FORMS = {name: reported for name, (_, reported) in bridge.families().items() if reported != name}
NEW = ("speed_lag", "yaw_lag", "acceleration_limit", "wheel_dead_band", "wheel_saturation")
ALIAS = {"dead_zone_shifted": "friction_coulomb", "friction_coulomb": "dead_zone_shifted"}  # without a lag between them


def as_log(x, u):
    return bridge.Log(np.arange(len(x)) * DT, x, u, np.ones(len(x) - 1, bool), DT)


def log_of(*names, rows=800, seed=7):
    rng = np.random.default_rng(seed)
    u = drives.rich(rng, rows, DT)[0]
    x = bridge.simulate(u[:-1], DT, active=[bridge.usual_effect(name) for name in names], integrator=bridge.ARC)
    return as_log(x + SP * rng.standard_normal(x.shape), u)


def simulated(report, log):
    """Poses from the first one under the effects of a report."""
    active = [bridge.Effect(e.get("form", e["name"]), tuple(e["params"].values())) for e in report["effects"]]
    return bridge.simulate(log.u[:-1], DT, active=active, integrator=bridge.ARC)


@pytest.mark.parametrize("name", [*FORMS, *NEW])
def test_effect_is_named_and_its_report_simulates_it(name):
    """By the name of the contract or, of an exact alias, with that as the other; far better than the nominal simulator on the whole log."""
    log = log_of(name)
    report = ddr.diagnose(log).report
    (effect,) = report["effects"]
    found = effect.get("form", effect["name"])
    assert found in (name, ALIAS.get(name))
    assert effect["name"] == FORMS.get(found, found)
    assert found == name or FORMS[name] in report["ambiguous_with"][effect["name"]]
    assert list(effect["params"]) == [row[0] for row in bridge.effects()[found][1]]
    truth = bridge.simulate(log.u[:-1], DT, active=[bridge.usual_effect(name)], integrator=bridge.ARC)
    off = [np.linalg.norm(x - truth) for x in (simulated(report, log), simulated({"effects": []}, log))]
    assert off[0] < 0.1 * off[1]


@pytest.mark.parametrize("name", ["saturation", "pacejka_slip", "actuator_lag"])
def test_cause_of_another_form_is_named_with_confidence(name):
    """By the second plant, whose other forms are written in continuous time."""
    log = log_of()
    u = log.u[:-1]
    usual = {row[0]: row[4] for row in bridge.effects()[name][1]}
    x = plant.simulate(u, DT, [plant.Cause(name, usual, "other")], (0.0, 0.0, 0.0), np.random.default_rng(0))
    report = ddr.diagnose(as_log(x + SP * np.random.default_rng(1).standard_normal(x.shape), log.u)).report
    assert report["verdict"] == "known" and report["effects"][0]["name"] == name and report["effects"][0]["confidence"] > 0.5
    assert report["gap"]["closed_fraction"]["50"] > 0.95


def test_names_of_a_report_are_those_of_the_contract():
    report = ddr.diagnose(log_of("slip_general", "yaw_lag")).report
    named = {e["name"] for e in report["effects"]} | {r["name"] for r in report["ranking"]} | {*report["not_testable"]}
    named |= {*report["contributions"], *report["ambiguous_with"], *sum(report["ambiguous_with"].values(), [])}
    assert not named & set(FORMS) and {"pacejka_slip", "yaw_lag"} == {e["name"] for e in report["effects"]}
    assert len(report["ranking"]) == len({r["name"] for r in report["ranking"]})


def test_effect_left_out_is_left_out_in_every_form():
    path = ddr.Path(log_of(), without=("pacejka_slip", "wheel_saturation"))
    assert not {"pacejka_slip", "slip_general", "slip_saturating", "wheel_saturation"} & set(path.effects)
    assert {"saturation", "saturation_soft"} <= set(path.effects)


def scanned(path, fit):
    """Names of the effects that a search for one effect more has simulated."""
    seen, steps = set(), path.steps
    path.steps = lambda trials: seen.update(c.name for trial in trials for c in trial) or steps(trials)
    candidates.candidates(Fitter(path, first(path)), fit)
    path.steps = steps
    return seen


def test_forms_are_tried_only_where_their_family_promises_something():
    def of(name):
        path = ddr.Path(log_of(name))
        return scanned(path, Fitter(path, first(path)).fit_of(()))

    slips = {"slip_general", "slip_saturating"}
    assert not of("world_drift") & slips and slips < of("pacejka_slip")
    leaders = {name for name, (_, reported) in bridge.families().items() if reported == name} - {"measurement_noise"}
    families = {bridge.families()[name][0] for name in of("world_drift")}
    assert families == {bridge.families()[name][0] for name in leaders}


def test_fit_takes_an_effect_in_one_form():
    path = ddr.Path(log_of("slip_general"))
    usual = tuple(p.usual for p in path.effects["slip_saturating"].parameters)
    fit = Fitter(path, first(path)).fit_of((Cause("slip_saturating", usual),))
    assert not {"pacejka_slip", "slip_general", "slip_saturating"} & set(fit.lacks(path.effects))
    assert "lateral_skid" in fit.lacks(path.effects)


def test_every_effect_has_few_starts_inside_its_bounds_and_a_phrase():
    for u in (log_of().u, np.ones((5, 2)), np.zeros((5, 2))):
        for name, effect in ddr.effects(u).items():
            assert name not in (*FORMS, *NEW) or len(effect.starts) <= 5
            for start in effect.starts:
                assert all(p.low <= value <= p.high for p, value in zip(effect.parameters, start))
            for values in ([p.usual for p in effect.parameters], [0.0] * len(effect.parameters)):
                assert PHRASES[name]({p.name: value for p, value in zip(effect.parameters, values)})


def test_patch_refuses_a_form(tmp_path):
    effect = {"name": "saturation", "form": "saturation_soft", "formula": "u", "params": {"v_max": 1.0}, "segments": [[0, 10]]}
    (tmp_path / "report.json").write_text(json.dumps({"verdict": "known", "effects": [effect], "log": {"seconds": 10}}))
    with pytest.raises(UserError, match="saturation was found in a form that no file can hold"):
        patch.run(tmp_path / "report.json", tmp_path / "robot.py")
