"""Numbers, times and names as a report has them."""

import math

from ...plumbing import results

MOST_SPANS = 2  # times of an effect that are told one by one
MILLIMETRES = 0.0995  # m, below which a length is given in mm
MOST_PLACES, LARGE = 6, 1e7  # decimals, and end, of the numbers that are written without an exponent


# ---- numbers -------------------------------------------------------------------------------------


def real(value):
    """A float; NaN for a null of the report."""
    return math.nan if value is None else float(value)


def length(metres):
    """0.45 m, 15 mm."""
    metres = real(metres)
    if not math.isfinite(metres):
        return "-"
    return f"{plain(1000 * metres)} mm" if abs(metres) < MILLIMETRES else f"{plain(metres)} m"


def metres(value):
    """0.015 m, where others beside it are larger."""
    return f"{plain(real(value))} m" if math.isfinite(real(value)) else "-"


def angle(radians):
    """In degrees."""
    radians = real(radians)
    return f"{plain(math.degrees(radians))} deg" if math.isfinite(radians) else "-"


def plain(value, digits=2):
    """Rounded to some digits, without an exponent where one reads no better."""
    if not math.isfinite(value):
        return "-"
    value = float(f"{value:.{digits}g}")
    places = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
    return f"{value:.{max(places, 0)}f}" if places <= MOST_PLACES and abs(value) < LARGE else results.number(value, digits)


def hundredths(part):
    """A share in percent, without the sign."""
    value = 100 * real(part)
    return f"{value:.0f}" if abs(value) < LARGE else results.number(value)


def percent(part):
    """Never 100 % for what was measured, nor 0."""
    part = real(part)
    if not math.isfinite(part):
        return "-"
    if part >= 0.995:
        return "over 99 %"
    return f"{hundredths(part)} %" if abs(part) >= 0.005 else "under 1 %"


def size_of(unit):
    """How a quantity of this unit is written."""
    return {"m": length, "rad": angle}.get(unit, lambda value: quantity(value, unit.replace("^2", "²")))


def common_size(unit, values):
    """How quantities of this unit are written beside each other: lengths all in m, or all in mm."""
    known = [abs(v) for v in map(real, values) if math.isfinite(v)]
    return metres if unit == "m" and max(known, default=0.0) >= MILLIMETRES else size_of(unit)


def quantity(value, unit, places=None):
    """A number with its unit; share and factor have none. places: decimals, else three digits."""
    number = plain(real(value), 3) if places is None or abs(real(value)) >= LARGE else f"{real(value):.{places}f}"
    return number + ("" if unit == "1" else f" {unit}")


def places_of(value, low, high):
    """Decimals that show two digits of an interval's width, but no more than five of the value; none where they are too many."""
    width = high - low
    if not width > 0:
        return None
    size = max(abs(value), abs(low), abs(high))
    places = max(0, min(1 - math.floor(math.log10(width)), 4 - math.floor(math.log10(size))))
    return places if places <= MOST_PLACES else None


def _limits_of(effect, name):
    """95 % interval of a parameter; NaN where it has none."""
    return [real(b) for b in effect["params_ci95"].get(name) or (math.nan, math.nan)]


def spread(low, high):
    """94 to 100 %; a dash where there is no percentage."""
    if real(low) >= 0.995 or abs(real(low)) + abs(real(high)) < 0.005:
        return percent(low)
    return f"{hundredths(low)} to {hundredths(high)} %" if math.isfinite(real(low) + real(high)) else "-"


def seconds(time):
    """A time in the log; tenths below a hundred."""
    return f"{plain(real(time), 3)} s"


def span(start, end):
    """30 to 70 s."""
    return f"{seconds(start)[:-2]} to {seconds(end)}"


def listed(items, last="and"):
    """a, b and c."""
    items = list(items)
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}" if items else ""


def title(name):
    """The name of an effect as people write it."""
    return str(name).replace("_", " ")


def capital(text):
    return text[:1].upper() + text[1:]


# ---- effects -------------------------------------------------------------------------------------


def percent_of(share):
    return f"{plain(abs(100 * real(share)))} %"


def signed(value, above, below):
    return above if real(value) > 0 else below


def acts(effect, report):
    """When an effect acts: "whole log", or its segments."""
    end = real(report["log"]["seconds"])
    spans = [[real(t) for t in span] for span in effect["segments"]]
    if not spans or (spans[0][0] <= 0 and spans[-1][1] >= end * 0.999 and len(spans) == 1):
        return "whole log"
    if len(spans) > MOST_SPANS:
        return f"{len(spans)} stretches, {percent(sum(b - a for a, b in spans) / end)} of the log"
    return listed(f"{seconds(a)} to the end" if a > 0 and b >= end * 0.999 else span(a, b) for a, b in spans)


def marks(effect, name):
    """What must be said beside a parameter: at its bound, or left open by the log."""
    said = []
    if name in effect.get("at_bound", ()):
        said.append("at its bound")
    bounds = _limits_of(effect, name)
    if not all(map(math.isfinite, bounds)) or bounds[1] - bounds[0] > 2 * abs(real(effect["params"][name])):
        said.append("undetermined")
    return said


def formula(effect):
    """What an effect does, with the units of its parameters; "" where that is not known."""
    units = effect.get("units", {})
    bare = [name for name, unit in units.items() if unit == "1"]
    known = [f"{name} in {unit}" for name, unit in units.items() if unit != "1"]
    known += [f"{listed(bare)} dimensionless"] if bare else []
    return f"{effect['formula']} ({', '.join(known)})" if effect.get("formula") else ""


def parameters(effect):
    """[(name, value with unit, interval, marks)] of an effect."""
    out = []
    for name, value in effect["params"].items():
        unit = effect.get("units", {}).get(name, "1")
        low, high = _limits_of(effect, name)
        if math.isfinite(low + high):
            places = places_of(real(value), low, high)
            shown = quantity(value, unit, places), "[{}, {}]".format(*(quantity(b, "1", places) for b in (low, high)))
        else:
            shown = quantity(value, unit), "no interval"
        out.append((name, *shown, marks(effect, name)))
    return out
