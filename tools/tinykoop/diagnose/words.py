"""Every sentence that people read, on the page and on the terminal: from the report to plain English."""

import math

from .. import bridge
from ..plumbing import results
from .elsewhere import AT_END

SURE = 0.9  # a confidence below is said beside the verdict
COLOURED = 0.95  # noise that remembers as much is hard to tell from slow errors
HIDDEN = 0.1  # standard deviations per row, below which a drive separates nothing
MOVES = 1e-3  # of the usual speed, from which on random motion is told
MOST_PHRASES = 2  # effects that fit into one sentence with their phrases
MOST_SPANS = 2  # times of an effect that are told one by one
MOST_RIVALS = 3
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
    return f"{plain(1000 * metres)} mm" if abs(metres) < 0.0995 else f"{plain(metres)} m"


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


def quantity(value, unit, places=None):
    """A number with its unit; share and factor have none. places: decimals, else three digits."""
    number = plain(real(value), 3) if places is None or abs(real(value)) >= LARGE else f"{real(value):.{places}f}"
    return number + ("" if unit == "1" else f" {unit}")


def _places(value, low, high):
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


def _limits(p):
    cut = [
        f"{verb} faster than {quantity(p[key], unit)}"
        for key, unit, verb in (("v_max", "m/s", "drive"), ("w_max", "rad/s", "turn"))
        if p[key]
    ]
    return f"the robot cannot {listed(cut, 'nor')}" if cut else "speed and turning are cut at a limit"


def _offset(p):
    ahead = f"{length(abs(p['lx']))} {signed(p['lx'], 'ahead of', 'behind')}"
    return f"the position is measured {ahead} and {length(abs(p['ly']))} to the {signed(p['ly'], 'left', 'right')} of the robot's centre"


PHRASES = {
    "speed_gain": lambda p: f"the robot drives {percent_of(p['a'])} {signed(p['a'], 'faster', 'slower')} than commanded",
    "yaw_gain": lambda p: f"the robot turns {percent_of(p['b'])} {signed(p['b'], 'faster', 'slower')} than commanded",
    "wheel_asymmetry": lambda p: (
        f"driving straight turns the robot {signed(p['c'], 'left', 'right')} by {angle(abs(p['c']))} per metre"
    ),
    "yaw_bias": lambda p: f"the robot turns {signed(p['d'], 'left', 'right')} by itself, by {angle(abs(p['d']))} per second",
    "actuator_lag": lambda p: f"speed and turning follow their commands sluggishly, with a time constant of {quantity(p['tau'], 's')}",
    "transport_delay": lambda p: f"commands act {quantity(p['delay'], 's')} late",
    "dead_band": lambda p: f"commands below {quantity(p['v_db'], 'm/s')} and {quantity(p['w_db'], 'rad/s')} do nothing",
    "saturation": _limits,
    "backlash": lambda p: f"play of {quantity(p['half_width'], 'rad/s')} to either side holds the yaw rate back at every reversal",
    "battery_sag": lambda p: f"the robot gets slower over the log, by {percent_of(p['loss_at_end'])} at the end",
    "clock_scale": lambda p: f"a logged second lasts {quantity(1 + real(p['kappa']), 's')}",
    "pacejka_slip": lambda p: f"the wheels slip in fast bends (peak D = {quantity(p['D'], '1')}, sideways {quantity(p['lat'], '1')})",
    "lateral_skid": lambda p: (
        f"in bends the robot slides {signed(p['k'], 'inwards', 'outwards')}, at {quantity(abs(p['k']), 's')} times v omega"
    ),
    "stribeck_friction": lambda p: (
        f"friction takes {percent_of(p['Fs'])} of the speed near standstill and {percent_of(p['Fc'])} and more in motion"
    ),
    "world_drift": lambda p: (
        f"something carries the robot along, at {quantity(p['wx'], 'm/s')} in x and {quantity(p['wy'], 'm/s')} in y"
    ),
    "sensor_lever_arm": _offset,
    "heading_bias": lambda p: f"the heading is measured {angle(abs(p['delta']))} too far {signed(p['delta'], 'left', 'right')}",
}  # fmt: skip


def phrase(effect, phrases=PHRASES):
    """What an effect of the report does, in plain words; name and parameters of one that has no phrase there."""
    try:
        return phrases[effect["name"]](effect["params"])
    except (KeyError, TypeError):
        units = effect.get("units", {})
        values = (f"{name} = {quantity(value, units.get(name, '1'))}" for name, value in effect["params"].items())
        return f"{title(effect['name'])} acts ({', '.join(values)})"


def acts(effect, report):
    """When an effect acts: "whole log", or its segments."""
    end = real(report["log"]["seconds"])
    spans = [[real(t) for t in span] for span in effect["segments"]]
    if not spans or (spans[0][0] <= 0 and spans[-1][1] >= end * 0.999 and len(spans) == 1):
        return "whole log"
    if len(spans) > MOST_SPANS:
        return f"{len(spans)} stretches, {percent(sum(b - a for a, b in spans) / end)} of the log"
    return listed(span(a, b) for a, b in spans)


def marks(effect, name):
    """What must be said beside a parameter: at its bound, or left open by the log."""
    said = []
    if name in effect.get("at_bound", ()):
        said.append("at the edge of its range")
    bounds = _limits_of(effect, name)
    if not all(map(math.isfinite, bounds)) or bounds[1] - bounds[0] > 2 * abs(real(effect["params"][name])):
        said.append("left open")
    return said


def parameters(effect):
    """[(name, value with unit, interval, marks)] of an effect."""
    out = []
    for name, value in effect["params"].items():
        unit = effect.get("units", {}).get(name, "1")
        low, high = _limits_of(effect, name)
        if math.isfinite(low + high):
            places = _places(real(value), low, high)
            shown = quantity(value, unit, places), "[{}, {}]".format(*(quantity(b, "1", places) for b in (low, high)))
        else:
            shown = quantity(value, unit), "no interval"
        out.append((name, *shown, marks(effect, name)))
    return out


def rivals(report, name):
    """Effects that this one may as well be, each once."""
    return [title(rival) for rival in dict.fromkeys(report["ambiguous_with"].get(name, ()))]


# ---- verdict -------------------------------------------------------------------------------------


def horizon(gap):
    """The longest horizon of a `gap` that could be measured; None without any."""
    measured = [key for key, value in gap["before"].items() if math.isfinite(real(value))]
    return max(measured, key=int) if measured else None


def by_heading(report):
    """Whether the verdict is about the heading, as of a robot that turns on the spot."""
    return report["unexplained"].get("unit") == "rad"


def judged(gap, report, size=length):
    """(the part of a `gap` that the verdict is about, how its size is written)."""
    return (gap["heading_rad"], angle) if by_heading(report) else (gap, size)


def steps(key, report):
    """50 steps = 2.5 s."""
    return f"{key} step{'s' if int(key) > 1 else ''} = {int(key) * real(report['log']['dt']):.3g} s"


def ahead(key, report):
    """50 steps = 2.5 s ahead."""
    return f"{steps(key, report)} ahead"


def sizes(gap, key, size=length):
    """Before, after and floor as text."""
    return [size(gap[part][key]) for part in ("before", "after", "noise_floor")]


def shrinks(gap, key, report, size=length):
    """0.45 m to 15 mm, 50 steps = 2.5 s ahead; noise floor 15 mm."""
    before, after, least = sizes(gap, key, size)
    return f"{before} to {after}, {ahead(key, report)}; noise floor {least}"


def named(effect, report, phrases=PHRASES):
    """Phrase, name, rivals and times of one effect."""
    also = rivals(report, effect["name"])
    if len(also) > MOST_RIVALS:
        also = [*also[:MOST_RIVALS], f"{len(also) - MOST_RIVALS} more"]
    name = listed([title(effect["name"]), *also], "or") + (": this log cannot tell which" if also else "")
    when = acts(effect, report)
    how = "in" if len(effect["segments"]) > MOST_SPANS else "from"
    return f"{phrase(effect, phrases)} ({name})" + ("" if when == "whole log" else f" {how} {when}")


def causes(report, phrases=PHRASES):
    """What acts: phrases of a few effects, names of many."""
    effects = report["effects"]
    if len(effects) <= MOST_PHRASES:
        return " and ".join(named(effect, report, phrases) for effect in effects)
    names = (
        title(e["name"]) + (f" (or {listed(rivals(report, e['name']), 'or')})" if rivals(report, e["name"]) else "")
        for e in effects
    )
    return f"{len(effects)} effects act, {listed(names)}"


def _closing(report):
    """How far the effects close the gap."""
    gap, size = judged(report["gap"], report)
    key = horizon(gap)
    if key is None:
        return "the log is too broken up to measure the gap"
    them = "them" if len(report["effects"]) > 1 else "it"
    if not math.isfinite(real(gap["closed_fraction"][key])):
        before, _, least = sizes(gap, key, size)
        return (
            f"the gap is about the noise ({before} against {least}, {ahead(key, report)}): no percentage can be given"
        )
    part = percent(gap["closed_fraction"][key])
    return f"adding {them} closes {part} of the gap ({shrinks(gap, key, report, size)})"


def _closed_in_part(report):
    """What effects that are not the whole cause do: the smaller one of what they close and what they explain."""
    gap, size = judged(report["gap"], report)
    key, explained = horizon(gap), 1 - real(report["unexplained"]["share"])
    if key is None:
        return f"{percent(explained)} of the gap is explained"
    closed = real(gap["closed_fraction"][key])
    part = min(explained, closed) if math.isfinite(closed) else explained
    return f"{percent(part)} of the gap closes ({shrinks(gap, key, report, size)})"


def _none(report):
    left, (gap, size) = report["unexplained"], judged(report["gap"], report)
    key = horizon(gap)
    if key is None:
        return "the log is too broken up to measure the gap"
    before, _, least = sizes(gap, key, size)
    off = f"{ahead(key, report)} it is {before} off, where noise alone makes {least}"
    systematic, smallest = real(left["of_gap_m"]), real(left["smallest_that_matters_m"])
    if systematic < smallest:
        return f"{off}; the gap without noise, {size(systematic)}, is below the smallest that matters, {size(smallest)}"
    return f"{off}; what is left shows no system"


def depends(report):
    """On what the unexplained part depends; empty where nothing is left that matters."""
    left = report["unexplained"]
    if not left["matters"]:
        return ""
    strong = [d for d in left["depends_on"] if real(d["share"]) >= 0.1][:3] or left["depends_on"][:1]
    return listed(
        f"{ {'place': 'position', 'heading': 'the heading'}.get(d['on'], d['on']) } ({d['channel']} error)"
        for d in strong
    )


def _unexplained(what, report):
    """That no effect explains the gap, or what is left of it, and on what that depends where it is known."""
    on = depends(report)
    return f"{what} depends on {on} and none of the known effects explains it" if on else f"none of the known effects explains {what}"


def sentence(report):
    """The verdict in one sentence."""
    left, size = report["unexplained"], judged(report["gap"], report)[1]
    if report["verdict"] == "none":
        return f"None: the simulator explains this log down to its noise: {_none(report)}."
    if report["verdict"] == "known":
        partly = left["matters"]
        return f"Known{', but PARTLY explained' if partly else ''}: {causes(report)}; {_closing(report)}."
    if not report["effects"]:
        return f"Unknown: the simulator is off by {size(left['of_gap_m'])} without noise; {_unexplained('the gap', report)}."
    names = listed(title(effect["name"]) for effect in report["effects"])
    return f"Unknown, PARTLY explained: with {names}, {_closed_in_part(report)}; {_unexplained('what is left', report)}."


def asides(report):
    """What must stand right beside the verdict: short sentences."""
    said, left, size = [], report["unexplained"], judged(report["gap"], report)[1]
    if report["verdict"] == "known" and left["matters"]:
        on = f"; it depends on {depends(report)}" if depends(report) else ""
        said.append(f"What is left is {size(left['gap_m'])} of {size(left['of_gap_m'])} without noise{on}.")
    return said + doubts(report) + tried(report)


def doubts(report):
    """Why the effects may not be the cause."""
    said = []
    if report["verdict"] == "unknown" and report["effects"]:
        said.append("The effects listed are the best that the known ones can do; do not take them for the cause.")
    doubtful = [e for e in report["effects"] if not real(e["confidence"]) >= SURE and report["verdict"] == "known"]
    if doubtful:
        said.append(f"Not certain: {listed(title(e['name']) + ' ' + percent(e['confidence']) for e in doubtful)} sure.")
    return said


def tried(report, size=length, at=horizon):
    """On what the effects were tried; at: the horizon of a gap to speak of."""
    if report["effects"] and "fresh" not in report:
        return ["Tried on rows of this log that were left out of the fit, not on a fresh log."]
    return fresh(report, size, at)


def fresh(report, size=length, at=horizon):
    """What the same model does on the fresh log, and what of it was taken to act there."""
    return [_on_fresh(report, size, at), *_carried(report)] if "fresh" in report else []


def _carried(report):
    """When effects of a part of the log act on the fresh one, and how large one grows that grows with time."""
    said, there = [], {effect["name"]: effect for effect in report["fresh"].get("effects", ())}
    for effect in report["effects"]:
        name, on = title(effect["name"]), there.get(effect["name"])
        if on and (acts(effect, report) != "whole log" or not on["acts"]):
            how = "to act all along" if on["acts"] else "not to act"
            said.append(f"{capital(name)} acts in a part of this log; on the fresh log it is taken {how}, which fits better.")
        if on and on["acts"] and AT_END in on["params"] and on["params"][AT_END] != effect["params"][AT_END]:
            said.append(f"On the fresh log {name} is taken to grow as fast, to {percent_of(on['params'][AT_END])} at its end.")
    return said


def _on_fresh(report, size, at):
    """What the same model does on the fresh log, in one sentence."""
    gap, size = judged(report["fresh"]["gap"], report, size)
    key = at(gap)
    if key is None:
        return "The fresh log is too broken up to measure the gap."
    before, after, least = sizes(gap, key, size)
    part = real(gap["closed_fraction"][key])
    if not report["effects"]:
        return f"On the fresh log the simulator is {before} off, {ahead(key, report)}; noise alone makes {least}."
    if not math.isfinite(part):
        return f"On the fresh log the gap is about the noise ({before} against {least})."
    if part < 0:
        return f"On the fresh log the effects make the gap larger ({before} to {after}): do not use them."
    return f"On the fresh log, with nothing fitted again, {percent(part)} of the gap closes ({shrinks(gap, key, report, size)})."


# ---- details -------------------------------------------------------------------------------------


def open_parameters(report):
    """What the log leaves open of the parameters, a sentence for each effect."""
    said = []
    for effect in report["effects"]:
        rows = [(name, bounds, remarks) for name, _, bounds, remarks in parameters(effect)]
        edge = [name for name, _, remarks in rows if "at the edge of its range" in remarks]
        free = [f"{name} {bounds}" for name, bounds, remarks in rows if "left open" in remarks and name not in edge]
        if free:
            said.append(f"Of {title(effect['name'])} these are left open: {listed(free)}.")
        if edge:
            said.append(
                f"Of {title(effect['name'])}, {listed(edge)} came out at the edge of what is allowed: the true value may lie beyond."
            )
    return said


def ambiguous(report):
    """Which effects this log cannot tell apart."""
    return [
        f"{capital(listed([title(effect['name']), *rivals(report, effect['name'])], 'or'))}: on this log they do the same."
        for effect in report["effects"]
        if rivals(report, effect["name"])
    ]


def unmeasured(report):
    """For which horizons there is no percentage."""
    (gap, _), said = judged(report["gap"], report), []
    near = [
        k
        for k in gap["before"]
        if math.isfinite(real(gap["before"][k])) and not math.isfinite(real(gap["closed_fraction"][k]))
    ]
    unseen = [key for key in gap["before"] if not math.isfinite(real(gap["before"][key]))]
    if near and report["verdict"] != "none":
        said.append(
            f"{listed(near)} step{'s' if near != ['1'] else ''} ahead the gap is about the noise: no percentage there."
        )
    if unseen:
        said.append(f"No stretch of the log is long enough to predict {listed(unseen, 'or')} steps ahead.")
    return said


def cannot_tell(report):
    """What this log leaves open, in sentences."""
    said = ambiguous(report)
    for alike in report["lookalikes"]:
        names = listed(title(name) for name in alike["effects"])
        said.append(f"{capital(names)} together may as well be {alike['as']}.")
    if report["not_testable"]:
        names = listed(title(name) for name in report["not_testable"])
        said.append(f"NOT TESTABLE: {names}. This drive would hardly show them, so they may act or not.")
    said += open_parameters(report) + unmeasured(report)
    if max(real(channel["correlation"]) for channel in report["noise"]["sensor"].values()) > COLOURED:
        said.append(
            "The noise changes so slowly that it cannot be told from slow errors: the noise floor may be too high."
        )
    return said


def noise(report):
    """What the noise of the measured pose is like, and the robot's own random motion."""
    sensor, process = report["noise"]["sensor"], report["noise"]["process"]
    position, heading = sensor["position"], sensor["heading"]
    said = [
        f"A measured position scatters by {length(position['sd'])}, a heading by {angle(heading['sd'])} (one standard deviation)."
    ]
    rho = [real(channel["correlation"]) for channel in (position, heading)]
    colour = "white" if max(rho) < 0.1 else "coloured"
    said.append(f"The noise is {colour}: from row to row it correlates by {rho[0]:.2f} (position) and {rho[1]:.2f} (heading).")
    rows = report["noise"]["outliers"]
    said.append(f"{rows} rows stand out of it: these outliers count less." if rows else "No reading stands out of it.")
    return [*said, _random_motion(process)]


def _random_motion(process):
    """The robot's own, in shares of its usual speed."""
    shares = {name: real(axis["share"]) for name, axis in process.items()}
    if max(shares.values()) < MOVES:
        return "The robot's own random motion is too small to be seen."
    sizes = listed(f"{percent(share)} of the {'yaw rate' if name == 'heading' else 'speed'} ({name})" for name, share in shares.items())
    lasts = seconds(next(iter(process.values()))["seconds"])
    return f"What no effect explains is like random motion of the robot that lasts {lasts}: {sizes}."


def rows_of(report):
    """Size of the log and what of it was used."""
    log = report["log"]
    usable = real(log["usable"])
    used = (
        "all rows were used"
        if usable == 1
        else f"{100 * (1 - usable):.2g} % of the rows are masked or beside a break and were not used"
    )
    return f"{log['rows']} rows, {seconds(log['seconds'])} at {plain(1 / real(log['dt']), 3)} Hz; {used}."


def measured_on(report):
    """The log, what was compared, and how the nominal simulator steps."""
    return [
        rows_of(report),
        f"{report['gap']['windows']} predictions were compared, each from a measured pose, by models fitted without it.",
        f"The nominal robot moves by this rule: {report['integrator']}. It is chosen before any effect, without a parameter.",
    ] + searched(report)


def searched(report):
    """Of a long log, what the search has seen."""
    rows = report["log"].get("searched_rows")
    if rows is None:
        return []
    return [
        f"The log is long: the search of effects looked at {rows:,} of its rows, in pieces evenly spread over it, and followed the "
        f"actuators from {seconds(bridge.WARM_UP)} before each."
    ]


def located(report):
    """Whether the report says where the gap lies."""
    return report["verdict"] != "none" and sum(real(part) for part in report["where"]["channels"].values()) > 0


def where(report):
    """Where the gap lies, in sentences."""
    if not located(report):
        return [
            "There is no gap to locate: what is left is noise."
            if report["verdict"] == "none"
            else "The gap could not be located."
        ]
    said = []
    spread = [s for s in report["where"]["segments"] if real(s[1]) > real(s[0])]
    end = real(report["log"]["seconds"])
    heavy = [s for s in spread if real(s[2]) > 1.5 * (real(s[1]) - real(s[0])) / end]
    if heavy:
        heavy = sorted(heavy, key=lambda s: -real(s[2]))[:3]
        said.append(
            "It is larger than elsewhere "
            + listed(f"from {span(a, b)} ({percent(part)} of it)" for a, b, part in heavy)
            + "."
        )
    worst = [r for r in report["where"]["regions"] if real(r["times_average"]) > 1.2]
    for r in worst[:4]:
        low, high = real(r["from"]), real(r["to"])
        places = _places(high, low, high)
        said.append(
            f"At {r['variable']} of {quantity(low, '1', places)} to {quantity(high, r['unit'], places)}"
            f" it is {real(r['times_average']):.1f} times the average."
        )
    return said


def settles(report):
    """(what the advised drive tells, in a sentence or none; the names of what it does not)."""
    separation = [(title(question), real(value)) for question, value in report["advice"]["separation"].items()]
    told = [f"{question} ({value:.2g})" for question, value in separation if value >= HIDDEN]
    said = f"It tells {listed(told)}; in brackets the distance, in standard deviations of the noise per row."
    return [said] * bool(told), [question for question, value in separation if not value >= HIDDEN]


def advice(report):
    """The next drive, in sentences; empty where nothing is open."""
    if not report["advice"]:
        return []
    drive = report["advice"]
    said = [f"Drive {drive['words']} ({drive['drive']}), at your own safe speeds."]
    told, hidden = settles(report)
    said += told
    if hidden:
        said.append(
            f"It does not settle {listed(hidden)}: that takes higher speeds or smaller commands than this log has."
        )
    said.append("Record it as a log of its own and diagnose that, or give it with --fresh to try what was found here.")
    return said


# ---- captions ------------------------------------------------------------------------------------


def gap_caption(gap, report, size=length, place=""):
    """What the bars bear out."""
    key = horizon(gap)
    if key is None:
        return f"The gap{place} could not be measured"
    before, after, least = (real(gap[part][key]) for part in ("before", "after", "noise_floor"))
    if not report["effects"]:
        return f"{capital(ahead(key, report))} the simulator is {size(before)} off{place}, where noise alone makes {size(least)}"
    if size(after) == size(before):
        return f"{capital(ahead(key, report))} the error stays at {size(after)}{place}; noise alone makes {size(least)}"
    if after > before:
        return f"{capital(ahead(key, report))} the error grows from {size(before)} to {size(after)}{place}"
    return f"{capital(ahead(key, report))} the error falls from {size(before)} to {size(after)}{place}; noise alone makes {size(least)}"


def path_caption(report, steps, before, after):
    """before, after: largest error (m) of the windows drawn."""
    start = f"Predicted {steps} steps ahead from measured poses, the simulator ends up to {length(before)} off"
    return start + (f"; with the effects {length(after)}" if report["effects"] else "")


def time_caption(report):
    """When the gap is there."""
    if report["verdict"] == "none":
        return "The error stays about the noise from the first row to the last"
    if not located(report):
        return "The error over time"
    end = real(report["log"]["seconds"])
    parts = [[real(v) for v in part] for part in report["where"]["segments"]]
    worst = max(parts, key=lambda s: s[2] / max(s[1] - s[0], 1e-9))
    if worst[2] > 1.5 * (worst[1] - worst[0]) / end:
        part = percent((worst[1] - worst[0]) / end)
        return f"The gap is largest from {span(*worst[:2])}: {percent(worst[2])} of it in {part} of the time"
    return "The gap is spread over the whole log"


def channel_caption(report):
    """In which direction the gap lies."""
    name, part = max(report["where"]["channels"].items(), key=lambda item: real(item[1]))
    return f"The largest part of the gap is {name} error: {percent(part)}"


def ranking_caption(report):
    """What the ranking bears out."""
    if report["verdict"] == "none":
        return "No effect explains more than noise does"
    if not report["effects"]:
        return "No known effect is worth adding"
    last = len(report["effects"]) - 1
    rest = [row for row in report["ranking"] if row["name"] not in {e["name"] for e in report["effects"]}]
    if not rest:
        return f"{capital(title(report['effects'][last]['name']))} is needed"
    next_best = rest[0]
    part = percent(min(real(next_best["score"]), 1))
    return f"{capital(title(next_best['name']))} comes next: in place of what was found it would do {part} of the work"


def contribution_caption(report):
    """What each effect is worth beside the others."""
    parts = {name: real(rise[key]) for name, rise in report["contributions"].items() if (key := horizon(report["gap"]))}
    best = max(parts, key=lambda name: parts[name])
    return f"{capital(title(best))} matters most: without it the error grows by {length(parts[best])}"


# ---- terminal ------------------------------------------------------------------------------------


def say(text="", style=None):
    results.console.print(text, highlight=False, style=style)


def effect_rows(report):
    """[(effect, parameter with interval, confidence, when, remarks)]: one row a parameter."""
    rows = []
    for effect in report["effects"]:
        for i, (name, value, bounds, remarks) in enumerate(parameters(effect)):
            first = (
                (title(effect["name"]), percent(effect["confidence"]), acts(effect, report)) if i == 0 else ("", "", "")
            )
            rows.append((first[0], f"{name} = {value}", bounds, first[1], first[2], ", ".join(remarks)))
    return rows


def spread(low, high):
    """94 to 100 %; a dash where there is no percentage."""
    if real(low) >= 0.995:
        return percent(low)
    return f"{hundredths(low)} to {hundredths(high)} %" if math.isfinite(real(low) + real(high)) else "-"


def gap_rows(gap, report, size=length):
    """[(horizon, before, after, floor, closed, interval)]."""
    rows = []
    for key, before in gap["before"].items():
        low, high = gap["ci95"][key] if "ci95" in gap else (None, None)
        closed = real(gap["closed_fraction"][key]) if "closed_fraction" in gap else math.nan
        rows.append(
            (
                steps(key, report),
                size(before),
                size(gap["after"][key]),
                size(gap["noise_floor"][key]),
                percent(closed),
                spread(low, high),
            )
        )
    return rows


GAP_HEADERS = ("ahead", "before", "after", "noise floor", "closed", "95 % interval")


def print_told(report, page, told, gap_name="position", size=length):
    """A report on the terminal. told: (sentence, asides, what the log cannot tell, heading of the advice, advice)."""
    verdict, beside, open_ends, heading, next_one = told
    gap, size = judged(report["gap"], report, size)
    say()
    say(verdict, "bold")
    for aside in beside:
        say(f"  {aside}")
    if report["effects"]:
        results.print_table(
            "Effects", ("effect", "parameter", "95 % interval", "sure", "acts", ""), effect_rows(report)
        )
    results.print_table(f"Gap, {'heading' if by_heading(report) else gap_name}", GAP_HEADERS, gap_rows(gap, report, size))
    if "fresh" in report:
        fresh_gap, _ = judged(report["fresh"]["gap"], report)
        results.print_table("Gap on the fresh log, nothing fitted again", GAP_HEADERS, gap_rows(fresh_gap, report, size))
    if open_ends:
        say("What this log cannot tell", "bold")
        for text in open_ends:
            say(f"  {text}")
    for text in next_one[:1]:
        say(heading, "bold")
        say(f"  {text}")
    say(f"\nPage: {page}")


def print_summary(report, page):
    """The report on the terminal; page: where the HTML is."""
    told = sentence(report), asides(report), cannot_tell(report), "Next drive", advice(report)
    print_told(report, page, told)
