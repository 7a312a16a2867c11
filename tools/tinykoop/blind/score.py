"""Scores the reports against the sealed truth. Knows nothing of how the reports were made.

`python -m tinykoop.blind.score build/out` scores the stored reports again. How a report is judged:

- The family comes first: slip, friction, lag, .. of `plant.FAMILIES`. A report may say the same cause in another form
  or by another name of its family; what is named is then right, and so is its confidence. `top1`, `top3`, `found` and
  `f1` ask for the name.
- An answer counts as the true effect if it is that, or if the report puts the two into one ambiguity set, in either
  direction; `strict` figures do without ambiguity sets.
- Parameter errors are relative to the true value. Of pacejka_slip and stribeck_friction, whose parameters a log does
  not pin down one by one, the error is that of the body velocities they take away over the log's commands: RMS of the
  difference over the RMS of what the true one takes. Plain shapes only, effects named exactly. Of these two a report has a
  95 % band of what the curve takes: the share of its commands counts at which the band holds what the true curve takes.
- Realised is (before - after) / (before - floor) of the report's fresh gap, with the true floor, which is known from
  the noise that was added; only where the noise-free gap of the fresh log is at least the floor. `own floor` is the
  same with the report's floor; `recomputed` takes before and after from the simulator under the effects reported.
- Of an effect that was left out nothing that is named is right, save for logs of `alias`, which the other effects
  explain exactly: they count neither for nor against, and have rows of their own.
- A run that failed, or whose report is not one, counts as wrong in every share that it could have entered.

Shares have Wilson intervals, medians and means bootstrap ones, all 95 %.
"""

import hashlib
import json
import sys
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from .. import bridge
from ..experiments.study.closed_loop import wilson
from ..plumbing.errors import UserError
from ..plumbing.results import number, print_table, progress, replacing
from . import plant, tiers
from .answer import Answer, paired

OURS = "tinykoop"
SURE = 0.9
OPEN = ("left_out", "never")
CLOSED = tuple(tier for tier in tiers.TIERS if tier not in OPEN)
HEALTHY = tuple(tier for tier in tiers.TIERS if tier.startswith("none"))
CURVES = ("pacejka_slip", "stribeck_friction")
TAKEN = 1e-9  # m/s, rad/s: an axis of which a curve takes less is none of its own


# ---- seal and storage --------------------------------------------------------------------------


def digest(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def load(work):
    """(seal, labels, runs {(who, log): run}) of a finished campaign; refuses a broken seal or a half one."""
    try:
        seal = json.loads((work / "seal.json").read_text())
        if digest(work / "labels.json") != seal["sha256"]:
            raise UserError(f"{work / 'labels.json'}: its SHA-256 is not the sealed one; the labels were changed")
        labels = json.loads((work / "labels.json").read_text())
        runs = {
            (who, log): json.loads((work / "reports" / who / f"{log}.json").read_text()) for who in seal["diagnosers"] for log in labels
        }
    except FileNotFoundError as error:
        raise UserError(f"{error.filename}: missing; the campaign was not finished, run `make blind` again")
    return seal, labels, runs


# ---- one report ----------------------------------------------------------------------------------


def overlap(found, true, duration, dt):
    """(IoU, onset error in s) of spans; the onset is that of the span that shares most with the true ones."""

    def shared(a, b):
        return max(0.0, min(a[1], b[1]) - max(a[0], b[0]))

    t = (np.arange(round(duration / dt)) + 0.5) * dt
    masks = [np.any([(t >= a) & (t < b) for a, b in spans], axis=0) for spans in (found, true)]
    best, of = max(((a, b) for a in found for b in true), key=lambda pair: shared(*pair))
    union = np.sum(masks[0] | masks[1])
    return float(np.sum(masks[0] & masks[1]) / union) if union else 0.0, abs(best[0] - of[0])


def curve(name, parameters, u):
    """What the effect takes from the body velocities over the commands, (rows, 3)."""
    v, w = np.transpose(u)
    m = SimpleNamespace(v=v, w=w, forward=v.copy(), left=np.zeros_like(v), turn=w.copy())
    plant.PLAIN[name](m, **parameters)
    return np.stack([m.forward - v, m.left, m.turn - w], axis=1)


def parameter_errors(effect, cause, u):
    """({parameter or "curve": relative error}, {parameter: whether its interval holds the true value})."""
    true, found, ci = cause["parameters"], effect.get("params") or {}, effect.get("params_ci95") or {}
    covered = {key: bool(ci[key][0] <= value <= ci[key][1]) for key, value in true.items() if ci.get(key)}
    if not set(true) <= set(found):
        return {}, covered  # a peer that names effects without their parameters
    if cause["name"] in CURVES:
        taken = curve(cause["name"], true, u)
        errors = {"curve": np.linalg.norm(curve(cause["name"], found, u) - taken) / np.linalg.norm(taken)}
    else:
        errors = {key: abs(found[key] - value) / abs(value) for key, value in true.items()}
    return {key: float(value) for key, value in errors.items()}, covered


def band_held(effect, cause):
    """Share of the commands of a report's band of a curve at which the band holds what the true curve takes; None without a band."""
    band = effect.get("curve")
    if not band or effect.get("form"):
        return None
    taken, limits = curve(cause["name"], cause["parameters"], band["commands"]), np.array(band["takes_ci95"])
    acts = np.abs(taken).max(0) > TAKEN
    return float(np.mean(((limits[..., 0] <= taken) & (taken <= limits[..., 1]))[:, acts])) if acts.any() else None


def _share(before, after, least):
    return None if None in (before, after, least) or before <= least else (before - after) / (before - least)


def recomputed_gap(answer, fresh):
    """({H: before}, {H: after}) on the fresh log, from the simulator under the effects that are reported, throughout."""
    table = bridge.effects()
    try:
        active = [
            bridge.Effect(form, tuple(float(e["params"][row[0]]) for row in table[form][1]))
            for e in answer.there
            if e.get("acts", True) and (form := e.get("form", e["name"]))
        ]
        return [tiers.gap(fresh.x, fresh.u, fresh.dt, active=a, usable=fresh.usable) for a in ((), active)]
    except (KeyError, TypeError, UserError):
        return {}, {}  # an effect that our simulator does not have, or not with these parameters


def judge(label, run, u=None, fresh=None):
    """Marks of one report; None where one does not apply. u: the log's commands, fresh: the fresh log."""
    duration = (label["rows"] - 1) * label["dt"]
    marks = {key: label[key] for key in ("tier", "truth", "alias")} | {"seconds": run["seconds"], "rows": label["rows"]}
    marks["forms"] = sorted({cause.get("form") or cause["shape"] for cause in label["causes"]})
    marks["families"] = _families(label["truth"])
    marks["visible"] = label["gap"]["50"] >= label["floor"]["50"]
    try:
        if run["report"] is None:
            raise ValueError(run["error"])
        answer = Answer(run["report"], duration)
        marks |= {"failure": None, "verdict": answer.verdict, "answer": (answer.ranking or ["-"])[0]}
        marks |= _which(label, answer) | _values(label, answer, u, duration)
        return marks | _how_much(label, answer, fresh)
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        return marks | {"failure": f"{type(error).__name__}: {error}"} | _all_wrong(label)


def _families(truth):
    return sorted(set(map(plant.family, truth)))


def _all_wrong(label):
    marks = {"verdict": "failed", "answer": "failed", "statements": [], "named": []}
    if label["tier"] in OPEN:
        return marks | {"unknown": False}
    marks |= {"false_unknown": True} if label["tier"] in CLOSED else {}
    if not label["truth"]:
        return marks | {"false_alarm": True}
    marks |= dict.fromkeys(("family1", "family_set", "strict1", "top1", "top3", "found"), False) | {"f1": 0.0, "family_f1": 0.0}
    return marks | ({"iou": 0.0, "onset": np.inf} if label["tier"] in ("switch", "five_phase") else {})


def _which(label, answer):
    """Marks on verdict, ranking and the set of effects."""
    truth, tier = label["truth"], label["tier"]
    allowed = set(tiers.EXACT) if label["alias"] else set() if tier in OPEN else set(truth)
    kinds = _families(allowed)
    statements = [(float(e.get("confidence") or 0), _is_one_of(answer, e["name"], kinds)) for e in answer.effects]
    marks = {"named": answer.names, "statements": statements}
    marks["confident_wrong"] = any(sure >= SURE and not right for sure, right in statements)
    marks["ambiguous"] = sorted(set().union(*(answer.ambiguous.get(name, set()) for name in answer.names)))
    marks["partly"] = answer.verdict == "partly"
    marks["set_size"] = float(np.mean([1 + len(answer.ambiguous.get(n, ())) for n in answer.names or [None]]))
    if tier in OPEN:
        return marks | {"unknown": answer.verdict == "unknown"}
    if tier in CLOSED:
        marks["false_unknown"] = answer.verdict == "unknown"
    if not truth:
        return marks | {"false_alarm": answer.verdict != "none"}
    marks |= _which_family(answer, _families(truth))
    hits = [any(answer.alike(name, true) for true in truth) for name in answer.ranking]
    matched = answer.matches(truth)
    marks |= {"strict1": answer.ranking[:1] != [] and answer.ranking[0] in truth}
    marks |= {"top1": any(hits[:1]), "top3": any(hits[:3]), "found": len(matched) == len(truth)}
    return marks | {"f1": 2 * len(matched) / (len(answer.names) + len(truth))}


def _is_one_of(answer, name, families):
    return any(answer.akin(answer.family(name), true) for true in families)


def _which_family(answer, true):
    """Marks on the family named first and on the set of families."""
    matched = len(paired(true, answer.families, answer.akin))
    return {
        "family1": any(_is_one_of(answer, name, true) for name in answer.ranking[:1]),
        "family_set": matched == len(true) == len(answer.families),
        "family_f1": 2 * matched / (len(answer.families) + len(true)),
    }


def _values(label, answer, u, duration):
    """Marks on parameters and segments of the effects that were found."""
    marks = {"parameter_errors": {}, "covered_curves": {}, "covered_rest": {}, "covered_bands": {}}
    if not label["truth"] or label["tier"] in OPEN:
        return marks
    causes = {cause["name"]: cause for cause in label["causes"]}
    for effect in answer.effects:
        cause = causes.get(effect["name"])
        if cause and cause["shape"] == "plain":
            errors, covered = parameter_errors(effect, cause, u)
            marks["parameter_errors"] |= {f"{cause['name']}.{key}": value for key, value in errors.items()}
            kind = "covered_curves" if cause["name"] in CURVES else "covered_rest"
            marks[kind] |= {f"{cause['name']}.{key}": value for key, value in covered.items()}
            held = band_held(effect, cause) if cause["name"] in CURVES else None
            marks["covered_bands"] |= {} if held is None else {cause["name"]: held}
    marks["link"] = {e["name"]: e["link"] == causes[e["name"]].get("link") for e in answer.effects if "link" in e and e["name"] in causes}
    if label["tier"] in ("switch", "five_phase"):
        matched, scores = answer.matches(label["truth"]), []
        for true in label["truth"]:
            spans = [(c["t0"], c["t1"]) for c in label["causes"] if c["name"] == true]
            known = true in matched
            scores.append(overlap(answer.spans(matched[true]), spans, duration, label["dt"]) if known else (0.0, np.inf))
        marks["iou"], marks["onset"] = (float(value) for value in np.mean(scores, axis=0))
    return marks


def _how_much(label, answer, fresh):
    """Marks on the gap: claimed, realised, and the difference."""
    marks = {}
    recomputed = recomputed_gap(answer, fresh) if fresh is not None and answer.effects else ({}, {})
    for h in ("10", "50"):
        if not label["truth"] or label["fresh"]["gap"][h] < label["fresh"]["floor"][h]:
            continue
        at = {key: (answer.fresh.get(key) or {}).get(h) for key in ("before", "after", "noise_floor")}
        least = label["fresh"]["floor"][h]
        marks[f"own_floor_{h}"] = _share(at["before"], at["after"], at["noise_floor"])
        marks[f"recomputed_{h}"] = _share(*(gap.get(h) for gap in recomputed), least)
        realised = marks[f"realised_{h}"] = _share(at["before"], at["after"], least)
        claimed = marks[f"claimed_{h}"] = (answer.gap.get("closed_fraction") or {}).get(h) if answer.effects else None
        if claimed is not None:
            realised = marks[f"recomputed_{h}"] if realised is None else realised
            marks[f"claim_error_{h}"] = None if realised is None else abs(claimed - realised)
            marks[f"claim_excess_{h}"] = None if realised is None else claimed - realised
            marks[f"overclaims_{h}"] = realised is None or claimed - realised > 0.1
    return marks


# ---- figures -------------------------------------------------------------------------------------

SHARES = ("family1", "family_set", "top1", "strict1", "top3", "found", "false_alarm", "unknown", "partly", "false_unknown",
          "confident_wrong", "link", "covered_curves", "covered_rest", "overclaims_50")  # fmt: skip
MEANS = ("f1", "family_f1", "covered_bands")
MEDIANS = ("parameter_errors", "iou", "onset", "claimed_10", "realised_10", "claim_error_10", "claimed_50", "realised_50",
           "own_floor_50", "recomputed_50", "claim_error_50", "claim_excess_50", "set_size", "seconds")  # fmt: skip


def values(rows, mark):
    """The values of a mark where it applies; of a mark that is a dict, all it holds."""
    found = [row[mark] for row in rows if row.get(mark) is not None]
    return [value for item in found for value in (item.values() if isinstance(item, dict) else [item])]


def figure(rows, mark):
    """{"value", "ci95", "n"} of a mark over rows; value None where there is nothing to count."""
    found = np.array(values(rows, mark), dtype=float)
    n = len(found)
    if n == 0:
        return {"value": None, "ci95": [None, None], "n": 0}
    if mark in SHARES:
        return {"value": float(found.mean()), "ci95": list(wilson(int(found.sum()), n)), "n": n}
    statistic = np.mean if mark in MEANS else np.median
    draws = np.random.default_rng(0).integers(0, n, (2000, n))
    ordered = np.sort(statistic(found[draws], axis=1))  # infinite ones too, which quantile() cannot
    return {"value": float(statistic(found)), "ci95": [float(ordered[49]), float(ordered[1950])], "n": n}


def calibration(rows, edges=(0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)):
    """[{"low", "high", "n", "stated", "right", "ci95"}] of the confidences stated, in bins."""
    stated = np.array([s for row in rows for s in row["statements"]], dtype=float).reshape(-1, 2)
    bins = []
    for low, high in pairwise(edges):
        some = stated[(stated[:, 0] >= low) & ((stated[:, 0] < high) | ((high == 1.0) & (stated[:, 0] <= 1)))]
        if len(some):
            mean, right = some.mean(axis=0)
            ci = list(wilson(int(some[:, 1].sum()), len(some)))
            bins.append({"low": low, "high": high, "n": len(some), "stated": mean, "right": right, "ci95": ci})
    return bins


def calibration_error(rows, edges=tuple(np.linspace(0, 1, 11))):
    """{"value", "excess", "ci95", "n"}: expected calibration error of the confidences of all effects named.

    excess: how much more is stated than is right, on average; it is negative if too little is stated.
    """
    stated = np.array([s for row in rows for s in row["statements"]], dtype=float).reshape(-1, 2)
    if len(stated) == 0:
        return {"value": None, "excess": None, "ci95": [None, None], "n": 0}
    bins = np.digitize(stated[:, 0], edges[1:-1])

    def error(some):
        over = np.bincount(bins[some], stated[some, 0] - stated[some, 1], len(edges) - 1)
        return float(np.sum(np.abs(over)) / len(some))

    draws = np.random.default_rng(0).integers(0, len(stated), (2000, len(stated)))
    low, high = np.quantile([error(some) for some in draws], (0.025, 0.975))
    value, excess = error(np.arange(len(stated))), float(np.mean(stated[:, 0] - stated[:, 1]))
    return {"value": value, "excess": excess, "ci95": [float(low), float(high)], "n": len(stated)}


def of(rows, *names):
    """Rows of these tiers; those whose effect has an exact alias in what was left are no test of `unknown`."""
    return [row for row in rows if row["tier"] in names and not row["alias"]]


def open_set(rows):
    """Mean of the share of unknown effects reported as unknown and of known ones and healthy robots not reported so."""
    unknown, wrong = figure(of(rows, *OPEN), "unknown"), figure(of(rows, *CLOSED), "false_unknown")
    return None if None in (unknown["value"], wrong["value"]) else (unknown["value"] + 1 - wrong["value"]) / 2


def must_hold(by):
    """The lines of the requirement: [{"line", "value", "ci95", "n", "target", "met"}]; by: {who: rows}."""
    rows = by[OURS]
    identified = [row for row in of(rows, "single") if row.get("family_set")]
    closed = [row for row in of(rows, *CLOSED) if row["truth"]]
    long = [row for row in rows if 1500 <= row["rows"] <= 2500]
    slowest = [row | {"seconds": row["seconds"] * max(1, 2000 / row["rows"])} for row in long]
    table = [
        ("single: family named first, ambiguity sets as one", of(rows, "single"), "family1", ">=", 0.95),
        ("other forms: family named first", of(rows, "single_other"), "family1", ">=", 0.9),
        ("lags: exact set of families", of(rows, "lags"), "family_set", ">=", 0.9),
        ("slips at random: family named first", of(rows, "slipping"), "family1", ">=", 0.9),
        ("odometry: family named first", of(rows, "odometry"), "family1", ">=", 0.9),
        ("all known effects: exact set of families", closed, "family_set", ">=", 0.8),
        ("no gap, all kinds: false alarms", of(rows, *HEALTHY), "false_alarm", "<=", 0.03),
        ("no gap, random slip: false alarms", of(rows, "none_slip"), "false_alarm", "<=", 0.05),
        ("single: top-1, ambiguity sets as one", of(rows, "single"), "top1", ">=", 0.95),
        ("single: top-3", of(rows, "single"), "top3", ">=", 0.99),
        ("single: parameter error, median", of(rows, "single"), "parameter_errors", "<=", 0.05),
        ("no gap, white noise: false alarms", of(rows, "none_white"), "false_alarm", "<=", 0.02),
        ("no gap, coloured noise: false alarms", of(rows, "none_coloured"), "false_alarm", "<=", 0.05),
        ("no gap, heavy-tailed noise: false alarms", of(rows, "none_heavy"), "false_alarm", "<=", 0.05),
        ("pairs: F1, mean", of(rows, "pair"), "f1", ">=", 0.93),
        ("switch: onset error (s), median", of(rows, "switch"), "onset", "<=", 1.0),
        ("switch: IoU, median", of(rows, "switch"), "iou", ">=", 0.85),
        ("left out: unknown", of(rows, "left_out"), "unknown", ">=", 0.9),
        ("never in library: unknown", of(rows, "never"), "unknown", ">=", 0.9),
        ("false unknown, known effects in any form and healthy", of(rows, *CLOSED), "false_unknown", "<=", 0.05),
        ("wrong with confidence of 0.9 or more, all logs", rows, "confident_wrong", "<=", 0.02),
        ("gap closed, fresh log, 10 steps, identified", identified, "realised_10", ">=", 0.95),
        ("gap closed, fresh log, 50 steps, identified", identified, "realised_50", ">=", 0.95),
        ("claimed against realised, 10 steps, median", identified, "claim_error_10", "<=", 0.03),
        ("claimed against realised, 50 steps, median", identified, "claim_error_50", "<=", 0.03),
        ("other forms: overclaims at 50 steps", of(rows, "single_other"), "overclaims_50", "<=", 0.2),
        ("all logs with an effect: overclaims at 50 steps", rows, "overclaims_50", "<=", 0.2),
        ("95 % intervals of curves hold the true value", rows, "covered_curves", ">=", 0.9),
        ("95 % bands of curves hold the true curve, mean share of commands", rows, "covered_bands", ">=", 0.92),
        ("95 % intervals of other parameters hold the true value", rows, "covered_rest", ">=", 0.9),
        ("five phases: both effects found", of(rows, "five_phase"), "found", ">=", 1.0),
        ("five phases: IoU, median", of(rows, "five_phase"), "iou", ">=", 0.9),
        ("gap too small to matter: not `none`", of(rows, "none_small"), "false_alarm", "<=", 0.0),
        ("seconds a log, 2,000 rows, median", slowest, "seconds", "<=", 10.0),
    ]
    lines = [_line(text, figure(some, mark), sign, target) for text, some, mark, sign, target in table]
    lines.append(_line("expected calibration error, all effects named", calibration_error(rows), "<=", 0.05))
    most = {"value": max((r["seconds"] for r in slowest), default=None), "ci95": [None, None], "n": len(slowest)}
    lines.append(_line("seconds a log, 2,000 rows, slowest", most, "<=", 10.0))
    for who in (name for name in by if name != OURS):
        for text, value in AGAINST.items():
            lines.append(_line(f"{text} against {who}", value(rows), ">", value(by[who])["value"]))
    return lines


# every single effect counts here, identified or not
AGAINST = {
    "poor: top-1": lambda rows: figure(of(rows, "poor"), "top1"),
    "other forms: family named first": lambda rows: figure(of(rows, "single_other"), "family1"),
    "open-set detection": lambda rows: {"value": open_set(rows), "ci95": [None, None], "n": len(rows)},
    "gap closed, fresh log, 50 steps": lambda rows: figure(of(rows, "single"), "realised_50"),
}


def _line(text, found, sign, target):
    met = None
    if found["value"] is not None and target is not None:
        met = {">=": found["value"] >= target, "<=": found["value"] <= target, ">": found["value"] > target}[sign]
    return {"line": text, **found, "target": f"{sign} {number(target)}", "met": met}


# ---- all -----------------------------------------------------------------------------------------


def run(out, draw=None):
    """Scores the campaign in `out`, writes blind.json, after its plots by `draw`, and prints what must hold; returns the results."""
    out = Path(out)
    work = out / "blind"
    seal, labels, runs = load(work)
    by = {who: [] for who in seal["diagnosers"]}
    for who, log in progress(list(runs), "scoring"):
        u, fresh = bridge.read_log(work / "logs" / f"{log}.csv").u, bridge.read_log(work / "fresh" / f"{log}.csv")
        by[who].append({"log": log, "who": who} | judge(labels[log], runs[who, log], u, fresh))
    results = summary(by) | {"seal": seal}
    with replacing(out / "blind.json", results):
        if draw:
            draw(out, results)
    report(results)
    return results


def summary(by):
    """What blind.json holds, but the seal."""
    figures, effects, families = [], [], []
    for who, rows in by.items():
        groups = {tier: of(rows, tier) for tier in tiers.TIERS}
        groups["left_out, alias"] = [row for row in rows if row["alias"]]
        groups["left_out, with aliases"] = [row for row in rows if row["tier"] == "left_out"]
        groups["poor, gap above the floor"] = [row for row in of(rows, "poor") if row["visible"]]
        for group, some in groups.items():
            for mark in SHARES + MEANS + MEDIANS:
                found = figure(some, mark)
                figures += [{"who": who, "tier": group, "figure": mark, **found}] if found["n"] else []
        families += _by_family(who, rows)
        for name in tiers.VOCABULARY:
            some = [row for row in of(rows, "single", "left_out", "single_other", "poor") if row["truth"] == [name]]
            for tier in sorted({row["tier"] for row in some}):
                mark = "unknown" if tier in OPEN else "top1"
                effects.append({"who": who, "effect": name, "tier": tier, "figure": mark, **figure(of(some, tier), mark)})
    failures = [{key: row[key] for key in ("who", "log", "tier", "failure")} for rows in by.values() for row in rows if row["failure"]]
    return {
        "must_hold": must_hold(by),
        "figures": figures,
        "effects": effects,
        "families": families,
        "calibration": {who: calibration(rows) for who, rows in by.items()},
        "calibration_error": {who: calibration_error(rows) for who, rows in by.items()},
        "failures": failures,
        "rows": [row for rows in by.values() for row in rows],
    }


def _by_family(who, rows):
    """The figures of logs with one effect, by its family and tier."""
    lines, some = [], [row for row in of(rows, *CLOSED) if len(row["families"]) == 1]
    for tier, name in sorted({(row["tier"], row["families"][0]) for row in some}):
        group = [row for row in of(some, tier) if row["families"] == [name]]
        for mark in ("family1", "family_set", "overclaims_50"):
            found = figure(group, mark)
            lines += [{"who": who, "family": name, "tier": tier, "figure": mark, **found}] if found["n"] else []
    return lines


def report(results):
    """Tables on the terminal."""
    lines = []
    for line in results["must_hold"]:
        ci = "-" if line["ci95"][0] is None else f"{number(line['ci95'][0])} .. {number(line['ci95'][1])}"
        met = {True: "yes", False: "NO", None: "-"}[line["met"]]
        lines.append([line["line"], number(line["value"]), ci, line["n"], line["target"], met])
    print_table("Blind check", ["what must hold", "found", "95 % interval", "n", "target", "met"], lines)
    failed = {}
    for failure in results["failures"]:
        failed.setdefault((failure["who"], failure["failure"].splitlines()[-1][:80]), []).append(failure["log"])
    if failed:
        print_table("Failed runs, counted as wrong", ["who", "logs", "first", "error"],
                    [[who, len(logs), logs[0], error] for (who, error), logs in failed.items()])  # fmt: skip


if __name__ == "__main__":
    try:
        run(sys.argv[1])
    except UserError as error:
        sys.exit(f"tinykoop: {error}")
