"""What a report says of a flight: its phrases, attitude and command over time, and what is missed by frequency."""

import math

import numpy as np

from ...prediction_errors.ahead import SHOWS, rms
from ...report.figures import bars
from ...report.story import Section, Table, Teller
from ...report.words import angle, capital, listed, percent, percent_of, plain, real, signed, size_of, title
from . import figures
from .advise import SECONDS
from .diagnosis import ANOTHER
from .vehicle import CHANNELS, UNITS
from .where import BANDS

SMALLEST = 0.1  # share of what is systematic, below which nothing counts as explained
RUNNING = 1.0  # s, over which errors are averaged: one by one they follow the turbulence
VEHICLES = {"simulated": "healthy simulated flights", "own": "the healthy flight that was given"}
U = {"pitch": "the dihedral", "yaw": "the wing twist"}


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


class Flight(Teller):
    phrases = PHRASES
    log = "flight"
    experiment = "What to fly next"
    fewest_worth = 1

    @property
    def moves(self):
        """Whether there is an effect that changes predictions: vibration is noise to them."""
        return bool(self.report["contributions"])

    # ---- the verdict -----------------------------------------------------------------------------

    def told_at(self, gap):
        """The longest horizon at which the gap is more than the noise: further ahead noise hides it."""
        return self.beyond(gap) or self.horizon(gap)

    @staticmethod
    def beyond(gap):
        return max((key for key, part in gap["closed_fraction"].items() if math.isfinite(real(part))), key=int, default=None)

    def closing(self):
        """How far the effects close the gap; what they move where that cannot be said."""
        gap, key, longest = self.gap, self.beyond(self.gap), self.horizon(self.gap)
        them = "them" if len(self.fitted) > 1 else "it"
        if longest is None:
            return "the flight is too broken up to measure the gap"
        if self._worse():
            return f"however, adding {them} makes the prediction worse ({self._worse()})"
        if not self.moves:
            return "vibration is noise, and changes no prediction"
        if key is None:
            moves = listed(f"{angle(by[longest])} ({title(name)})" for name, by in self.report["contributions"].items())
            noise = f"where wing beat, turbulence and sensors alone make {angle(gap['noise_floor'][longest])}"
            return f"{self.ahead(longest)}, that moves the predicted attitude by {moves}, {noise}, so no percentage is given"
        return f"adding {them} closes {percent(gap['closed_fraction'][key])} of the gap ({self.shrinks(gap, key)})"

    def _worse(self):
        """How the prediction gets worse with the effects; empty where it does not."""
        gap, key = self.gap, self.horizon(self.gap)
        if key is None or not real(gap["after"][key]) > real(gap["before"][key]) or len(set(self.sizes(gap, key)[:2])) == 1:
            return ""
        return self.shrinks(gap, key)

    def depends(self):
        """What the unexplained part looks like; empty where nothing systematic is left."""
        found = self.left["depends_on"]
        strong = [d for d in found if real(d["share"]) >= 0.1][:3] or found[:1]
        goes = {"always": "is always there", "time": "changes with time"} | {name: f"goes with {name}" for name in ("roll", "pitch", "yaw")}
        return listed(f"an acceleration {d['channel']} that {goes.get(d['on'], 'goes with the ' + d['on'])}" for d in strong)

    def _foreign(self):
        """How what is missed differs from the noise of the vehicle that the flight is compared with."""
        times, whose = real(self.left["times_noise"]), VEHICLES[self.report["vehicle"]]
        if times > ANOTHER:
            return f"The prediction errors have {plain(times)} times the variance of {whose}, so something acts that the simulator lacks"
        return f"The vibration shakes the sensors in other proportions than on {whose}"

    def sentence(self):
        if self.report["verdict"] != "unknown":
            return super().sentence()
        why = self._foreign() if self.left["another_vehicle"] else "Systematic errors remain that match none of the known effects"
        explained = 1 - real(self.left["share"])
        if self.moves and explained >= SMALLEST and not self._worse():
            names = listed(title(name) for name in self.report["contributions"])
            return f"Cause not identified. {capital(names)} would explain {percent(explained)} of the systematic error. {why}."
        return f"Cause not identified. {why}."

    def asides(self):
        said, rest = [], self.depends()
        if self.report["verdict"] != "none" and self.left["matters"] and rest:
            part = f", {percent(self.left['share'])} of the systematic error," if self.moves else ""
            said.append(f"The rest{part} looks like {rest}.")
        if self.left["another_vehicle"] and self.report["vehicle"] == "simulated":
            said.append(
                "A vehicle of your own always differs from the simulated one: give a healthy flight of it with --healthy HEALTHY.csv,"
                " and the simulator is fitted to that first."
            )
        if self.report["verdict"] == "unknown" and self._worse():
            said.append(f"With the effects listed the prediction gets worse: {self._worse()}.")
        return said + self.doubts() + self.small() + (self.tried() if self.moves or "fresh" in self.report else [])

    # ---- where -----------------------------------------------------------------------------------

    def predictions(self):
        return figures.follow(self.result, self.moves)

    def where(self):
        loud = self.band_caption()
        drawn = self.times(), self.channels(), (loud, figures.frequencies(self.result, self.moves, loud))
        return Section("Where and when", figures=drawn, sentences=(*self.places(), *self.bands()))

    def errors(self, j):
        t, missed = self.result.path.t[self.result.found.starts], self.result.found
        near = np.abs(t[:, None] - t) <= RUNNING / 2
        errors = [rms(np.where(near, part["attitude"][:, j], np.nan), axis=1) for part in (missed.before, missed.after)]
        return [np.degrees(e) for e in (*errors, missed.floor["attitude"][:, j])], f"deg, RMS over {RUNNING:g} s"

    def segments(self):
        return super().segments() if self.beyond(self.gap) else ()

    def places(self):
        if self.beyond(self.gap) is None and self.report["verdict"] != "none":
            return ["When and in what kind of flight the attitude errors are large tells little: they are about those of healthy flights."]
        return super().places()

    def _left_over(self):
        return []

    def time_caption(self):
        return "The attitude error stays about that of healthy flights" if self.beyond(self.gap) is None else super().time_caption()

    def channels(self):
        caption = self.channel_caption()
        before, after = (self.channel_times(part) for part in ("before", "after"))
        rows = []
        for name, times in before.items():
            rows.append((name, times, f"{times:.2f}", "bar-before"))
            rows += [("", after[name], f"{after[name]:.2f}", "bar-after")] * self.moves
        return caption, bars(rows, caption)

    def channel_times(self, part):
        """{channel: its error in times that of healthy flights}, at the longest horizon."""
        key = self.horizon(self.gap)
        channels = self.report["channels"] if key else {}
        return {name: real(parts[part][key]) / real(parts["noise_floor"][key]) for name, parts in channels.items()}

    def channel_caption(self):
        """Which channel is worst, in times its noise."""
        times = self.channel_times("before")
        if not times:
            return "The channels could not be measured"
        worst, when = max(times, key=times.get), capital(self.ahead(self.horizon(self.gap)))
        if times[worst] < 1 + SHOWS:
            return f"{when} no channel is clearly more off than on healthy flights"
        return f"{when} {worst} is most off: {times[worst]:.1f} times as much as on healthy flights"

    def band_caption(self):
        """Which band of which channel is loudest."""
        found = self.report["where"]["frequencies"]
        if not found:
            return "At no frequency are the prediction errors clearly larger than on healthy flights"
        worst, at = found[0], _band(found[0]["from_hz"], found[0]["to_hz"])
        return f"{capital(worst['channel'])} at {at}: {real(worst['times_noise']):.1f} times the error on healthy flights"

    def bands(self):
        """Where in frequency more is missed than on healthy flights."""
        named = {}
        for band in self.report["where"]["frequencies"]:
            named.setdefault((band["from_hz"], band["to_hz"]), []).append(f"{band['channel']} ({real(band['times_noise']):.1f} times)")
        return [f"At {_band(*edges)} errors are larger than on healthy flights: {listed(channels)}." for edges, channels in named.items()]

    # ---- which, how much, what next ----------------------------------------------------------------

    def ranked(self):
        """Vibration is measured, and nothing stands in for it."""
        return [[row for row in part if row["name"] != "vibration"] for part in super().ranked()]

    def contribution_caption(self, best, size, key):
        most = " most, by" if len(self.report["contributions"]) > 1 else " by"
        return f"{capital(self.ahead(key))} {title(best)} moves the predicted attitude{most} {size}"

    def much(self):
        section, rows = super().much(), self.channel_rows()
        channels = (Table(f"Channels, {self.ahead(self.horizon(self.gap))}", CHANNEL_HEADERS, rows),) if rows else ()
        note = section.note.replace("RMS error.", "RMS error. Noise floor: that of healthy flights.")
        return Section(section.heading, section.tables + channels, note, section.figures)

    def channel_rows(self):
        """[(channel, before, after, floor)] at the longest horizon."""
        key = self.horizon(self.gap)
        parts = ((name, size_of(unit), self.report["channels"][name]) for name, unit in zip(CHANNELS, UNITS))
        return [(name, *(size(of[part][key]) for part in ("before", "after", "noise_floor"))) for name, size, of in parts] if key else []

    def cannot_tell(self):
        said = super().cannot_tell()
        return [
            *said,
            "No flight shows steady wind, with which the vehicle drifts, nor battery sag that the height hold compensates.",
        ]

    def advice(self):
        flight, (told, hidden) = self.report["advice"], self.settles()
        said = [f"Fly {flight['drive']}: {flight['words']} for {SECONDS} s at least, with the vehicle as it was."]
        if not told:
            nearest = f"{flight['drive']} comes nearest: {flight['words']}, for longer."
            said = [f"No manoeuvre decides {listed(hidden, 'or')} in {SECONDS} s; {nearest}"]
        elif hidden:
            told.append(f"It does not decide {listed(hidden)}.")
        return [*said, *told, self.record]

    def compared(self):
        return [
            f"The command u was taken for {U[self.report['axis']]}: within a moment it goes with the {self.report['axis']} that the"
            " controller holds.",
            f"{self.gap['windows']} predictions were compared, each from what an observer made of the rows before,"
            " by models fitted without it; commands and flight controller are those of the log.",
        ]

    def noise(self):
        times, whose = real(self.left["times_noise"]), VEHICLES[self.report["vehicle"]]
        return [
            f"The noise is that of {whose}: wing beat, turbulence, and differences between flights."
            if self.report["vehicle"] == "simulated"
            else f"The noise is that of {whose}, after the simulator was fitted to it.",
            f"The innovations of this flight have {plain(times)} times its variance{' with the effects' * self.moves}.",
        ]


CHANNEL_HEADERS = ("channel", "before", "after", "noise floor")


def _band(low, high):
    """3 to 8 Hz (control loop)."""
    return f"{low:g} to {high:g} Hz ({BANDS[low, high]})"
