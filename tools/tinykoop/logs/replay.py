"""Replay of a real log through all methods, in both precisions and forms of the covariance.

The first 20 % of the log fits the offline model, the next 20 % calibrates the dead-zone threshold
(paper, remark "Dead-Zone Threshold Selection"), the rest is learned online and scored one step ahead.
"""

from pathlib import Path

import numpy as np

from .. import bridge, dictionaries, platforms
from ..experiments import scenario
from ..plumbing import plots
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, printable, progress, replacing
from . import quadrotor

FIT, CALIBRATE = 0.2, 0.2  # shares of the log
ETA = 0.75
LAMBDA = {"ddr": 0.98, "fwmav": 0.995, "quadrotor": 0.995}  # paper, section "Comparison Protocol"; both vehicles have 100 rows per second
INVERSE_RIDGE = {
    "ddr": scenario.OFFLINE_P0,
    "fwmav": scenario.OFFLINE_P0,
    "quadrotor": 100.0,
}  # of an offline model: one of 2 s of hover must not fit noise
ANGLES = {"ddr": [2], "fwmav": [6, 7, 8]}  # states that wrap
MIN_USABLE = 100

# (form, bits, behind the gate): the reference, then what firmware can choose from
VARIANTS = (("sqrt", 64, False), ("plain", 32, False), ("sqrt", 32, False), ("sqrt", 32, True))

NOTHING = "state stays"
NOMINAL = "unicycle"


def unwrapped(log, platform):
    """The log, its angles without jumps."""
    for column in ANGLES[platform]:
        angle = log.x[:, column]
        known = np.isfinite(angle)
        angle[known] = np.unwrap(angle[known])
    return log


def load(path, platform=None):
    """(log, platform) as learners take it: angles without the jump of a turn through pi, of a quadrotor what quadrotor.learned() makes."""
    platform = platform or platforms.of_log(path)
    log = bridge.read_log(path, platform)
    log = quadrotor.learned(log, path) if platform == "quadrotor" else unwrapped(log, platform)
    if log.usable.sum() < MIN_USABLE:
        raise UserError(f"{path}: {int(log.usable.sum())} usable steps, at least {MIN_USABLE} are needed; check seg and pose_ok")
    return log, platform


def given(log, platform, dictionary):
    """What a --dictionary stands for: the name of one in the library, or one of dictionaries.py."""
    if dictionary not in dictionaries.BUILT_IN:
        return dictionaries.from_file(dictionary)
    return quadrotor.dictionary(dictionary, log.states) if platform == "quadrotor" else f"{dictionary}_{platform}"


def lifting(log, platform, dictionary):
    """What bridge.Estimator takes of a --dictionary, for the states of a log."""
    n = log.x.shape[1]
    if platform == "quadrotor" and dictionary in dictionaries.BUILT_IN:
        return given(log, platform, dictionary).own(n)
    return dictionaries.named(dictionary, platform, n)


def told_states(log):
    """The states of a quadrotor's log, which depend on what it has; of other platforms nothing."""
    return f"; states {', '.join(log.states)}" if getattr(log, "states", ()) else ""


def offline_fit(log, platform, dictionary, precision=64, p0=None, usable=None):
    """Estimator fitted with lambda = 1 over the usable steps; p0 is one over the ridge. dictionary: as --dictionary."""
    p0 = INVERSE_RIDGE[platform] if p0 is None else p0
    lifts = lifting(log, platform, dictionary)
    estimator = bridge.Estimator(lifts, "none", precision, form="sqrt", n_inputs=log.u.shape[1], p0=p0)
    usable = log.usable if usable is None else usable
    dictionaries.check(estimator, log.x, np.append(usable, False) | np.append(False, usable), dictionary)
    estimator.replay(log.x, log.u[:-1], usable=usable, traces=())
    return estimator


def norm(matrix):
    """Frobenius, also where squares leave the range."""
    largest = float(np.abs(matrix).max())
    return largest * float(np.linalg.norm(matrix / largest)) if 0 < largest < np.inf else largest


def baselines(log, platform):
    """{name: one-step error (K,)} of models that learn nothing."""
    rows = {NOTHING: log.x[:-1]}
    if platform == "ddr":
        v, omega, theta = log.u[:-1, 0], log.u[:-1, 1], log.x[:-1, 2]
        rows[NOMINAL] = log.x[:-1] + log.dt * np.stack([v * np.cos(theta), v * np.sin(theta), omega], axis=1)
    return {name: np.linalg.norm(log.x[1:] - predicted, axis=1) for name, predicted in rows.items()}


def run_log(path, out, platform=None, dictionary=None):
    """Writes replay_STEM.json and its plot into `out`; returns the rows.

    dictionary: FILE.py:NAME, replayed with every regulator instead of poly and rbf.
    """
    out = output_folder(out)
    log, platform = load(path, platform)
    K = len(log.usable)
    index = np.arange(K)
    fit = log.usable & (index < FIT * K)
    calibrate = log.usable & (index >= FIT * K) & (index < (FIT + CALIBRATE) * K)
    scored = log.usable & (index >= (FIT + CALIBRATE) * K)
    if min(fit.sum(), calibrate.sum(), scored.sum()) < 10:
        raise UserError(f"{path}: a fifth of the log has fewer than 10 usable steps; it is too short or has too many gaps")

    offline, delta = {}, {}
    methods = scenario.METHODS if dictionary is None else scenario.methods_of(dictionary)
    for name in dict.fromkeys(method.dictionary for method in methods):
        estimator = offline_fit(log, platform, name, usable=fit)
        offline[name] = estimator.theta
        psi = estimator.lift(np.where(np.isfinite(log.x), log.x, 0))
        predicted = np.concatenate([psi[:-1], log.u[:-1]], axis=1) @ estimator.theta.T
        delta[name] = bridge.threshold(np.linalg.norm(psi[1:] - predicted, axis=1)[calibrate], ETA)

    rows, errors = [], {}
    for name, error in baselines(log, platform).items():
        errors[name] = np.where(scored, error, np.nan)
        rows.append({"source": printable(Path(path).stem), "method": name, "mean_error": float(error[scored].mean())})
    online = {method: method.regulator != "offline" for method in methods}
    jobs = [(method, *variant) for method in methods for variant in VARIANTS if online[method] or not variant[-1]]
    for method, form, precision, gate in progress(jobs, Path(path).stem):
        estimator = bridge.Estimator(
            lifting(log, platform, method.dictionary), method.regulator if online[method] else "none", precision, form=form,
            n_inputs=log.u.shape[1], lam=LAMBDA[platform], delta=delta[method.dictionary], gate=gate,
        )  # fmt: skip
        estimator.theta = offline[method.dictionary]
        trace = estimator.replay(log.x, log.u[:-1], usable=scored, learn=online[method], traces=("error", *bridge.FLAGS))
        errors[method, form, precision, gate] = trace["error"]
        gates = method.regulator in bridge.dead_zones()
        rows.append(
            {
                "source": printable(Path(path).stem),
                "method": method.label,
                "dictionary": method.dictionary,
                "regulator": method.regulator,
                "precision": f"f{precision}",
                "form": form,
                "gate": gate,
                "steps": int(scored.sum()),
                "mean_error": float(np.nanmean(trace["error"])),
                "final_P_fro": norm(estimator.covariance) if online[method] else None,
                "skip_rate": float(trace["frozen"][scored].mean()) if gates else None,
                "delta": delta[method.dictionary] if gates else None,
                "lost_positive_definite_at": scenario.first(trace["positive_definite"] == 0) if online[method] else None,
                "refused": int((trace["status"] < 0).sum()),
                "trust": {name: float((trace["trust"][scored] == i).mean()) for i, name in enumerate(bridge.TRUST)} if gate else None,
            }
        )
    with replacing(out / f"replay_{Path(path).stem}.json", rows):
        draw(out / f"replay_{Path(path).stem}.png", rows, errors, log, scored)
    report(rows, log, scored)
    return rows


def by_method(rows):
    """[(name, {(form, bits, gate): row})] in the order of the rows; a baseline has the key None."""
    table = {}
    for row in rows:
        key = (row["form"], int(row["precision"][1:]), row["gate"]) if "form" in row else None
        table.setdefault(row["method"], {})[key] = row
    return list(table.items())


DIVERGED = 1.1  # float32 is said to diverge when its error is above that of float64 by more than this


def report(rows, log, scored):
    """Error of the reference, and what float32 makes of it in either form."""
    lines = []
    for name, variants in by_method(rows):
        reference = variants.get(VARIANTS[0]) or variants[None]
        plain, root, gated = (variants.get(key, {}) for key in VARIANTS[1:])
        ratios = [f"{v['mean_error'] / reference['mean_error']:.4g}" if v else "" for v in (plain, root, gated)]
        skip = reference.get("skip_rate")
        lines.append(
            [
                name,
                number(reference["mean_error"]),
                *ratios,
                number(plain.get("lost_positive_definite_at")) if plain else "",
                " / ".join(str(v["refused"]) for v in (plain, root, gated) if v),
                f"{100 * skip:.1f}" if skip is not None else "",
                number(reference.get("final_P_fro")) if plain else "",
                " / ".join(f"{100 * gated['trust'][name]:.1f}" for name in bridge.TRUST[1:]) if gated else "",
            ]
        )
    print_table(
        f"Replay of {rows[0]['source']}: {len(log.t):,} rows at {1 / log.dt:.0f} Hz, {int(scored.sum()):,} steps scored",
        ["method", "error", "f32 plain", "f32 sqrt", "gate", "P lost", "refused", "frozen", "final |P|", "doubt, refuse"],
        lines,
        "error: in float64. f32 plain, f32 sqrt, gate: theirs over it. P lost: row at which the plain form is not positive"
        " definite. refused: samples, plain / sqrt / gate. In % of samples: frozen, P unchanged; doubt, refuse, by gate_trust().",
    )


def _method(row):
    return scenario.Method(row["dictionary"], row["regulator"]) if "regulator" in row else None


def _hatch(row):
    """Of a bar: that of its regulator; none where nothing is learned."""
    return plots.HATCHES[row["regulator"]] if row.get("regulator") else ""


def draw(path, rows, errors, log, scored):
    """Error over time of a few, mean error of all in float64 and float32."""
    table = by_method(rows)
    pairs = [(v[VARIANTS[0]], v[VARIANTS[1]]) for _, v in table if VARIANTS[0] in v]
    diverged = sum(not plain["mean_error"] <= DIVERGED * reference["mean_error"] for reference, plain in pairs)
    best = min((reference for reference, _ in pairs), key=lambda r: r["mean_error"])
    figure, (left, right) = plots.subplots(1, 2, figsize=(11, 1.8 + 0.22 * len(table)), width_ratios=[3, 2])
    figure.suptitle(
        f"{rows[0]['source']}: {best['method']} predicts best; plain float32 diverges in {diverged} of {len(pairs)} methods",
        x=0.01, ha="left",
    )  # fmt: skip
    t = log.t[:-1][scored]
    drawn = [m for m in map(_method, rows) if m and m.dictionary != "poly"]
    for method in dict.fromkeys(m for m in drawn if m.regulator in ("offline", "ef", "dz_cs", "sift")):
        error = errors[method, *VARIANTS[0]][scored]
        left.semilogy(t, plots.smooth(error, 200), lw=1.2, label=method.label, **plots.STYLES[method.regulator])
    reference = NOMINAL if NOMINAL in errors else NOTHING
    left.semilogy(t, plots.smooth(errors[reference][scored], 200), color="k", lw=0.8, label=reference)
    left.set_xlabel("time (s)")
    left.set_ylabel("one-step error, RMS over 200 samples (state units)")
    left.legend(ncols=2)
    limit = 20 * max(v.get(None, v.get(VARIANTS[0]))["mean_error"] for _, v in table)
    for i, (_, variants) in enumerate(table):
        row = variants.get(None) or variants[VARIANTS[0]]
        right.barh(i, row["mean_error"], color="0.85", edgecolor="k", hatch=_hatch(row))
        for key, marker in zip(VARIANTS[1:3], ("x", "o")):
            if key in variants:
                value = min(variants[key]["mean_error"], limit)
                right.plot(value, i, marker, color="#d62728" if marker == "x" else "k", ms=6, mfc="none", mew=1.5)
    right.plot([], [], "x", color="#d62728", mew=1.5, label="float32, plain (at the right edge: beyond)")
    right.plot([], [], "o", color="k", mfc="none", mew=1.5, label="float32, square root")
    right.set_yticks(range(len(table)), [name for name, _ in table])
    right.invert_yaxis()
    right.set_xscale("log")
    right.set_xlabel("mean one-step error (state units), bars: float64")
    right.grid(axis="y", visible=False)
    right.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14))
    plots.save(figure, path)
