"""The regulators of lib/ and their settings, as the library lists them."""

import ctypes as ct
from functools import cache
from typing import NamedTuple

from . import library
from .library import call, raw


class Setting(NamedTuple):
    """Name, bounds (refused outside) and default of a setting, in float64."""

    name: str
    low: float
    high: float
    default: float


def regulators():
    """Returns {name: (Setting, ..)} of all regulators, in the order of KOOP_REGULATORS."""
    return dict(_regulators())


def regulator_names():
    """Names of all regulators, in the order of KOOP_REGULATORS."""
    return tuple(_regulators())


def dead_zones():
    """Names of the regulators that gate by a threshold delta of the innovation, which can be calibrated."""
    return tuple(name for name, settings in _regulators().items() if any(s.name == "delta" for s in settings))


@cache
def _regulators():
    raw("tk_message")  # loads the library
    library._c.tk_regulator_name.restype = ct.c_char_p
    library._c.tk_regulator_settings.restype = ct.c_size_t
    table = {}
    while name := raw("tk_regulator_name", ct.c_size_t(len(table))):
        count = raw("tk_regulator_settings", ct.c_size_t(len(table)))
        table[name.decode()] = tuple(_setting(len(table), i) for i in range(count))
    return table


def _setting(regulator, setting):
    name, numbers = ct.c_char_p(), [ct.c_double() for _ in range(3)]
    call("tk_regulator_setting", ct.c_size_t(regulator), ct.c_size_t(setting), ct.byref(name), *map(ct.byref, numbers))
    return Setting(name.value.decode(), *(number.value for number in numbers))


def setting_values(regulator, given):
    """Values of all settings of a regulator, in its order; raises TypeError for a name that no regulator knows."""
    known = {setting.name for settings in _regulators().values() for setting in settings}
    if unknown := set(given) - known:
        raise TypeError(f"no regulator has a setting named {sorted(unknown)}; there are {sorted(known)}")
    return [given.get(setting.name, setting.default) for setting in _regulators().get(regulator, ())]
