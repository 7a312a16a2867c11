"""A diagnosis as an MCAP file for Foxglove: what was measured and predicted, the residuals, and when effects act, with a layout beside it."""

import io
import json
from pathlib import Path

from ...plumbing import checkout
from ...plumbing.errors import UserError
from ...plumbing.results import output_folder, printable, write_bytes
from ..report.terminal import say
from . import layout, messages, tracks


def prepare(path):
    """Refuses a file that could not be written after the diagnosis, before it."""
    try:
        import mcap  # noqa: F401
    except ImportError:
        raise UserError(f"--mcap: the package mcap is missing; {checkout.install('mcap')}") from None
    output_folder(Path(path).parent)


def _bytes(channels):
    """The file of channels {topic: (schema, [(ns, message)])}, in the order of time."""
    from mcap.writer import Writer

    file = io.BytesIO()
    writer = Writer(file)
    writer.start(profile="", library="tinykoop")
    known, rows = {}, []
    for topic, (schema, some) in channels.items():
        title = schema["title"]
        if title not in known:
            known[title] = writer.register_schema(title, "jsonschema", json.dumps(schema).encode())
        channel = writer.register_channel(topic, "json", known[title])
        rows += [(at, channel, message) for at, message in some]
    for at, channel, message in sorted(rows, key=lambda row: row[0]):
        writer.add_message(channel, log_time=at, publish_time=at, data=json.dumps(message).encode())
    writer.finish()
    return file.getvalue()


def write(result, path):
    """Writes the file and its layout."""
    shown = tracks.of(result)
    channels = messages.channels(shown, result.report)
    beside = Path(path).with_suffix(".layout.json")
    write_bytes(path, _bytes(channels))
    write_bytes(beside, (json.dumps(layout.of(channels), indent=1) + "\n").encode())
    say(f"Recording: {printable(path)}, with the Foxglove layout {printable(beside.name)}")
