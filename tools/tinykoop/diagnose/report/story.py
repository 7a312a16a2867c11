"""What a report says, told once: sections of tables, figures and sentences, for whoever renders them."""

import math
from dataclasses import dataclass
from pathlib import Path

from ...plumbing.results import number
from ..elsewhere import AT_END
from ..prediction_errors.ahead import HORIZONS, opens
from . import figures, words
from .words import capital, listed, percent, real, title

COLOURED = 0.95  # noise that correlates as much is hard to tell from slow errors
WHITE = 0.1  # correlation of noise that counts as none
MOVES = 0.01  # of the usual rate, from which on random motion is told
RANDOM = 0.02  # share of the squared error beyond sensor noise, from which on random motion is told at once
STANDS_OUT = 1.2  # times the average, from which on a region is told
LOUDER = 1.5  # times its share of the time, that a part of the gap must have to be reported
HIDDEN = 0.1  # standard deviations per row, below which an experiment separates nothing
LEADING = 0.1  # share of what is left, from which on its dependence is told
SHOWN = 0.05  # score of an effect from which on it is shown
MOST_PHRASES = 2  # effects that fit into one sentence with their phrases
MOST_RIVALS, MOST_RANKED, MOST_REGIONS, MOST_PARTS = 3, 8, 4, 3
DEGREES = (180 / math.pi, "deg")

PARTS = ("before", "after", "noise_floor")
GAP_HEADERS = ("ahead", "before", "after", "noise floor", "closed", "95 % interval")
BARS = (
    "RMS errors of predictions on rows that were not used for the fit. The noise floor is the error of a perfect simulator. "
    "Closed: the share of the error above it that the effects remove, with its 95 % interval in parentheses."
)
EFFECT_HEADERS = ("effect", "parameter", "95 % interval", "confidence", "active", "remark")
SCORE = "Score above 1: identified, and needed beside the others. Score below 1: the share that the effect would explain on its own."
CLOSED = "Closed: the share of the gap above the noise floor that the effects remove on held-out rows; no share is given near it."


@dataclass(frozen=True)
class Table:
    caption: str
    headers: tuple
    rows: list
    brief: bool = False  # on a terminal, too


@dataclass(frozen=True)
class Section:
    heading: str
    tables: tuple = ()
    note: str = ""
    figures: tuple = ()  # (caption, SVG)
    sentences: tuple = ()
    brief: int = 0  # sentences that a terminal shows
    file: tuple = ()  # (text, name, contents) of a file to take along

    def __bool__(self):
        return bool(self.tables or self.figures or self.sentences)


@dataclass(frozen=True)
class Story:
    """head: what ten seconds are enough for."""

    verdict: str  # of the contract
    files: str
    sentence: str
    asides: tuple
    glance: tuple
    head: Section
    sections: tuple


class Teller:
    """Tells the report of a Diagnosis; a platform has its own phrases and figures, and says more."""

    phrases: dict = {}  # {effect: what it does, in plain words, as a function of its parameters}
    log = "log"
    experiment = "What to record next"
    record = "Record it as a log of its own and diagnose that, or give it with --fresh to try what was found here."
    title = staticmethod(title)

    def __init__(self, result):
        self.result, self.report = result, result.report
        self.effects, self.left = self.report["effects"], self.report["unexplained"]
        self.fitted = self.report["best_fit"] or self.effects  # what predictions were made with
        self.sure = {effect["name"] for effect in self.effects}
        self.name, self.gap = self.gaps(self.report)[0]
        self.size = words.size_of(self.gap["unit"])

    def story(self):
        report = self.report
        files = Path(report["log_file"]).name if report.get("log_file") else self.log
        files += f", fresh log {Path(report['fresh_file']).name}" if report.get("fresh_file") else ""
        sections = self.where(), self.which(), self.much(), self.open(), self.next(), self.measured()
        told = tuple(section for section in sections if section)
        return Story(report["verdict"], files, self.sentence(), tuple(self.asides()), tuple(self.glance()), self.head(), told)

    def glance(self):
        """Where the gap lies and what to do next, for the first screen of the page; the sections say more."""
        where = [f"{self.channels()[0]}. {self.time_caption()}."] if self.located() else []
        return [*where, *self.shares(), self.next_step()]

    def shares(self):
        """By how much the error grows without each of several effects, largest first, in one sentence or none."""
        worth, key = self.report.get("contributions", {}), self.horizon(self.report["gap"])
        if self.report["verdict"] == "unknown" or len(worth) < 2 or not key:
            return []
        size = words.common_size(self.report["gap"]["unit"], [by[key] for by in worth.values()])
        grows = [f"by {size(by[key])} without {self.title(name)}" for name, by in sorted(worth.items(), key=lambda w: -real(w[1][key]))]
        return [f"The error {self.ahead(key)} grows {listed(grows)}."]

    def next_step(self):
        verdict, advice = self.report["verdict"], self.next().sentences
        if verdict == "none":
            return "Nothing is missing in the simulator. Diagnose a log of faster or other motion to test more of it."
        if verdict == "known":
            tried = "" if "fresh" in self.report else ", and diagnose a fresh log with it"
            return f"Next: put this into the simulator with `tinykoop patch report.json --into FILE`{tried}."
        return (
            f"Next: {advice[0][:1].lower()}{advice[0][1:]}"
            if advice
            else "Next: record another log under faster and more varied commands, and diagnose both."
        )

    # ---- gaps ----------------------------------------------------------------------------------------

    def gaps(self, part):
        """[(name, gap)] of the report or of its fresh part, that which the verdict is about first."""
        return sorted(part["gaps"].items(), key=lambda one: one[1]["unit"] != self.left.get("unit", one[1]["unit"]))

    @staticmethod
    def horizon(gap):
        """The longest horizon that could be measured; None without any."""
        return max((key for key, value in gap["before"].items() if math.isfinite(real(value))), key=int, default=None)

    def told_at(self, gap):
        """The horizon to speak of."""
        return self.horizon(gap)

    def steps(self, key):
        """50 steps = 2.5 s."""
        return f"{key} step{'s' if int(key) > 1 else ''} = {int(key) * real(self.report['log']['dt']):.3g} s"

    def ahead(self, key):
        """50 steps = 2.5 s ahead."""
        return f"{self.steps(key)} ahead"

    def sizes(self, gap, key):
        """Before, after and floor as text, in one unit."""
        size = words.common_size(gap["unit"], [value for part in PARTS for value in gap[part].values()])
        return [size(gap[part][key]) for part in PARTS]

    def shrinks(self, gap, key):
        """0.45 m to 15 mm, 50 steps = 2.5 s ahead; noise floor 15 mm."""
        before, after, least = self.sizes(gap, key)
        return f"{before} to {after}, {self.ahead(key)}; noise floor {least}"

    def gap_rows(self, gap):
        """[(horizon, before, after, floor, closed, interval)]."""
        return [
            (self.steps(key), *self.sizes(gap, key), percent(gap["closed_fraction"][key]), words.spread(*gap["ci95"][key]))
            for key in gap["before"]
        ]

    def gap_figure(self, gap, name="", place=""):
        """(caption, bars of before, after and floor for every horizon)."""
        caption = self.gap_caption(gap, place)
        caption = f"{capital(name)}: {caption}" if name else caption
        return caption, figures.gap(self.gap_rows(gap), gap, bool(self.fitted), caption)

    def gap_caption(self, gap, place=""):
        """What the bars bear out."""
        key = self.horizon(gap)
        if key is None:
            return f"The gap{place} could not be measured"
        before, after, least = (real(gap[part][key]) for part in PARTS)
        when, size = capital(self.ahead(key)), words.common_size(gap["unit"], (before, after, least))
        if not self.fitted:
            return f"{when} the RMS error is {size(before)}{place}; noise alone makes {size(least)}"
        if size(after) == size(before):
            return f"{when} the RMS error stays at {size(after)}{place}; noise alone makes {size(least)}"
        if after > before:
            return f"{when} the RMS error grows from {size(before)} to {size(after)}{place}"
        return f"{when} the RMS error falls from {size(before)} to {size(after)}{place}; noise alone makes {size(least)}"

    # ---- effects -------------------------------------------------------------------------------------

    def phrase(self, effect):
        """What an effect does, in plain words; name and parameters of one that has no phrase."""
        try:
            return self.phrases[effect.get("form", effect["name"])](effect["params"])
        except (KeyError, TypeError):
            units = effect.get("units", {})
            values = (f"{name} = {words.quantity(value, units.get(name, '1'))}" for name, value in effect["params"].items())
            return f"{self.title(effect['name'])} acts ({', '.join(values)})"

    def rivals(self, name):
        """Effects that this one may as well be, each once."""
        return [self.title(rival) for rival in dict.fromkeys(self.report["ambiguous_with"].get(name, ()))]

    def acts(self, effect):
        return words.acts(effect, self.report)

    def named(self, effect):
        """Phrase, name, rivals and times of one effect."""
        also = self.rivals(effect["name"])
        if len(also) > MOST_RIVALS:
            also = [*also[:MOST_RIVALS], f"{len(also) - MOST_RIVALS} more"]
        name = listed([self.title(effect["name"]), *also], "or") + (": this log cannot separate them" if also else "")
        when = self.acts(effect)
        how = "in" if len(effect["segments"]) > words.MOST_SPANS else "from"
        always = "" if all(self.acts(e) == "whole log" for e in self.effects) else " throughout"
        return f"{self.phrase(effect)} ({name})" + (always if when == "whole log" else f" {how} {when}")

    @property
    def since(self):
        """Whether the question was what has changed since logs of the healthy robot."""
        return self.report.get("healthy", {}).get("logs", 0) > 0

    def causes(self):
        """What acts: phrases of a few effects, names of many."""
        if len(self.effects) <= MOST_PHRASES:
            return " and ".join(self.named(effect) for effect in self.effects)
        names = []
        for effect in self.effects:
            also = self.rivals(effect["name"])
            names.append(self.title(effect["name"]) + (f" (or {listed(also, 'or')})" if also else ""))
        return f"{len(self.effects)} effects act: {listed(names)}"

    def effect_rows(self, effects):
        """One row per parameter. An effect that is not established has no confidence."""
        rows = []
        for effect in effects:
            for i, (name, value, bounds, remarks) in enumerate(words.parameters(effect) or [("", "-", "-", ())]):
                confidence = percent(effect["confidence"]) if effect["name"] in self.sure else "-"
                remarks = [f"form: {self.title(effect['form'])}", *remarks] if i == 0 and "form" in effect else remarks
                first = (self.title(effect["name"]), confidence, self.acts(effect)) if i == 0 else ("", "", "")
                rows.append((first[0], f"{name} = {value}" if name else "-", bounds, first[1], first[2], ", ".join(remarks)))
        return rows

    # ---- verdict -------------------------------------------------------------------------------------

    def sentence(self):
        """The verdict in one sentence."""
        verdict = self.report["verdict"]
        if verdict == "none":
            return f"No gap: {self.nothing()}. {capital(self._none())}."
        since = "since the healthy logs, " * self.since
        if verdict == "known":
            one = "Causes" if len(self.effects) > 1 else "Cause"
            return f"{one} identified: {since}{self.causes()}. {capital(self.closing())}."
        if verdict == "partly":
            one = "Causes" if len(self.effects) > 1 else "Cause"
            return f"{one} identified in part: {since}{self.causes()}. {capital(self.closing())}. {self.unexplained('The rest')}."
        if not self.fitted:
            off = f"Beyond noise the simulator is off by {self.size(self.left['of_gap'])}"
            return f"Cause not identified. {off}. {self.unexplained('The gap')}."
        names = listed(self.title(effect["name"]) for effect in self.fitted)
        return f"Cause not identified. {self._best_fit(names)}. {self.unexplained('What they leave')}."

    def nothing(self):
        return "nothing has changed since the healthy logs" if self.since else f"the simulator matches this {self.log} to within its noise"

    def closing(self):
        """How far the effects close the gap."""
        key = self.horizon(self.gap)
        if key is None:
            return "the log is too broken up to measure the gap"
        them = "them" if len(self.fitted) > 1 else "it"
        if not math.isfinite(real(self.gap["closed_fraction"][key])):
            before, _, least = self.sizes(self.gap, key)
            return f"the gap is about the noise ({before} against {least}, {self.ahead(key)}), so no percentage is given"
        return f"adding {them} closes {percent(self.gap['closed_fraction'][key])} of the gap ({self.shrinks(self.gap, key)})"

    def _best_fit(self, names):
        """How far effects that are not the cause would let the error fall."""
        key = self.horizon(self.gap)
        how = f"lets the error fall from {self.shrinks(self.gap, key)}" if key else "could not be measured"
        return f"The best fit among the known effects ({names}) {how}"

    def _none(self):
        key = self.horizon(self.gap)
        if key is None:
            return "the log is too broken up to measure the gap"
        before, _, least = self.sizes(self.gap, key)
        off = f"{self.ahead(key)} it is {before} off; noise alone makes {least}"
        systematic, smallest = real(self.left["of_gap"]), real(self.left["smallest_that_matters"])
        if systematic < smallest:
            return f"{off}. The gap beyond noise, {self.size(systematic)}, is below the smallest that matters, {self.size(smallest)}"
        return f"{off}. The residuals show no systematic error"

    def depends(self):
        """On what the unexplained part depends; empty where nothing is left that matters."""
        found = self.left["depends_on"] if self.left["matters"] else []
        strong = [d for d in found if real(d["share"]) >= LEADING][:MOST_PARTS] or found[:1]
        plain = {"place": "position", "heading": "the heading"}
        return listed(f"{plain.get(d['on'], d['on'])} ({d['channel']} error)" for d in strong)

    def unexplained(self, what):
        """That no effect explains the gap, or the rest of it, and on what that depends where it is known."""
        on = self.depends()
        return f"{what} {f'depends on {on} and ' if on else ''}matches none of the known effects"

    def asides(self):
        """What must stand right beside the verdict: short sentences."""
        return self.doubts() + self.random() + self.small() + self.cautions() + self.tried()

    def doubts(self):
        """Why the effects may not be the cause."""
        said = []
        helpers = [effect for effect in self.report["best_fit"] if effect["name"] not in self.sure]
        if self.report["verdict"] == "unknown" and helpers:
            said.append("A best fit is not a diagnosis: do not take these effects for the cause.")
        elif helpers:
            them = listed(self.phrase(effect) for effect in helpers)
            said.append(f"In the best fit, but not established by this log: {them}.")
        if self.effects:
            said.append(f"Confidence that it acts: {listed(self.title(e['name']) + ' ' + percent(e['confidence']) for e in self.effects)}.")
        return said

    def random(self):
        """That a part of what predictions miss is the robot's own random motion, where it is more than the sensor's noise."""
        share = real((self.report.get("shares") or {}).get("random"))
        return [self._random_motion() + " No simulator predicts it."] if share > RANDOM and self.moves_at_random() else []

    def moves_at_random(self):
        """Axes of random motion that is worth telling."""
        return {name: n for name, n in self.report["noise"]["process"].items() if real(n["share"]) > MOVES}

    def small(self):
        """What is significant and too small to matter."""
        small = self.report["small"]
        return [f"Significant, but too small to matter on this log: {listed(self.phrase(e) for e in small)}."] if small else []

    def cautions(self):
        """What limits the log by itself, each with what to do about it."""
        told = {"closed_loop": self._closed_loop, "short": self._short, "steady": self._steady}
        return [told[caution["kind"]](caution) for caution in self.report["log"].get("cautions", ())]

    @staticmethod
    def _closed_loop(caution):
        shares = caution["share"]
        name = max(shares, key=lambda name: real(shares[name]))
        return (
            f"Closed loop: measurements predict {percent(shares[name])} of the changes of {name} that past commands do not, so a wrong noise "
            "model can bias the effects; drive the commands open loop, or add a random signal (dither) to them."
        )

    def _short(self, caution):
        need = f"Short: this {self.log}"
        if caution["predictions"] < caution["least_predictions"]:
            said = f"holds {caution['predictions']} separate predictions of {max(HORIZONS)} steps, and {caution['least_predictions']} are needed"
        else:
            said = f"lasts {words.seconds(caution['seconds'])}, and its held-out blocks need {words.seconds(caution['least_seconds'])}"
        return f"{need} {said}; record a longer one without gaps."

    @staticmethod
    def _steady(caution):
        held = caution["variation"]
        hardly, of = ("hardly varies", "its") if len(held) == 1 else ("hardly vary", "their")
        return (
            f"Steady: {listed(held)} {hardly} (by {percent(max(map(real, held.values())))} of {of} largest size), so this log separates no "
            "gain from a bias and shows no lag, delay or dead band there; record steps of several sizes."
        )

    def tried(self):
        """On what the effects were tried."""
        if "fresh" in self.report:
            return [self._on_fresh(), *self._carried()]
        return ["Checked on held-out rows of this log only, not on a fresh log."] if self.fitted else []

    def _carried(self):
        """When effects of a part of the log act on the fresh one, and how large one grows that grows with time."""
        said, there = [], {effect["name"]: effect for effect in self.report["fresh"].get("effects", ())}
        for effect in self.fitted:
            name, on = self.title(effect["name"]), there.get(effect["name"])
            if on and (self.acts(effect) != "whole log" or not on["acts"]):
                how = "to act throughout" if on["acts"] else "not to act"
                said.append(
                    f"On the fresh log {name} is assumed {how}, which predicts the fresh log better; its size is that of the first log."
                )
            if on and on["acts"] and AT_END in on["params"] and on["params"][AT_END] != effect["params"][AT_END]:
                said.append(f"On the fresh log {name} is taken to grow as fast, to {words.percent_of(on['params'][AT_END])} at its end.")
        return said

    def _on_fresh(self):
        """What the same model does on the fresh log, in one sentence."""
        _, gap = self.gaps(self.report["fresh"])[0]
        key = self.told_at(gap)
        if key is None:
            return "The fresh log is too broken up to measure the gap."
        before, after, least = self.sizes(gap, key)
        part = real(gap["closed_fraction"][key])
        if not self.fitted:
            return f"On the fresh log the simulator is {before} off, {self.ahead(key)}; noise alone makes {least}."
        if part < 0 or opens({name: {h: real(v) for h, v in gap[name].items()} for name in (*PARTS, "closed_fraction")}):
            return f"On the fresh log the effects make the gap larger ({before} to {after}): do not use them."
        if not math.isfinite(part):
            return f"On the fresh log the gap is about the noise ({before} against {least})."
        return f"On the fresh log, without refitting, {percent(part)} of the gap closes ({self.shrinks(gap, key)})."

    # ---- sections ------------------------------------------------------------------------------------

    def head(self):
        """The gap, what the platform shows of predictions, and the effects where the first sentence has no room for them."""
        told = not self.report["best_fit"] and len(self.effects) <= MOST_PHRASES
        causes = () if told else tuple(
            f"{self.phrase(e)} ({self.title(e['name'])}, {self.acts(e)}{self._confidence(e)})" for e in self.fitted
        )  # fmt: skip
        note = BARS if self.fitted else ""
        return Section("", note=note, figures=(self.gap_figure(self.gap), self.predictions()), sentences=causes)

    def _confidence(self, effect):
        return f", confidence {percent(effect['confidence'])}" if effect["name"] in self.sure else ", not established"

    def predictions(self):
        """(caption, figure) of predictions beside the log: the platform's."""
        raise NotImplementedError

    def times(self):
        """(caption, figure) of the error over time."""
        key, caption = self.horizon(self.gap), self.time_caption()
        error = f"error {self.ahead(key)}" if key else "error"
        return caption, self.over_time(*self.errors(list(self.gap["before"]).index(key) if key else 0), error, caption)

    def errors(self, j):
        """(before, after, floor (W,), unit) of predictions at horizon j."""
        found, (factor, unit) = self.result.found, DEGREES if self.gap["unit"] == "rad" else (1.0, self.gap["unit"])
        return [part[self.name][:, j] * factor for part in (found.before, found.after, found.floor)], unit

    def over_time(self, errors, unit, error, caption):
        found, with_effects = self.result.found, bool(self.fitted)
        acts = [(f"{self.title(e['name'])}: {self.acts(e)}", e["segments"]) for e in self.fitted]
        errors = errors if with_effects else errors[::2]
        ends = (0, real(self.report["log"]["seconds"]))
        return figures.over_time(found.path.t[found.starts], errors, ends, self.segments(), acts, caption, f"{error} ({unit})")

    def segments(self):
        """Shares of the gap over time, where there is one."""
        return self.report["where"]["segments"] if self.report["verdict"] != "none" else ()

    def located(self):
        """Whether the report says where the gap lies."""
        return self.report["verdict"] != "none" and sum(real(part) for part in self.report["where"]["channels"].values()) > 0

    def where(self):
        shown = (self.times(), self.channels()) if self.located() else (self.times(),)
        return Section("Where and when", figures=shown, sentences=tuple(self.places()))

    def channels(self):
        """(caption, bars of the share of each channel)."""
        shares = self.report["where"]["channels"]
        name, part = max(shares.items(), key=lambda item: real(item[1]))
        caption = f"The largest part of the gap is {name} error: {percent(part)}"
        return caption, figures.bars([(name, real(part), percent(part), "bar-before") for name, part in shares.items()], caption)

    def time_caption(self):
        """When the gap is there."""
        if self.report["verdict"] == "none":
            return "The error stays about the noise from the first row to the last"
        if not self.located():
            return "The error over time"
        start, end, part = max(self._parts(), key=lambda s: s[2] / max(s[1] - s[0], 1e-9))
        of = (end - start) / real(self.report["log"]["seconds"])
        if part > LOUDER * of:
            return f"The gap is largest from {words.span(start, end)}: {percent(part)} of it in {percent(of)} of the time"
        return "The gap is spread over the whole log"

    def _parts(self):
        return [[real(v) for v in part] for part in self.report["where"]["segments"]]

    def places(self):
        """Where the gap lies, in sentences."""
        if self.report["verdict"] == "none":
            return ["There is no gap to locate."]
        if not self.located():
            return ["The gap could not be located."]
        end = real(self.report["log"]["seconds"])
        heavy = sorted((s for s in self._parts() if s[1] > s[0] and s[2] > LOUDER * (s[1] - s[0]) / end), key=lambda s: -s[2])[:MOST_PARTS]
        parts = listed(f"from {words.span(a, b)} ({percent(part)} of it)" for a, b, part in heavy)
        return ([f"It is larger than elsewhere {parts}."] if heavy else []) + self._regions() + self._left_over()

    def _regions(self):
        said = []
        for r in [r for r in self.report["where"]["regions"] if real(r["times_average"]) > STANDS_OUT][:MOST_REGIONS]:
            low, high = real(r["from"]), real(r["to"])
            places = words.places_of(high, low, high)
            reach = f"{words.quantity(low, '1', places)} to {words.quantity(high, r['unit'], places)}"
            said.append(f"At {r['variable']} of {reach} it is {real(r['times_average']):.1f} times the average.")
        return said

    def _left_over(self):
        return [f"The unexplained rest depends on {self.depends()}."] if self.depends() else []

    def which(self):
        """The effects with their parameters, and the ranking beside what each is worth."""
        shown, tables, note = self.fitted, (), SCORE
        if shown:
            tables = (Table("Best fit" if self.report["best_fit"] else "Effects", EFFECT_HEADERS, self.effect_rows(shown), True),)
            worth = ", ".join(f"{self.title(e['name'])} {number(real(e['evidence']))}" for e in shown)
            note = f"Evidence (increase of the sum of squared residuals, in noise variances, without the effect): {worth}. {SCORE}"
        drawn = (self.ranking(), *self.contributions()) if self.report["ranking"] else ()
        formulas = tuple(f"{capital(self.title(e['name']))}: {words.formula(e)}." for e in shown if words.formula(e))
        return Section("Which effect", tables, note, drawn, formulas)

    def ranked(self):
        """(effects, ranking) that are compared."""
        return self.fitted, self.report["ranking"]

    def ranking(self):
        """(caption, bars of the scores; those that were found are solid)."""
        found = {e["name"] for e in self.fitted}
        rows = [r for r in self.report["ranking"] if real(r["score"]) >= SHOWN or r["name"] in found][:MOST_RANKED]
        caption = self.ranking_caption()
        kinds = ["bar-after" if r["name"] in found else "bar-floor" for r in rows]
        return caption, figures.bars(
            [(self.title(r["name"]), real(r["score"]), f"{real(r['score']):.2f}", kind) for r, kind in zip(rows, kinds)], caption
        )

    def ranking_caption(self):
        """What the ranking bears out."""
        effects, ranking = self.ranked()
        if self.report["verdict"] == "none":
            return "No effect explains more than noise does"
        if not effects:
            return "No known effect is worth adding"
        rest = [row for row in ranking if row["name"] not in {e["name"] for e in effects}]
        if not rest:
            return f"{capital(self.title(effects[-1]['name']))} is needed"
        part = percent(min(real(rest[0]["score"]), 1))
        return f"Next comes {self.title(rest[0]['name'])}: on its own it would explain {part} as much"

    def contributions(self):
        """[(caption, bars of what each effect is worth beside the others)]."""
        worth, key = self.report.get("contributions", {}), self.horizon(self.report["gap"])
        if len(worth) < self.fewest_worth or not key:
            return []
        sizes, size = {name: real(by[key]) for name, by in worth.items()}, words.size_of(self.report["gap"]["unit"])
        caption = self.contribution_caption(max(sizes, key=sizes.get), size(max(sizes.values())), key)
        return [(caption, figures.bars([(self.title(name), value, size(value), "bar-after") for name, value in sizes.items()], caption))]

    fewest_worth = 2

    def contribution_caption(self, best, size, key):
        return f"{capital(self.title(best))} matters most: without it the error grows by {size}"

    def much(self):
        """Tables of all gaps and horizons, and the fresh log."""
        tables, drawn = [], []
        for i, (name, gap) in enumerate(self.gaps(self.report)):
            tables.append(Table(f"Gap, {name}", GAP_HEADERS, self.gap_rows(gap), i == 0))
            drawn += [self.gap_figure(gap, name)] if i else []
        if "fresh" in self.report:
            name, gap = self.gaps(self.report["fresh"])[0]
            tables.append(Table(f"Gap on the fresh log, without refitting, {name}", GAP_HEADERS, self.gap_rows(gap), True))
            drawn.append(self.gap_figure(gap, place=" on the fresh log"))
        return Section("How much", tuple(tables), f"RMS error. {CLOSED}", (*self.closable(), *drawn))

    def closable(self):
        """[(caption, bars of what of the gap is explained, what could be predicted, and what is random)]."""
        shares, key = self.report.get("shares"), self.horizon(self.report["gap"])
        if not shares or not key or self.report["verdict"] == "none":
            return []
        caption = f"{capital(self.ahead(key))}, {percent(shares['random'])} of the squared error beyond sensor noise is random"
        names = (("explained", "explained by the effects", "bar-after"), ("predictable", "predictable, by no effect", "bar-before"),
                 ("random", "random: no simulator predicts it", "bar-floor"))  # fmt: skip
        return [(caption, figures.bars([(name, shares[k], percent(shares[k]), kind) for k, name, kind in names], caption))]

    def open(self):
        said = tuple(self.cannot_tell()) or ("This log leaves no question open.",)
        return Section("What this log cannot tell", sentences=said, brief=len(said) if self.cannot_tell() else 0)

    def cannot_tell(self):
        """What this log leaves open, in sentences."""
        said = self.ambiguous()
        for alike in self.report.get("lookalikes", ()):
            together = " together" * (len(alike["effects"]) > 1)
            said.append(f"{capital(listed(map(self.title, alike['effects'])))}{together} may as well be {alike['as']}.")
        if self.report["not_testable"]:
            names = listed(map(self.title, self.report["not_testable"]))
            said.append(f"Not testable: {names}. This {self.log} would barely show them: they are neither confirmed nor ruled out.")
        said += self.open_parameters() + self.unmeasured()
        if max((real(c["correlation"]) for c in self.report["noise"]["sensor"].values()), default=0) > COLOURED:
            said.append("The noise changes so slowly that slow errors cannot be separated from it: the noise floor may be too high.")
        return said

    def ambiguous(self):
        """The effects that this log cannot distinguish."""
        return [
            f"{capital(listed([self.title(e['name']), *self.rivals(e['name'])], 'or'))}: this log cannot separate them."
            for e in self.fitted
            if self.rivals(e["name"])
        ]

    def open_parameters(self):
        """What the log leaves open of the parameters, a sentence for each effect."""
        said = []
        for effect in self.fitted:
            rows = [(name, bounds, remarks) for name, _, bounds, remarks in words.parameters(effect)]
            edge = [name for name, _, remarks in rows if "at its bound" in remarks]
            free = [f"{name} {bounds}" for name, bounds, remarks in rows if "undetermined" in remarks and name not in edge]
            of = self.title(effect["name"])
            said += [f"This log does not determine these parameters of {of}: {listed(free)}."] if free else []
            said += [f"{capital(of)}: {listed(edge)} is at the bound of its range; the true value may lie beyond."] if edge else []
        return said

    def unmeasured(self):
        """For which horizons there is no percentage."""
        before, closed, said = self.gap["before"], self.gap["closed_fraction"], []
        near = [key for key in before if math.isfinite(real(before[key])) and not math.isfinite(real(closed[key]))]
        unseen = [key for key in before if not math.isfinite(real(before[key]))]
        if near and self.report["verdict"] != "none":
            said.append(f"{listed(near)} step{'s' if near != ['1'] else ''} ahead the gap is about the noise, so no percentage is given.")
        if unseen:
            said.append(f"No stretch of the log is long enough to predict {listed(unseen, 'or')} steps ahead.")
        return said

    def next(self):
        """What to record next; nothing where nothing is open."""
        said = tuple(self.advice()) if self.report.get("advice") else ()
        return Section(self.experiment, sentences=said, brief=1)

    def settles(self):
        """(what the advised experiment tells, in a sentence or none; the names of what it does not)."""
        separation = [(self.title(question), real(value)) for question, value in self.report["advice"]["separation"].items()]
        told = [f"{question} ({value:.2g})" for question, value in separation if value >= HIDDEN]
        said = f"It decides {listed(told)}, in parentheses by how many noise sigma per row."
        return [said] * bool(told), [question for question, value in separation if not value >= HIDDEN]

    def measured(self):
        return Section("The log and its noise", sentences=(self.rows_of(), *self.compared(), *self.noise()))

    def rows_of(self):
        """Size of the log and what of it was used."""
        log = self.report["log"]
        usable = real(log["usable"])
        left_out = f"{100 * (1 - usable):.2g} % of the rows are masked or next to a gap and were not used"
        used = "all rows were used" if usable == 1 else left_out
        return f"{log['rows']} rows, {words.seconds(log['seconds'])} at {words.plain(1 / real(log['dt']), 3)} Hz; {used}."

    def compared(self):
        return [f"{self.report['gap']['windows']} predictions were compared, each from a measured state, with models not fitted to it."]

    def noise(self):
        """What the noise is like, and the robot's own random motion."""
        sensor = self.report["noise"]["sensor"]
        sizes = listed(f"{words.size_of(n['unit'])(n['sd'])} ({name})" for name, n in sensor.items())
        said = [f"The measurement noise has a standard deviation of {sizes}."]
        correlations = listed(f"{real(n['correlation']):.2f} ({name})" for name, n in sensor.items())
        colour = "white" if max(real(n["correlation"]) for n in sensor.values()) < WHITE else "coloured"
        said.append(f"It is {colour}: from row to row it correlates by {correlations}.")
        rows = self.report["noise"]["outliers"]
        said.append(f"{rows} rows are outliers and count less." if rows else "There are no outliers.")
        return [*said, self._random_motion()]

    def _random_motion(self):
        """The robot's own, in shares of its usual rates."""
        moves = self.moves_at_random()
        if not moves:
            return "The robot's own random motion is too small to matter."
        of = {name: f"{name}, {percent(n['share'])} of its usual rate" for name, n in moves.items()}
        sizes = listed(f"{words.quantity(n['sd'], n['unit'])} ({of[name]})" for name, n in moves.items())
        lasts = words.seconds(next(iter(moves.values()))["seconds"])
        how = self.report["noise"].get("motion", "at any speed")
        return f"The robot also moves at random, {how}, correlated over {lasts}, with a standard deviation of {sizes}."
