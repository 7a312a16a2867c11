"""The tables of docs/quadrotor-flights.md, each as (title, headers, lines), and its figure."""

from statistics import median

import numpy as np

from ...diagnose.platforms.quadrotor import causes
from ...diagnose.platforms.quadrotor.causes import SLUNG
from ...diagnose.platforms.quadrotor.features import ROTORS
from ...plumbing import pages, plots
from ...plumbing.results import number
from . import answers

PAGE = "docs/quadrotor-flights.md"
FIGURE = "flights.png"
SOURCE = "`make flights`"
SIZES = {causes.PAYLOAD: ("mass", 1e3, "g"), causes.GAIN: ("a", -100, "%")}  # effect: its parameter, its factor and unit in the table
SIZES |= {causes.rotor(i): ("a", -100, "%") for i in ROTORS}
ASKED = {
    "healthy": "healthy",
    "rotor": "one rotor, 3 mm or more",
    "pair": "two rotors, 4 mm or more together",
    "payload": "payload",
    SLUNG: "slung load",
}


def conditions(flights, rows):
    """[(condition, its rows)] in the order of the labels."""
    found = {}
    for flight, row in zip(flights, rows):
        found.setdefault(flight.condition, []).append(row)
    return list(found.items())


def changed(flights, rows):
    """What was flown, and whether something is said to have changed."""
    lines = []
    for condition, some in conditions(flights, rows):
        unchanged = [f"{extreme(row['unchanged'] for row in some):.2f}" for extreme in (min, max)]
        loss, mass = (median(row["smallest"][name] for row in some) for name in (causes.rotor(3), causes.PAYLOAD))
        named = sum(row["changed"] for row in some)
        lines.append([condition, len(some), named, *unchanged, number(100 * loss, 2), number(1e3 * mass, 2)])
    headers = [
        "condition", "flights", "changed", "nothing changed: probability, min", "the same, max",
        "smallest loss of rotor 3 that would show (%)", "smallest payload (g)",
    ]  # fmt: skip
    return (f"{SOURCE}: conditions", headers, lines)


def _size(rows, name):
    """[value, low, high, unit]: medians over the flights that name an effect, in the units of the table."""
    found = [cause for row in rows for cause in row["named"] if cause["name"] == name]
    if not found or name not in SIZES:
        return ["-"] * 4
    key, factor, unit = SIZES[name]
    values = np.array([[c["params"][key][0], *c["params"][key][1]] for c in found])
    value, *ends = factor * np.median(values, axis=0)
    return [*(number(float(v), 2) for v in (value, *sorted(ends))), unit]


def not_changed(row):
    return not row["changed"]


def unknown(row):
    return row["changed"] and not row["named"]


def said(flights, rows):
    """What was named and declared, with sizes: a line for each effect of a condition."""
    lines = []
    for condition, some in conditions(flights, rows):
        named = [[cause["name"] for cause in row["named"]] for row in some]
        declared = [row["declared"] for row in some]
        names = dict.fromkeys(name for part in (*named, *declared) for name in part)
        for name in names:
            first, both = (sum(name in part for part in kind) for kind in (named, declared))
            lines.append([condition, f"`{name}`", first, both, *_size(some, name)])
        for name, test in (("none", not_changed), ("unknown", unknown)):
            lines += [[condition, name, sum(map(test, some)), 0, *["-"] * 4]] * any(map(test, some))
    headers = ["condition", "effect", "named (flights)", "declared (flights)", "size", "95 %, from", "to", "unit"]
    return (f"{SOURCE}: what was said, sizes as medians over the flights that name the effect", headers, lines)


def held(lines):
    """What must hold."""
    cells = []
    for what, value, count, wanted in lines:
        share = value if count is None else value / count if count else None
        cells.append([what, "-" if count is None else value, "-" if count is None else count, number(share, 2), number(wanted, 2)])
    return (f"{SOURCE}: what must hold", ["", "flights", "of", "share or coefficient", "required"], cells)


def peers(flights, found):
    """Counts right of the diagnoser and of its peers, {who: {flight: Answer}}."""
    kinds = {kind: [one for one in flights if one.asks == kind] for kind in ASKED}
    loads = kinds["payload"] + kinds[SLUNG]
    lines = [["flights", *map(len, kinds.values()), len(loads), len(flights), len(flights)]]
    for who, said in found.items():
        counts = [sum(answers.right(one, said[one.name]) for one in some) for some in kinds.values()]
        place = sum(answers.near(one, said[one.name]) for one in loads)
        known = [one for one in flights if said[one.name].confidence is not None]
        sure = [one for one in known if said[one.name].confidence > answers.SURE]
        wrong = sum(answers.sure_and_wrong(one, said[one.name]) for one in sure)
        lines.append([who, *counts, place, *([len(sure), wrong] if known else ["-", "-"])])
    headers = ["", *ASKED.values(), "rotor next to a load in the set", "confidence over 0.9", "of these wrong"]
    return (f"{SOURCE}: flights answered rightly", headers, lines)


def sensitivity(lines):
    """How many answers another constant changes."""
    headers = [
        "instead", "flights", "other causes named", "other causes in the set", "flights whose cause must be found",
        "right as it is", "right with it",
    ]  # fmt: skip
    return (f"{SOURCE}: how many answers change", headers, lines)


def tables(flights, rows, holds, found, changes):
    """{region of the page, without flights-: table}."""
    return {
        "holds": held(holds),
        "changed": changed(flights, rows),
        "said": said(flights, rows),
        "peers": peers(flights, found),
        "sensitivity": sensitivity(changes),
    }


def write(tables, out):
    """Takes tables and figure over into docs/."""
    for name, table in tables.items():
        pages.update(PAGE, f"flights-{name}", pages.table(*table))
    pages.picture(out / FIGURE)


# ---- figure ------------------------------------------------------------------------------------------


LOOKS = (("o", "k", -0.22), ("s", "0.55", 0.22))  # marker and colour of each vehicle, and its offset at 0 mm, which both have
WIDE = 0.18  # mm, by which flights of the same cut are spread to either side


def _points(rows, rotor):
    """{mm: [(loss, low, high) in %]} of a rotor, of healthy flights and those with cut propellers."""
    found = {}
    for row in rows:
        if row["family"] in ("none", "rotor"):
            mm = dict(zip(row["rotors"].split("+"), row["size"].split("+"))).get(f"M{rotor}", 0)
            found.setdefault(float(mm), []).append(100 * np.array(answers.loss(row, rotor)))
    return found


def _errors(ax, x, points, **look):
    """Points with their intervals; open ones where the rotor is not named."""
    value, low, high = np.transpose(points)
    for is_named, face in ((value > 0, look["color"]), (value == 0, "w")):
        apart = np.stack([value - low, high - value])[:, is_named]
        ax.errorbar(x[is_named], value[is_named], apart, ls="none", ms=4, lw=1, mfc=face, **look)


def draw(out, rows):
    """Estimated loss of each rotor's thrust over what its propeller was shortened by."""
    figure, axes = plots.subplots(1, 4, figsize=(11, 3.6), sharex=True, sharey=True)
    figure.suptitle("The longer the cut, the larger the estimated loss of thrust; cuts of 1 mm do not show", x=0.01, ha="left")
    vehicles = dict(zip(dict.fromkeys(row["vehicle"] for row in rows), LOOKS))
    for rotor, ax in zip(ROTORS, axes):
        for vehicle, (marker, color, side) in vehicles.items():
            for mm, points in _points([row for row in rows if row["vehicle"] == vehicle], rotor).items():
                _errors(ax, mm + side * (mm == 0) + np.linspace(-WIDE, WIDE, len(points)), points, marker=marker, color=color)
        ax.set_title(f"rotor {rotor}")
        ax.set_xlabel("propeller shortened by (mm)")
    axes[0].set_ylabel("estimated loss of thrust (%)")
    for vehicle, (marker, color, _) in vehicles.items():
        axes[0].plot([], [], marker, color=color, ls="none", label=f"vehicle {vehicle}, with 95 % interval")
    axes[0].plot([], [], "o", color="k", mfc="w", label="open: this rotor is not named")
    plots.legend(figure)
    plots.save(figure, out / FIGURE)
