"""A quadrotor before and after a change: the paper's transfer across flight regimes, on another vehicle.

A model is fitted on the first 20 % of the flights of a healthy vehicle (H) or a changed one (C), and learned on over the other flights, or
over the rest of its own. What is measured needs no low-pass: the state estimator of the vehicle has filtered it.
"""

from itertools import count
from pathlib import Path

from .. import bridge
from ..logs import fly, quadrotor
from ..plumbing import pages, plots
from ..plumbing.errors import UserError
from ..plumbing.results import number, output_folder, print_table, printable, replacing
from . import scenario, transfer

PLATFORM, NAME = "quadrotor", "transfer_quadrotor"
PAGE = "docs/quadrotor.md"
HEALTHY, CHANGED = "HC"
SIMULATED = "synthetic"  # as of the flapping wing
CHANGES = {"rotor 3 weaker by 20 %": "rotor3_thrust=-0.2", "payload of 3 g": "payload=0.003,-0.02,0.02"}  # of the simulated vehicle
MANOEUVRE, SECONDS, FLIGHTS = "mixed", 40, 2  # simulated flights, before a change and after it
BEFORE = scenario.Method("rbf", "offline")  # the paper's baseline, which goes on with its model of the healthy vehicle


# ---- flights -----------------------------------------------------------------------------------------


def _joined(logs):
    """One Flight of flights of one vehicle."""
    seen = [quadrotor.learned(log, getattr(log, "path", "the flight")) for log in logs]
    odd = next((log for log, one in zip(logs, seen) if one.states != seen[0].states), None)
    if odd is not None:
        raise UserError(f"{odd.path}: its columns are not those of {logs[0].path}; give flights with the same columns")
    return transfer.joined(seen, cutoff=0)


def synthetic():
    """{change: {regime: Flight}} of the simulated vehicle; no two flights have the same noise."""
    effects, seed, found = bridge.quadrotor_effects(), count(1), {}
    for change, text in CHANGES.items():
        active = {HEALTHY: [], CHANGED: [fly.effect(text, effects)]}
        found[change] = {
            regime: _joined([bridge.quadrotor(MANOEUVRE, SECONDS, next(seed), acts)[0] for _ in range(FLIGHTS)])
            for regime, acts in active.items()
        }
    return found


def labelled(folder):
    """{change: {regime: Flight}} of labelled flights (docs/quadrotor-flights.md): of each vehicle, healthy and with the longest cuts."""
    from .flights import data

    flights, found = data.load(Path(folder)), {}
    for vehicle in sorted({one.vehicle for one in flights}):
        own = [one for one in flights if one.vehicle == vehicle]
        longest = max(sum(one.cut.values()) for one in own)
        parts = {
            HEALTHY: [one for one in own if one.family == "none"],
            CHANGED: [one for one in own if sum(one.cut.values()) == longest > 0],
        }
        if all(parts.values()):
            found[parts[CHANGED][0].condition] = {regime: _joined([one.log for one in part]) for regime, part in parts.items()}
    if not found:
        raise UserError(f"{folder}: no vehicle has both healthy flights and flights with a shortened propeller; label some in labels.csv")
    return found


# ---- results -----------------------------------------------------------------------------------------


def run(out, data=None, update=False):
    """Writes transfer_quadrotor.json and its plot into `out`: simulated flights, and the labelled ones of the folder `data` if it is given.

    update: also the tables of docs/quadrotor.md; that of real flights and the plot if there are any.
    """
    out, sources = output_folder(out), {SIMULATED: synthetic()}
    if data:
        sources[printable(Path(data).name)] = labelled(data)
    rows = [
        row | {"change": change}
        for source, changes in sources.items()
        for change, flights in changes.items()
        for row in transfer.transfers(source, flights, PLATFORM, thresholds=(True,))[0]
    ]
    with replacing(out / f"{NAME}.json", rows):
        draw(out / f"{NAME}.png", rows)
    for source in sources:
        table = _table([row for row in rows if row["source"] == source])
        print_table(*table)
        if update:
            region = NAME.replace("_", "-") + ("" if source == SIMULATED else "-real")
            pages.update(PAGE, region, pages.table(*table))
    if update and data:
        pages.picture(out / f"{NAME}.png")
    print(_gains(rows))
    return rows


def _changes(rows):
    return [*dict.fromkeys(row["change"] for row in rows)]


def _of(rows, method, change, direction, precision="f64"):
    """The row of a method."""
    key = method.dictionary, method.regulator, change, "->".join(direction), precision
    return next(row for row in rows if (row["dictionary"], row["regulator"], row["change"], row["direction"], row["precision"]) == key)


def _columns(rows):
    """[(change, direction)] of the table: within healthy flights, and from these to changed ones."""
    return [(change, (HEALTHY, to)) for change in _changes(rows) for to in (HEALTHY, CHANGED)]


def _apart(rows):
    """Largest relative difference of float32's error from that of float64, over all changes and directions."""
    pairs = {}
    for row in rows:
        pairs.setdefault((row["change"], row["direction"]), {})[row["precision"]] = row["mean_error"]
    return max(abs(pair["f32"] / pair["f64"] - 1) for pair in pairs.values())


def _line(rows, method):
    own = [row for row in rows if (row["dictionary"], row["regulator"]) == (method.dictionary, method.regulator)]
    norms = [row["final_P_fro"] for row in own if row["final_P_fro"] is not None]
    errors = [number(_of(own, method, *column)["mean_error"]) for column in _columns(rows)]
    return [method.label, *errors, number(max(norms)) if norms else "-", number(_apart(own), 1)]


def _table(rows):
    """(title, headers, lines), as pages.table() and print_table() take them."""
    stays = [number(_of(rows, BEFORE, *column)["stays"]) for column in _columns(rows)]
    lines = [[transfer.replay.NOTHING, *stays, "-", "-"], *(_line(rows, method) for method in scenario.METHODS)]
    heads = [f"{change}: {'before' if to == HEALTHY else 'after'}" for change, (_, to) in _columns(rows)]
    flights = "simulated" if rows[0]["source"] == SIMULATED else "real"
    title = f"Mean one-step error, {flights} flights, begun with a model of the healthy vehicle"
    return title, ["method", *heads, "largest final |P|", "float32, relative"], lines


def _ratios(rows):
    """{change: {method: error after the change over that of BEFORE}} of methods that learn online."""
    online = [method for method in scenario.METHODS if method.regulator != "offline"]
    error = lambda method, change: _of(rows, method, change, (HEALTHY, CHANGED))["mean_error"]  # noqa: E731
    return {change: {method: error(method, change) / error(BEFORE, change) for method in online} for change in _changes(rows)}


def _gains(rows):
    """The finding, in a sentence."""
    ratios = [ratio for part in _ratios(rows).values() for ratio in part.values()]
    better = sum(ratio < 1 for ratio in ratios)
    off = " to ".join(f"{100 * (1 - ratio):.0f}" for ratio in (max(ratios), min(ratios)))
    return f"After a change online learning beats the offline model in {better} of {len(ratios)} runs, by {off} %"


def draw(path, rows):
    """Error after the change relative to the offline model, every method, one panel for each change."""
    ratios = _ratios(rows)
    methods = [*next(iter(ratios.values()))]
    figure, axes = plots.subplots(1, len(ratios), figsize=(2.4 * len(ratios) + 3, 1.8 + 0.22 * len(methods)), sharey=True)
    figure.suptitle(_gains(rows), x=0.01, ha="left")
    for ax, (change, part) in zip(axes, ratios.items()):
        for i, (method, ratio) in enumerate(part.items()):
            ax.barh(i, ratio, color="0.85", edgecolor="k", hatch=plots.HATCHES[method.regulator])
        still = _of(rows, BEFORE, change, (HEALTHY, CHANGED))
        ax.axvline(still["stays"] / still["mean_error"], color="k", lw=1, ls="--", label=transfer.replay.NOTHING)
        ax.axvline(1, color="k", lw=1, label=BEFORE.label)
        ax.set_title(change)
        ax.set_xlabel(f"error / {BEFORE.label}'s")
        ax.grid(axis="y", visible=False)
    axes[0].set_yticks(range(len(methods)), [method.label for method in methods])
    axes[0].invert_yaxis()
    plots.legend(figure)
    plots.save(figure, path)
