"""Messages as Foxglove's schemas have them (foxglove.PoseInFrame, SceneUpdate, Log: foxglove-sdk, schemas/jsonschema), in JSON.

What is no pose goes by a schema of its own, tinykoop.Signals: a number for each signal.
"""

import re

import numpy as np

from ..report.words import percent
from .tracks import POSE

FRAME, INFO = "world", 2  # of all poses; level of a log's message
COLOURS = {"measured": (0.2, 0.2, 0.2), "simulator": (0.85, 0.33, 0.1), "with_effects": (0.0, 0.45, 0.7)}
WIDTH = 3.0  # pixels of a line
NUMBER, TEXT, WHOLE, FLAG = ({"type": kind} for kind in ("number", "string", "integer", "boolean"))
PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")


# ---- schemas ---------------------------------------------------------------------------------------------------


def _object(title="", **properties):
    return ({"title": title} if title else {}) | {"type": "object", "properties": properties, "required": list(properties)}


def _list(items):
    return {"type": "array", "items": items}


TIME = _object("time", sec=WHOLE, nsec=WHOLE)
POINT = _object(x=NUMBER, y=NUMBER, z=NUMBER)
PLACE = _object(position=POINT, orientation=_object(x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER))
COLOUR = _object(r=NUMBER, g=NUMBER, b=NUMBER, a=NUMBER)
LINE = _object(
    type=WHOLE,
    pose=PLACE,
    thickness=NUMBER,
    scale_invariant=FLAG,
    points=_list(POINT),
    color=COLOUR,
    colors=_list(COLOUR),
    indices=_list(WHOLE),
)
ENTITY = _object(
    timestamp=TIME, frame_id=TEXT, id=TEXT, lifetime=_object("duration", sec=WHOLE, nsec=WHOLE), frame_locked=FLAG,
    metadata=_list(_object(key=TEXT, value=TEXT)), **{name: _list(LINE if name == "lines" else _object()) for name in PRIMITIVES},
)  # fmt: skip
POSE_IN_FRAME = _object("foxglove.PoseInFrame", timestamp=TIME, frame_id=TEXT, pose=PLACE)
SCENE_UPDATE = _object("foxglove.SceneUpdate", deletions=_list(_object()), entities=_list(ENTITY))
LOG = _object("foxglove.Log", timestamp=TIME, level=WHOLE, message=TEXT, name=TEXT, file=TEXT, line=WHOLE)


def key(name):
    """A signal's name as paths of messages take it."""
    return re.sub(r"\W", "_", name)


def _signals(signals):
    return _object("tinykoop.Signals", **{key(name): NUMBER | {"description": unit} for name, unit in signals}) | {"required": []}


# ---- messages --------------------------------------------------------------------------------------------------


def _time(ns):
    return {"sec": ns // 10**9, "nsec": ns % 10**9}


def _point(x, y, z=0.0):
    return {"x": float(x), "y": float(y), "z": float(z)}


def _placed(pose, row):
    """Position and orientation of a row of signals; what is not known of them is zero."""
    from scipy.spatial.transform import Rotation  # most diagnoses write no recording: they start a quarter of a second earlier without it

    at = {axis: float(row[pose[axis]]) if axis in pose else 0.0 for axis in POSE}
    turned = Rotation.from_euler("ZYX", [at["yaw"], at["pitch"], at["roll"]]).as_quat()
    return {"position": _point(at["x"], at["y"], at["z"]), "orientation": dict(zip("xyzw", map(float, turned)))}


def _poses(pose, times, values):
    there = np.isfinite(values[:, list(pose.values())]).all(1)
    return [
        (ns, {"timestamp": _time(ns), "frame_id": FRAME, "pose": _placed(pose, row)})
        for ns, row, is_there in zip(times, values, there)
        if is_there
    ]


def _numbers(signals, times, values):
    """Rows that have a number at all; one that is missing is left out."""
    names = [key(name) for name, _ in signals]
    rows = [(ns, {name: float(v) for name, v in zip(names, row) if np.isfinite(v)}) for ns, row in zip(times, values)]
    return [row for row in rows if row[1]]


def _line(pose, values, kind):
    points = values[:, [pose["x"], pose["y"]]]
    identity = {"position": _point(0, 0), "orientation": _point(0, 0) | {"w": 1.0}}
    return {
        "type": 0, "pose": identity, "thickness": WIDTH, "scale_invariant": True, "color": dict(zip("rgba", (*COLOURS[kind], 1.0))),
        "points": [_point(*point) for point in points[np.isfinite(points).all(1)]], "colors": [], "indices": [],
    }  # fmt: skip


def _entity(ns, kind, line):
    lists = {name: [] for name in PRIMITIVES} | {"lines": [line]}
    return {
        "timestamp": _time(ns), "frame_id": FRAME, "id": kind, "lifetime": _time(0), "frame_locked": False, "metadata": [], **lists,
    }  # fmt: skip


def _scenes(tracks, times):
    """The predictions of each window as lines, beside what was measured."""
    kinds = {"measured": tracks.measured} | tracks.predicted
    for a, b in tracks.windows:
        lines = {kind: _line(tracks.pose, values[a : b + 1], kind) for kind, values in kinds.items()}
        yield times[a], {"deletions": [], "entities": [_entity(times[a], kind, line) for kind, line in lines.items()]}


def _said(report):
    """[(s from the first row, sentence)] of what comes, goes, and where the gap is."""
    end = report["log"]["seconds"]
    yield 0.0, f"Verdict: {report['verdict']}"
    for effect in report["effects"] or report.get("best_fit", []):
        sizes = ", ".join(f"{name} = {value:.4g} {effect['units'][name]}" for name, value in effect["params"].items())
        for start, stop in effect["segments"]:
            yield start, f"{effect['name']} begins: {sizes}"
            yield min(stop, end), f"{effect['name']} ends"
    for start, stop, share in report["where"]["segments"] if report["verdict"] != "none" else ():
        yield start, f"{percent(share)} of the gap lies between here and {stop - start:.3g} s later"


def _events(report, ns_of):
    for seconds, text in _said(report):
        ns = ns_of(seconds)
        yield ns, {"timestamp": _time(ns), "level": INFO, "message": text, "name": "tinykoop", "file": "", "line": 0}


def channels(tracks, report):
    """{topic: (schema, [(ns, message)])}; time is the log's own, or begins at 0 where that begins before."""
    ns_of = lambda seconds: round((max(float(tracks.t[0]), 0.0) + seconds) * 1e9)  # noqa: E731
    times, kinds = [ns_of(t - tracks.t[0]) for t in tracks.t.tolist()], {"measured": tracks.measured} | tracks.predicted
    found, schema = {}, _signals(tracks.signals)
    for kind, values in kinds.items():
        if tracks.pose:
            found[f"/{kind}/pose"] = POSE_IN_FRAME, _poses(tracks.pose, times, values)
        found[f"/{kind}/signals"] = schema, _numbers(tracks.signals, times, values)
    for kind in tracks.predicted:
        found[f"/{kind}/residuals"] = schema, _numbers(tracks.signals, times, tracks.residuals(kind))
    if tracks.pose:
        found["/predictions"] = SCENE_UPDATE, list(_scenes(tracks, times))
    found["/events"] = LOG, list(_events(report, ns_of))
    return found
