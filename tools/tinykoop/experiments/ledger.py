"""The paper's claims against our figures: each with the command that makes them, and a verdict that is computed.

holds                   our figures bear it out
differs                 they point the same way, and are off by more than is tolerated
contradicted            they say the opposite
cannot be reproduced    a figure that follows from what the paper leaves open
"""

import json
import math
from pathlib import Path

from scipy.stats import spearmanr

from ..dictionaries import BUILT_IN
from ..plumbing import checkout, pages
from ..plumbing.errors import UserError
from ..plumbing.results import console, number, output_folder, write_json
from . import ablate, scenario

HOLDS, DIFFERS, CONTRADICTED, OPEN = "holds", "differs", "contradicted", "cannot be reproduced"
REGULATED = tuple(dict.fromkeys(name for _, name in scenario.PAPER if name not in ("offline", "ef")))  # the paper's, whatever lib/ lists
METHODS = ("offline", "none", "ef", *REGULATED)
WITHIN, ACROSS = ("P->P", "Y->Y"), ("P->Y", "Y->P")
SIMULATED = "synthetic"  # the source of the flights that everybody can make
TRACKS = 0.06  # m, rad: a mean tracking error below is that of a run that keeps the path
LOST = 1.0  # m, rad: and above, that of one that has lost it
HEADERS = ["claim of the paper", "command", "ours", "verdict"]


def of_the_paper(row):
    """Whether a row is of the paper's dictionaries and regulators; some rows name neither."""
    return row.get("dictionary", "rbf") in BUILT_IN and row.get("regulator", "none") in METHODS


class Results:
    """Rows of the experiments with the paper's dictionaries and regulators, in float64, as the commands have written them."""

    def __init__(self, out):
        self.out = Path(out)

    def rows(self, name, **keys):
        path = self.out / f"{name}.json"
        try:
            rows = json.loads(path.read_text())
        except (OSError, ValueError) as error:
            raise UserError(f"{path}: cannot be read; run `make {name}` first") from error
        rows = [row for row in rows if row.get("precision", "f64") == "f64" and of_the_paper(row)]
        return [row for row in rows if all(row.get(key) == value for key, value in keys.items())]

    def errors(self, name, dictionary, **keys):
        """{regulator: mean error}."""
        return {row["regulator"]: row["mean_error"] for row in self.rows(name, dictionary=dictionary, **keys)}

    def flights(self, direction, source=SIMULATED):
        """{(dictionary, regulator): mean error} with the fixed threshold."""
        rows = self.rows("transfer", source=source, direction=direction, calibrated=False)
        return {(row["dictionary"], row["regulator"]): row["mean_error"] for row in rows if math.isfinite(row["mean_error"] or math.nan)}

    def on_flights(self, figure):
        """(what is said, verdict) of figure(source) -> (said, verdict): that of simulated flights; real ones are told if there are any."""
        sources = dict.fromkeys([SIMULATED, *(row["source"] for row in self.rows("transfer"))])
        seen = [figure(source) for source in sources]
        said = [f"{text} ({'simulated' if source == SIMULATED else 'real'} flights)" for source, (text, _) in zip(sources, seen)]
        return "; ".join(said), seen[0][1]


def _percent(part):
    return f"{100 * part:.1f} %"


def _online(r):
    offline = r.errors("learn", "rbf")["offline"]
    online = [e for d in ("poly", "rbf") for name, e in r.errors("learn", d).items() if name != "offline" and (d, name) != ("rbf", "ef")]
    return f"{number(min(online))} to {number(max(online))} against {number(offline)}", HOLDS if max(online) < offline else CONTRADICTED


def _windup(r):
    (row,) = r.rows("learn", dictionary="rbf", regulator="ef")
    return f"{number(row['final_P_fro'])}", HOLDS if abs(row["final_P_fro"] / 2.51e46 - 1) < 0.01 else DIFFERS


def _explosion(r):
    (root,) = r.rows("windup", dictionary="rbf", regulator="ef", form="sqrt")
    (plain,) = r.rows("windup", dictionary="rbf", regulator="ef", form="plain")
    said = f"{number(plain['mean_error'])} in the plain form, {number(root['mean_error'])} in square-root form, with the same norm of P"
    return said, CONTRADICTED if root["mean_error"] < 0.01 else HOLDS


def _skipping(r):
    less = {d: 1 - e["dz_cs"] / e["dz_ks"] for d in ("rbf", "poly") for e in (r.errors("learn", d),)}
    close = abs(less["rbf"] - 0.767) < 0.05 and abs(less["poly"] - 0.015) < 0.05
    return f"{_percent(less['rbf'])} (RBF), {_percent(less['poly'])} (Poly)", HOLDS if close else DIFFERS if min(
        less.values()
    ) > 0 else CONTRADICTED


def _safeguard(r):
    e = r.errors("learn", "poly")
    said = f"vanilla {number(e['ef'])}, CT {number(e['ct'])}, SIFt {number(e['sift'])}"
    return said, HOLDS if min(e["ct"], e["sift"]) > e["ef"] else CONTRADICTED


def _threshold(r):
    paper = ablate.PAPER_DELTA
    rows = {row["delta"]: row for row in r.rows("ablate", study="delta", dictionary="rbf", regulator="dz_cs")}
    said = ", ".join(f"{number(d)}: {_percent(rows[d]['skip_rate'])}, {number(rows[d]['mean_error'])}" for d in paper)
    off = max(abs(rows[d]["mean_error"] / error - 1) for d, (_, error) in paper.items())
    skipped = max(abs(rows[d]["skip_rate"] - skip) for d, (skip, _) in paper.items())
    return said, HOLDS if off < 0.15 and skipped < 0.05 else DIFFERS


def _traces(r):
    falls, worse = [], []
    groups = {}
    for row in r.rows("ablate", study="ct", dictionary="rbf"):
        groups.setdefault((row["lambda"], row["p0"]), {})[row["trace_multiple"]] = row
    for group in groups.values():
        low, high = group[min(group)], group[max(group)]
        falls.append(high["mean_error"] < low["mean_error"])
        worse.append(high["final_condition"] > low["final_condition"])
    said = f"RBF: lower error in {sum(falls)} of {len(falls)} groups, worse condition in {sum(worse)}"
    return said, HOLDS if sum(falls) > len(falls) / 2 and sum(worse) > len(worse) / 2 else CONTRADICTED


def _horizon(r):
    rows = {(row["dictionary"], row["regulator"]): row["rollout_error"] for row in r.rows("ablate", study="rollout")}
    regulated = {key: value for key, value in rows.items() if key[1] in REGULATED}
    best = [min(regulated, key=lambda key: regulated[key][h]) for h in ("1", "50")]
    said = f"best of the regulated at 1 step: {_name(best[0])}; at 50: {_name(best[1])}, {number(regulated[best[1]]['50'])}"
    return said, HOLDS if best[0] != best[1] and best[1][1] == "sift" else DIFFERS if best[0] != best[1] else CONTRADICTED


def _name(key):
    return scenario.Method(*key).label


def _shift(r):
    return r.on_flights(lambda source: _gains(r, source))


def _gains(r, source):
    every = [r.flights(d, source) for d in ACROSS]
    less = [1 - e / flights["rbf", "offline"] for flights in every for key, e in flights.items() if key[1] != "offline"]
    better = sum(part > 0 for part in less)
    said = f"{better} of {len(less)} better, by {_percent(min(less))} to {_percent(max(less))}"
    return said, HOLDS if better == len(less) else DIFFERS if better > len(less) / 2 else CONTRADICTED


def _flight_skipping(r):
    return r.on_flights(lambda source: _lower(r, source))


def _lower(r, source):
    flights = [r.flights(d, source) for d in (*WITHIN, *ACROSS)]
    lower = sum(e[name, "dz_cs"] < e[name, "dz_ks"] for e in flights for name in ("poly", "rbf"))
    return f"lower in {lower} of 8", HOLDS if lower == 8 else CONTRADICTED


def _averages(r, dictionary, source):
    flights = [r.flights(d, source) for d in ACROSS]
    return {key[1]: sum(e[key] for e in flights) / 2 for key in flights[0] if key[0] == dictionary and key[1] != "offline"}


def _best_across(r):
    return r.on_flights(lambda source: _best(r, source))


def _best(r, source):
    said, right = [], []
    for dictionary in ("poly", "rbf"):
        mean = _averages(r, dictionary, source)
        best = min(REGULATED, key=mean.get)
        right.append(best == "ct")
        said.append(
            f"{_name((dictionary, best))} {_percent(1 - mean[best] / mean['ct'])} below CT, {_percent(1 - mean[best] / mean['ef'])} below vanilla"
        )
    return "; ".join(said), HOLDS if all(right) else CONTRADICTED


def _tracking(r):
    e = r.errors("control", "rbf")
    worst = max(e[name] for name in REGULATED)
    return f"at most {number(worst)} against {number(e['offline'])}", HOLDS if worst < e["offline"] else CONTRADICTED


def _fallback(r):
    (row,) = r.rows("control", dictionary="rbf", regulator="ef")
    return f"{_percent(row['fallback_rate'])} fallback, error {number(row['mean_error'])}", HOLDS if row[
        "fallback_rate"
    ] > 0.95 else DIFFERS


def _poly_control(r):
    e = r.errors("control", "poly")
    return f"CT {number(e['ct'])}, DZ-CS {number(e['dz_cs'])}: single draws (`make study`)", OPEN if e["ct"] < TRACKS else HOLDS


def _rankings(r):
    learned, tracked = r.errors("learn", "rbf"), r.errors("control", "rbf")
    rho = float(spearmanr([learned[n] for n in REGULATED], [tracked[n] for n in REGULATED]).statistic)
    order = ", ".join(scenario.LABELS[n] for n in sorted(REGULATED, key=tracked.get))
    return f"control: {order}; rank correlation {rho:.2f}", HOLDS if rho > 0.99 else CONTRADICTED


def _robust(r):
    errors = {d: r.errors("control", d) for d in ("poly", "rbf")}
    keep = [n for n in REGULATED if max(errors[d][n] for d in errors) < TRACKS]
    names = ", ".join(scenario.LABELS[n] for n in keep)
    return f"{names} keep the path with both", HOLDS if keep == ["sift"] else CONTRADICTED if "sift" in keep else DIFFERS


def _ellipsoid(r):
    (row,) = r.rows("windup", dictionary="rbf", regulator="none", form="sqrt")
    part = max(row["final_P_inputs"]) / scenario.P0
    return f"after 5,000 steps P of the inputs is {number(part, 1)} of P0 (RBF)", HOLDS if part < 0.01 else CONTRADICTED


def _trace_bounds(r):
    rows = r.rows("ablate", study="ct")
    gain, norm = (max(row[key] for row in rows) for key in ("gain_over_bound", "norm_over_trace"))
    said = f"{len(rows)} runs: the gain reaches {_percent(gain)} of its bound, the norm of P {_percent(norm)}"
    return said, HOLDS if max(gain, norm) <= 1 else CONTRADICTED


def _within_regime(r):
    return r.on_flights(lambda source: _ranks(r, source))


def _ranks(r, source):
    errors = {direction: r.flights(direction, source) for direction in WITHIN}
    ranks = {direction: sorted(e.values()).index(e["rbf", "offline"]) + 1 for direction, e in errors.items()}
    said = ", ".join(f"{direction} rank {rank} of {len(errors[direction])}" for direction, rank in ranks.items())
    return said, HOLDS if ranks["P->P"] == 1 else CONTRADICTED


def _lower_bound(r):
    lost = [row for row in r.rows("control", dictionary="poly") if row["mean_error"] > LOST]
    shares = ", ".join(f"{scenario.LABELS[row['regulator']]} {_percent(row['at_bounds']['v_min'])}" for row in lost)
    if not lost:
        return "no Poly run fails here", OPEN
    return f"the Poly runs that fail here: {shares}", HOLDS if min(row["at_bounds"]["v_min"] for row in lost) > 0.7 else CONTRADICTED


def _update_time(r):
    times = [row["update_us"]["median"] / 1000 for row in r.rows("learn")]
    near = 0.15 <= min(times) and max(times) <= 0.28
    return f"{min(times):.4f} to {max(times):.4f} ms (x86-64)", HOLDS if near else DIFFERS


def _deadline(r):
    worst = max(row["update_us"]["p95"] for row in r.rows("learn")) + max(row["solve_us"]["p95"] for row in r.rows("control"))
    return f"{worst / 1000:.2f} ms at the 95th percentile, the slowest of each", HOLDS if worst < 1e6 * scenario.DT else CONTRADICTED


def _time(r):
    times = [row["solve_us"]["median"] for row in r.rows("control")]
    near = 14800 <= min(times) and max(times) <= 18500
    return f"{min(times) / 1000:.3f} to {max(times) / 1000:.3f} ms (x86-64, condensing included)", HOLDS if near else DIFFERS


CLAIMS = (
    ("Every usable online method improves on the offline one-step error of 1.30e-2", "learn", _online),
    ("With vanilla RBF the norm of P grows to 2.51e46", "learn", _windup),
    ("Without forgetting P drops toward zero where the robot excites it, and the gain vanishes", "windup", _ellipsoid),
    ("The one-step error of vanilla RBF explodes, to 1.95", "windup", _explosion),
    ("DZ-CS is below DZ-KS by 76.7 % (RBF) and 1.5 % (Poly)", "learn", _skipping),
    ("With Poly, CT and SIFt are less accurate than vanilla", "learn", _safeguard),
    ("Thresholds 0.003, 0.01, 0.03 skip 69.9, 97.7, 99.5 % with errors 1.52, 1.07, 5.58e-3", "ablate", _threshold),
    ("27 constant-trace settings: a larger trace often lowers the error and worsens the condition", "ablate", _traces),
    (
        "With constant trace the norm of P is at most tau0, the gain at most tau0 times the regressor's norm / lambda",
        "ablate",
        _trace_bounds,
    ),
    ("The one-step ranking does not persist: SIFt has the best 50-step error (0.180, 0.171)", "ablate", _horizon),
    ("Across flight regimes every online method improves on the offline model, by 22.6 to 41.4 %", "transfer", _shift),
    ("Within pitch flights (P->P) offline RBF is the best of all", "transfer", _within_regime),
    ("DZ-CS is below DZ-KS in all eight flight comparisons", "transfer", _flight_skipping),
    ("Across flight regimes CT is the best regulated method with both dictionaries, vanilla the best of all", "transfer", _best_across),
    ("Regulated RBF tracks better than offline RBF (4.46e-2)", "control", _tracking),
    ("Vanilla RBF fails under control: 100 % fallback", "control", _fallback),
    ("Poly (CT) and Poly (DZ-CS) fail under control: 70.2, 36.3", "control", _poly_control),
    ("A Poly run that fails has speed at its lower bound: 77.4 % of the steps (DZ-CS), 98.1 % (CT)", "control", _lower_bound),
    ("For regulated RBF, one-step and control rankings agree: DZ-CS, SIFt, DZ-KS, CT", "control", _rankings),
    ("Only SIFt is robust across dictionaries under control", "control", _robust),
    ("Lift and update take 0.15 to 0.28 ms (median, M1)", "learn", _update_time),
    ("A solve over 50 steps takes 14.8 to 18.5 ms (CVXPY, M1)", "control", _time),
    ("Update and solve end within the control period of 50 ms", "control", _deadline),
)


def judged(out):
    """[{claim, command, ours, verdict}]."""
    results = Results(out)
    return [
        dict(zip(("claim", "command", "ours", "verdict"), (text, f"make {command}", *judge(results)))) for text, command, judge in CLAIMS
    ]


def run(out, update=False):
    """Writes ledger.json into `out`, and with `update` the table of docs/paper.md; refuses verdicts that are not those of the page."""
    out = output_folder(out)
    rows = judged(out)
    lines = [[row["claim"], f"`{row['command']}`", row["ours"], row["verdict"]] for row in rows]
    write_json(out / "ledger.json", rows)
    for row in rows:
        console.print(f"{row['verdict']}: {row['claim']}", highlight=False)
    if update:
        pages.update("docs/paper.md", "ledger", pages.table("The paper's claims and our figures", HEADERS, lines, "---"))
    if checkout.EXISTS:
        _compare(rows)


def _compare(rows):
    """Refuses verdicts that are not those of the page."""
    page = (pages.ROOT / "docs/paper.md").read_text()
    changed = [
        row["claim"] for row in rows if not any(row["claim"] in line and f"| {row['verdict']} |" in line for line in page.splitlines())
    ]
    if changed:
        raise UserError(f"docs/paper.md: other verdicts than those measured (make ledger UPDATE=1 updates them): {'; '.join(changed)}")
