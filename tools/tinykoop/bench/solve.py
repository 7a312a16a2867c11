"""One solve of the controller's quadratic program, side by side with its peers.

Everyone solves the same steps, recorded in closed loop: TinyKoop from Theta, psi and the reference, so that
its time includes condensing, the peers from H and f, so that theirs does not. H is new at every step, so
set-up is part of everyone's time. Cold: from nothing. Warm: from the solution of the step before, one step on.

Each solver gets, for each accuracy, the loosest tolerance with which u is within it on every step, and of
its variants the fastest. Every timed call follows an untimed one on the step before, on both sides. Blocks
of steps go from contender to contender, so that whatever else the machine does meets them all.
"""

import gc
import itertools
import math
import statistics
import tempfile
import time
import warnings
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..experiments import control, scenario
from ..plumbing import plots, results
from . import native, qp, qp_peers

METHODS = [scenario.Method("rbf", name) for name in ("offline", "dz_cs", "dz_ks", "ct", "sift")]
POLY = [scenario.Method("poly", name) for name in ("ct", "sift")]
PROGRAMS = {"": "qp_O2", "_O3": "qp_O3"}  # suffix of the task, program
MODES = ("cold", "warm")
KINDS = {"recovery": "", "tracking": ", tracking"}  # kind of step, what its tasks are called; the first is the main one
ACCURACIES = ("1e-3", "1e-4", "1e-6")
COARSE = "1e-2"  # for float32 only
CLAIMS = {"cold": 0.35, "warm": 0.25}  # of the fastest peer's time, float64, 1e-6

ROUNDS = 3
FEW = 300  # instances of each kind, which show that everything runs
BLOCK = 30  # steps
SLOW = 10  # our gradient method gets each tenth step; the slow peers say themselves

# Ours: precision and method, and tolerances of the KKT residual, loosest first; 0 is the library's own
NEWTON, GRADIENT = "newton", "gradient"
TOLERANCES = {
    ("f64", NEWTON): ("1e-2", "1e-3", "1e-4", "1e-5", "1e-6", "1e-7", "1e-8", "0"),
    ("f32", NEWTON): ("1e-2", "1e-3", "1e-4", "0"),
    ("f64", GRADIENT): ("1e-4", "1e-5", "1e-6", "1e-7", "1e-8"),
    ("f32", GRADIENT): ("1e-3", "1e-4", "0"),
}


def run(out_dir, build_dir, rounds=ROUNDS, most=None):
    """Measures `most` instances of each kind, or all; writes the plots; returns rows of bench.json, all times in us per solve."""
    programs = {suffix: native.program(build_dir, name) for suffix, name in PROGRAMS.items()}
    with tempfile.TemporaryDirectory() as folder, _undisturbed():
        main = Comparison(recorded(METHODS, most), qp_peers.PEERS, TOLERANCES, programs, Path(folder) / "rbf")
        poly = Comparison(
            recorded(POLY, most), (qp_peers.Daqp, qp_peers.Proxqp), {("f64", NEWTON): TOLERANCES["f64", NEWTON]}, programs,
            Path(folder) / "poly",
        )  # fmt: skip
        for comparison in (main, poly):
            comparison.choose()
        for _ in results.progress(range(rounds), "bench: solve"):
            for comparison in (main, poly):
                comparison.measure()
    facts = {suffix: native.read(path, "facts")[0] for suffix, path in programs.items()}
    rows = rows_of(main, poly, facts)
    show(main)
    plot_times(main, out_dir / "bench_qp.png")
    plot_accuracy(main, out_dir / "bench_qp_accuracy.png")
    return rows


@contextmanager
def _undisturbed():
    """No garbage collection between the timed calls, no warnings of peers that stop short: their error tells."""
    gc.disable()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        gc.enable()


def recorded(methods, most=None):
    """Instances of all methods, or `most` of each kind, shuffled so that any few of them are a fair sample."""
    found = [i for method in results.progress(methods, "bench: record") for i in qp.instances(method)]
    shuffled = [found[k] for k in np.random.default_rng(0).permutation(len(found))]
    kept = {id(i) for kind in KINDS for i in [i for i in shuffled if i.kind == kind][:most]}
    return [i for i in shuffled if id(i) in kept]


def write_file(path, instances):
    """The steps as tools/bench/qp.c reads them."""
    mpc = control.MPC
    header = [len(instances[0].step.psi), mpc.horizon, len(instances), *mpc.q, *mpc.r, *mpc.u_min, *mpc.u_max]
    steps = [a.ravel() for i in instances for s in (i.step_before, i.step) for a in (s.theta, s.psi, s.reference)]
    np.concatenate([header, *steps]).tofile(path)


class Comparison:
    """Instances, contenders, the settings that they need, and their times.

    A contender is a Peer, or (precision, method, suffix of the program). Its setting is (variant, tolerance).
    """

    def __init__(self, instances, peers, ours, programs, path):
        self.instances, self.ours, self.programs = instances, ours, programs
        self.peers = qp_peers.open_all(instances[0].problem, peers)
        self.members = {kind: [k for k, i in enumerate(instances) if i.kind == kind] for kind in KINDS}
        self.descriptions = {kind: self._describe(kind) for kind in KINDS}
        self.files = {1: path.with_suffix(".all"), SLOW: path.with_suffix(".few")}
        for every, file in self.files.items():
            write_file(file, instances[::every])
        self.tried = {}  # (peer, mode, setting) -> {k: (us, u error)}
        self.errors = {}  # (precision, method, mode, tolerance) -> {k: u error}
        self.chosen = {}  # (contender, mode, kind, accuracy) -> (setting, largest u error), or (None, least)
        self.times = {}  # (contender, mode, setting) -> {(round, k): us}
        self.timers = {}  # the same by the solver's own timer
        self.rounds = 0

    # ---- settings --------------------------------------------------------------------------------

    def choose(self):
        """Finds for every contender, mode, kind and accuracy what setting it needs."""
        for (precision, method), tolerances in self.ours.items():
            self._plans(precision, method, tolerances)
        contenders = [(precision, method) for precision, method in self.ours] + self.peers
        for contender in results.progress(contenders, "bench: settings"):
            for mode in MODES:
                for kind in KINDS:
                    for accuracy in (COARSE, *ACCURACIES):
                        choice = self._choose(contender, mode, kind, accuracy)
                        if choice:
                            self.chosen[contender, mode, kind, accuracy] = choice

    def _plans(self, precision, method, tolerances):
        every = SLOW if method == GRADIENT else 1
        settings = [f"{precision},{method},{tolerance}" for tolerance in tolerances]
        for line in native.read(self.programs[""], "plans", self.files[every], *settings):
            k = every * line["instance"]
            for mode in MODES:
                error = np.max(np.abs(line[mode]["plan"] - self.instances[k].problem.u))
                key = (precision, method, mode, line["setting"].split(",")[2])
                self.errors.setdefault(key, {})[k] = error

    def _choose(self, contender, mode, kind, accuracy):
        """(setting, its largest u error); (None, the least of the largest u errors) where none will do."""
        if isinstance(contender, tuple):
            variants = {contender[1]: self.ours[contender]}
        else:
            variants = contender.variants if mode == "cold" else contender.warm_variants
        fit, least = [], math.inf
        for variant, tolerances in (variants or {}).items():
            for tolerance in tolerances:
                error = self._largest_error(contender, mode, (variant, tolerance), kind, float(accuracy))
                least = min(least, error)
                if error <= float(accuracy):
                    fit.append(((variant, tolerance), error))
                    break
        if len(fit) > 1:
            fit.sort(key=lambda choice: statistics.median(us for us, _ in self.tried[contender, mode, choice[0]].values()))
        return fit[0] if fit else (None, least) if variants else None

    def _largest_error(self, contender, mode, setting, kind, enough):
        """Of all steps; only a lower bound for it if that is above `enough`."""
        if isinstance(contender, tuple):
            errors = self.errors[(*contender, mode, setting[1])]
            return max(errors[k] for k in self.members[kind] if k in errors)
        tried = self.tried.setdefault((contender, mode, setting), {})
        members = [k for k in self.members[kind] if k % contender.every == 0]
        worst = max((tried[k][1] for k in members if k in tried), default=0)
        for k in members:
            if worst > enough:
                break
            if k not in tried:
                us, _, error = self._call(contender, mode, setting, k)
                tried[k] = us, error
                worst = max(worst, error)
        return worst

    def _call(self, peer, mode, setting, k):
        """(us, us by its own timer, u error) of one solve that follows one of the step before."""
        instance = self.instances[k]
        peer.prepare(*setting, instance, instance.before, None if mode == "cold" else _start(instance.before, 0))
        peer.solve()
        peer.prepare(*setting, instance, instance.problem, None if mode == "cold" else _start(instance.before, 1))
        start = time.perf_counter_ns()
        peer.solve()
        us = (time.perf_counter_ns() - start) / 1e3
        u, own = peer.read()
        error = np.max(np.abs(u - instance.problem.u))
        return us, own, error if np.isfinite(error) else math.inf

    # ---- times -----------------------------------------------------------------------------------

    def settings(self, contender, mode):
        """Those that were chosen for some kind and accuracy."""
        found = {choice[0] for key, choice in self.chosen.items() if key[:2] == (contender, mode) and choice[0]}
        return sorted(found, key=str)

    def measure(self):
        """One round."""
        fast = [f"{p},{m},{t}" for (p, m), ts in self.ours.items() if m == NEWTON for t in ts if self._used((p, m), t)]
        slow = [f"{p},{m},{t}" for (p, m), ts in self.ours.items() if m == GRADIENT for t in ts if self._used((p, m), t)]
        for first in range(0, len(self.instances), BLOCK):
            block = range(first, min(first + BLOCK, len(self.instances)))
            self._native("", 1, block, fast)
            for peer in self.peers:
                self._peer(peer, block)
            self._native("_O3", 1, block, fast)
        if slow:
            self._native("", SLOW, range(len(self.instances[::SLOW])), slow)
        self.rounds += 1

    def _used(self, contender, tolerance):
        return any((contender[1], tolerance) in self.settings(contender, mode) for mode in MODES)

    def _native(self, suffix, every, block, settings):
        for line in native.read(self.programs[suffix], "run", self.files[every], block.start, len(block), 1, *settings):
            precision, method, tolerance = line["setting"].split(",")
            for mode in MODES:
                key = ((precision, method, suffix), mode, (method, tolerance))
                self.times.setdefault(key, {})[self.rounds, every * line["instance"]] = line[mode]["us"]

    def _peer(self, peer, block):
        for mode in MODES:
            for setting in self.settings(peer, mode):
                key = (peer, mode, setting)
                for k in block:
                    if k % peer.every == 0:
                        us, own, _ = self._call(peer, mode, setting, k)
                        self.times.setdefault(key, {})[self.rounds, k] = us
                        if own is not None:
                            self.timers.setdefault(key, {})[self.rounds, k] = own

    # ---- results ---------------------------------------------------------------------------------

    def found(self, contender, mode, kind="recovery", accuracy="1e-6", timer=False):
        """({(round, k): us}, setting, largest u error), or None where the contender is not within the accuracy."""
        who = contender[:2] if isinstance(contender, tuple) else contender
        if not isinstance(contender, tuple) and contender.warm_variants is None:
            mode = "cold"
        setting, error = self.chosen[who, mode, kind, accuracy]
        times = (self.timers if timer else self.times).get((contender, mode, setting))
        if not times:
            return None
        members = set(self.members[kind])
        return {at: us for at, us in times.items() if at[1] in members}, setting, error

    def typical(self, contender, mode, kind="recovery", accuracy="1e-6"):
        """Median us, or None."""
        found = self.found(contender, mode, kind, accuracy)
        return statistics.median(found[0].values()) if found else None

    def row(self, task, ours, peer, mode, kind, accuracy, flags, timer=False):
        """One row of bench.json, or None where either side has no figure."""
        a, b = self.found(ours, mode, kind, accuracy), self.found(peer, mode, kind, accuracy, timer)
        if not a or not b:
            return None
        shared = sorted(a[0].keys() & b[0].keys())
        return {
            "task": task,
            "unit": "us",
            "ours": round(statistics.median(a[0][at] for at in shared), 2),
            "peer": round(statistics.median(b[0][at] for at in shared), 2),
            "peer_name": _name(peer, b[1], mode),
            "peer_version": peer.version,
            "ratio": round(statistics.median(b[0][at] / a[0][at] for at in shared), 3),
            "flags": flags,
            "our_setting": " ".join((*ours[:2], f"tolerance {a[1][1]}")),
            "u_error": {"ours": a[2], "peer": b[2]},
            "steps": len({k for _, k in shared}),
            "of": self.descriptions[kind],
        }

    def _describe(self, kind):
        problems = [self.instances[k].problem for k in self.members[kind]]
        active = [np.count_nonzero(p.multipliers) for p in problems]
        condition = [np.linalg.cond(p.H) for p in problems]
        return (
            f"{len(problems)} steps of {kind}: {min(active)} to {max(active)} of {len(problems[0].f)} bounds active (mean "
            f"{np.mean(active):.0f}), cond(H) {results.number(min(condition), 2)} to {results.number(max(condition), 2)}"
        )


def _start(before, steps):
    """What a warm start begins from: the solution of the step before, moved on."""
    return (qp.shift(before.u), qp.shift(before.multipliers)) if steps else (before.u, before.multipliers)


def _name(peer, setting, mode):
    parts = [peer.label, setting[0], f"tolerance {setting[1]:g}" if setting[1] else ""]
    parts.append("no warm start" if mode == "warm" and peer.warm_variants is None else "")
    return ", ".join(part for part in parts if part)


def rows_of(main, poly, facts):
    """All rows of bench.json. Tasks without suffix are ours at -O2, with condensing."""
    flags = {suffix: f"{f['compiler']} {f['flags']} -ffp-contract=off, ours condensing included" for suffix, f in facts.items()}
    rows = []

    def add(comparison, task, precision, method, suffix, mode, kind, accuracy, peers, **more):
        ours = (precision, method, suffix)
        rows.extend(comparison.row(task, ours, p, mode, kind, accuracy, flags[suffix], **more) for p in peers)

    for mode in MODES:
        for kind, suffix in itertools.product(KINDS, PROGRAMS):
            for accuracy, precision in [(a, p) for a in ACCURACIES for p in ("f64", "f32")] + [(COARSE, "f32")]:
                task = f"qp_{mode}_{accuracy}_{precision}{suffix}{KINDS[kind]}"
                add(main, task, precision, NEWTON, suffix, mode, kind, accuracy, main.peers)
                if not suffix:
                    add(main, f"{task}, gradient", precision, GRADIENT, "", mode, kind, accuracy, main.peers[:1])
        task = f"qp_{mode}_1e-6_f64"
        for kind, name in KINDS.items():
            add(main, f"{task}{name}, the peer's own timer", "f64", NEWTON, "", mode, kind, "1e-6", main.peers, timer=True)
            add(poly, f"{task}{name}, Poly (N = 7)", "f64", NEWTON, "", mode, kind, "1e-6", poly.peers)
    return [row for row in rows if row]


def nearest(comparison, mode, kind="recovery"):
    """(the peer whose times come nearest to ours, our time over its), float64 at 1e-6; None without peers."""
    rows = [(p, comparison.row("", ("f64", NEWTON, ""), p, mode, kind, "1e-6", "")) for p in comparison.peers]
    return max(((p, 1 / row["ratio"]) for p, row in rows if row), key=lambda pair: pair[1], default=None)


# ---- tables and plots ------------------------------------------------------------------------


def _contenders(comparison):
    """[(label, contender)]: ours, then the peers. The gradient method is timed at -O2 only."""
    ours = [
        (f"TinyKoop {p} {'gradient' if m == GRADIENT else flags}", (p, m, suffix))
        for p, m in comparison.ours
        for suffix, flags in (("", "-O2"), ("_O3", "-O3"))
        if m == NEWTON or not suffix
    ]
    return ours + [(peer.label, peer) for peer in comparison.peers]


def _has_mode(contender, mode):
    return mode == "cold" or isinstance(contender, tuple) or contender.warm_variants is not None


def _cell(comparison, contender, mode, kind, accuracy):
    """Median us and the ratio to ours at -O2, or how near it came."""
    if not _has_mode(contender, mode):
        return "-"
    us = comparison.typical(contender, mode, kind, accuracy)
    if us is None:
        who = contender[:2] if isinstance(contender, tuple) else contender
        return f"no, {results.number(comparison.chosen[who, mode, kind, accuracy][1], 1)}"
    if isinstance(contender, tuple):
        return f"{us:.0f}"
    row = comparison.row("", ("f64", NEWTON, ""), contender, mode, kind, accuracy, "")
    return f"{us:.0f} ({results.number(row['ratio'], 2)})" if row else f"{us:.0f}"


def show(main):
    """Tables on the terminal, and whether the claims hold."""
    columns = [(mode, accuracy) for mode in MODES for accuracy in ACCURACIES]
    notes = {
        "recovery": "Median us, in brackets peer / TinyKoop f64 -O2. TinyKoop condenses too, the peers get H and f. "
        "-: no warm start. no: at no setting within the accuracy on every step; the least of the largest errors.",
        "tracking": "TinyMPC cannot express the program: its gains are those of the infinite horizon, so that its last "
        "state is weighted with their Riccati matrix, not with Q.",
    }
    for kind in KINDS:
        rows = [[label, *(_cell(main, who, mode, kind, accuracy) for mode, accuracy in columns)] for label, who in _contenders(main)]
        headers = ["", *(f"{mode} {accuracy}" for mode, accuracy in columns)]
        results.print_table(f"One solve, us: {main.descriptions[kind]}", headers, rows, notes[kind])
    for kind, mode in itertools.product(KINDS, MODES):
        found = nearest(main, mode, kind)
        if found is None:
            results.console.print(f"{kind}, {mode}: no peer reaches 1e-6")
            continue
        peer, part = found
        results.console.print(
            f"{kind}, {mode}: float64 at 1e-6 takes {part:.2f} of {peer.label}'s time; "
            f"at most {CLAIMS[mode]} {'holds' if part <= CLAIMS[mode] else 'does not hold'}"
        )


def plot_times(main, path):
    """Median time of a solve at 1e-6, cold and warm, with the 95th percentile."""
    entries = [(label, who) for label, who in _contenders(main) if main.typical(who, "cold") is not None]
    entries.sort(key=lambda entry: -main.typical(entry[1], "cold"))
    figure, axes = plots.subplots(figsize=(9, 1.2 + 0.42 * len(entries)))
    for row, (label, who) in enumerate(entries):
        ours = isinstance(who, tuple)
        for mode, shift, hatch in (("cold", 0.2, ""), ("warm", -0.2, "////")):
            if not _has_mode(who, mode) or not main.found(who, mode):
                continue
            us = list(main.found(who, mode)[0].values())
            middle, high = statistics.median(us), np.percentile(us, 95)
            shade = "0.45" if ours else "0.88"
            axes.barh(row + shift, middle, 0.4, color=shade, hatch=hatch, edgecolor="black", lw=0.7)
            axes.plot([middle, high], [row + shift] * 2, color="black", lw=1, marker="|", markevery=[1], ms=6)
            axes.annotate(
                f"{middle:.0f}, {high:.0f}", (high, row + shift), xytext=(4, 0), textcoords="offset points", va="center",
                fontsize=7,
            )  # fmt: skip
    axes.set_xscale("log")
    axes.margins(x=0.12, y=0.01)
    axes.grid(False, axis="y")
    axes.set_yticks(range(len(entries)), [label for label, _ in entries])
    axes.set_xlabel("us per solve, median and 95th percentile (log scale)")
    box = plots.patches().Rectangle
    looks = [dict(fc="white"), dict(fc="white", hatch="////"), dict(fc="0.45"), dict(fc="0.88")]
    keys = [box((0, 0), 1, 1, ec="black", **look) for look in looks]
    names = ["cold", "warm (where there is a warm start)", "TinyKoop, condensing included", "peers"]
    axes.legend(keys, names, ncols=4, loc="upper center", bbox_to_anchor=(0.4, -0.09))
    found = {mode: nearest(main, mode) for mode in MODES}
    told = ", ".join(f"{pair[1]:.2f} {mode}" for mode, pair in found.items() if pair)
    axes.set_title(f"Solves of recovery, u within 1e-6: TinyKoop f64 -O2 takes {told or 'no known'} times the fastest peer's")
    plots.save(figure, path)


def plot_accuracy(main, path):
    """Median cold time against the largest u error, at the settings that the three accuracies need."""
    figure, axes = plots.subplots(figsize=(9, 5.2))
    marks = "osD^v<>PX*hdp"
    lines = [(label, who) for label, who in _contenders(main) if not (isinstance(who, tuple) and who[2])]
    for n, (label, who) in enumerate(lines):
        points = []
        for accuracy in ACCURACIES:
            found = main.found(who, "cold", "recovery", accuracy)
            if found:
                points.append((found[2], statistics.median(found[0].values())))
        if points:
            ours = isinstance(who, tuple)
            axes.plot(
                *zip(*sorted(set(points))), marker=marks[n % len(marks)], ms=7 if ours else 5, lw=2 if ours else 1,
                color="black" if ours else "0.55", mfc="black" if ours else "white", mec="black",
                ls=("-", "--", ":", "-.")[n % 4], label=label,
            )  # fmt: skip
    for accuracy in ACCURACIES:
        axes.axvline(float(accuracy), color="0.7", lw=0.8, ls=(0, (2, 2)))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    axes.set_xlabel("largest u error of all steps (m/s, rad/s), better to the right")
    axes.set_ylabel("us per cold solve of recovery, median (log scale)")
    axes.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    ours = main.typical(("f64", NEWTON, ""), "cold")
    quick = []
    for accuracy in ACCURACIES:
        others = [us for us in (main.typical(p, "cold", accuracy=accuracy) for p in main.peers) if us is not None]
        if ours is not None and ours <= min(others, default=math.inf):
            quick.append(accuracy)
    told = f"no peer is faster than TinyKoop f64 at {', '.join(quick)}" if quick else "a peer is faster than TinyKoop f64"
    axes.set_title(f"Time against accuracy (dashed: 1e-3, 1e-4, 1e-6): {told}")
    plots.save(figure, path)
