"""Results on disk and on the terminal."""

import glob
import json
import math
import os
import re
import sys
from contextlib import ExitStack, contextmanager
from pathlib import Path

from rich import box
from rich.cells import cell_len
from rich.console import Console
from rich.markup import escape
from rich.padding import Padding
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn, track
from rich.table import Table

from .errors import UserError
from .locks import locked

MOST_KEYS = 3  # columns that are repeated where a table is too wide


class _Console(Console):
    def on_broken_pipe(self):
        raise  # rich would end the process here with its own status; cli.main() says which one


console = _Console(markup=False)  # brackets in the name of a file are no style; a pipe is as wide as a terminal of 80 columns


def printable(name):
    """The name of a file as text for pages, plots and JSON: its bytes that are not UTF-8, which Linux allows, become \\xff."""
    return str(name).encode("utf-8", "surrogateescape").decode("utf-8", "backslashreplace")


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
    """The folder, made if need be; refused before the work if nothing can be written there."""
    path = Path(path)
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{path}: cannot be made as output folder ({error.strerror}); choose another with --out")
    if not os.access(path, os.W_OK | os.X_OK):
        raise UserError(f"{path}: nothing can be written there; mend its rights, or choose another folder with --out")
    return path


def _refused(path, error):
    """What to say where `path` cannot be written."""
    return UserError(f"{path}: cannot be written ({error.strerror}); check folder, rights and free space")


def _is_running(process):
    if sys.platform == "win32":
        return True  # signal 0 would interrupt it there
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True


def sweep(path):
    """Removes what runs that were killed have left half-written beside `path`."""
    for part in glob.glob(f"{glob.escape(str(path))}.*.part"):
        process = part.split(".")[-2]
        if process.isdigit() and not _is_running(int(process)):
            Path(part).unlink(missing_ok=True)


def write_bytes(path, data):
    """Writes the whole file or none of it, whenever this is killed or the power goes; of two at once the last one stays."""
    path = Path(path)
    beside = path.with_name(f"{path.name}.{os.getpid()}.part")
    try:
        sweep(path)
        with open(beside, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)
    except OSError as error:
        raise _refused(path, error)
    finally:
        beside.unlink(missing_ok=True)


def write_json(path, rows):
    """Writes `rows` as JSON, numbers that are not finite as null."""
    write_bytes(path, (json.dumps(_finite(rows), indent=1) + "\n").encode())


def remove(path):
    """Removes a result, if it is there."""
    try:
        Path(path).unlink(missing_ok=True)
    except OSError as error:
        raise _refused(path, error)


@contextmanager
def replacing(path, rows):
    """Writes `rows` as JSON once the block has written what belongs to them: plots, pages.

    Until then there is no `path`, so that old figures never stand beside new plots. Another run into the folder waits.
    """
    path = Path(path)
    with locked(path.parent):
        remove(path)
        yield
        write_json(path, rows)


@contextmanager
def alone(path):
    """Refuses a second run that would work on `path` at the same time."""
    lock = Path(path).with_name(f".{Path(path).name}.lock")
    with ExitStack() as held:
        try:
            held.enter_context(locked(lock, wait=False))
        except BlockingIOError:
            raise UserError(f"{path}: another run is at work on it; wait for that, or choose another folder with --out")
        except OSError as error:
            raise _refused(path, error)
        yield


def number(value, digits=3):
    """A number for a table, a dash for none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "-"
    if isinstance(value, int):
        return str(value)
    return re.sub(r"e\+?(-?)0*", r"e\1", f"{value:.{digits}g}")


def print_table(title, headers, rows, note=""):
    """A table whose first column is text and whose others are figures; one that is too wide goes on below, with its first columns again."""
    cells = [[str(cell) for cell in row] for row in rows]
    kept = [j for j, header in enumerate(headers) if not cells or any(row[j] for row in cells) or j == 0]
    parts = _parts([headers[j] for j in kept], [[row[j] for j in kept] for row in cells])
    console.print(f"\n{title}", style="italic", highlight=False)
    for i, part in enumerate(parts):
        console.print(*[""] * (i > 0), _table(*part), sep="\n")
    console.print(*[note] * bool(note), style="dim italic", highlight=False, end="\n" * bool(note))


def _table(headers, rows):
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    fits = sum(_widths(headers, rows)) <= console.width
    for i, header in enumerate(headers):
        table.add_column(header, justify="right" if i else "left", no_wrap=fits, overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def _widths(headers, rows):
    """Of each column with what is between it and the next."""
    return [2 + max(cell_len(row[j]) for row in [headers, *rows]) for j in range(len(headers))]


def _parts(headers, rows):
    """[(headers, rows)] as wide as the terminal, each with the columns that identify a row."""
    widths, keys = _widths(headers, rows), _keys(rows)
    parts = [[]]
    for j in range(keys, len(headers)):
        if parts[-1] and sum(widths[k] for k in (*range(keys), *parts[-1], j)) > console.width:
            parts.append([])
        parts[-1].append(j)
    columns = [[*range(keys), *part] for part in parts]
    return [([headers[j] for j in part], [[row[j] for j in part] for row in rows]) for part in columns]


def _keys(rows):
    """How many first columns identify a row, the last of them with something in each; one where no few do."""
    wide = range(1, MOST_KEYS + 1)
    return next((k for k in wide if len({tuple(row[:k]) for row in rows}) == len(rows) and all(row[k - 1 : k] != [""] for row in rows)), 1)


def print_terms(title, terms):
    """A list of names and what is said of each, {name: text}."""
    console.print(f"\n{title}", style="bold")
    for name, text in terms.items():
        console.print(Padding(f"{name}: {text}", (0, 0, 0, 2)), highlight=False)


def progress(items, description):
    """Iterates over a list with a progress bar on the terminal.

    Elsewhere nobody sees it move, and the thread that moves it would wait for itself if the bar is abandoned and collected there.
    """
    moves = console.is_terminal
    return track(items, description=escape(printable(f"{description:<28}")), console=console, transient=True, auto_refresh=moves)


@contextmanager
def busy(description):
    """Shows on the terminal that something of unknown length goes on, and for how long."""
    columns = SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        bar.add_task(printable(description), total=None)
        yield
