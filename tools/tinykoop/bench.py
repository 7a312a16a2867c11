"""Side by side with peers: an update of the model (bench_rls), and a solve of the controller (bench_qp)."""

from . import bench_qp, bench_rls, results


def run(out_dir, build_dir):
    """Measures everything; writes bench.json and the plots into out_dir; returns the rows.

    build_dir was configured with -DTINYKOOP_BENCH=ON.
    """
    out_dir = results.output_folder(out_dir)
    rows = []
    with results.replacing(out_dir / "bench.json", rows):
        rows += bench_rls.run(out_dir, build_dir)
        rows += bench_qp.run(out_dir, build_dir)
    return rows
