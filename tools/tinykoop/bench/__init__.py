"""Side by side with peers: an update of the model (update), a solve of the controller (solve), learners in Python (learners)."""

from ..plumbing import results
from ..plumbing.errors import UserError
from . import learners, page
from . import solve as solving
from . import update as updating


def run(out_dir, build_dir, update=False, quick=False):
    """Measures everything; writes bench.json and the plots into out_dir, and with `update` docs/benchmarks.md; returns the rows.

    build_dir was configured with -DTINYKOOP_BENCH=ON. quick: one round over few instances, which shows that it runs.
    """
    if update and quick:
        raise UserError("--update: one round is too few for the docs; leave out --quick")
    out_dir = results.output_folder(out_dir)
    rows = []
    with results.replacing(out_dir / "bench.json", rows):
        rows += updating.run(out_dir, build_dir, *((1,) if quick else ()))
        rows += solving.run(out_dir, build_dir, *((1, solving.FEW) if quick else ()))
        rows += learners.run(*((1, learners.FEW_ROWS) if quick else ()))
    if update:
        page.write(rows)
    return rows
