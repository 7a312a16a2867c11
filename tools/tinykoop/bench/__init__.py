"""Side by side with peers: an update of the model (update), and a solve of the controller (solve)."""

from ..plumbing import results
from . import page
from . import solve as solving
from . import update as updating


def run(out_dir, build_dir, update=False):
    """Measures everything; writes bench.json and the plots into out_dir, and with `update` docs/benchmarks.md; returns the rows.

    build_dir was configured with -DTINYKOOP_BENCH=ON.
    """
    out_dir = results.output_folder(out_dir)
    rows = []
    with results.replacing(out_dir / "bench.json", rows):
        rows += updating.run(out_dir, build_dir)
        rows += solving.run(out_dir, build_dir)
    if update:
        page.write(rows)
    return rows
