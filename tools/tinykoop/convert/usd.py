"""Crazyflie uSD deck: binary, self-describing, little endian.

Byte 0xBC, version, number of event types; for each type id, name and variables "GROUP.NAME(type)"; then
events: id, time (version 1: ms in 32 bits, 2: us in 64 bits), values; at last the CRC-32 of all before it.
"""

import struct
import zlib

import numpy as np

from ..plumbing.errors import UserError
from ..plumbing.results import progress
from .choose import listed
from .variables import CrazyflieLog

MAGIC = 0xBC
TIMES = {1: ("<u4", 1e-3), 2: ("<u8", 1e-6)}
TYPES = {"b": "i1", "B": "u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "f": "<f4", "e": "<f2"}
MEND = "add it to config.txt of the card"
BLOCK = 1 << 20


def is_mine(path, head):
    return head[:1] == bytes([MAGIC])


def open_log(path, damaged):
    """All events; a variable that several event types have is taken from the fixed-frequency one."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); name one log file of the card")
    if data[:1] != bytes([MAGIC]):
        raise UserError(f"{path}: not a uSD log: it does not begin with the byte 0xBC")
    try:
        events, start, scale = header(data)
    except (struct.error, IndexError, KeyError, UnicodeError, ValueError) as error:
        raise UserError(f"{path}: the header is truncated or damaged ({listed([error])}); copy the file from the card again")
    sound = len(data) >= start + 4 and zlib.crc32(data[:-4]) == int.from_bytes(data[-4:], "little")
    if not sound and not damaged:
        raise UserError(
            f"{path}: truncated or damaged, its check sum is wrong (power failure before logging was stopped?); "
            "--damaged reads what is intact"
        )
    found, stop, end = scan(path, data, events, start, len(data) - 4 * sound)
    if stop < end and not damaged:
        raise UserError(f"{path}: no event begins at byte {stop}; --damaged takes what comes before")
    samples = {}
    for event, (name, dtype) in sorted(events.items(), key=lambda item: item[1][0] != "fixedFrequency"):
        at = np.array(found[event], dtype=np.int64)
        if not len(at):
            continue
        raw = np.frombuffer(data, np.uint8)[at[:, None] + np.arange(dtype.itemsize)]
        rows = np.ascontiguousarray(raw).view(dtype)[:, 0]
        t = rows["time"] * scale
        for variable in dtype.names[2:]:
            full = variable if "." in variable else f"{name}.{variable}"
            samples.setdefault(full, (t, rows[variable].astype(float)))
    if not samples:
        raise UserError(f"{path}: has no events; was logging started?")
    return CrazyflieLog(path, samples, MEND)


def header(data):
    """({event id: (name, dtype of a record)}, where the events begin, seconds for a unit of time)."""
    version, count = struct.unpack_from("<HH", data, 1)
    if version not in TIMES:
        raise ValueError(f"version {version}; 1 and 2 are known")
    kind, scale = TIMES[version]
    at, events = 5, {}

    def word():
        nonlocal at
        end = data.index(0, at)
        text, at = data[at:end].decode(), end + 1
        return text

    def integer():
        nonlocal at
        (value,) = struct.unpack_from("<H", data, at)
        at += 2
        return value

    for _ in range(count):
        event, name = integer(), word()
        fields = [("event", "<u2"), ("time", kind)]
        for variable in (word() for _ in range(integer())):
            fields.append((variable[:-3], TYPES[variable[-2:-1]]))
        events[event] = name, np.dtype(fields)
    return events, at, scale


def scan(path, data, events, start, end):
    """({event id: offsets}, where reading stopped, end)."""
    sizes = {event: dtype.itemsize for event, (_, dtype) in events.items()}
    found = {event: [] for event in events}
    unpack, at = struct.Struct("<H").unpack_from, start
    for block in progress(range(start, max(end, start + 1), BLOCK), path.name):
        while at < min(block + BLOCK, end - 1):
            (event,) = unpack(data, at)
            size = sizes.get(event)
            if size is None or at + size > end:
                return found, at, end
            found[event].append(at)
            at += size
    return found, at, end
