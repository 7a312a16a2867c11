"""Units that a column may have, and what one of each is in the unit that everything here reckons in."""

import math

from .plumbing.errors import UserError

UNITS = {  # unit: (unit here, factor)
    "deg": ("rad", math.pi / 180), "mrad": ("rad", 1e-3), "deg/s": ("rad/s", math.pi / 180), "mrad/s": ("rad/s", 1e-3),
    "rpm": ("rad/s", 2 * math.pi / 60), "min": ("s", 60.0), "ms": ("s", 1e-3), "us": ("s", 1e-6), "ns": ("s", 1e-9),
    "mm": ("m", 1e-3), "cm": ("m", 1e-2), "km": ("m", 1e3), "mm/s": ("m/s", 1e-3), "cm/s": ("m/s", 1e-2), "km/h": ("m/s", 1 / 3.6),
    "g": ("m/s2", 9.80665), "mg": ("m/s2", 9.80665e-3), "m/s^2": ("m/s2", 1.0), "m/s/s": ("m/s2", 1.0),
    "mV": ("V", 1e-3), "%": ("1", 1e-2),
}  # fmt: skip


def base(unit):
    """(unit here, factor); a unit that is not known is one of its own."""
    return UNITS.get(unit, (unit, 1.0))


def factor(unit, wanted, where):
    """What one of `unit` is in the wanted unit; refuses what does not measure the same."""
    found, scale = base(unit)
    if found != wanted:
        known = ", ".join([wanted, *(name for name, (to, _) in UNITS.items() if to == wanted)])
        raise UserError(f"{where}: '{unit}' is no unit of what is in {wanted} here; there are {known}")
    return scale
