"""The sim-to-real gap of a flapping-wing flight: the simulated vehicle is held to the log by an observer.

Data flow: vehicle (the observer) -> innovations (whitened, against a baseline of healthy flights) -> search of effects and
stretches -> evidence, generic -> gap, where, advise -> diagnosis (the report) -> page (what people read).
"""

from ...results import output_folder, write_bytes, write_json
from .. import in_log_time
from . import page, words
from .diagnosis import diagnose, load


def run(path, out, fresh=None, without=(), healthy=None):
    """Diagnoses a flight; writes report.json and report.html to `out` and prints the summary."""
    log = load(path)
    fresh_log, own = load(fresh) if fresh else None, load(healthy) if healthy else None
    out = output_folder(out)
    result = diagnose(log, fresh_log, without, own)
    result.report = {"log_file": str(path), "fresh_file": str(fresh) if fresh else None, **result.report}
    write_json(out / "report.json", in_log_time(result.report, float(log.t[0])))
    write_bytes(out / "report.html", page.html(result))
    words.print_summary(result.report, out / "report.html")
    return result
