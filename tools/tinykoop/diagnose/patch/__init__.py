"""The fix handed back: what a report found, as a change of the file that holds the simulator's numbers."""

import difflib
import hashlib
import json
from pathlib import Path

import numpy as np

from ...plumbing.errors import UserError
from ...plumbing.results import printable, write_bytes
from ..report.terminal import say
from ..standing import FAULTS
from . import c, diff_drive, mjcf, python, sdf, toml, urdf

WRITERS = {
    ".toml": toml, ".yaml": diff_drive, ".yml": diff_drive, ".xml": mjcf, ".urdf": urdf, ".xacro": urdf, ".sdf": sdf, ".py": python, ".c": c,
}  # fmt: skip
NEW = (python, c)  # a file that is not there yet is begun
MARKS = {".c": "/* {} */"} | dict.fromkeys((".xml", ".urdf", ".xacro", ".sdf"), "<!-- {} -->")  # comments; of others: # {}


def _report(path):
    try:
        report = json.loads(Path(path).read_text())
        verdict, effects = report["verdict"], report["effects"]
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); `tinykoop diagnose LOG` writes it as report.json") from error
    except (ValueError, KeyError, TypeError) as error:
        raise UserError(f"{path}: is no report of `tinykoop diagnose`; give its report.json") from error
    if verdict != "known" or not effects:
        raise UserError(f"{path}: the verdict is '{verdict}', so there is nothing to patch; record another log and diagnose that")
    if report.get("platform") == "quadrotor":
        raise UserError(
            f"{path}: the file of a vehicle holds none of these effects; add them to your simulator by hand (docs/quadrotor.md)"
        )
    for effect in effects:
        if effect["name"] in FAULTS:
            raise UserError(f"{path}: {effect['name']} is a fault of the robot, not of the simulator; correct it and record another log")
        if not _all_along(effect, report):
            raise UserError(f"{path}: {effect['name']} acts in a part of the log only; a simulator's number cannot say that")
        if "form" in effect:
            form = f"{effect['form']}: {effect['formula']}"
            raise UserError(
                f"{path}: {effect['name']} was found in a form that no file can hold; add it to your simulator by hand ({form})"
            )
    return report


def _all_along(effect, report):
    return not effect["segments"] or len(effect["segments"]) == 1 and np.ptp(effect["segments"]) >= 0.999 * report["log"]["seconds"]


def patched(report, path):
    """(text of the file, text with the effects of the report in it)."""
    writer = WRITERS.get(path.suffix)
    if writer is None:
        raise UserError(f"{path}: --into takes {', '.join(WRITERS)}; copy the sizes from the report's table by hand")
    try:
        text = path.read_text() if path.exists() or writer not in NEW else ""
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: cannot be read ({error})") from error
    if all(effect.get("field") for effect in report["effects"]) and path.suffix in MARKS:  # the number itself is written
        return text, writer.patched(text, report, path)
    mark = MARKS.get(path.suffix, "# {}").format(f"tinykoop patch {_key(report)}")
    if mark in text:
        raise UserError(f"{path}: has the effects of this report already ({mark}); diagnose a new log with it")
    new = writer.patched(text, report, path)
    return text, f"{new}{'' if new.endswith(chr(10)) else chr(10)}{mark}\n"


def _key(report):
    """What distinguishes a report: its effects, which a file shall get once."""
    return hashlib.sha256(json.dumps(report["effects"], sort_keys=True).encode()).hexdigest()[:12]


def difference(text, new, name):
    """The change as `patch` takes it."""
    lines = difflib.unified_diff(*(part.splitlines(keepends=True) for part in (text, new)), name, name)
    return "".join(line if line.endswith("\n") else f"{line}\n\\ No newline at end of file\n" for line in lines)


def run(report_file, into, write=False):
    """Prints the change as a diff; with `write` makes it."""
    into = Path(into)
    report = _report(report_file)
    text, new = patched(report, into)
    print(difference(text, new, printable(into)), end="")
    for name, others in report.get("ambiguous_with", {}).items():
        say(f"{name} may as well be {' or '.join(others)}: the log cannot separate them.")
    if write:
        write_bytes(into, new.encode())
        say(f"Written: {printable(into)}. Diagnose a fresh log with it to see that the gap closes.")
