"""The labelled flights of Crazyflies, read where they are: a folder with flights/*.usd and labels.csv."""

import csv
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory

from ... import convert
from ...diagnose.platforms.quadrotor import causes, diagnosis, features
from ...diagnose.platforms.quadrotor.causes import SLUNG
from ...plumbing.errors import UserError

FIELDS = ("flight", "vehicle", "family", "rotors", "size")
SESSIONS = (("d021", "d022"), ("d023", "d024"))  # healthy flights recorded together; labels.csv does not say it
FAMILIES = ("none", "rotor", "tape", "payload", SLUNG)
LABELS = f"families are {', '.join(FAMILIES)}, rotors as M1+M2, sizes of cuts in mm, per rotor, as 4+5.5"
CUTS = {1: ("rotor", 3.0), 2: ("pair", 4.0)}  # rotors: what must be found, from this on (mm, together)


@dataclass(frozen=True, eq=False)
class Flight:
    """One labelled flight; log: as diagnosis.load() gives it."""

    name: str
    vehicle: str
    family: str
    rotors: str
    size: str
    log: object

    @cached_property
    def features(self):
        return features.of(self.log)

    # ---- what was done -------------------------------------------------------------------------------

    @property
    def condition(self):
        """Such as: E8, rotor M3, 6 mm."""
        unit = " mm" * (self.family == "rotor")
        return ", ".join(part for part in (self.vehicle, f"{self.family} {self.rotors}".strip(), self.size + unit) if part)

    @property
    def at(self):
        """The rotors that something was done at or near, such as (1, 2)."""
        return tuple(int(name[1:]) for name in self.rotors.split("+") if name)

    @property
    def cut(self):
        """{rotor: mm} that its propeller was shortened by."""
        return dict(zip(self.at, map(float, self.size.split("+")))) if self.family == "rotor" else {}

    @property
    def truth(self):
        """Names of the effects that act, each of which is right; a weight on a string is one in steady flight."""
        if self.family in ("payload", SLUNG):
            return {causes.PAYLOAD, SLUNG}
        return set(map(causes.rotor, self.at))

    @property
    def asks(self):
        """What must be found: healthy, rotor, pair, payload or slung_load; nothing of a tape or a cut that is too small."""
        if self.family == "rotor":
            what, least = CUTS.get(len(self.at), (None, 0))
            return what if sum(self.cut.values()) >= least else None
        return {"none": "healthy", "tape": None}.get(self.family, self.family)

    # ---- what it is compared with --------------------------------------------------------------------

    @property
    def session(self):
        """Names of the flights that no healthy flight of it is compared with."""
        return next((some for some in SESSIONS if self.name in some), (self.name,))

    @property
    def group(self):
        """Flights of a group are left out together in choices about one of them: a condition, or a session of healthy flights."""
        return self.session if self.family == "none" else self.condition

    def healthy(self, flights):
        """The healthy flights of its vehicle, none of its own session unless there are no others."""
        same = [one for one in flights if one.vehicle == self.vehicle and one.family == "none" and one.name != self.name]
        return [one for one in same if one.name not in self.session] or same


def _check(path, row):
    """Refuses labels that mean nothing here."""
    sizes = row["size"].split("+") if row["family"] == "rotor" else []
    rules = {
        "family": row["family"] in FAMILIES,
        "rotors": re.fullmatch(r"(M[1-4])(\+M[1-4])*" if row["family"] != "none" else "", row["rotors"]),
        "size": all(re.fullmatch(r"\d+(\.\d+)?", size) for size in sizes) and len(sizes) in (0, len(row["rotors"].split("+"))),
    }
    wrong = next((name for name, holds in rules.items() if not holds), None)
    if wrong:
        raise UserError(f"{path}: {row['flight']}: {wrong} '{row[wrong]}'; {LABELS}")


def _flight(folder, row, work):
    source = folder / "flights" / row["flight"]
    convert.quietly(source, work / f"{source.stem}.csv", "quadrotor")
    return Flight(source.stem, *(row[name] for name in FIELDS[1:]), diagnosis.load(work / f"{source.stem}.csv"))


def load(folder):
    """[Flight] of labels.csv."""
    try:
        with open(folder / "labels.csv", encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise UserError(f"{folder}/labels.csv: cannot be read ({error.strerror}); name the folder of the labelled flights with --data")
    if not rows or not set(FIELDS) <= set(rows[0]):
        raise UserError(f"{folder}/labels.csv: needs the columns {', '.join(FIELDS)} and a row per flight")
    for row in rows:
        _check(folder / "labels.csv", row)
    with TemporaryDirectory() as work:
        found = [_flight(folder, row, Path(work)) for row in rows]
    alone = [one.name for one in found if not one.healthy(found)]
    if alone:
        raise UserError(f"{folder}: no healthy flight of the same vehicle to compare {', '.join(alone)} with; add one to labels.csv")
    return found
