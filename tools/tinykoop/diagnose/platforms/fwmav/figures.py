"""The plots of a flight's page, as SVG."""

import numpy as np

from ...prediction_errors.ahead import HORIZONS, rms
from ...report.figures import WIDTH, Panel, extent, legend, note, stroke, svg
from ...report.words import angle
from .vehicle import ANGLES, CHANNELS, SMOOTHED, UNITS, measured
from .where import BANDS, spectrum

SECONDS = 3.0  # that are drawn of the predictions, the worst
PANELS = 3
AXES = ("roll", "pitch", "yaw")


# ---- predictions against the log -----------------------------------------------------------------


def _axis(result):
    """Of the angle that the cause moves most, in times its noise; of the one that is most off where it is not known."""
    known, (before, after) = result.report["verdict"] == "known" and result.report["contributions"], result.more["missed"]
    moved = before - after if known else before
    return int(np.argmax(rms(moved[:, -1, ANGLES]) / result.path.noises.missed[-1, ANGLES]))


def predictions(result):
    """(axis, rows (W, n + 1), before, after (W, n + 1, 9)): one after the other, in the worst seconds of an axis."""
    log, path, n, axis = result.log, result.path, HORIZONS[-1], _axis(result)
    rows, starts = round(SECONDS / log.dt), result.found.starts
    missed = np.abs(result.more["missed"][0][:, -1, 6 + axis])
    inside = [(starts >= a) & (starts <= a + rows - n) for a in starts]
    worst = starts[int(np.argmax([rms(missed[part]) * part.sum() ** 0.5 for part in inside]))]
    starts = np.arange(worst, min(worst + rows - n, starts[-1]) + 1, n)
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


def follow(result, with_effects):
    """(caption, figure): predictions of the angle and the rate of an axis, each from the log, and the command."""
    log = result.log
    axis, rows, before, after = predictions(result)
    y, t = measured(log), log.t - log.t[0]
    shown = slice(rows[0, 0], rows[-1, -1] + 1)
    off = [np.abs(p[..., 6 + axis] - y[rows, 6 + axis]).max() for p in (before, after)]
    keys = [("measured", "log"), ("before", "simulator")] + [("after", "with effects")] * with_effects
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
    caption = f"In the worst seconds {AXES[axis]}, predicted up to 0.5 s ahead, is up to {angle(off[0])} off"
    caption += f"; with the effects {angle(off[1])}" if with_effects else ""
    return caption, svg(492, caption, *parts)


# ---- frequencies ---------------------------------------------------------------------------------


def _spectra(result):
    """(frequencies, amplitudes (3, F, 9) a root Hz): of what is missed before, after, and on healthy flights."""
    log, known = result.log, result.path.known[:, None]
    f, before = spectrum(np.where(known, result.more["innovations"][0], 0), log.dt)
    after = spectrum(np.where(known, result.more["innovations"][1], 0), log.dt)[1]
    healthy = np.mean([spectrum(missed, flight.dt)[1] for flight, missed in result.more["healthy"].flights], axis=0)
    amplitude = np.sqrt([before, after, healthy])[:, 1:]  # no constant on a logarithmic axis
    amplitude[..., ANGLES] = np.degrees(amplitude[..., ANGLES])
    return f[1:], amplitude


def _worst(report, amplitude):
    """The channels to draw: those that the report names, then those that are loudest beside healthy flights."""
    named = [CHANNELS.index(band["channel"]) for band in report["where"]["frequencies"]]
    louder = np.argsort(-(amplitude[0] / amplitude[2]).sum(0), kind="stable")
    return list(dict.fromkeys([*named, *louder.tolist()]))[:PANELS]


def frequencies(result, with_effects, label):
    """What the observer misses, by frequency, of the worst channels; both axes are logarithmic."""
    report = result.report
    f, amplitude = _spectra(result)
    keys = [("before", "simulator")] + [("after", "with effects")] * with_effects + [("floor", "healthy flights")]
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
        for low, high, name in zip(edges, edges[1:], BANDS.values()):
            out.append(note(float(panel.px(np.log10(low * high) / 2)), base + 30, name, "tick", "middle"))
        out.append(note(panel.left + panel.width / 2, base + 48, "frequency (Hz)", "label", "middle"))
    return "".join(out)
