"""A table of text: one line of names, then rows of numbers, read by Python's csv module."""

import csv
import io
from array import array
from contextlib import contextmanager

import numpy as np
import rich.progress
from rich.markup import escape

from ..plumbing.errors import UserError
from ..plumbing.results import console, printable
from .choose import listed

DELIMITERS = ";\t|, "  # a space may stand after another, a comma within numbers
LONGEST = 1 << 16  # characters of a line that are looked at for them


@contextmanager
def opened(path):
    """The file as text, with a progress bar."""
    text = {"encoding": "utf-8-sig", "errors": "replace", "newline": ""}
    bar = {"console": console, "transient": True, "disable": not console.is_terminal, "description": escape(printable(path.name))}
    try:
        with rich.progress.open(path, "r", **text, **bar) as file:
            yield file
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path")


def cells(line, delimiter):
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:  # no text at all
        return [line]


def parted(first, second):
    """(names, cells of the first row, delimiter): the first delimiter that parts both lines alike."""
    first = first.lstrip("# ")  # as NumPy writes it
    for delimiter in DELIMITERS:
        names, row = (cells(line.strip("\r\n"), delimiter) for line in (first, second))
        if len(names) == len(row) > 1:
            break
    else:
        delimiter = ","
        names, row = cells(first.strip("\r\n"), delimiter), []
    return [name.strip() for name in names], row, delimiter


def header(path):
    """(names of the columns, delimiter)."""
    with opened(path) as file:
        names, _, delimiter = parted(file.readline(LONGEST), file.readline(LONGEST))
    return names, delimiter


def number(text, delimiter):
    """An empty cell is no number; where commas do not part cells, they may be decimal points."""
    text = text.strip()
    return float(text if delimiter == "," else text.replace(",", ".")) if text else np.nan


def read(path, wanted, damaged=False):
    """{name: values} of the wanted columns; others may hold any text. `damaged` leaves out a last line that is truncated."""
    names, delimiter = header(path)
    for name in wanted:
        if names.count(name) > 1:
            raise UserError(f"{path}:1: duplicate column {name!r}; rename one")
    at = {names.index(name): name for name in wanted}
    columns = {name: array("d") for name in wanted}
    with opened(path) as file:
        rows = csv.reader(file, delimiter=delimiter, skipinitialspace=True)
        following(rows, path)  # the names
        while (row := following(rows, path)) is not None:
            try:
                if len(row) != len(names):
                    raise ValueError(f"{len(row)} fields under {len(names)} columns")
                found = {name: number(row[i], delimiter) for i, name in at.items()}
            except ValueError as error:
                if cut_off(path, rows):
                    if damaged:
                        break
                    raise UserError(f"{path}:{rows.line_num}: the file is truncated in this line; --damaged omits it")
                raise UserError(f"{path}:{rows.line_num}: {listed([error])}; correct or delete the line")
            for name, value in found.items():
                columns[name].append(value)
    return {name: np.array(values) for name, values in columns.items()}


def following(rows, path):
    """The next row that is not empty; None after the last."""
    try:
        return next((row for row in rows if any(cell.strip() for cell in row)), None)
    except csv.Error as error:
        raise UserError(f"{path}:{rows.line_num}: {listed([error])}; correct or delete the line")


def cut_off(path, rows):
    """Whether a line is the last one, without its end."""
    with open(path, "rb") as file:
        file.seek(-1, io.SEEK_END)
        return file.read() not in b"\r\n" and following(rows, path) is None
