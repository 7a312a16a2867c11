"""Every regulator that lib/ lists, whatever it is: a new one is tested by being listed."""

import itertools
import re

import numpy as np
import pytest
from tinykoop import bridge
from tinykoop.experiments import scenario
from tinykoop.plumbing import plots, sources
from tinykoop.plumbing.checkout import ROOT
from tinykoop.plumbing.errors import UserError

NAMES = bridge.regulator_names()
SETTINGS = [(name, setting) for name, settings in bridge.regulators().items() for setting in settings]


@pytest.fixture(scope="module")
def drive():
    u = scenario.commands(400)
    return bridge.simulate(u, scenario.DT, np.zeros(3)), u


def test_the_lists_of_library_and_sources_agree():
    assert NAMES == sources.regulators()
    assert NAMES[:6] == ("none", "ef", "dz_cs", "dz_ks", "ct", "sift")
    assert set(bridge.dead_zones()) >= {"dz_cs", "dz_ks"}


def test_every_regulator_is_in_experiments_and_plots_in_a_style_of_its_own():
    for name in NAMES:
        assert scenario.LABELS[name] and plots.STYLES[name]["color"] and isinstance(plots.HATCHES[name], str)
    styles = [(plots.STYLES[name]["color"], str(plots.STYLES[name]["ls"])) for name in NAMES]
    assert len(set(styles)) == len(NAMES)
    assert {method.regulator for method in scenario.METHODS} == set(NAMES) - {"none"} | {"offline"}
    assert len(scenario.METHODS) == 11 + 2 * (len(NAMES) - 6)


@pytest.mark.parametrize("name, precision, form", list(itertools.product(NAMES, (32, 64), ("plain", "sqrt"))))
def test_learns_a_nominal_drive_with_default_settings(name, precision, form, drive):
    estimator = bridge.Estimator("poly_ddr", name, precision, form=form)
    trace = estimator.replay(*drive)
    assert (trace["status"] == 0).all() and np.isfinite(trace["norm_p"]).all()
    assert trace["positive_definite"].all()
    assert np.mean(trace["error"][-100:]) < 0.2 * np.mean(trace["error"][:10])


@pytest.mark.parametrize("name, setting", SETTINGS)
def test_settings_have_bounds_that_hold(name, setting):
    assert setting.low <= setting.default <= setting.high and np.isfinite([setting.low, setting.high]).all()
    bridge.Estimator("poly_ddr", name, 64, **{setting.name: setting.default})
    for outside in (setting.low - 1e-3 - 1e-3 * abs(setting.low), np.inf, np.nan):
        said = f"setting {setting.name} of regulator {name} is {outside:g}, outside its range {setting.low:g} to {setting.high:g}"
        with pytest.raises(UserError, match=re.escape(said)):
            bridge.Estimator("poly_ddr", name, 64, **{setting.name: outside})


def test_a_setting_that_no_regulator_has_is_refused():
    with pytest.raises(TypeError, match="no regulator has a setting named \\['detla'\\]; there are .*'delta'"):
        bridge.Estimator("poly_ddr", "dz_cs", 64, detla=0.1)


def test_a_setting_of_another_regulator_changes_nothing(drive):
    plain, other = (bridge.Estimator("poly_ddr", "ct", 64, **given) for given in ({}, {"delta": 1e3, "eps_sift": 1.0}))
    plain.replay(*drive), other.replay(*drive)
    assert (plain.theta == other.theta).all()


def test_every_regulator_that_is_defined_is_listed_and_compiled():
    """A name that is forgotten in the list would leave its regulator untested and unused."""
    files = sorted((ROOT / "lib/src").glob("regulator_*.c"))
    defined = [name for file in files for name in re.findall(r"^const KOOP\(regulator\) KOOP\(reg_(\w+)\)", file.read_text(), re.M)]
    assert sorted(defined) == sorted(NAMES)
    included = (ROOT / "lib/src/all.h").read_text()
    assert [file.name for file in files if f'#include "{file.name}"' not in included] == []


@pytest.mark.parametrize("name", NAMES)
def test_every_regulator_and_each_of_its_settings_is_described(name):
    page = (ROOT / "docs/learning.md").read_text()
    assert re.search(rf"^\|[^|]*`{name}`", page, re.M), f"docs/learning.md has no row of `{name}`"
    assert [setting.name for setting in bridge.regulators()[name] if f"`{setting.name}`" not in page] == []


@pytest.mark.parametrize("end", ["low", "high"])
@pytest.mark.parametrize("name, setting", SETTINGS)
def test_learns_at_the_ends_of_its_settings(name, setting, end, drive):
    """Or is refused, where the other settings forbid that end."""
    try:
        estimator = bridge.Estimator("poly_ddr", name, 64, form="sqrt", check=bridge.CHECK_REFUSE, **{setting.name: getattr(setting, end)})
    except UserError as refused:
        assert re.search(rf"regulator {name}, lambda = .*, {setting.name} = ", str(refused))
        return
    trace = estimator.replay(*drive)
    assert np.isfinite(trace["error"]).all() and np.isfinite(estimator.theta).all()
