"""What a report says of your own robot: effects by their formulas, and its channels over time."""

import numpy as np

from ...prediction_errors.ahead import HORIZONS
from ...report import figures, words
from ...report.links import Linked
from ...report.words import listed, percent
from . import told_links


class Own(Linked):
    title = staticmethod(str)  # names are those of the robot's file
    links_note, link_figure = told_links.NOTE, told_links.figure
    fault, motion = staticmethod(told_links.fault), staticmethod(told_links.motion)

    def effect_phrase(self, effect):
        """gain:speed, (1 + a) speed with a = 0.08."""
        values = listed(f"{name} = {words.quantity(value, effect['units'][name])}" for name, value in effect["params"].items())
        return f"{effect['formula']} with {values}"

    def asides(self):
        said = super().asides()
        if self.report["time_step"]["matters"]:
            said.append("The simulator's step of time is too long for this log: shorter steps bring it nearer. That is taken into account.")
        if "surrogate" in self.report:
            said += self._surrogate()
        return said

    def _surrogate(self):
        """What stood instead of a simulator that is known by a recorded run alone."""
        surrogate = self.report["surrogate"]
        worst = percent(max(surrogate["off"].values()))
        return [
            f"The simulator is known only by its run {surrogate['file']}: a surrogate, which was fitted to that run, stood in for it.",
            f"{surrogate['rows']} steps ahead, on held-out rows, the surrogate is off by {worst} of this log's noise at most.",
        ]

    def predictions(self):
        """The channel with the most of the gap over time: predictions in turn, without and with the effects."""
        path, shares = self.result.path, self.report["where"]["channels"]
        c = int(np.argmax(list(shares.values())))
        channel = path.robot.channels[c]
        length = max(min(HORIZONS[-1], len(path.rows) // 4), 1)
        starts = np.arange(path.settled, len(path.rows) - length, length)
        t = path.t[starts[:, None] + np.arange(1, length + 1)]
        key = (("before", "simulator"), ("after", "with effects")) if self.result.fit.causes else (("before", "simulator"),)
        missed = [path.ahead(some, starts, tuple(range(1, length + 1)))[..., c] for some in ((), self.result.fit.causes)[: len(key)]]
        reach = figures.extent(np.concatenate([m.ravel() for m in missed]))
        panel = figures.Panel((56, 40, figures.WIDTH - 66, 180), (0, float(path.t[-1])), reach)
        parts = [figures.legend(0, 14, key), panel.frame("time (s)", f"error of {channel.name} ({channel.unit})")]
        for values, (kind, _) in zip(missed, key):
            x, y = (np.concatenate([v, np.full((len(v), 1), np.nan)], 1).ravel() for v in (t, values))
            parts.append(panel.line(x, y, f"{kind} noisy"))
        of = f": it has {percent(shares[channel.name])} of the misfit" if self.located() else ""
        caption = f"Errors of {channel.name} in predictions of {length} steps, one after the other{of}"
        return caption, figures.svg(260, caption, *parts)

    def rows_of(self):
        return f"{super().rows_of()} The simulator went over them {self.report['passes']} times."
