"""Results on disk and on the terminal."""

import json
import math
import os
import re
from pathlib import Path

from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from .errors import UserError

_terminal = Console()
# Tables are made for 110 columns; where the width is unknown (a pipe, CI) that is what they get.
console = _terminal if _terminal.width >= 110 else Console(width=110)


def _finite(value):
    """JSON knows neither NaN nor infinity: null."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def output_folder(path):
    """The folder, made if need be."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path}: cannot be made as output folder ({error.strerror}); choose another with --out")
    return path


def write_bytes(path, data):
    """Writes the whole file or none of it."""
    path = Path(path)
    beside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        beside.write_bytes(data)
        os.replace(beside, path)
    except OSError as error:
        beside.unlink(missing_ok=True)
        raise UserError(f"{path}: cannot be written ({error.strerror}); check folder, rights and free space")


def write_json(path, rows):
    """Writes `rows` as JSON, numbers that are not finite as null."""
    write_bytes(path, (json.dumps(_finite(rows), indent=1) + "\n").encode())


def number(value, digits=3):
    """A number for a table, a dash for none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    if isinstance(value, int):
        return str(value)
    return re.sub(r"e\+?(-?)0*", r"e\1", f"{value:.{digits}g}")


def print_table(title, headers, rows, note=""):
    """A table whose first column is text and whose others are figures."""
    table = Table(
        title=f"\n{title}", caption=note, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    for i, header in enumerate(headers):
        table.add_column(header, justify="right" if i else "left", no_wrap=True)
    for row in rows:
        table.add_row(*[str(cell) for cell in row])
    console.print(table)


def progress(items, description):
    """Iterates over a list with a progress bar on the terminal."""
    return track(items, description=f"{description:<28}", console=console, transient=True)
