"""A report as the scorer reads it: what it names, of which family, and what it calls ambiguous with what."""

from . import plant

VERDICTS = ("known", "partly", "none", "unknown")


def _entry(given):
    """An effect with a name; of one that has none, what else says which it is."""
    given = {"name": given} if isinstance(given, str) else given
    return given | {"name": given.get("name") or given.get("form") or given["family"]}


def paired(truth, names, alike):
    """{true one: its name}, one to one, as many as can be paired."""
    pairs = {}

    def pair(true, tried):
        for name in sorted(names, key=lambda n: n != true):
            if name not in tried and alike(name, true):
                tried.add(name)
                if name not in pairs or pair(pairs[name], tried):
                    pairs[name] = true
                    return True
        return False

    for true in truth:
        pair(true, set())
    return {true: name for name, true in pairs.items()}


class Answer:
    """A report as the scorer reads it; raises on one that is none."""

    def __init__(self, report, duration):
        self.verdict = report["verdict"]
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict {self.verdict!r}")
        self.effects = list(map(_entry, report.get("effects") or []))
        listed = list(map(_entry, report.get("ranking") or report.get("best_fit") or self.effects))
        self.ranking = [entry["name"] for entry in listed]
        self.ambiguous = {name: set(others) for name, others in (report.get("ambiguous_with") or {}).items()}
        self.names = sorted({effect["name"] for effect in self.effects})
        self.kinds = {entry["name"]: plant.family(entry["name"], entry.get("family")) for entry in (*listed, *self.effects)}
        self.families = sorted({self.family(name) for name in self.names})
        self.duration = duration
        fresh = report.get("fresh") or {}
        self.gap, self.fresh, self.there = report.get("gap") or {}, fresh.get("gap") or {}, fresh.get("effects", self.effects)

    def family(self, name):
        return self.kinds.get(name) or plant.family(name)

    def alike(self, a, b):
        return a == b or b in self.ambiguous.get(a, ()) or a in self.ambiguous.get(b, ())

    def akin(self, a, b):
        """The same of families."""
        pairs = [(self.family(name), self.family(other)) for name, others in self.ambiguous.items() for other in others]
        return a == b or (a, b) in pairs or (b, a) in pairs

    def spans(self, name):
        """Where the effect is said to act; no segments: all the time."""
        return [
            tuple(span) for effect in self.effects if effect["name"] == name for span in effect.get("segments") or [(0.0, self.duration)]
        ]

    def matches(self, truth):
        """{true effect: its name in the report}, as many as can be paired."""
        return paired(truth, self.names, self.alike)
