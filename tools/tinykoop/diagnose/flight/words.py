"""What people read about a flight: from its report to plain English, with the helpers of ../words.py."""

import math

from .. import words
from ..prediction_errors.ahead import SHOWS
from ..words import ahead, angle, capital, listed, percent, percent_of, plain, quantity, real, shrinks, signed, sizes, title
from .advise import SECONDS
from .diagnosis import ANOTHER
from .vehicle import CHANNELS, UNITS
from .where import BANDS

SMALLEST = 0.1  # share of what is systematic, below which nothing counts as explained
BAND_NAMES = ("drift", "manoeuvres", "control loop", "wing beat", "its harmonics")
VEHICLES = {"simulated": "the simulated vehicle", "own": "the vehicle of the healthy flight"}
U = {"pitch": "the dihedral", "yaw": "the wing twist"}


# ---- effects -------------------------------------------------------------------------------------


def _milliseconds(time):
    return f"{plain(1000 * real(time))} ms"


def _trim(p):
    dihedral, twist = (angle(abs(real(p[name]))) for name in ("pitch", "yaw"))
    return (
        f"neutral dihedral is off by {dihedral}, which tips {signed(p['pitch'], 'forward', 'back')},"
        f" and neutral twist by {twist}, which turns {signed(p['yaw'], 'left', 'right')}"
    )


PHRASES = {
    "delay": lambda p: f"the command reaches the servos {_milliseconds(p['delay'])} late",
    "lag": lambda p: f"the servos follow the command sluggishly, with a time constant of {_milliseconds(p['tau'])} on top of their own",
    "gain": lambda p: f"the command does {percent_of(p['a'])} {signed(p['a'], 'more', 'less')} than it should",
    "trim_bias": _trim,
    "battery_sag": lambda p: f"the battery's voltage falls by {percent_of(p['loss_at_end'])} by the end, on top of the usual",
    "asymmetry": lambda p: (
        f"the left wing pushes {percent_of(p['c'])} {signed(p['c'], 'more', 'less')} than it should"
        f" and the right one as much {signed(p['c'], 'less', 'more')}"
    ),
    "damping": lambda p: f"the air brakes moving and turning {percent_of(p['a'])} {signed(p['a'], 'more', 'less')} than it should",
    "vibration": lambda p: f"the sensors are shaken {percent_of(p['a'])} {signed(p['a'], 'more', 'less')} than on healthy flights",
    "gust": lambda p: f"wind of {plain(real(p['wx']))} m/s in x and {plain(real(p['wy']))} m/s in y sets in",
    "gyro_bias": lambda p: (
        f"the gyro is off by {listed(f'{angle(p[name])}/s about {axis}' for name, axis in (('bx', 'x'), ('by', 'y'), ('bz', 'z')))}"
    ),
}  # fmt: skip


# ---- verdict -------------------------------------------------------------------------------------


def beyond(gap):
    """The longest horizon at which the gap is more than the noise; None if it is nowhere."""
    return max((key for key, part in gap["closed_fraction"].items() if math.isfinite(real(part))), key=int, default=None)


def _told(gap):
    """The horizon to speak of: further ahead than that noise hides the gap."""
    return beyond(gap) or words.horizon(gap)


def _closing(report):
    """How far the effects close the gap; what they move where that cannot be said."""
    gap, key, longest = report["gap"], beyond(report["gap"]), words.horizon(report["gap"])
    them = "them" if len(report["effects"]) > 1 else "it"
    if longest is None:
        return "the flight is too broken up to measure the gap"
    if _worse(report):
        return f"but adding {them} makes the prediction worse ({_worse(report)})"
    if not report["contributions"]:
        return "that is noise, and moves no prediction"
    if key is None:
        moves = listed(f"{angle(by[longest])} ({title(name)})" for name, by in report["contributions"].items())
        noise = f"where wing beat, turbulence and sensors alone make {angle(gap['noise_floor'][longest])}"
        return f"{ahead(longest, report)}, that moves the predicted attitude by {moves}, {noise}: no percentage can be given"
    return f"adding {them} closes {percent(gap['closed_fraction'][key])} of the gap ({shrinks(gap, key, report, angle)})"


def _worse(report):
    """How the prediction gets worse with the effects; empty where it does not."""
    gap, key = report["gap"], words.horizon(report["gap"])
    if key is None or not real(gap["after"][key]) > real(gap["before"][key]) or len(set(sizes(gap, key, angle)[:2])) == 1:
        return ""
    return shrinks(gap, key, report, angle)


def depends(report):
    """What the unexplained part looks like; empty where nothing systematic is left."""
    found = report["unexplained"]["depends_on"]
    strong = [d for d in found if real(d["share"]) >= 0.1][:3] or found[:1]
    goes = {"always": "is always there", "time": "changes with time"} | {name: f"goes with {name}" for name in ("roll", "pitch", "yaw")}
    return listed(f"an acceleration {d['channel']} that {goes.get(d['on'], 'goes with the ' + d['on'])}" for d in strong)


def _foreign(report):
    """How what is missed differs from the noise of the vehicle that the flight is compared with."""
    times = real(report["unexplained"]["times_noise"])
    how = f"its variance is {plain(times)} times as large" if times > ANOTHER else "it shakes the sensors in other proportions"
    return f"what is missed is not the noise of {VEHICLES[report['vehicle']]}: {how}"


def sentence(report):
    """The verdict in one sentence."""
    left = report["unexplained"]
    if report["verdict"] == "none":
        key, off = words.horizon(report["gap"]), "it is too broken up to measure the gap"
        if key:
            before, _, least = sizes(report["gap"], key, angle)
            off = f"{ahead(key, report)} the attitude is {before} off, where noise alone makes {least}"
        return f"None: the simulator explains this flight down to its noise: {off}; what is left shows no system."
    if report["verdict"] == "known":
        return f"Known{', but PARTLY explained' if left['matters'] else ''}: {words.causes(report, PHRASES)}; {_closing(report)}."
    why = _foreign(report) if left["another_vehicle"] else "something is left that none of the known effects explains"
    explained = 1 - real(left["share"])
    fitted = [title(name) for name in report["contributions"]]
    if fitted and explained >= SMALLEST and not _worse(report):
        return f"Unknown, PARTLY explained: {listed(fitted)} would explain {percent(explained)} of what is systematic, but {why}."
    return f"Unknown: {why}."


def asides(report):
    """What must stand right beside the verdict: short sentences."""
    said, left, rest = [], report["unexplained"], depends(report)
    if report["verdict"] != "none" and left["matters"] and rest:
        part = f", {percent(left['share'])} of what was systematic" if report["effects"] else ""
        said.append(f"What is left{part}, shows as {rest}.")
    if left["another_vehicle"] and report["vehicle"] == "simulated":
        said.append(
            "A vehicle of your own always differs from the simulated one: give a healthy flight of it with --healthy HEALTHY.csv,"
            " and the simulator is fitted to that first."
        )
    if report["verdict"] == "unknown" and _worse(report):
        said.append(f"With the effects listed the prediction gets worse: {_worse(report)}.")
    said += words.doubts(report)
    return said + (words.tried(report, angle, _told) if report["contributions"] or "fresh" in report else [])


# ---- details -------------------------------------------------------------------------------------


def bands(report):
    """Where in frequency more is missed than on healthy flights."""
    named = {}
    for band in report["where"]["frequencies"]:
        named.setdefault((band["from_hz"], band["to_hz"]), []).append(f"{band['channel']} ({real(band['times_noise']):.1f} times)")
    return [f"At {_band(*edges)} more is missed than on healthy flights of {listed(channels)}." for edges, channels in named.items()]


def _band(low, high):
    """3 to 8 Hz (control loop)."""
    return f"{low:g} to {high:g} Hz ({dict(zip(BANDS, BAND_NAMES))[low, high]})"


def where(report):
    """Where the gap lies, in sentences."""
    if beyond(report["gap"]) is None and report["verdict"] != "none":
        return ["When and in what kind of flight the attitude errors are large tells little here: they are about those of healthy flights."]
    return words.where(report)


def cannot_tell(report):
    """What this flight leaves open, in sentences."""
    said = words.ambiguous(report)
    rivals = {name for also in report["ambiguous_with"].values() for name in also}
    hidden = [title(name) for name in report["not_testable"] if name not in rivals]
    if hidden:
        said.append(f"NOT TESTABLE: {listed(hidden)}. At their usual size this flight would hardly show them, so they may act or not.")
    said.append(
        "No flight shows steady wind, with which the vehicle drifts, nor a battery that sags as long as the height hold can make up for it."
    )
    return said + words.open_parameters(report) + words.unmeasured(report)


def advice(report):
    """The next flight, in sentences; empty where nothing is open."""
    if not report["advice"]:
        return []
    flight, (told, hidden) = report["advice"], words.settles(report)
    said = [f"Fly {flight['drive']}: {flight['words']} for {SECONDS} s at least, with the vehicle as it was."]
    if not told:
        said = [
            f"{SECONDS} s of no manoeuvre settle {listed(hidden, 'or')}; {flight['drive']} comes nearest: {flight['words']}, for longer."
        ]
    elif hidden:
        told.append(f"It does not settle {listed(hidden)}.")
    return [*said, *told, "Record it as a log of its own and diagnose that, or give it with --fresh to try what was found here."]


def measured_on(report):
    """The log, what was compared, and how."""
    return [
        words.rows_of(report),
        f"The command u was taken for {U[report['axis']]}: within a moment it goes with the {report['axis']} that the controller holds.",
        f"{report['gap']['windows']} predictions were compared, each from what an observer made of the rows before,"
        " by models fitted without it; commands and flight controller are those of the log.",
    ]


def noise(report):
    """What the noise is, and whether the flight has it."""
    times, whose = real(report["unexplained"]["times_noise"]), VEHICLES[report["vehicle"]]
    return [
        f"Noise is what healthy flights of {whose} leave: wing beat, turbulence, and what differs from flight to flight."
        if report["vehicle"] == "simulated"
        else "Noise is what the healthy flight leaves that was given, after the simulator was fitted to it.",
        f"What the observer misses in each row has {plain(times)} times its variance{' with the effects' * bool(report['contributions'])}.",
    ]


def channel_rows(report):
    """[(channel, before, after, floor)] at the longest horizon."""
    key = words.horizon(report["gap"])
    if key is None:
        return []
    rows = []
    for name, unit in zip(CHANNELS, UNITS):
        parts = report["gap"]["channels"][name]
        values = [parts[part][key] for part in ("before", "after", "noise_floor")]
        rows.append((name, *(angle(value) if unit == "rad" else quantity(value, unit.replace("^2", "²")) for value in values)))
    return rows


CHANNEL_HEADERS = ("channel", "before", "after", "noise floor")


# ---- captions ------------------------------------------------------------------------------------


def time_caption(report):
    """When the gap is there."""
    if beyond(report["gap"]) is None:
        return "The attitude error stays about that of healthy flights"
    return words.time_caption(report)


def channel_caption(report):
    """Which channel is worst, in times its noise."""
    key = words.horizon(report["gap"])
    times = channel_times(report, "before")
    if not times:
        return "The channels could not be measured"
    worst = max(times, key=times.get)
    if times[worst] < 1 + SHOWS:
        return f"{capital(ahead(key, report))} no channel is clearly more off than on healthy flights"
    return f"{capital(ahead(key, report))} {worst} is most off: {times[worst]:.1f} times as much as on healthy flights"


def channel_times(report, part):
    """{channel: its error in times that of healthy flights}, at the longest horizon."""
    key = words.horizon(report["gap"])
    channels = report["gap"]["channels"] if key else {}
    return {name: real(parts[part][key]) / real(parts["noise_floor"][key]) for name, parts in channels.items()}


def band_caption(report):
    """Which band of which channel is loudest."""
    found = report["where"]["frequencies"]
    if not found:
        return "At no frequency is clearly more missed than on healthy flights"
    worst = found[0]
    at = _band(worst["from_hz"], worst["to_hz"])
    return f"{capital(worst['channel'])} at {at}: {real(worst['times_noise']):.1f} times what is missed on healthy flights"


def follow_caption(report, axis, before, after):
    """before, after: largest error (rad) of the predictions drawn."""
    said = f"In the worst seconds {axis}, predicted up to 0.5 s ahead, is up to {angle(before)} off"
    return said + (f"; with the effects {angle(after)}" if report["contributions"] else "")


def ranking_caption(report):
    """What the ranking bears out; vibration is measured, and nothing stands in for it."""
    fitted = {part: [row for row in report[part] if row["name"] != "vibration"] for part in ("effects", "ranking")}
    return words.ranking_caption({**report, **fitted})


def contribution_caption(report):
    """What each effect moves."""
    key = words.horizon(report["gap"])
    parts = {name: real(by[key]) for name, by in report["contributions"].items()}
    best = max(parts, key=parts.get)
    most = " most, by" if len(parts) > 1 else " by"
    return f"{capital(ahead(key, report))} {title(best)} moves the predicted attitude{most} {angle(parts[best])}"


# ---- terminal ------------------------------------------------------------------------------------


def print_summary(report, page):
    """The report on the terminal; page: where the HTML is."""
    told = sentence(report), asides(report), cannot_tell(report), "Next flight", advice(report)
    words.print_told(report, page, told, "attitude", angle)
