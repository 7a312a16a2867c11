"""Side by side with peers: an update of the model (update), and a solve of the controller (solve)."""

from ..plumbing import results
from . import solve, update


def run(out_dir, build_dir):
    """Measures everything; writes bench.json and the plots into out_dir; returns the rows.

    build_dir was configured with -DTINYKOOP_BENCH=ON.
    """
    out_dir = results.output_folder(out_dir)
    rows = []
    with results.replacing(out_dir / "bench.json", rows):
        rows += update.run(out_dir, build_dir)
        rows += solve.run(out_dir, build_dir)
    return rows
