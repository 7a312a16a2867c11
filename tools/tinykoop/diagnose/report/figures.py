"""The plots of the page, as SVG.

Drawn here and not by matplotlib, which takes two of the ten seconds that a diagnosis may take: these take
milliseconds, and through the page's style sheet they follow the reader's light or dark scheme. Before,
after and noise floor differ in dash or hatch and in lightness too, so they are readable in greyscale.
"""

import math
from html import escape

import numpy as np

from ...plumbing.results import number
from . import words

WIDTH = 480  # of every figure, px; narrower screens scale it
TEXT = 8  # px, about, of a character
LONGEST = 12  # characters of a number at an axis that is written without an exponent


# ---- drawing -------------------------------------------------------------------------------------


def round_numbers(low, high, most=5):
    """Round numbers in low..high and how many decimals they need."""
    span = high - low
    if not span > 0:
        return [low], 1
    rough = span / most
    power = 10.0 ** math.floor(math.log10(rough))
    sizes = [power * f for f in (0.5, 1, 2, 5, 10)]
    wide = next(i for i in range(1, 5) if sizes[i] >= rough * 0.999)
    for step in sizes[wide], sizes[wide - 1]:  # the finer one where the other leaves a single number, of which no scale is read
        numbers = range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
        if len(numbers) > 1:
            break
    return [i * step for i in numbers], max(0, -math.floor(math.log10(step) + 1e-9))


def tick(value, places):
    text = f"{value + 0.0:.{places}f}"
    return text if len(text) <= LONGEST else number(value)


def extent(values, pad=0.05):
    """Lowest and highest of what is finite, with some room."""
    values = np.asarray(values, float).ravel()
    values = values[np.isfinite(values)]
    low, high = (values.min(), values.max()) if len(values) else (0.0, 1.0)
    room = pad * (high - low) or 0.5 * abs(high) or 1.0
    return low - room, high + room


def svg(height, label, *parts):
    return f'<svg viewBox="0 0 {WIDTH} {height:.0f}" role="img" aria-label="{escape(label)}">{"".join(parts)}</svg>'


def note(x, y, text, kind="", anchor="start"):
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}" text-anchor="{anchor}">{escape(str(text))}</text>'


def rect(x, y, width, height, kind):
    return f'<rect x="{x:.1f}" y="{y:.1f}" width="{max(width, 0):.1f}" height="{max(height, 0):.1f}" class="{kind}"/>'


def stroke(x0, y0, x1, y1, kind):
    return f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" class="{kind}"/>'


def drawn(X, Y, good):
    """Which points (px) of a line are seen: of those that follow each other in one column of pixels its ends and extremes."""
    if not len(X):
        return np.zeros(0, bool)
    column = np.where(good, np.floor(np.where(good, X, 0)), np.nan)
    begins = np.r_[True, (column[1:] != column[:-1]) & (good[1:] | good[:-1])]
    starts = np.flatnonzero(begins)
    stretch = np.cumsum(begins) - 1
    low, high = (f.reduceat(Y, starts) for f in (np.minimum, np.maximum))
    extreme = ((Y == low[stretch]) | (Y == high[stretch])) & (low < high)[stretch]
    return begins | np.r_[begins[1:], True] | extreme


class Panel:
    """Axes in a box (left, top, width, height) px; equal: a metre is as long both ways."""

    def __init__(self, box, x, y, equal=False):
        self.left, self.top, self.width, self.height = box
        if equal:
            scale = max((x[1] - x[0]) / self.width, (y[1] - y[0]) / self.height)
            x, y = ((sum(r) / 2 - scale * size / 2, sum(r) / 2 + scale * size / 2) for r, size in ((x, self.width), (y, self.height)))
        self.x, self.y = x, y

    def px(self, x):
        return self.left + (np.asarray(x, float) - self.x[0]) / (self.x[1] - self.x[0]) * self.width

    def py(self, y):
        return self.top + (self.y[1] - np.asarray(y, float)) / (self.y[1] - self.y[0]) * self.height

    def line(self, x, y, kind):
        """A line, broken where it is not finite."""
        X, Y = np.broadcast_arrays(self.px(x), self.py(y))
        good = np.isfinite(X) & np.isfinite(Y)
        shown = drawn(X, Y, good)
        X, Y, good = X[shown], Y[shown], good[shown]
        parts, pen = [], "M"
        for a, b, fine in zip(X, Y, good):
            if fine:
                parts.append(f"{pen}{a:.1f} {b:.1f}")
            pen = "L" if fine else "M"
        return f'<path d="{"".join(parts)}" class="{kind}"/>'

    def frame(self, x_label="", y_label="", x_ticks=5, y_ticks=4):
        """Grid, numbers and labels."""
        out = []
        base = self.top + self.height
        for axis, (ticks, places) in (("x", round_numbers(*self.x, x_ticks)), ("y", round_numbers(*self.y, y_ticks))):
            for value in ticks:
                text = tick(value, places).replace("-", "\N{MINUS SIGN}")
                if axis == "x":
                    at = float(self.px(value))
                    out.append(stroke(at, self.top, at, base, "grid"))
                    if x_label is not None:
                        out.append(note(at, base + 15, text, "tick", "middle"))
                else:
                    at = float(self.py(value))
                    out.append(stroke(self.left, at, self.left + self.width, at, "grid"))
                    out.append(note(self.left - 5, at + 4, text, "tick", "end"))
        if x_label:
            out.append(note(self.left + self.width / 2, base + 32, x_label, "label", "middle"))
        if y_label:
            out.append(note(self.left - 36, self.top - 8, y_label, "label"))
        return "".join(out)


def legend(x, y, entries):
    """Keys in a row: [(class, text)], a class of lines or one of bars."""
    out = []
    for kind, text in entries:
        bar = kind.startswith("bar")
        out.append(rect(x, y - 9, 18, 10, kind) if bar else stroke(x, y - 4, x + 22, y - 4, kind))
        out.append(note(x + 27, y, text))
        x += 27 + TEXT * len(text) + 16
    return "".join(out)


def bars(entries, label):
    """Horizontal bars: [(name, value, text, class)]; an entry of one string is a heading."""
    values = [entry[1] for entry in entries if len(entry) > 1 and math.isfinite(entry[1])]
    most = max([v for v in values if v > 0], default=1.0)
    names = max([len(entry[0]) for entry in entries if len(entry) > 1], default=0)
    ends = max([len(entry[2]) for entry in entries if len(entry) > 1], default=0)
    left = names * TEXT + 8
    room = WIDTH - left - ends * TEXT - 14
    y, out = 4, []
    for entry in entries:
        if len(entry) == 1:
            out.append(note(0, y + 14, entry[0], "strong"))
            y += 20
            continue
        name, value, text, kind = entry
        size = max(value, 0) / most * room if math.isfinite(value) else 0
        out.append(note(left - 6, y + 12, name, "", "end") + rect(left, y + 1, size, 13, kind) + note(left + size + 5, y + 12, text))
        y += 18
    return svg(y + 4, label, *out)


# ---- figures -------------------------------------------------------------------------------------


def gap(rows, values, with_effects, label):
    """Bars of before, after and floor for every horizon; what is closed stands above each group.

    rows: of the table of this gap; values: the gap of the report.
    """
    entries = []
    for key, (name, before, after, floor, closed, spread) in zip(values["before"], rows):
        spread = f" ({spread})" if spread != "-" else ""
        entries.append((f"{name} ahead" + (f": {closed} closed{spread}" if closed != "-" else ""),))
        entries.append(("simulator", words.real(values["before"][key]), before, "bar-before"))
        entries += [("with effects", words.real(values["after"][key]), after, "bar-after")] * with_effects
        entries.append(("noise floor", words.real(values["noise_floor"][key]), floor, "bar-floor"))
    return bars(entries, label)


def over_time(t, errors, ends, segments, acts, label, error):
    """Errors over time, the share of the gap of each part, and when each effect acts.

    t (W,): times of the predictions (s); errors: before, after and floor (W,), without `after` where there are no effects; ends: of the
    time shown; segments: [(t0, t1, share of the gap)], if any; acts: [(text, [(t0, t1)])] of each effect.
    """
    left, width, with_effects = 44, WIDTH - 60, len(errors) == 3
    keys = [("before noisy", "simulator"), *[("after", "with effects")] * with_effects, ("floor", "noise floor")]
    panel = Panel((left, 52, width, 150), ends, (0, extent(np.concatenate(errors))[1]))
    alone = not (segments or acts)
    parts = [legend(0, 14, keys), panel.frame("time (s)" if alone else None, error)]
    broken = np.flatnonzero(np.diff(t) > 3 * np.median(np.diff(t))) + 1 if len(t) > 2 else []
    for values, (kind, _) in zip(errors, keys):
        parts.append(panel.line(np.insert(t, broken, np.nan), np.insert(values, broken, np.nan), kind))
    if alone:
        return svg(240, label, *parts)
    base = panel.top + panel.height
    if segments:
        base = 300
        parts.append(_shares(segments, Panel((left, 240, width, 60), ends, (0, _most_of(segments))), not acts))
    bottom = base + 34 * len(acts)
    for cut in sorted({words.real(s) for segment in segments for s in segment[:2]})[1:-1]:
        parts.append(stroke(float(panel.px(cut)), panel.top, float(panel.px(cut)), bottom, "cut"))
    if not acts:
        return svg(336, label, *parts)
    parts += [_acting(panel, base + 18 + 34 * i, *one) for i, one in enumerate(acts)]
    ticks, places = round_numbers(*ends)
    parts += [note(float(panel.px(v)), bottom + 29, tick(v, places), "tick", "middle") for v in ticks]
    parts.append(note(left + width / 2, bottom + 46, "time (s)", "label", "middle"))
    return svg(bottom + 52, label, *parts)


def _most_of(segments):
    """The end of an axis of shares, in percent."""
    return 1.15 * max([words.real(s[2]) for s in segments] + [0.01]) * 100


def _shares(segments, panel, last):
    parts, base = [panel.frame("time (s)" if last else None, "share of the gap (%)", 5, 2)], panel.top + panel.height
    for a, b, part in segments:
        x0, x1, y = panel.px(words.real(a)), panel.px(min(words.real(b), panel.x[1])), panel.py(100 * words.real(part))
        parts.append(rect(x0 + 0.5, y, x1 - x0 - 1, base - y, "bar-before"))
    return "".join(parts)


def _acting(panel, y, text, segments):
    """A bar over the times in which an effect acts."""
    parts = [note(panel.left, y + 8, text)]
    for a, b in segments:
        x0, x1 = panel.px(max(words.real(a), 0)), panel.px(min(words.real(b), panel.x[1]))
        parts.append(rect(x0, y + 12, x1 - x0, 11, "bar-after"))
    return "".join(parts)
