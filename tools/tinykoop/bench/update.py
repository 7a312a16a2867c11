"""One full update, side by side: TinyKoop, Eigen, NumPy and padasip; and the replay of a whole log.

The native programs of tools/bench time TinyKoop and Eigen in turns within one
process; the Python peers take their turn between the programs' runs. Times are
medians, ratios are medians of the ratios of neighbouring measurements, so that
whatever else the machine does meets both sides.
"""

import platform
import statistics
import time
from importlib.metadata import version

import numpy as np

from .. import bridge
from ..experiments import scenario, transfer
from ..logs import replay
from ..plumbing import plots, results
from ..plumbing.errors import UserError
from . import native

ROUNDS = 10  # every contender has a turn in each
REPEATS = 20  # measurements of a native program per round
CALLS = 500  # calls per native measurement
PYTHON_REPEATS = 3  # measurements of a Python peer per round
PYTHON_UPDATES = 192  # updates per Python measurement

# program, and what its rows are called
PROGRAMS = {"bench_O3": "", "bench_O2": "_O2", "bench_O3_contract": "_contract"}
PRECISIONS = ("f32", "f64")

FLIGHT_SECONDS = 300  # of the log that is replayed: as long as the simulated battery lasts
REPLAY_REPEATS = 7
REPLAY_DICTIONARIES = ("poly_fwmav", "rbf_fwmav", "wide_fwmav")  # N = 20, 30, 40
REPLAY_REGULATORS = bridge.regulator_names()
REPLAY_FORMS = {"plain": "", "sqrt": "_sqrt"}  # and what their rows are called
NUMPY_ROWS = 500  # of that log: soon after, the textbook's P is lost in float32


def run(out_dir, build_dir, rounds=ROUNDS):
    """Measures everything; writes bench_rls.png; returns rows of bench.json, all times in ns per call or sample."""
    programs = {name: native.program(build_dir, name) for name in PROGRAMS}
    data = {name: native.read(path, "data") for name, path in programs.items()}
    facts = {name: lines[-1] for name, lines in data.items()}
    samples = [line for line in data["bench_O2"] if line["kind"] == "sample"]
    peers = _python_peers(samples, facts["bench_O2"])
    times = _measure(programs, peers, rounds)
    versions = {
        "Eigen": facts["bench_O2"]["eigen"],
        "NumPy": version("numpy"),
        "padasip": version("padasip"),
        "libm": " ".join(platform.libc_ver()).strip() or platform.system(),
    }
    rows = rows_of(times, facts, versions)
    plot(rows, out_dir / "bench_rls.png")
    show(rows)
    replays = replay_rows(*flight(), f"{facts['bench_O2']['compiler']} {facts['bench_O2']['flags']}, ours -ffp-contract=off")
    show_replays(replays)
    return rows + replays


class NumpyRls:
    """The update as one writes it in NumPy, with every array allocated once."""

    def __init__(self, dtype, n_lifted, n_regressors, forgetting, p0):
        self.theta = np.zeros((n_lifted, n_regressors), dtype)
        self.covariance = (p0 * np.eye(n_regressors)).astype(dtype)
        self.forgetting = dtype(forgetting)
        self.growth = dtype(1 / forgetting)
        self.step = np.empty_like(self.covariance)
        self.change = np.empty_like(self.theta)

    def update(self, zeta, psi_next):
        error = psi_next - self.theta @ zeta
        g = self.covariance @ zeta
        gain = g / (self.forgetting + zeta @ g)
        self.theta += np.multiply(error[:, None], gain, out=self.change)
        self.covariance -= np.multiply(gain[:, None], g, out=self.step)
        self.covariance *= self.growth


def _python_peers(samples, learned):
    """{(peer, precision): function returning ns per update}, each checked to
    learn what TinyKoop does."""
    try:
        import padasip
    except ImportError:
        raise UserError("bench compares with padasip, which is missing: pip install padasip") from None
    zeta = np.array([sample["psi"] + sample["u"] for sample in samples])
    psi_next = np.array([sample["psi_next"] for sample in samples])
    n_lifted, n_regressors = psi_next.shape[1], zeta.shape[1]
    theta = np.array(learned["theta"]).reshape(n_lifted, n_regressors)
    forgetting, p0 = learned["lambda"], learned["p0"]

    def check(name, difference, allowed):
        if not difference <= allowed:
            raise UserError(f"{name} learns something else than TinyKoop: Theta differs by {difference:.3g}")

    def numpy_peer(dtype, allowed):
        inputs, outputs = zeta.astype(dtype), psi_next.astype(dtype)

        def learn(count):
            rls = NumpyRls(dtype, n_lifted, n_regressors, forgetting, p0)
            start = time.perf_counter_ns()
            for k in range(count):
                rls.update(inputs[k % len(inputs)], outputs[k % len(outputs)])
            return (time.perf_counter_ns() - start) / count, rls.theta

        check("NumPy", abs(learn(learned["updates"])[1] - theta).max(), allowed)
        return lambda: learn(PYTHON_UPDATES)[0]

    def padasip_peer(allowed):
        def learn(count):
            rls = padasip.filters.FilterRLS(n=n_regressors, mu=forgetting, eps=1 / p0, w="zeros")
            start = time.perf_counter_ns()
            for k in range(count):
                rls.adapt(psi_next[k % len(zeta), 0], zeta[k % len(zeta)])
            return (time.perf_counter_ns() - start) / count, rls.w

        check("padasip", abs(learn(learned["updates"])[1] - theta[0]).max(), allowed)
        return lambda: learn(PYTHON_UPDATES)[0]

    return {
        ("NumPy", "f32"): numpy_peer(np.float32, 1e-4),
        ("NumPy", "f64"): numpy_peer(np.float64, 1e-10),
        ("padasip", "f64"): padasip_peer(1e-10),
    }


def _measure(programs, peers, rounds):
    """{(program, task, precision, who): [ns per call, ..]}, one list element per
    repeat; lists of one program are aligned. Python peers: one element per
    round, under the program name "python"."""
    times = {}
    for _ in range(rounds):
        for program, path in programs.items():
            for line in native.read(path, "run", REPEATS, CALLS):
                if line["kind"] == "time":
                    key = (program, line["task"], line["precision"], line["who"])
                    times.setdefault(key, []).append(line["ns"])
        for (peer, precision), measure in peers.items():
            value = statistics.median(measure() for _ in range(PYTHON_REPEATS))
            times.setdefault(("python", "rls_update", precision, peer), []).append(value)
    return times


def fastest(times, program, precision):
    """The name of the Eigen form with the least median time."""
    forms = [key[3] for key in times if key[0] == program and key[2] == precision and key[3].startswith("Eigen")]
    return min(forms, key=lambda who: statistics.median(times[program, "rls_update", precision, who]))


def compare(task, ours, peer, peer_name, peer_version, flags):
    """One row of bench.json from two aligned lists of ns per call."""
    return {
        "task": task,
        "unit": "ns",
        "ours": round(statistics.median(ours), 2),
        "peer": round(statistics.median(peer), 2),
        "peer_name": peer_name,
        "peer_version": peer_version,
        "ratio": round(statistics.median(b / a for a, b in zip(ours, peer)), 3),
        "flags": flags,
    }


def rows_of(times, facts, versions):
    """All rows of bench.json. facts: per program its compiler and flags."""
    rows = []
    for program, suffix in PROGRAMS.items():
        flags = f"{facts[program]['compiler']} {facts[program]['flags']}"
        both_flags = f"{flags}, ours -ffp-contract={'fast' if suffix == '_contract' else 'off'}"
        for precision in PRECISIONS:
            form = fastest(times, program, precision)
            eigen = times[program, "rls_update", precision, form]
            variants = [("", "")]
            if suffix != "_contract":
                variants += [("_health", ", without it"), ("_checked", ", without it"), ("_sqrt", ", plain P")]
            for variant, note in variants:
                ours = times[program, "rls_update" + variant, precision, "tinykoop"]
                name = f"{form}{note}"
                task = f"rls_update_{precision}{suffix}{variant}"
                rows.append(compare(task, ours, eigen, name, versions["Eigen"], both_flags))
            for task in ("lift_rbf_ddr", "lift_poly_ddr") if suffix != "_contract" else ():
                ours = times[program, task, precision, "tinykoop"]
                libm = times[program, task, precision, "libm"]
                name = "libm, unchecked"
                rows.append(compare(f"{task}_{precision}{suffix}", ours, libm, name, versions["libm"], both_flags))
    flags = f"{facts['bench_O2']['compiler']} {facts['bench_O2']['flags']}, ours -ffp-contract=off"
    notes = {"NumPy": "", "padasip": " FilterRLS, 1 of 22 outputs"}
    for (program, _, precision, peer), values in times.items():
        if program == "python":
            ours = by_round(times["bench_O2", "rls_update", precision, "tinykoop"], len(values))
            task = f"rls_update_{precision}_{peer.lower()}"
            rows.append(compare(task, ours, values, peer + notes[peer], versions[peer], flags))
    return rows


def by_round(values, rounds):
    """Medians of `rounds` equal parts of a list."""
    size = len(values) // rounds
    return [statistics.median(values[k * size : (k + 1) * size]) for k in range(rounds)]


def show(rows):
    """The table on the terminal."""
    results.print_table(
        "One call, ns",
        ["task", "TinyKoop", "peer", "ratio", "peer's name", "version"],
        [[r["task"], f"{r['ours']:.0f}", f"{r['peer']:.0f}", f"{r['ratio']:.2f}", r["peer_name"], r["peer_version"]] for r in rows],
        "ratio = peer / TinyKoop, median over repeats: above 1, TinyKoop is faster. No peer checks anything. "
        "health: with the health report; checked: P factored at every update; sqrt: square-root form; "
        "contract: TinyKoop compiled with -ffp-contract=fast.",
    )


def plot(rows, path):
    """Bars of ns per update, log axis; who is who by hatch, not by colour."""
    row = {r["task"]: r for r in rows}
    contenders = [
        ("TinyKoop", "", lambda p, s: row[f"rls_update_{p}{s}"]["ours"]),
        ("Eigen", "///", lambda p, s: row[f"rls_update_{p}{s}"]["peer"]),
        ("TinyKoop, square root", "...", lambda p, s: row[f"rls_update_{p}{s}_sqrt"]["ours"]),
        ("TinyKoop, P factored", "xx", lambda p, s: row[f"rls_update_{p}{s}_checked"]["ours"]),
        ("NumPy", "\\\\\\", lambda p, s: row[f"rls_update_{p}_numpy"]["peer"]),
        ("padasip, 1 of 22 outputs", "oo", lambda p, s: row[f"rls_update_{p}_padasip"]["peer"]),
    ]
    groups = [("f32", "_O2"), ("f32", ""), ("f64", "_O2"), ("f64", "")]
    names = {"_O2": "-O2", "": "-O3 native"}
    width = 0.8 / len(contenders)
    figure, axes = plots.subplots(figsize=(10, 4.8))
    for k, (label, hatch, value) in enumerate(contenders):
        places, heights = [], []
        for g, (precision, suffix) in enumerate(groups):
            if "padasip" in label and precision == "f32":
                continue
            places.append(g + (k - (len(contenders) - 1) / 2) * width)
            heights.append(value(precision, suffix))
        shade = "0.35" if label == "TinyKoop" else "0.9"
        bars = axes.bar(places, heights, width, label=label, color=shade, hatch=hatch, edgecolor="black")
        axes.bar_label(bars, [f"{h:.0f}" for h in heights], fontsize=7)
    ratios = [row[f"rls_update_{p}{s}"]["ratio"] for p, s in groups]
    axes.set_yscale("log")
    axes.margins(y=0.25)
    axes.set_ylabel("ns per update (log scale)")
    axes.set_xticks(range(len(groups)), [f"{p}, {names[s]}" for p, s in groups])
    axes.set_title(f"One update of N = 22, m = 2: TinyKoop is {min(ratios):.2f} to {max(ratios):.2f} times as fast as Eigen")
    axes.legend(ncols=3, fontsize=8, frameon=False)
    plots.save(figure, path)


# ---- the whole replay ------------------------------------------------------------------------


def flight():
    """States (K+1, 10) and commands (K, 1) of one long simulated flight, low-passed as in `make transfer`."""
    log, _ = bridge.fwmav("pitch", FLIGHT_SECONDS, 1)
    x, u = transfer.filtered(replay.unwrapped(log, "fwmav"))
    return x, u[:-1]


def _estimator(dictionary, regulator, form, precision=32):
    return bridge.Estimator(
        dictionary,
        regulator,
        precision,
        form=form,
        n_inputs=1,
        lam=replay.LAMBDA["fwmav"],
        delta=transfer.DELTA,
        check=bridge.CHECK_DIAGONAL,
    )


def _numpy_replay(dictionary, x, u):
    """Function returning ns of the process per sample of NumPy's vanilla update in float32, of rows that come lifted.

    Checked to learn what TinyKoop does, in float64.
    """
    x, u = x[: NUMPY_ROWS + 1], u[:NUMPY_ROWS]

    def learn(precision):
        ours = _estimator(dictionary, "ef", "sqrt", precision)
        psi = ours.lift(x).astype(ours.dtype)
        zeta = np.concatenate([psi[:-1], u], axis=1, dtype=ours.dtype, casting="same_kind")
        rls = NumpyRls(ours.dtype, ours.N, ours.d, replay.LAMBDA["fwmav"], 100.0)
        start = time.process_time_ns()
        for k in range(len(u)):
            rls.update(zeta[k], psi[k + 1])
        spent = (time.process_time_ns() - start) / len(u)
        ours.replay(x, u, traces=())
        return spent, abs(rls.theta - ours.theta).max() / abs(ours.theta).max()

    difference = learn(64)[1]
    if not difference <= 1e-8:
        raise UserError(f"NumPy learns something else than TinyKoop from {dictionary}: Theta differs by {difference:.3g} of its largest")
    return lambda: learn(32)[0]


def replay_rows(x, u, flags, repeats=REPLAY_REPEATS):
    """Rows of bench.json: ns of the process per sample from lift to update, float32, and samples per second.

    refused and gated are shares of the samples: either costs less than a sample that is learned from. NumPy is the
    peer of vanilla in the square-root form, which refuses nothing.
    """
    jobs = [(d, r, f) for d in REPLAY_DICTIONARIES for r in REPLAY_REGULATORS for f in REPLAY_FORMS]
    numpy_of = {dictionary: _numpy_replay(dictionary, x, u) for dictionary in REPLAY_DICTIONARIES}
    times, peers = {job: [] for job in jobs}, {dictionary: [] for dictionary in REPLAY_DICTIONARIES}
    for _ in range(repeats):
        for job in jobs:
            estimator = _estimator(*job)
            start = time.process_time_ns()
            estimator.replay(x, u, traces=("error",))
            times[job].append((time.process_time_ns() - start) / len(u))
        for dictionary, measure in numpy_of.items():
            peers[dictionary].append(measure())
    rows = []
    for (dictionary, regulator, form), ours in times.items():
        estimator = _estimator(dictionary, regulator, form)
        seen = estimator.replay(x, u, traces=("status", "frozen"))
        task = f"replay_f32_N{estimator.N}_{regulator}{REPLAY_FORMS[form]}"
        if (regulator, form) == ("ef", "sqrt"):
            row = compare(task, ours, peers[dictionary], "NumPy, update only", version("numpy"), flags)
        else:
            row = {"task": task, "unit": "ns", "ours": round(statistics.median(ours), 2)}
            row |= {"peer": None, "peer_name": None, "peer_version": None, "ratio": None, "flags": flags}
        row["samples_per_second"] = round(1e9 / row["ours"])
        row |= {"refused": float((seen["status"] < 0).mean()), "frozen": float(seen["frozen"].mean())}
        rows.append(row)
    return rows


def show_replays(rows):
    """Samples per second on the terminal, one line a regulator."""
    row = {r["task"]: r for r in rows}
    sizes = sorted({int(r["task"].split("_")[2][1:]) for r in rows})
    columns = [(N, form) for N in sizes for form in REPLAY_FORMS]

    def cell(N, regulator, form):
        r = row[f"replay_f32_N{N}_{regulator}{REPLAY_FORMS[form]}"]
        lost = f" ({100 * r['refused']:.0f})" if r["refused"] >= 0.005 else ""
        return f"{r['samples_per_second'] / 1e6:.2f}{lost}"

    lines = [[scenario.LABELS[g], *(cell(N, g, form) for N, form in columns)] for g in REPLAY_REGULATORS]
    ratios = ", ".join(f"{row[f'replay_f32_N{N}_ef_sqrt']['ratio']:.1f} (N = {N})" for N in sizes)
    gated = [100 * r["frozen"] for r in rows if "_dz_" in r["task"] and r["task"].endswith("_sqrt")]
    results.print_table(
        "Replay of a log from lift to update, float32, one core: million samples per second",
        ["regulator", *(f"N = {N}, {form}" for N, form in columns)],
        lines,
        "In brackets: percent of the samples that were refused, which costs less than learning from them.\n"
        f"So does what dead zones gate: {min(gated):.0f} to {max(gated):.0f} % of the samples, in the square-root form.\n"
        f"Vanilla, square root, against NumPy's update alone: {ratios} times as fast.",
    )
