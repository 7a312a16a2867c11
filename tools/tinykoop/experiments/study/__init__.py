"""What the paper's control table leaves open: which Poly runs fail and why, and the sensitivities that control sees.

Bistability: each method tracks from many starts around the reference, with several solvers, precisions,
forms of P and ways to begin. A run has failed when its mean error is above FAILED; failures are counted, with
Wilson's 95 % interval. The k-th run of every setting begins at the k-th offset of one sequence, so settings
differ by nothing else.

Mechanism: two runs of vanilla Poly that begin TWIN_DISTANCE apart, of which one fails; and interventions
on each suspect, of which only the causes can change the count.

Sensitivities: C A^j B, what the learned model says that an input does to the states j + 1 steps later, against
finite differences of the simulated robot under the inputs it was given afterwards.

Horizon: every method over 10, 20 and 50 steps, from the same starts: the error, and which runs are lost.
"""

from ...plumbing import pages
from ...plumbing.errors import UserError
from ...plumbing.results import output_folder, progress, replacing
from .. import scenario
from . import bistability, causes, figures, horizons, sensitivities, solvers, tables
from .closed_loop import scene


def run(out, runs, update=False):
    """Writes study.json and its plots into `out`, and with `update` the tables of docs/control.md; returns the rows."""
    if runs < 1:
        raise UserError(f"--runs is {runs}, it must be at least 1")
    for name in ("daqp", "osqp"):
        solvers.peer(name)
    out = output_folder(out)
    paper = scene()
    compared = {method: sensitivities.compare(paper, method) for method in progress(scenario.METHODS, "sensitivities")}
    seen = [row for row, _ in compared.values()]
    changed = causes.interventions(paper, runs)
    rescued = causes.rescue(paper, runs)
    traced = causes.twins(paper, runs)
    parts = [causes.anatomy(paper, trace) for trace in traced] if traced else None
    parted = [causes.twin_row(traced, parts)] if traced else []
    cells = bistability.bistability(paper, runs)
    ahead = horizons.horizons(paper, max(1, runs // 4))
    rows = cells + ahead + changed + rescued + parted + seen
    with replacing(out / "study.json", rows):
        figures.draw_bistability(out, cells)
        if traced:
            figures.draw_mechanism(out, parts, changed)
        figures.draw_sensitivities(out, compared)
        figures.draw_horizons(out, ahead)
    tables.report(cells, ahead, changed, rescued, parted, seen)
    if update:
        pages.update("docs/control.md", "study", tables.page(cells, changed))
        pages.update("docs/control.md", "horizons", "\n".join(pages.table(*table) for table in tables.by_horizon(ahead)))
    return rows
