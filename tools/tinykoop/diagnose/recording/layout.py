"""A layout of Foxglove's panels for the recording: the paths in space, the residuals of each signal, and the events."""


def _plot(topics, signal):
    paths = [
        {"value": f"{topic}.{signal}", "label": topic.split("/")[1], "enabled": True, "timestampMethod": "receiveTime"} for topic in topics
    ]
    return {"title": f"residual of {signal}", "paths": paths, "xAxisVal": "timestamp", "showLegend": True, "isSynced": True}


def _stacked(panels, direction):
    """Panels beside each other, each as large as the others."""
    first, *rest = panels
    if not rest:
        return first
    return {"direction": direction, "first": first, "second": _stacked(rest, direction), "splitPercentage": 100 / len(panels)}


def of(channels):
    """The layout for channels {topic: (schema, ..)}."""
    residuals = [topic for topic in channels if topic.endswith("/residuals")]
    signals = channels[residuals[0]][0]["properties"]
    plots = {f"Plot!{signal}": _plot(residuals, signal) for signal in signals}
    shown = [topic for topic in channels if topic.endswith("/pose") or topic == "/predictions"]
    space = {"3D!paths": {"topics": {topic: {"visible": True} for topic in shown}, "followMode": "follow-none"}} if shown else {}
    log = {"RosOut!events": {"topicToRender": "/events", "searchTerms": [], "minLogLevel": 1}}
    columns = [_stacked([*space, *log], "column"), _stacked(list(plots), "column")]
    return {
        "configById": {**space, **log, **plots}, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 1},
        "layout": _stacked(columns, "row"),
    }  # fmt: skip
