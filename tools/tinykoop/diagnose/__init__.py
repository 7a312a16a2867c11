"""The sim-to-real gap of one log: where it lies, which unmodelled effect causes it, how far it shrinks.

Data flow: pieces (whitened residuals) -> noise -> search of effects, with phases -> verdict -> measure,
where, advise -> diagnosis (the report) -> page (what people read).
"""

from ..errors import UserError
from ..results import output_folder, write_bytes, write_json
from . import page, words
from .diagnosis import diagnose, in_log_time, load
from .platform import PLATFORMS


def run(path, out, fresh=None, platform="ddr", without=(), healthy=None):
    """Diagnoses a log file; writes report.json and report.html to `out` and prints the summary."""
    if platform == "fwmav":
        from . import flight

        return flight.run(path, out, fresh, without, healthy)
    if healthy:
        raise UserError("--healthy: only the flapping wing is fitted to a healthy log; leave it out, or add --platform fwmav")
    robot = PLATFORMS[platform]()
    log = load(path, robot)
    fresh_log = load(fresh, robot) if fresh else None
    out = output_folder(out)
    result = diagnose(log, robot, fresh_log, without)
    # page and summary count seconds from the first row
    result.report = {"log_file": str(path), "fresh_file": str(fresh) if fresh else None, **result.report}
    write_json(out / "report.json", in_log_time(result.report, float(log.t[0])))
    write_bytes(out / "report.html", page.html(result))
    words.print_summary(result.report, out / "report.html")
    return result
