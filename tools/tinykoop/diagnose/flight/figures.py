"""The plots of a flight's page, as SVG, with the drawing of ../figures.py."""

import numpy as np

from .. import words as said
from ..figures import WIDTH, Panel, bars, extent, legend, note, over_time, stroke, svg
from ..prediction_errors.ahead import HORIZONS, rms
from . import words
from .gap import attitude
from .vehicle import ANGLES, CHANNELS, SMOOTHED, UNITS, measured
from .where import BANDS, spectrum

SECONDS = 3.0  # that are drawn of the predictions, the worst
RUNNING = 1.0  # s, over which errors are averaged: one by one they follow the turbulence
PANELS = 3
AXES = ("roll", "pitch", "yaw")


def channels(report, label):
    """Bars of every channel's error, in times that of healthy flights."""
    before, after = (words.channel_times(report, part) for part in ("before", "after"))
    rows = []
    for name, times in before.items():
        rows.append((name, times, f"{times:.2f}", "bar-before"))
        if report["contributions"]:
            rows.append(("", after[name], f"{after[name]:.2f}", "bar-after"))
    return bars(rows, label)


def _running(errors, starts, dt):
    """RMS of the errors (W,) of the windows that start within RUNNING s."""
    near = np.abs(starts[:, None] - starts) * dt <= RUNNING / 2
    return rms(np.where(near, errors, np.nan), axis=1)


def time_line(result, label):
    """Attitude error over time, the share of the gap of each part, and when each effect acts."""
    report = result.report
    key = words.beyond(report["gap"])
    ahead = said.horizon(report["gap"])
    j = [str(H) for H in HORIZONS].index(ahead) if ahead else -1
    errors = [_running(attitude(missed)[:, j], result.starts, result.log.dt) for missed in (result.before, result.after)]
    errors.append(np.full(len(result.starts), attitude(result.floor)[j]))
    error = f"RMS error {said.ahead(ahead, report)} (deg), over {RUNNING:g} s" if ahead else "error (deg)"
    return over_time(result, result.starts, np.degrees(errors), label, error, report["where"]["segments"] if key else ())


# ---- predictions against the log -----------------------------------------------------------------


def _axis(result):
    """Of the angle that the cause moves most, in times its noise; of the one that is most off where it is not known."""
    known = result.report["verdict"] == "known" and result.report["contributions"]
    moved = result.before - result.after if known else result.before
    return int(np.argmax(rms(moved[:, -1, ANGLES]) / result.floor[-1, ANGLES]))


def predictions(result):
    """(axis, rows (W, n + 1), before, after (W, n + 1, 9)): one after the other, in the worst seconds of an axis."""
    log, path, n, axis = result.log, result.path, HORIZONS[-1], _axis(result)
    rows = round(SECONDS / log.dt)
    missed = np.abs(result.before[:, -1, 6 + axis])
    inside = [(result.starts >= a) & (result.starts <= a + rows - n) for a in result.starts]
    worst = result.starts[int(np.argmax([rms(missed[part]) * part.sum() ** 0.5 for part in inside]))]
    starts = np.arange(worst, min(worst + rows - n, result.starts[-1]) + 1, n)
    starts = starts[[log.usable[a : a + n].all() and bool(path.known[a]) for a in starts]]
    steps = np.arange(1, n + 1)
    y = measured(log)
    out = []
    for causes in ((), result.fit.causes):
        predicted = y[starts[:, None] + steps] - path.ahead(causes, starts, steps)
        predicted = np.concatenate([y[starts][:, None], predicted], axis=1)
        predicted[..., ANGLES] = np.unwrap(predicted[..., ANGLES], axis=1)
        out.append(predicted)
    return axis, starts[:, None] + np.arange(n + 1), *out


def follow(result):
    """(caption, figure): predictions of the angle and the rate of an axis, each from the log, and the command."""
    report, log = result.report, result.log
    axis, rows, before, after = predictions(result)
    y, t = measured(log), log.t - log.t[0]
    shown = slice(rows[0, 0], rows[-1, -1] + 1)
    off = [np.abs(p[..., 6 + axis] - y[rows, 6 + axis]).max() for p in (before, after)]
    with_effects = bool(report["contributions"])
    keys = [("measured", "log"), ("before", "before" if with_effects else "simulator")] + [("after", "after")] * with_effects
    parts = [legend(0, 14, keys)]
    beat = max(round(SMOOTHED / log.dt), 1)
    y[:, axis] = np.convolve(np.nan_to_num(y[:, axis]), np.full(beat, 1 / beat), "same")  # else the wing beat hides all
    names = (f"{AXES[axis]} (deg)", f"{CHANNELS[axis]} (deg/s), log without the wing beat")
    for i, (channel, name) in enumerate(zip((6 + axis, axis), names)):
        # a rate is shaken where a prediction begins: that row is not drawn
        lines = [np.degrees(v[..., channel]) for v in (y[None, shown], before[:, i:], *[after[:, i:]] * with_effects)]
        panel = Panel((44, 44 + 175 * i, WIDTH - 60, 130), (t[shown][0], t[shown][-1]), extent(np.concatenate([v.ravel() for v in lines])))
        parts += [panel.frame(None, name), panel.line(t[shown], lines[0][0], "measured")]
        for predicted, kind in zip(lines[1:], ("before", "after")):
            parts += [panel.line(t[row], one, kind) for row, one in zip(rows[:, i:], predicted)]
    u = log.u[shown, 0]
    panel = Panel((44, 394, WIDTH - 60, 60), (t[shown][0], t[shown][-1]), extent(u))
    parts += [panel.frame("time (s)", "u (rad)", 5, 3), panel.line(t[shown], u, "command")]
    caption = words.follow_caption(report, AXES[axis], *off)
    return caption, svg(492, caption, *parts)


# ---- frequencies ---------------------------------------------------------------------------------


def _spectra(result):
    """(frequencies, amplitudes (3, F, 9) a root Hz): of what is missed before, after, and on healthy flights."""
    log, known = result.log, result.path.known[:, None]
    f, before = spectrum(np.where(known, result.left[0], 0), log.dt)
    after = spectrum(np.where(known, result.left[1], 0), log.dt)[1]
    healthy = np.mean([spectrum(missed, flight.dt)[1] for flight, missed in result.healthy.flights], axis=0)
    amplitude = np.sqrt([before, after, healthy])[:, 1:]  # no constant on a logarithmic axis
    amplitude[..., ANGLES] = np.degrees(amplitude[..., ANGLES])
    return f[1:], amplitude


def _worst(report, amplitude):
    """The channels to draw: those that the report names, then those that are loudest beside healthy flights."""
    named = [CHANNELS.index(band["channel"]) for band in report["where"]["frequencies"]]
    louder = np.argsort(-(amplitude[0] / amplitude[2]).sum(0), kind="stable")
    return list(dict.fromkeys([*named, *louder.tolist()]))[:PANELS]


def frequencies(result, label):
    """What the observer misses, by frequency, of the worst channels; both axes are logarithmic."""
    report = result.report
    f, amplitude = _spectra(result)
    with_effects = bool(report["contributions"])
    keys = [("before", "before" if with_effects else "simulator")] + [("after", "after")] * with_effects + [("floor", "healthy flights")]
    parts = [legend(0, 14, keys)]
    edges = sorted({edge for band in BANDS for edge in band if edge} | {f[0]})
    worst = _worst(report, amplitude)
    for i, channel in enumerate(worst):
        panel = Panel((44, 62 + 160 * i, WIDTH - 60, 104), np.log10([f[0], f[-1]]), extent(np.log10(amplitude[..., channel]), 0.08))
        unit = "deg" if UNITS[channel] == "rad" else UNITS[channel].replace("^2", "²")
        parts.append(note(panel.left - 36, panel.top - 8, f"{CHANNELS[channel]} ({unit} / √Hz)", "label"))
        parts.append(_decades(panel, edges, i == len(worst) - 1))
        for values, kind in zip(amplitude[..., channel], ("before", "after", "floor")):
            if with_effects or kind != "after":
                parts.append(panel.line(np.log10(f), np.log10(values), kind))
    return svg(62 + 160 * len(worst) + 24, label, *parts)


def _decades(panel, edges, last):
    """The grid: edges of the bands, and 1, 3, 10 and so on; names of the bands below the last panel."""
    base, out = panel.top + panel.height, []
    for value in (factor * 10.0**power for power in range(-6, 4) for factor in (1, 3)):
        if panel.y[0] < np.log10(value) < panel.y[1]:
            at = float(panel.py(np.log10(value)))
            out += [stroke(panel.left, at, panel.left + panel.width, at, "grid"), note(panel.left - 5, at + 4, f"{value:g}", "tick", "end")]
    for edge in edges:
        at = float(panel.px(np.log10(edge)))
        out += [stroke(at, panel.top, at, base, "grid"), note(at, base + 15, f"{edge:g}", "tick", "middle")]
    if last:
        for low, high, name in zip(edges, edges[1:], words.BAND_NAMES):
            out.append(note(float(panel.px(np.log10(low * high) / 2)), base + 30, name, "tick", "middle"))
        out.append(note(panel.left + panel.width / 2, base + 48, "frequency (Hz)", "label", "middle"))
    return "".join(out)
