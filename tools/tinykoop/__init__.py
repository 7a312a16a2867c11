"""TinyKoop in Python: learn, predict, control and diagnose with the C library inside; and the host tools.

Names are loaded when they are first used, so that the command starts quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from . import diagnose as diagnose
    from .bridge import Effect as Effect
    from .bridge import Log as Log
    from .bridge import lowpass as lowpass
    from .bridge import read_log as read_log
    from .bridge import regulators as regulators
    from .bridge import simulate as simulate
    from .bridge import threshold as threshold
    from .bridge import write_log as write_log
    from .controller import MPC as MPC
    from .controller import Guard as Guard
    from .dictionaries import RBF as RBF
    from .dictionaries import Angles as Angles
    from .dictionaries import Constant as Constant
    from .dictionaries import CSource as CSource
    from .dictionaries import Function as Function
    from .dictionaries import Poly as Poly
    from .dictionaries import Products as Products
    from .learner import RLS as RLS
    from .learner import Gate as Gate
    from .learner import Health as Health
    from .learner import Refused as Refused
    from .learner import c_library as c_library
    from .plumbing.errors import UserError as UserError

_PLACES = {
    "bridge": ("Effect", "Log", "lowpass", "read_log", "regulators", "simulate", "threshold", "write_log"),
    "controller": ("MPC", "Guard"),
    "dictionaries": ("RBF", "Angles", "Constant", "CSource", "Function", "Poly", "Products"),
    "learner": ("RLS", "Gate", "Health", "Refused", "c_library"),
    "plumbing.errors": ("UserError",),
}
_WHERE = {name: place for place, names in _PLACES.items() for name in names}
__all__ = [*_WHERE, "diagnose"]


def __getattr__(name):
    if name == "diagnose":
        return import_module(f".{name}", __name__)
    if name not in _WHERE:
        raise AttributeError(f"module 'tinykoop' has no attribute {name!r}")
    value = getattr(import_module(f".{_WHERE[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__():
    return sorted({*globals(), *__all__})
