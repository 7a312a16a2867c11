"""What a report says of a flight of a quadrotor: its phrases, the vehicle from above, and what differs from healthy flights."""

import math
from dataclasses import replace

from ...report.figures import bars
from ...report.story import Section, Table, Teller
from ...report.words import angle, capital, listed, percent, percent_of, plain, quantity, real, signed
from . import figures
from .causes import PAYLOAD, SLUNG
from .changes import SURE

STANDS_OUT = 2.0  # standard deviations, from which on a feature is told
PLACES = {1: "front right", 2: "rear right", 3: "rear left", 4: "front left"}


def _rotor(i):
    def phrase(p):
        return f"rotor {i} ({PLACES[i]}) gives {percent_of(p['a'])} {signed(p['a'], 'more', 'less')} thrust than it did"

    return phrase


def _place(p):
    """12 mm behind and 9 mm left of the centre."""
    x, y = real(p["x"]), real(p["y"])
    parts = f"{plain(abs(1000 * x))} mm {'ahead' if x > 0 else 'behind'}", f"{plain(abs(1000 * y))} mm {'left' if y > 0 else 'right'}"
    return f"{parts[0]} and {parts[1]} of the centre"


def _grams(mass):
    return f"{plain(1000 * real(mass))} g"


def _moments(p):
    return [f"{quantity(1000 * real(p[name]), 'mN m')} ({name})" for name in ("roll", "pitch", "yaw")]


PHRASES = {f"rotor{i}_thrust": _rotor(i) for i in PLACES} | {
    "payload": lambda p: f"a weight of {_grams(p['mass'])} is on the vehicle, {_place(p)}",
    "slung_load": lambda p: f"a weight of {_grams(p['mass'])} hangs from the vehicle, {_place(p)}",
    "thrust_gain": lambda p: f"all rotors give {percent_of(p['a'])} {signed(p['a'], 'more', 'less')} thrust than they did",
    "trim": lambda p: f"a constant moment of {listed(_moments(p))} turns the vehicle",
    "battery_sag": lambda p: f"thrust falls by {percent_of(p['loss_at_end'])} by the end, on top of the usual",
    "wind": lambda p: f"wind of {plain(real(p['wx']))} m/s in x and {plain(real(p['wy']))} m/s in y",
    "drag": lambda p: f"the air brakes {plain(abs(real(p['k'])))}/s {signed(p['k'], 'more', 'less')} than it did",
    "motor_lag": lambda p: f"the rotors answer with {plain(1000 * real(p['tau']))} ms more of lag",
    "transport_delay": lambda p: f"requests reach the rotors {plain(1000 * real(p['delay']))} ms late",
    "gyro_bias": lambda p: (
        f"the gyro is off by {listed(f'{angle(p[n])}/s about {axis}' for n, axis in (('bx', 'x'), ('by', 'y'), ('bz', 'z')))}"
    ),
    "accel_bias": lambda p: (
        f"the accelerometer is off by {listed(f'{plain(real(p[n]))} m/s² along {axis}' for n, axis in (('bx', 'x'), ('by', 'y'), ('bz', 'z')))}"
    ),
    "vibration": lambda p: f"the sensors are shaken {percent_of(p['a'])} {signed(p['a'], 'more', 'less')} than on healthy flights",
}  # fmt: skip

BARS = (
    "RMS errors of predictions, each from what an observer made of the rows before. The noise floor is the error on healthy flights. "
    "Closed: the share of the error above it that the effects remove, with its 95 % interval in parentheses."
)
FEATURES = ("feature", "this flight", "healthy", "healthy flights differ by", "difference")


class Flight(Teller):
    phrases = PHRASES
    log = "flight"
    experiment = "What to fly next"

    @property
    def healthy(self):
        return "the healthy flights given" if self.report["vehicle"] == "own" else "healthy simulated flights"

    @property
    def since(self):
        return self.report["healthy"]["logs"] > 0

    # ---- the verdict -----------------------------------------------------------------------------

    def _none(self):
        return f"requests, motion and sensors are those of {self.healthy}"

    def nothing(self):
        return "nothing has changed since the healthy flights" if self.since else "this flight is one of the simulated vehicle"

    def closing(self):
        return super().closing() if self.horizon(self.gap) else "the flight shows too little of the motion to measure a gap"

    def depends(self):
        blocks = {"balance": "what the rotors are asked for", "course": "how their balance changes over the flight",
                  "air": "the horizontal acceleration", "drag": "the drag", "gyro": "the gyro",
                  "accelerometer": "the accelerometer", "answer": "the answer to requests"}  # fmt: skip
        return listed(blocks[part["on"]] for part in self.left["depends_on"]) if self.left["matters"] else ""

    def unexplained(self, what):
        return (
            f"{what}: {self.depends()} differs from {self.healthy} as by none of the known effects" if self.depends() else f"{what} is open"
        )

    def asides(self):
        return [*self.doubts(), *self._smallest(), *self.tried()]

    def tried(self):
        return super().tried() if "fresh" in self.report else ["Checked on this flight only."] if self.fitted else []

    def _smallest(self):
        """What would have shown."""
        smallest = self.report["smallest"]
        if self.report["verdict"] != "none" or not smallest:
            return []
        rotors = [percent(smallest[f"rotor{i}_thrust"]) for i in PLACES]
        loss = " to ".join(dict.fromkeys([min(rotors), max(rotors)]))
        return [
            f"A smaller change is not detectable in this flight: the smallest loss of thrust of one rotor that would show is {loss}, the "
            f"smallest weight above a rotor {_grams(smallest[PAYLOAD])}."
        ]

    def next_step(self):
        if self.report["verdict"] != "known":
            return super().next_step()
        return "Next: repair the vehicle, or add this to your simulator, and diagnose a fresh flight."

    def head(self):
        return replace(super().head(), note=BARS if self.fitted else "")

    def much(self):
        section = super().much()
        return replace(section, note=section.note.replace(" on held-out rows", ""))

    # ---- sections --------------------------------------------------------------------------------

    def predictions(self):
        return figures.above(self.result, self.fitted, self.sentence_of_view())

    def sentence_of_view(self):
        if not self.fitted:
            return "The vehicle from above: every rotor is asked for about what healthy flights ask for"
        return f"The vehicle from above: {listed(self.title(e['name']) for e in self.fitted)}"

    def channels(self):
        caption = self.channel_caption()
        rows = [(row["name"], abs(self._times(row)), f"{self._times(row):+.1f}", "bar-before") for row in self.report["features"]]
        return caption, bars(rows, caption)

    @staticmethod
    def _times(row):
        return (real(row["flight"]) - real(row["healthy"])) / real(row["spread"])

    def channel_caption(self):
        rows = self.report["features"]
        worst = max(rows, key=lambda row: abs(self._times(row)), default=None)
        if worst is None or abs(self._times(worst)) < STANDS_OUT:
            return f"Nothing differs clearly from {self.healthy}, in standard deviations of these"
        return f"{capital(worst['name'])} differs most from {self.healthy}: by {abs(self._times(worst)):.1f} of their standard deviations"

    def where(self):
        drawn = (self.times(),) if len(self.result.found.starts) else ()
        return Section("Where and when", figures=(*drawn, self.channels()), sentences=tuple(self.places()))

    def places(self):
        loud = [row for row in self.report["features"] if abs(self._times(row)) >= STANDS_OUT]
        told = [f"{row['name']} ({self._times(row):+.1f})" for row in sorted(loud, key=lambda row: -abs(self._times(row)))]
        return [f"Different from {self.healthy}, in standard deviations: {listed(told)}."] if told else []

    def which(self):
        section = super().which()
        rows = [
            (row["name"], *(quantity(row[key], row["unit"]) for key in ("flight", "healthy", "spread")), f"{self._times(row):+.1f}")
            for row in self.report["features"]
        ]
        note = "Score: probability of each effect. Difference: in standard deviations of healthy flights."
        return Section(section.heading, (*section.tables, Table("Features of steady flight", FEATURES, rows)), note, section.figures,
                       section.sentences)  # fmt: skip

    def ranking_caption(self):
        effects, ranking = self.ranked()
        if self.report["verdict"] == "none":
            return f"That nothing has changed is the most probable, {percent(self.report['unchanged'])}"
        rest = [row for row in ranking if row["name"] not in {e["name"] for e in effects}]
        return (
            f"Next comes {self.title(rest[0]['name'])}, with a probability of {percent(rest[0]['score'])}"
            if rest
            else "Nothing else is likely"
        )

    def cannot_tell(self):
        names = {e["name"] for e in self.fitted}
        said = super().cannot_tell()
        if self.since and (any(n.startswith("rotor") for n in names) or names & {PAYLOAD, SLUNG}):
            said.append(
                "A weak rotor and a weight above it ask for the same in thrust, roll and pitch, and differ in yaw alone, in which healthy "
                f"flights differ, too. So the confidence is at most {percent(SURE)}."
            )
        return said

    def advice(self):
        flight = self.report["advice"]
        told, hidden = self.settles()
        return [f"Fly {flight['drive']}: {flight['words']}.", *told, *([f"It does not decide {listed(hidden)}."] if hidden and told else []),
                self.record]  # fmt: skip

    def compared(self):
        vehicle = "the healthy flights that were given" if self.since else "the simulated vehicle"
        return [
            f"{real(self.report['steady']):.1f} s of steady flight were compared with {vehicle}.",
            f"{self.report['gap']['windows']} predictions were compared, each from what an observer made of the rows before.",
        ]

    def noise(self):
        return [f"The noise floor is the error of the same predictions on {self.healthy}."]

    def unmeasured(self):
        """Horizons without a size: the vehicle is unstable, and its angular velocity may be hidden."""
        gone = [key for key, value in self.gap["before"].items() if not math.isfinite(real(value))]
        if not gone or len(gone) == len(self.gap["before"]):
            return []
        return [f"{listed(gone, 'or')} steps ahead even predictions of healthy flights are lost, so no error is given."]
