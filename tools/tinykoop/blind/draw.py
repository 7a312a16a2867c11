"""Plots of a blind check, of what blind.json holds."""

import numpy as np

from ..plumbing import plots
from ..plumbing.results import number
from . import score, tiers

VERDICTS = {
    "known": ("#08306b", ""),
    "partly": ("#4292c6", "xx"),
    "none": ("#9ecae1", ".."),
    "unknown": ("#e6a000", "//"),
    "failed": ("#000000", ""),
}


def _matrix(ax, counts, totals, rows, columns, text):
    """Counts written into their cells unless zero, in grey by their share of the row's total."""
    shares = counts / np.maximum(totals, 1)[:, None]
    ax.imshow(shares, cmap="Greys", vmin=0, vmax=1.3, aspect="auto")
    ax.set_xticks(range(len(columns)), columns, rotation=60, ha="right", fontsize=7)
    ax.set_yticks(range(len(rows)), rows, fontsize=7)
    ax.grid(False)
    for i, j in zip(*np.nonzero(counts)):
        light = shares[i, j] > 0.6
        ax.annotate(text(counts[i, j]), (j, i), ha="center", va="center", fontsize=7, color="w" if light else "k")


def draw_confusion(out, rows):
    """True effect against first answer, single effects and healthy robots."""
    names = [*tiers.VOCABULARY, "none"]
    some = [row for row in rows if row["tier"] == "single" or row["tier"].startswith("none")]
    answers = [(row["truth"] or ["none"], "none" if row["verdict"] == "none" and not row["truth"] else row["answer"]) for row in some]
    extra = sorted({answer for _, answer in answers} - set(names))
    counts = np.zeros((len(names), len(names) + len(extra)))
    for truth, answer in answers:
        counts[names.index(truth[0]), (names + extra).index(answer)] += 1
    right = np.trace(counts[:-1])
    figure, ax = plots.subplots(figsize=(8, 6.5))
    _matrix(ax, counts, counts.sum(axis=1), names, names + extra, lambda value: f"{value:.0f}")
    healthy = f", {counts[-1, -1 - len(extra)]:.0f} of {counts[-1].sum():.0f} healthy robots `none`"
    ax.set_title(f"First answer strictly right on {right:.0f} of {counts[:-1].sum():.0f} single effects{healthy}")
    ax.set_xlabel("first of the ranking (`none`: the verdict), number of logs")
    ax.set_ylabel("true effect")
    plots.save(figure, out / "blind_confusion.png")


def draw_claims(out, rows):
    """Share of the gap claimed against the share realised on the fresh log."""
    styles = {
        "identified": ("o", "#08306b", "one effect, identified"),
        "single_other": ("^", "#e6a000", "one effect in another form"),
        "rest": (".", "#999999", "all other logs with an effect"),
    }
    points = {kind: [] for kind in styles}
    for row in rows:
        if row.get("claimed_50") is not None and row.get("realised_50") is not None:
            known = row["tier"] == "single" and row.get("found")
            kind = "identified" if known else row["tier"] if row["tier"] in styles else "rest"
            points[kind].append((row["claimed_50"], row["realised_50"]))
    figure, ax = plots.subplots(figsize=(6, 5.5))
    ends = np.array([-1.05, 1.05])
    ax.plot(ends, ends, color="k", lw=0.8)
    ax.plot(ends, ends - 0.1, color="k", lw=0.8, ls="--", label="claimed 0.1 more than realised")
    for kind, (marker, colour, label) in reversed(styles.items()):
        if points[kind]:
            claimed, realised = np.clip(np.transpose(points[kind]), -1, 1)
            ax.plot(claimed, realised, marker, color=colour, mfc="none", ms=6, label=f"{label} ({len(claimed)})")
    everything = [point for some in points.values() for point in some]
    over = sum(claimed - realised > 0.1 for claimed, realised in everything)
    ax.set_title(f"Gap closed at 50 steps: overclaimed on {over} of {len(everything)} logs (cut at -1)")
    ax.set_xlim(-0.05 if all(claimed > 0 for claimed, _ in everything) else -1.05, 1.05)
    ax.set_ylim(-1.05, 1.05)
    ax.set_xlabel("claimed from the log (share of the reducible gap)")
    ax.set_ylabel("realised on the fresh log (share)")
    ax.legend(loc="upper left")
    plots.save(figure, out / "blind_claims.png")


def draw_ambiguity(out, rows):
    """The sets that reports put forward: what they name and what they call ambiguous with it."""
    names = list(tiers.VOCABULARY)
    figure, axes = plots.subplots(1, 2, figsize=(12, 6), sharey=True)
    for ax, tier in zip(axes, ("single", "poor")):
        some = [row for row in rows if row["tier"] == tier]
        counts = np.zeros((len(names), len(names)))
        for row in some:
            for member in {*row["named"], *row.get("ambiguous", ())} & set(names):
                counts[names.index(row["truth"][0]), names.index(member)] += 1
        totals = np.array([sum(row["truth"] == [name] for row in some) for name in names])
        _matrix(ax, counts, totals, names, names, lambda value: f"{value:.0f}")
        named = [row for row in some if row["named"]]
        size = np.mean([len({*row["named"], *row["ambiguous"]}) for row in named]) if named else np.nan
        kind = "rich" if tier == "single" else "poor"
        ax.set_title(f"{kind} drives: {np.trace(counts):.0f} of {len(some)} sets hold the truth, {number(size)} effects each")
        ax.set_xlabel("named, or ambiguous with what is named (number of logs)")
    axes[0].set_ylabel("true effect")
    plots.save(figure, out / "blind_ambiguity.png")


def draw_verdicts(out, rows):
    """Verdicts by tier."""
    names = [tier for tier in tiers.TIERS if score.of(rows, tier)]
    figure, ax = plots.subplots(figsize=(8, 4.5))
    left = np.zeros(len(names))
    for verdict, (colour, hatch) in VERDICTS.items():
        shares = [np.mean([row["verdict"] == verdict for row in score.of(rows, name)]) for name in names]
        if verdict != "failed" or any(shares):
            ax.barh(names, shares, left=left, color=colour, hatch=hatch, edgecolor="w", lw=0.5, label=verdict)
        left += shares
    unseen = score.figure(score.of(rows, *score.OPEN), "unknown")
    wrong = score.figure(score.of(rows, *score.CLOSED), "false_unknown")
    shares = ["-" if f["value"] is None else f"{100 * f['value']:.0f} %" for f in (unseen, wrong)]
    ax.set_axisbelow(True)
    ax.set_title(f"Called unknown: {shares[0]} where the cause is in no library, {shares[1]} where it is or none is", pad=22)
    ax.invert_yaxis()
    ax.set_xlim(0, 1)
    ax.set_xlabel("share of logs (left_out without the exact aliases)")
    ax.legend(ncols=4, loc="lower left", bbox_to_anchor=(0, 1))
    plots.save(figure, out / "blind_verdicts.png")


def draw_calibration(out, bins):
    """Share of the effects named that are right, against the confidence stated."""
    figure, ax = plots.subplots(figsize=(6, 4.5))
    ax.plot([0, 1], [0, 1], color="k", lw=0.8, ls="--", label="as stated")
    if bins:
        stated, right, ci = (np.array([b[key] for b in bins]) for key in ("stated", "right", "ci95"))
        ax.errorbar(stated, right, np.abs(ci.T - right), fmt="o", color="#08306b", capsize=3, label="95 % interval")
        for b in bins:
            ax.annotate(f"{b['n']}", (b["stated"], b["right"]), xytext=(-5, 4), textcoords="offset points", fontsize=8,
                        ha="right")  # fmt: skip
    sure = [b for b in bins if b["low"] >= score.SURE]
    n = sum(b["n"] for b in sure)
    share = "-" if not n else f"{100 * sum(b['n'] * b['right'] for b in sure) / n:.0f} %"
    ax.set_title(f"Of {n} effects named with a confidence of {score.SURE} or more {share} are right")
    ax.set_xlim(-0.02, 1.02)
    ax.set_ylim(-0.02, 1.05)
    ax.set_xlabel("confidence stated (mean of the bin; numbers: effects named)")
    ax.set_ylabel("share that is right")
    ax.legend(loc="upper left")
    plots.save(figure, out / "blind_calibration.png")


def run(out, results):
    """Draws what `score.run` returned."""
    rows = [row for row in results["rows"] if row["who"] == score.OURS]
    draw_confusion(out, rows)
    draw_claims(out, rows)
    draw_ambiguity(out, rows)
    draw_verdicts(out, rows)
    draw_calibration(out, results["calibration"][score.OURS])
