"""Logs of others to the CSV that everything here reads: `tinykoop convert`.

A source format is one file beside this one and one line in formats.py. It says which fields a file has,
which of them usually make which column, and what brings each to SI units with x forward, y left, z up.
The rest is the same for all: choosing fields (choose.py), the uniform rows (rows.py), writing.
"""

from importlib import import_module
from pathlib import Path

import numpy as np

from ..formats import FORMATS
from ..platforms import COLUMNS, COMMANDS, REQUIRED
from ..plumbing.errors import UserError
from ..plumbing.results import console, number, print_table, printable, write_bytes
from .choose import choose
from .rows import resample


def detect(path):
    """The format of a file or folder, by what is in it."""
    head = b""
    if path.is_file():
        try:
            with open(path, "rb") as file:
                head = file.read(4096)
        except OSError as error:
            raise UserError(f"{path}: cannot be opened ({error.strerror}); check the path")
        if not head:
            raise UserError(f"{path}: the file is empty")
    for name in FORMATS:
        if import_module(f".{name}", __package__).is_mine(path, head):
            return name
    known = "; ".join(f"{name} ({what})" for name, what in FORMATS.items())
    raise UserError(f"{path}: unknown format; the known ones are {known}; choose one with --format")


def run(source, out, platform, form=None, rate=None, maps=(), damaged=False):
    """Converts the log `source` to the CSV `out`, and says what each column was made of; the arguments are those of quietly()."""
    report(source, *quietly(source, out, platform, form, rate, maps, damaged))


def quietly(source, out, platform, form=None, rate=None, maps=(), damaged=False):
    """Converts the log `source` to the CSV `out`; returns (its rows, {column: field}, [columns that it lacks]).

    rate: rows per second (default: that of the slowest part of the state). maps: COLUMNS=FIELD[UNIT]*FACTOR, or a TOML file.
    damaged: take what can be read of a file that is truncated.
    """
    source, out = Path(source), Path(out)
    if not source.exists():
        raise UserError(f"{source}: no such file; check the path")
    if out.exists() and out.resolve() == source.resolve():
        raise UserError(f"{out}: is the source; name another output file")
    if rate is not None and not 0 < rate <= 1e5:
        raise UserError(f"--rate {rate:g}: rows per second must be above 0, at most 100000")
    module = import_module(f".{form or detect(source)}", __package__)
    optional = [column for column in COLUMNS[platform] if column not in REQUIRED[platform]]
    with np.errstate(invalid="ignore", over="ignore"):  # damaged bytes make numbers of every kind
        log = module.open_log(source, damaged)
        log.usual = log.usual | (log.quadrotor() if platform == "quadrotor" else {})
        chosen = log.clocked(choose(log, (*log.timed, *COLUMNS[platform]), maps, optional))
        table = resample(log, chosen, rate, optional)
    write_table(out, table, [column for column in COLUMNS[platform] if column in table.columns])
    return table, chosen, [column for column in optional if column not in table.columns]


def write_table(out, table, columns):
    """The CSV of the contract, with seg and pose_ok."""
    names = ("t", *columns, "seg", "pose_ok")
    data = np.column_stack([table.t, *(table.columns[name] for name in columns)])
    lines = [",".join(names)]
    for row, seg, ok in zip(data.tolist(), table.seg.tolist(), table.pose_ok.tolist()):
        lines.append(",".join([f"{row[0]:.12g}", *(f"{value:.12g}" for value in row[1:]), str(seg), str(int(ok))]))
    write_bytes(out, ("\n".join(lines) + "\n").encode())


def report(source, table, chosen, absent):
    """Which field made which column, and what was lost."""
    source, lines = Path(source), []
    for column, field in chosen.items():
        if column in absent:
            continue
        where = f"{field.label}{'' if field.factor == 1 else f' * {field.factor:g}'}" if field else "gyro and attitude"
        rate = number(table.rates[column]) if field else ""
        lines.append([column, where, "held" if column in COMMANDS else "interpolated" if field else "computed", rate])
    print_table(printable(source.name), ["column", "from", "between samples", "its rate (Hz)"], lines)
    count, parts, masked = len(table.t), int(table.seg[-1]) + 1, int((~table.pose_ok).sum())
    text = f"{count:,} rows at {table.rate:.6g} Hz, {table.t[-1]:.1f} s; segments: {parts}; rows with pose_ok 0: {masked:,}."
    lacking = [f"The log lacks {', '.join(absent)}."] if absent else []
    console.print("\n".join([text, *lacking, *table.notes]), highlight=False)
