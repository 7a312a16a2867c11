"""The tables of docs/benchmarks.md, from the rows of bench.json."""

from ..experiments import scenario
from ..plumbing import pages
from ..plumbing.results import number
from . import learners
from .update import REPLAY_REGULATORS

COLUMNS = {
    "float32 -O2": ("f32", "_O2"),
    "float32 -O3 native": ("f32", ""),
    "float64 -O2": ("f64", "_O2"),
    "float64 -O3 native": ("f64", ""),
}
SOLVES = {
    "recovery cold": ("cold", ""),
    "recovery warm": ("warm", ""),
    "tracking cold": ("cold", ", tracking"),
    "tracking warm": ("warm", ", tracking"),
}
OURS = {"TinyKoop -O2": "", "TinyKoop -O3 native": "_O3", "TinyKoop -O2, without a matrix": ", gradient"}

COLD_ONLY = "no warm start"


def _cell(row, key, digits=None):
    """A figure of a row, or a dash where there is no row; times as whole numbers with separators."""
    if row is None:
        return "-"
    return f"{row[key]:,.0f}" if digits is None else f"{row[key]:.{digits}f}"


def update_table(rows):
    """ns of one update."""
    row = {r["task"]: r for r in rows}
    at = {name: [row[f"rls_update_{p}{s}{name}"] for p, s in COLUMNS.values()] for name in ("", "_sqrt", "_checked")}
    python = {
        name: [row.get(f"rls_update_{p}_{name}") if s == "_O2" else None for p, s in COLUMNS.values()] for name in ("numpy", "padasip")
    }
    lines = [
        ["TinyKoop, any N and m", *(_cell(r, "ours") for r in at[""])],
        ["Eigen, sizes fixed at compile time", *(_cell(r, "peer") for r in at[""])],
        ["Eigen / TinyKoop, median of pairs", *(_cell(r, "ratio", 2) for r in at[""])],
        ["NumPy", *(_cell(r, "peer") for r in python["numpy"])],
        ["padasip, 1 of 22 outputs", *(_cell(r, "peer") for r in python["padasip"])],
        ["TinyKoop, square-root form", *(_cell(r, "ours") for r in at["_sqrt"])],
        ["TinyKoop, P factored at every update", *(_cell(r, "ours") for r in at["_checked"])],
    ]
    return pages.table("One update, N = 22, m = 2: median ns", ["", *COLUMNS], lines)


def replay_table(rows):
    """Million samples per second of a whole replay."""
    row = {r["task"]: r for r in rows}
    sizes = sorted({int(task.split("_")[2][1:]) for task in row if task.startswith("replay_")})
    columns = {
        f"N = {N}, {name}": f"replay_f32_N{N}_{{}}{suffix}" for N in sizes for name, suffix in (("plain", ""), ("square root", "_sqrt"))
    }
    lines = [
        [scenario.LABELS[regulator], *(f"{row[task.format(regulator)]['samples_per_second'] / 1e6:.2f}" for task in columns.values())]
        for regulator in REPLAY_REGULATORS
    ]
    return pages.table(
        "Replay of a log from lift to update, float32 -O2, one core: million samples per second", ["regulator", *columns], lines
    )


def _peer(row):
    """Who it is, without settings; CVXPY comes in two forms."""
    parts = row["peer_name"].split(", ")
    return ", ".join(parts[:2] if parts[0] == "CVXPY" else parts[:1])


def solve_table(rows):
    """us of one solve by everyone, and the largest share of the nearest peer's time."""
    wanted = {name: f"qp_{mode}_1e-6_f64{{}}{kind}" for name, (mode, kind) in SOLVES.items()}
    found = {
        name: [r for r in rows if r["task"] == task.format("") and not r["peer_name"].endswith(COLD_ONLY)] for name, task in wanted.items()
    }
    labels = dict.fromkeys(_peer(r) for some in found.values() for r in some)
    lines = [[label, *(_cell(_ours(rows, task, suffix), "ours") for task in wanted.values())] for label, suffix in OURS.items()]
    for label in labels:
        lines.append([label, *(_cell(next((r for r in some if _peer(r) == label), None), "peer") for some in found.values())])
    nearest = [min(some, key=lambda r: r["ratio"]) if some else None for some in found.values()]
    lines.append(["TinyKoop -O2 / nearest peer, median of pairs", *("-" if r is None else number(1 / r["ratio"], 2) for r in nearest)])
    return pages.table("One solve, float64, u within 1e-6 on every step: median us", ["", *SOLVES], lines)


def _ours(rows, task, suffix):
    name = f"{task.format('')}{suffix}" if suffix.startswith(",") else task.format(suffix)
    return next((r for r in rows if r["task"] == name), None)


def python_table(rows):
    """Learners in Python, and what was asked of 5,000 updates."""
    title = (
        f"Learners in Python, N = {learners.SIZE}, m = 2, float64: errors are RMS position errors on {learners.HELD_OUT:,} held-out rows"
    )
    updates = pages.facts(f"{learners.ROWS:,} updates from Python, N = 22, m = 2, float32", learners.claim_lines(rows))
    return pages.table(title, *learners.table(rows)) + "\n" + updates


def write(rows):
    """Writes the tables, and the figure of the README."""
    for name, contents in (("update", update_table), ("replay", replay_table), ("solve", solve_table), ("python", python_table)):
        pages.update("docs/benchmarks.md", f"bench-{name}", contents(rows))
    (main,) = [r for r in rows if r["task"] == "rls_update_f32_O2"]
    pages.headline("eigen", f"{1 / main['ratio']:.2f}")
