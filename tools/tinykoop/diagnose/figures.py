"""The plots of the page, as SVG.

Drawn here and not by matplotlib, which takes two of the ten seconds that a diagnosis may take: these take
milliseconds, and through the page's style sheet they follow the reader's light or dark scheme. Before,
after and noise floor differ in dash or hatch and in lightness too, so they are readable in greyscale.
"""

import math
from html import escape

import numpy as np

from ..plumbing.results import number
from . import words
from .prediction_errors.ahead import HORIZONS

WIDTH = 480  # of every figure, px; narrower screens scale it
MOST_POINTS = 1500  # of a path: more are not seen
ZOOMS = 3
TEXT = 8  # px, about, of a character
LONGEST = 12  # characters of a number at an axis that is written without an exponent
SHORTEST = 2  # steps of a prediction worth drawing


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
            x, y = (
                (sum(r) / 2 - scale * size / 2, sum(r) / 2 + scale * size / 2)
                for r, size in ((x, self.width), (y, self.height))
            )
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


def bars(entries, label, zero_is_floor=True):
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
        out.append(
            note(left - 6, y + 12, name, "", "end")
            + rect(left, y + 1, size, 13, kind)
            + note(left + size + 5, y + 12, text)
        )
        y += 18
    return svg(y + 4, label, *out)


# ---- figures -------------------------------------------------------------------------------------


def gap(gap, report, label, size=words.length):
    """Bars of before, after and floor for every horizon; what is closed stands above each group."""
    rows, with_effects = [], bool(report["effects"])
    for name, _, _, _, closed, spread in words.gap_rows(gap, report, size):
        spread = f" ({spread})" if spread != "-" else ""
        rows.append((f"{name} ahead" + (f": {closed} closed{spread}" if closed != "-" else ""),))
        key = name.split()[0]
        for part, text, kind in (
            ("before", "before" if with_effects else "simulator", "bar-before"),
            ("after", "after", "bar-after"),
            ("noise_floor", "noise floor", "bar-floor"),
        ):
            if part != "after" or with_effects:
                value = words.real(gap[part][key])
                rows.append((text, value, size(value), kind))
    return bars(rows, label)


def ranking(report, label, most=8):
    """Bars of the ranking's scores; those that were found are solid."""
    found = {effect["name"] for effect in report["effects"]}
    rows = [r for r in report["ranking"] if words.real(r["score"]) >= 0.005 or r["name"] in found][:most]
    kinds = ["bar-after" if r["name"] in found else "bar-floor" for r in rows]
    scores = [words.real(r["score"]) for r in rows]
    return bars([(words.title(r["name"]), s, f"{s:.2f}", kind) for r, s, kind in zip(rows, scores, kinds)], label)


def contributions(report, label, size=words.length):
    """Bars of how much each effect is worth."""
    key = words.horizon(report["gap"])
    rows = [
        (words.title(name), words.real(rise[key]), size(rise[key]), "bar-after")
        for name, rise in report["contributions"].items()
    ]
    return bars(rows, label)


def channels(report, label):
    """Bars of the share of each direction."""
    shares = report["where"]["channels"]
    return bars([(name, words.real(part), words.percent(part), "bar-before") for name, part in shares.items()], label)


def predictions(result):
    """(rows (W, n + 1), before, after (W, n + 1, 2)): one after the other along the log, each from a measured pose."""
    log = result.log
    edges = np.flatnonzero(np.diff(np.concatenate([[0], log.usable.astype(int), [0]])))
    runs = edges.reshape(-1, 2)
    steps = min(HORIZONS[-1], int((runs[:, 1] - runs[:, 0]).max()))
    starts = np.concatenate([np.arange(a, b - steps + 1, steps) for a, b in runs])
    rows = starts[:, None] + np.arange(steps + 1)
    out = []
    for causes in ((), result.fit.causes):
        predicted, _ = result.path.predicted(causes, starts, np.arange(1, steps + 1))
        out.append(np.concatenate([log.x[starts][:, None, :2], predicted[..., :2]], axis=1))
    return rows, *out


def path(result):
    """(caption, figure): the measured path, and the windows of the largest errors by themselves."""
    report, log = result.report, result.log
    rows, before, after = predictions(result)
    measured = log.x[rows][..., :2]
    error = [np.hypot(*np.moveaxis(p[:, -1] - measured[:, -1], -1, 0)) for p in (before, after)]
    worst = np.argsort(-np.nan_to_num(error[0]), kind="stable")[:ZOOMS]
    worst = np.sort(worst)
    steps = rows.shape[1] - 1
    caption = words.path_caption(report, steps, *(np.nanmax(e) for e in error))
    if steps < SHORTEST:
        worst = worst[:0]
    with_effects = bool(report["effects"])

    whole = log.x[:, :2].copy()
    whole[:-1][~log.usable] = np.nan
    whole = whole[:: max(1, len(whole) // MOST_POINTS)]
    panel = Panel(
        (44, 44, WIDTH - 54, 220),
        extent(np.r_[whole[:, 0], before[..., 0].ravel()]),
        extent(np.r_[whole[:, 1], before[..., 1].ravel()]),
        True,
    )
    keys = [("measured", "measured"), ("before", "before" if with_effects else "simulator")] + [
        ("after", "after")
    ] * with_effects
    parts = [legend(0, 14, keys), panel.frame("x (m)", "y (m)"), panel.line(*whole.T, "measured")]
    thin = max(1, steps // 10)
    for k in range(0, len(rows), max(1, len(rows) // 100)):
        parts.append(panel.line(*before[k, ::thin].T, "before thin"))
        if with_effects:
            parts.append(panel.line(*after[k, ::thin].T, "after thin"))
    for i, k in enumerate(worst):
        x, y = measured[k, 0]
        parts.append(f'<circle cx="{panel.px(x):.1f}" cy="{panel.py(y):.1f}" r="8" class="mark"/>')
        parts.append(note(panel.px(x), panel.py(y) + 4, i + 1, "strong", "middle"))
    top, each = 322, (WIDTH - 44) / ZOOMS
    for i, k in enumerate(worst):
        lines = [measured[k], before[k]] + [after[k]] * with_effects
        together = np.concatenate(lines)
        zoom = Panel((44 + i * each, top, each - 40, each - 40), extent(together[:, 0]), extent(together[:, 1]), True)
        parts.append(zoom.frame("x (m)" if i == 1 or len(worst) == 1 else "", "", 3, 3))
        parts.append(
            note(zoom.left, top - 8, f"{i + 1}: from {words.seconds(log.t[rows[k, 0]] - log.t[0])}", "strong")
        )
        parts += [zoom.line(*line.T, kind) for line, kind in zip(lines, ("measured", "before", "after"))]
    return caption, svg(top + each if len(worst) else 310, caption, *parts)


def time_line(result, label):
    """Error over time, the share of the gap of each part, and when each effect acts."""
    report = result.report
    key = words.horizon(report["gap"])
    j = [str(H) for H in HORIZONS].index(key) if key else 0
    errors = [part["position"][:, j] for part in (result.before, result.after, result.floor)]
    error = f"error {words.ahead(key, report)} (m)" if key else "error (m)"
    return over_time(result, result.path.rows[result.starts], errors, label, error, report["where"]["segments"])


def over_time(result, starts, errors, label, error, segments):
    """errors: before, after and floor of the windows from rows `starts`; segments: [(t0, t1, share of the gap)], if any."""
    report, log = result.report, result.log
    end = words.real(report["log"]["seconds"])
    with_effects, left, width = bool(report["effects"]), 44, WIDTH - 60
    keys = (
        [("before noisy", "before" if with_effects else "simulator")]
        + [("after", "after")] * with_effects
        + [("floor", "noise floor")]
    )
    parts = [legend(0, 14, keys)]
    t = log.t[starts] - log.t[0]
    lines = [line for line in zip(errors, ("before noisy", "after", "floor")) if with_effects or line[1] != "after"]
    high = extent(np.concatenate([values for values, _ in lines]))[1]
    panel = Panel((left, 52, width, 150), (0, end), (0, high))
    alone = report["verdict"] == "none" or not (segments or with_effects)
    parts.append(panel.frame("time (s)" if alone else None, error))
    broken = np.flatnonzero(np.diff(starts) > 3 * np.median(np.diff(starts))) + 1 if len(t) > 2 else []
    for values, kind in lines:
        parts.append(panel.line(np.insert(t, broken, np.nan), np.insert(values, broken, np.nan), kind))
    if alone:
        return svg(240, label, *parts)
    base = panel.top + panel.height
    if segments:
        base = 300
        most = 1.15 * max([words.real(s[2]) for s in segments] + [0.01]) * 100
        share = Panel((left, 240, width, 60), (0, end), (0, most))
        parts.append(share.frame(None if with_effects else "time (s)", "share of the gap (%)", 5, 2))
        for a, b, part in segments:
            x0, x1, y = share.px(words.real(a)), share.px(min(words.real(b), end)), share.py(100 * words.real(part))
            parts.append(rect(x0 + 0.5, y, x1 - x0 - 1, base - y, "bar-before"))
    bottom = base + 34 * len(report["effects"])
    for cut in sorted({words.real(s) for segment in segments for s in segment[:2]})[1:-1]:
        parts.append(stroke(float(panel.px(cut)), panel.top, float(panel.px(cut)), bottom, "cut"))
    if not with_effects:
        return svg(336, label, *parts)
    for i, effect in enumerate(report["effects"]):
        y = base + 18 + 34 * i
        parts.append(note(left, y + 8, f"{words.title(effect['name'])}: {words.acts(effect, report)}"))
        for a, b in effect["segments"]:
            x0, x1 = panel.px(max(words.real(a), 0)), panel.px(min(words.real(b), end))
            parts.append(rect(x0, y + 12, x1 - x0, 11, "bar-after"))
    ticks, places = round_numbers(0, end)
    parts += [note(float(panel.px(v)), bottom + 29, tick(v, places), "tick", "middle") for v in ticks]
    parts.append(note(left + width / 2, bottom + 46, "time (s)", "label", "middle"))
    return svg(bottom + 52, label, *parts)


def drive(advice, dt, names, label):
    """The advised commands over time."""
    commands = advice[2]
    t = np.repeat(np.arange(len(commands) + 1) * dt, 2)[1:-1]
    parts = []
    for i, (name, unit) in enumerate(zip(names, ("m/s", "rad/s"))):
        held = np.repeat(commands[:, i], 2)
        low, high = extent(held, 0.15)
        panel = Panel((44, 26 + 145 * i, WIDTH - 60, 92), (0, t[-1]), (min(low, 0), max(high, 0)))
        parts += [panel.frame("time (s)" if i else "", f"{name} ({unit})", 5, 3), panel.line(t, held, "command")]
    return svg(302, label, *parts)
