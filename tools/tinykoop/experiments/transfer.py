"""Flapping wing across flight regimes: the paper's table "Learning Performance of an FWMAV Across Flight Regimes".

A model is fitted on the first 20 % of one regime, pitch (P) or yaw (Y) manoeuvres, and learned on over the other
regime, or over the rest of its own. State and command pass the library's low-pass first, as in firmware: wings shake the
sensors more than the vehicle moves. Both pass the same one, so a linear relation between them stays what it is.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import bridge
from ..logs import replay
from ..plumbing import pages, plots
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, printable, progress, replacing
from . import scenario

# The paper names no filter. At 3 Hz a threshold of 1 gates about as often as the paper says it does (54 to 73 %).
CUTOFF = 3.0  # Hz
FIT, CALIBRATE = 0.2, 0.2  # shares of the source regime
ETA = 0.75
INVERSE_RIDGES = tuple(10.0**k for k in range(-4, 9))
DELTA = 1.0  # paper, section "Comparison Protocol"
REGIMES = {"P": "pitch", "Y": "yaw"}  # what the names of their logs begin with
SECONDS, SEEDS = 40, {"P": (1,), "Y": (2,)}  # of the synthetic flights
PRECISIONS = (64, 32)
FORM = "sqrt"

# mean error P->P, Y->Y, P->Y, Y->P and largest final |P|
PAPER = {
    ("rbf", "offline"): (0.453, 0.595, 0.889, 0.862, None),
    ("poly", "ef"): (0.516, 0.609, 0.629, 0.552, 5.81e4),
    ("poly", "dz_cs"): (0.538, 0.627, 0.644, 0.591, 1.81e3),
    ("poly", "dz_ks"): (0.587, 0.660, 0.688, 0.621, 2.18e3),
    ("poly", "ct"): (0.508, 0.620, 0.641, 0.559, 1.04e3),
    ("poly", "sift"): (0.508, 0.618, 0.652, 0.568, 3.79e2),
    ("rbf", "ef"): (0.474, 0.565, 0.583, 0.508, 9.69e4),
    ("rbf", "dz_cs"): (0.500, 0.574, 0.601, 0.530, 4.40e3),
    ("rbf", "dz_ks"): (0.527, 0.603, 0.627, 0.565, 5.31e3),
    ("rbf", "ct"): (0.465, 0.576, 0.597, 0.505, 1.25e3),
    ("rbf", "sift"): (0.464, 0.578, 0.599, 0.508, 6.72e2),
}


@dataclass(frozen=True)
class Flight:
    """Logs of one regime, one after another: states (K, n), commands (K, m), which of the K - 1 steps may be used."""

    x: np.ndarray
    u: np.ndarray
    usable: np.ndarray
    dt: float
    states: tuple = ()  # of a quadrotor

    def part(self, first, last):
        """Which steps lie between two shares of the usable ones."""
        order = np.cumsum(self.usable) / max(self.usable.sum(), 1)
        return self.usable & (order > first) & (order <= last)


def directions(regimes):
    """[(regime that is fitted, regime that is learned on)] of two regimes, those within one first."""
    a, b = regimes
    return [(a, a), (b, b), (a, b), (b, a)]


DIRECTIONS = directions(REGIMES)


def filtered(log, cutoff=CUTOFF):
    """(x, u) of a log after the low-pass; as they are where it is 0."""
    both = np.column_stack([log.x, log.u])
    if cutoff:
        both = bridge.lowpass(both, cutoff, 1 / log.dt, usable=log.usable)
    return both[:, : log.x.shape[1]], both[:, log.x.shape[1] :]


def joined(logs, cutoff=CUTOFF):
    """One Flight of several logs of the same regime."""
    parts = [filtered(log, cutoff) for log in logs]
    usable = [np.append(log.usable, False) for log in logs]
    x, u = (np.concatenate(columns) for columns in zip(*parts))
    return Flight(x, u, np.concatenate(usable)[:-1], logs[0].dt, getattr(logs[0], "states", ()))


def read(folder):
    """{regime: Flight} of the logs in a folder."""
    flights = {}
    for regime, name in REGIMES.items():
        paths = [p for p in sorted(Path(folder).glob(f"{name}*.csv")) if not p.stem.endswith("_aux")]
        if not paths:
            raise UserError(f"{folder}: no log of {name} manoeuvres; name them {name}*.csv, with the columns of the flapping wing")
        flights[regime] = joined([replay.load(path, "fwmav")[0] for path in paths])
    return flights


def synthetic():
    """{regime: Flight} of the simulated vehicle."""
    return {
        regime: joined([replay.unwrapped(bridge.fwmav(name, SECONDS, seed)[0], "fwmav") for seed in SEEDS[regime]])
        for regime, name in REGIMES.items()
    }


def innovations(estimator, flight):
    """Norms (K - 1) of what the estimator's Theta, as it is, leaves of the lifted states."""
    psi = estimator.lift(np.where(np.isfinite(flight.x), flight.x, 0))
    predicted = np.concatenate([psi[:-1], flight.u[:-1]], axis=1) @ estimator.theta.T
    return np.linalg.norm(psi[1:] - predicted, axis=1)


def models(flight, platform):
    """{dictionary: (Theta, calibrated delta)} of a source regime.

    The ridge is the power of ten that predicts the calibration part best: the offline model is to be as good as it can be
    from this regime alone.
    """
    fit, calibration, out = flight.part(0, FIT), flight.part(FIT, FIT + CALIBRATE), {}
    for dictionary in ("poly", "rbf"):
        candidates = []
        for p0 in INVERSE_RIDGES:
            estimator = replay.offline_fit(flight, platform, dictionary, usable=fit, p0=p0)
            scores = innovations(estimator, flight)[calibration]
            candidates.append((float(scores.mean()), estimator.theta, bridge.threshold(scores, ETA)))
        out[dictionary] = min(candidates, key=lambda c: c[0])[1:]
    return out


def learned(method, precision, theta, delta, flight, scored, platform):
    """Trace of one method that begins at theta."""
    online = method.regulator != "offline"
    estimator = bridge.Estimator(
        replay.lifting(flight, platform, method.dictionary), method.regulator if online else "none", precision, form=FORM,
        n_inputs=flight.u.shape[1], lam=replay.LAMBDA[platform], delta=delta,
    )  # fmt: skip
    estimator.theta = theta
    return estimator.replay(flight.x, flight.u[:-1], usable=scored, learn=online)


def transfers(name, flights, platform="fwmav", thresholds=(False, True)):
    """Rows of transfer.json of one source of flights, and the traces {(direction, method): trace} of float64, delta = 1.

    thresholds: of dead zones, whether they are calibrated.
    """
    fitted = {regime: models(flight, platform) for regime, flight in flights.items()}
    rows, traces = [], {}
    jobs = [
        (direction, method, precision, calibrated)
        for direction in directions(flights)
        for method in scenario.METHODS
        for precision in PRECISIONS
        for calibrated in (thresholds if method.regulator in bridge.dead_zones() else (False,))
    ]
    for (source, target), method, precision, calibrated in progress(jobs, name):
        theta, own = fitted[source][method.dictionary]
        delta, flight = own if calibrated else DELTA, flights[target]
        scored = flight.part(FIT + CALIBRATE if source == target else 0, 1)
        trace = learned(method, precision, theta, delta, flight, scored, platform)
        online, gates = method.regulator != "offline", method.regulator in bridge.dead_zones()
        rows.append(
            {
                "source": name,
                "dictionary": method.dictionary,
                "regulator": method.regulator,
                "precision": f"f{precision}",
                "form": FORM,
                "direction": f"{source}->{target}",
                "steps": int(scored.sum()),
                "mean_error": float(np.mean(trace["error"][scored])),
                "final_P_fro": float(trace["norm_p"][-1]) if online else None,
                "skip_rate": float(trace["frozen"][scored].mean()) if gates else None,
                "delta": delta if gates else None,
                "calibrated": calibrated,
                "stays": float(np.linalg.norm(np.diff(flight.x, axis=0), axis=1)[scored].mean()),
                "refused": int((trace["status"][scored] < 0).sum()),
            }
        )
        if precision == 64 and not calibrated:
            traces[(source, target), method] = trace
    return rows, traces


def run(out, data, update=False):
    """Writes transfer.json and its plots into `out`: synthetic flights, and those in the folder `data` if it is given.

    update: also the tables of docs/flapping-wing.md, that of real flights if there are any.
    """
    out = output_folder(out)
    sources = {"synthetic": synthetic()}
    if data:
        sources[printable(Path(data).name)] = read(data)
    learned = {name: transfers(name, flights) for name, flights in sources.items()}
    rows = [row for own, _ in learned.values() for row in own]
    with replacing(out / "transfer.json", rows):
        for name, (own, traces) in learned.items():
            draw_table(out, name, own)
            shown = {m: traces[SHOWN_DIRECTION, m] for m in scenario.METHODS if m.dictionary == "rbf"}
            for end, some in scenario.families(shown).items():
                draw_time(out / f"transfer_{name}_time{end}.png", name, sources[name][SHOWN_DIRECTION[1]], some)
            draw_channels(out, name, sources[name], traces)
    for name, (own, _) in learned.items():
        report(name, own)
        if update:
            region, flights = ("transfer", "simulated") if name == "synthetic" else ("transfer-real", "real")
            pages.update("docs/flapping-wing.md", region, page(flights, own))
    return rows


def chosen(rows, method, precision="f64", calibrated=False):
    """The four rows of a method, in the order of DIRECTIONS."""
    key = method.dictionary, method.regulator, precision, calibrated
    return [row for row in rows if (row["dictionary"], row["regulator"], row["precision"], row["calibrated"]) == key]


def page(flights, rows):
    """The table of docs/flapping-wing.md."""
    names = ["->".join(direction) for direction in DIRECTIONS]
    lines = [[replay.NOTHING, *[number(row["stays"]) for row in chosen(rows, scenario.METHODS[0])], "-", "-"]]
    for method in scenario.METHODS:
        four, narrow = chosen(rows, method), chosen(rows, method, "f32")
        norms = [row["final_P_fro"] for row in four if row["final_P_fro"] is not None]
        apart = max(abs(b["mean_error"] / a["mean_error"] - 1) for a, b in zip(four, narrow))
        largest = number(max(norms)) if norms else "-"
        lines.append([method.label, *[number(row["mean_error"]) for row in four], largest, number(apart, 1)])
    headers = ["method", *names, "largest final |P|", "float32, relative"]
    return pages.table(f"Mean one-step error, {flights} flights, threshold {DELTA:g}", headers, lines)


def report(name, rows):
    """The paper's table, and what a calibrated threshold and float32 make of it."""
    names = ["->".join(direction) for direction in DIRECTIONS]
    errors, norms, calibrations = [], [], []
    for method in scenario.METHODS:
        four, narrow = chosen(rows, method), chosen(rows, method, "f32")
        *paper, paper_P = PAPER.get((method.dictionary, method.regulator), ("-",) * 4 + (None,))
        errors.append([method.label, *[f"{number(row['mean_error'])} ({error})" for row, error in zip(four, paper)]])
        P = [row["final_P_fro"] for row in four if row["final_P_fro"] is not None]
        skip = [100 * row["skip_rate"] for row in four if row["skip_rate"] is not None]
        norms.append(
            [
                method.label,
                f"{number(max(P))} ({number(paper_P)})" if P else "",
                f"{min(skip):.0f} to {max(skip):.0f}" if skip else "",
                f"{max(abs(b['mean_error'] / a['mean_error'] - 1) for a, b in zip(four, narrow)):.1e}",
            ]
        )
        if skip:
            own = chosen(rows, method, calibrated=True)
            calibrations.append(
                [method.label, *[f"{number(row['mean_error'])}, {100 * row['skip_rate']:.0f} %, {number(row['delta'])}" for row in own]]
            )
    stays = [row["stays"] for row in chosen(rows, scenario.METHODS[0])]
    errors.insert(0, [replay.NOTHING, *[number(error) for error in stays]])
    print_table(
        f"Across flight regimes, {name}: mean one-step error, float64, the paper's vehicle in brackets",
        ["method", *names],
        errors,
        f"Low-pass of {CUTOFF:g} Hz on state and command; square-root form; delta = {DELTA:g}",
    )
    print_table(f"{name}: the covariance, and float32", ["method", "largest final |P|", "frozen %", "f32, relative"], norms)
    print_table(
        f"{name}: threshold calibrated on the source, the {ETA:g} quantile of its innovations: error, frozen, delta",
        ["method", *names],
        calibrations,
    )
    for direction in ("P->Y", "Y->P"):
        errors = {m: row["mean_error"] for m in scenario.METHODS for row in chosen(rows, m) if row["direction"] == direction}
        offline = next(error for m, error in errors.items() if m.regulator == "offline")
        gains = [100 * (1 - error / offline) for m, error in errors.items() if m.regulator != "offline"]
        print(f"{direction}: learning online takes away {min(gains):.1f} to {max(gains):.1f} % of the offline model's error")


# ---- plots -----------------------------------------------------------------------------------

CHANNELS = (
    ("gyro x", "rad/s"), ("gyro y", "rad/s"), ("gyro z", "rad/s"), ("accel. x", "m/s$^2$"), ("accel. y", "m/s$^2$"),
    ("accel. z", "m/s$^2$"), ("pitch", "rad"), ("roll", "rad"), ("yaw", "rad"), ("yaw rate", "rad/s"),
)  # fmt: skip
SHOWN = scenario.Method("poly", "dz_cs")
SHOWN_DIRECTION = ("P", "Y")


def draw_table(out, name, rows):
    """Mean error of all methods in the four directions, relative to the offline model, ours and the paper's."""
    methods = [m for m in scenario.METHODS if m.regulator != "offline"]
    figure, axes = plots.subplots(1, 4, figsize=(11, 1.8 + 0.22 * len(methods)), sharey=True)
    offline = chosen(rows, scenario.Method("rbf", "offline"))
    worst = max(row["mean_error"] / base["mean_error"] for m in methods for row, base in zip(chosen(rows, m)[2:], offline[2:]))
    verdict = "every online method beats the offline model" if worst < 1 else "not every online method beats the offline model"
    figure.suptitle(f"{name}: across regimes {verdict}", x=0.01, ha="left")
    for i, (ax, direction) in enumerate(zip(axes, DIRECTIONS)):
        for j, method in enumerate(methods):
            ratio = chosen(rows, method)[i]["mean_error"] / offline[i]["mean_error"]
            ax.barh(j, ratio, color="0.85", edgecolor="k", hatch=plots.HATCHES[method.regulator])
            if (method.dictionary, method.regulator) not in PAPER:
                continue
            paper = PAPER[method.dictionary, method.regulator][i] / PAPER["rbf", "offline"][i]
            ax.plot(paper, j, "D", color="k", ms=4, mfc="w", label="paper's vehicle" if (i, j) == (0, 0) else None)
        ax.axvline(1, color="k", lw=1)
        ax.set_title(" to ".join(REGIMES[r] for r in direction))
        ax.set_xlabel("error / offline RBF's")
        ax.set_xlim(0, 1.4)
        ax.grid(axis="y", visible=False)
    axes[0].set_yticks(range(len(methods)), [m.label for m in methods])
    axes[0].invert_yaxis()
    axes[0].legend(loc="upper left", bbox_to_anchor=(0, -0.09))
    plots.save(figure, out / f"transfer_{name}.png")


def draw_time(path, name, flight, traces):
    """Error and |P| over time of RBF in one cross-regime transfer."""
    t = np.arange(len(flight.usable)) * flight.dt
    figure, (top, bottom) = plots.subplots(2, 1, figsize=(10, 6), sharex=True)
    largest = {m: np.nanmax(trace["norm_p"]) for m, trace in traces.items() if m.regulator not in ("offline", "ef")}
    figure.suptitle(
        f"{name}: a model of pitch manoeuvres meets yaw manoeuvres; regulated |P| stays below {max(largest.values()):.1g}",
        x=0.01,
        ha="left",
    )
    for method, trace in traces.items():
        error = np.where(flight.usable, trace["error"], np.nan)
        top.semilogy(t, plots.smooth(error, 100), lw=1.2, label=method.label, **plots.STYLES[method.regulator])
        if method.regulator != "offline":
            bottom.semilogy(t, trace["norm_p"], lw=1.2, label=method.label, **plots.STYLES[method.regulator])
    top.set_ylabel("one-step error, RMS over 1 s")
    bottom.set_ylabel(r"$\|P\|_F$")
    bottom.set_xlabel("time of the yaw manoeuvres (s)")
    top.legend(ncols=3)
    _mark(top, flight)
    _mark(bottom, flight)
    plots.save(figure, path)


def _mark(ax, flight):
    """Where one log ends and the next begins."""
    for k in np.flatnonzero(~flight.usable):
        ax.axvline(k * flight.dt, color="0.5", lw=0.8, ls=(0, (2, 2)))


def draw_channels(out, name, flights, traces):
    """Prediction against log, every channel, a second in the middle of the last transfer."""
    direction = ("Y", "P")
    flight, predicted = flights[direction[1]], traces[direction, SHOWN]["predicted"]
    count = round(2 / flight.dt)
    first = len(flight.usable) // 2
    rows = slice(first, first + count)
    t = np.arange(len(flight.usable))[rows] * flight.dt
    figure, axes = plots.subplots(5, 2, figsize=(10, 9), sharex=True)
    figure.suptitle(f"{name}: {SHOWN.label} one step ahead, begun on yaw, flying pitch manoeuvres", x=0.01, ha="left")
    for i, (ax, (channel, unit)) in enumerate(zip(axes.T.ravel(), CHANNELS)):
        ax.plot(t, flight.x[1:][rows, i], color="0.7", lw=3, label="log, low-passed")
        ax.plot(t, predicted[rows, i], color="k", lw=0.9, label="predicted")
        ax.set_ylabel(f"{channel} ({unit})")
    axes[0, 0].legend(ncols=2, loc="lower left", bbox_to_anchor=(0, 1))
    for ax in axes[-1]:
        ax.set_xlabel("time (s)")
    plots.save(figure, out / f"transfer_{name}_channels.png")
