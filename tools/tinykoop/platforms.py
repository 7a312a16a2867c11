"""The robots that come with TinyKoop, by the columns of their logs; host_sim/ knows the same ones."""

from .plumbing.errors import UserError

COLUMNS = {  # beside t
    "ddr": ("px", "py", "theta", "v", "omega"),
    "fwmav": ("gx", "gy", "gz", "ax", "ay", "az", "pitch", "roll", "yaw", "yaw_rate", "u"),
    "quadrotor": (
        "m1", "m2", "m3", "m4", "vbat", "px", "py", "pz", "vx", "vy", "vz", "ax", "ay", "az", "roll", "pitch", "yaw", "gx", "gy", "gz",
    ),
}  # fmt: skip
COMMANDS = ("v", "omega", "u", "m1", "m2", "m3", "m4", "vbat")
REQUIRED = {**COLUMNS, "quadrotor": ("m1", "m2", "m3", "m4")}  # a log may lack the others: NaN
LEARNED = {  # states of learners, where they are not the log's columns; docs/quadrotor.md
    "quadrotor": (
        "forward", "left", "up", "roll", "pitch", "gx", "gy", "gz", "thrust", "roll_moment", "pitch_moment", "yaw_moment",
    ),
}  # fmt: skip
UNITS = {  # of the columns of all of them
    "t": "s", "px": "m", "py": "m", "theta": "rad", "v": "m/s", "omega": "rad/s",
    "gx": "rad/s", "gy": "rad/s", "gz": "rad/s", "ax": "m/s2", "ay": "m/s2", "az": "m/s2",
    "pitch": "rad", "roll": "rad", "yaw": "rad", "yaw_rate": "rad/s", "u": "rad",
    "pz": "m", "vx": "m/s", "vy": "m/s", "vz": "m/s",
    "m1": "1", "m2": "1", "m3": "1", "m4": "1", "vbat": "V",
}  # fmt: skip
HEADER = 1 << 16  # characters of the first line that are looked at


def sizes(platform):
    """(number of states, number of commands)."""
    check(platform)
    commands = sum(column in COMMANDS for column in COLUMNS[platform])
    return len(COLUMNS[platform]) - commands, commands


def learned(platform):
    """Number of states of a learner, of a log that lacks nothing."""
    return len(LEARNED[platform]) if platform in LEARNED else sizes(platform)[0]


def check(platform, *others):
    """Refuses what is no platform; others: what may be given beside one."""
    if platform not in COLUMNS:
        *most, last = *COLUMNS, *others
        raise UserError(f"there is no platform named '{platform}': use {', '.join(most)} or {last}")


def of_log(path):
    """The platform of which the header names the largest share of the columns that it must have; other files are left to the reader to refuse."""
    try:
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            names = {name.strip() for name in file.readline(HEADER).split(",")}
    except OSError as error:
        raise UserError(f"{path}: cannot be opened ({error.strerror}); check the path")
    return max(REQUIRED, key=lambda platform: len(names.intersection(REQUIRED[platform])) / len(REQUIRED[platform]))
