"""Your own CSV: an analytic motion is written with foreign names, units, signs and delimiters, and must come back."""

import csv

import numpy as np
import pytest
from test_convert import DEG, G, T, check, check_held, command, crazyflie_variables, drive, flight, refused, run, wrap, write_crazyflie
from tinykoop import units
from tinykoop.plumbing.asked import near

MAP = ("t=ms[ms]", "px=x [mm]", "py=y[cm]", "theta=psi[deg]", "v=speed[km/h]", "omega=turn[rpm]*-1")
TOML = """
[log]
time = {column = "ms", unit = "ms"}
state = [
  {name = "px", column = "x [mm]", unit = "mm"},
  {name = "py", column = "y", unit = "cm"},
  {name = "theta", column = "psi", unit = "deg", wraps = true},
]
command = [
  {name = "v", column = "speed", unit = "km/h"},
  {name = "omega", column = "turn", unit = "rpm", factor = -1},
]
"""


def foreign(t):
    """A drive as somebody else logs it."""
    m = drive(t)
    return {
        "mode": ["auto" for _ in t], "ms": t * 1e3, "psi": wrap(m["theta"]) / DEG, "x [mm]": m["px"] * 1e3, "y": m["py"] * 1e2,
        "speed": m["v"] * 3.6, "turn": -m["omega"] * 60 / (2 * np.pi),
    }  # fmt: skip


def write(path, columns, delimiter=",", comma=".", **options):
    """By Python's csv module, numbers with the decimal sign that the user's country has."""
    with open(path, "w", newline="") as file:
        writer = csv.writer(file, delimiter=delimiter, **options)
        writer.writerow(columns)
        for row in zip(*columns.values()):
            writer.writerow([x if isinstance(x, str) else repr(float(x)).replace(".", comma) for x in row])
    return path


@pytest.fixture
def log(tmp_path):
    return write(tmp_path / "mine.csv", foreign(T))


@pytest.fixture
def toml(tmp_path):
    path = tmp_path / "map.toml"
    path.write_text(TOML)
    return path


@pytest.mark.parametrize("delimiter, comma", [(",", "."), (";", ","), (";", "."), ("\t", ","), ("|", "."), (" ", ".")])
def test_names_units_and_delimiter_of_ones_own(tmp_path, delimiter, comma):
    log = write(tmp_path / "mine.csv", foreign(T), delimiter, comma)
    result = run(log, "ddr", maps=MAP)
    check(result, 0.0, drive, 1e-9, but=())
    assert len(result.t) == len(T) and result.log.dt == pytest.approx(0.01)


@pytest.mark.parametrize("end", ("\n", "\r\n", "\r"))
def test_every_cell_in_quotes_with_any_line_end(tmp_path, end):
    log = write(tmp_path / "mine.csv", foreign(T), quoting=csv.QUOTE_ALL, lineterminator=end)
    log.write_bytes(b"\xef\xbb\xbf" + log.read_bytes())
    check(run(log, "ddr", maps=MAP), 0.0, drive, 1e-9, but=())


def test_the_table_of_numpy_needs_no_map_for_names_as_here(tmp_path):
    m = drive(T)
    np.savetxt(tmp_path / "mine.txt", np.column_stack([T, *m.values()]), header=" ".join(["t", *m]))
    check(run(tmp_path / "mine.txt", "ddr"), 0.0, drive, 1e-9, but=())


def test_a_toml_file_says_the_same_as_the_command_line(log, toml):
    check(run(log, "ddr", maps=[str(toml)]), 0.0, drive, 1e-9, but=())


def test_a_robots_file_is_a_map_whatever_else_it_says(log, toml):
    toml.write_text('name = "bot"\n' + TOML + '[simulator]\npython = "nowhere.py:step"\n')
    check(run(log, "ddr", maps=[str(toml)]), 0.0, drive, 1e-9, but=())


def test_a_toml_file_maps_other_formats_too(tmp_path, toml):
    log = write_crazyflie(tmp_path / "log.csv", T * 1e3, crazyflie_variables(drive(T)))
    toml.write_text('[log]\ntime = {column = ""}\nstate = []\ncommand = [{name = "v", column = "stateEstimate.x", factor = 2}]\n')
    result = run(log, "ddr", maps=[str(toml)])
    check_held(result, 0.0, "v", T, 2 * drive(T)["px"])


def test_a_flight_in_g_and_degrees(tmp_path):
    m = flight(T)
    columns = {"time_us": T * 1e6} | {f"w{a}": m[f"g{a}"] / DEG for a in "xyz"} | {f"f{a}": m[f"a{a}"] / G for a in "xyz"}
    columns |= {"nose_up": -m["pitch"] / DEG, "roll": m["roll"], "yaw": m["yaw"], "servo": m["u"] * 1e3}
    maps = ["t=time_us[us]", "pitch=nose_up[deg]*-1", "u=servo[mrad]"]
    maps += [f"g{a}=w{a}[deg/s]" for a in "xyz"] + [f"a{a}=f{a}[g]" for a in "xyz"]
    log = write(tmp_path / "mine.csv", columns)
    check(run(log, "fwmav", maps=maps), 0.0, flight, 1e-9, but=())
    columns["yaw_rate"] = 0 * T + 7
    result = run(write(log, columns), "fwmav", maps=maps)
    assert (result.columns["yaw_rate"] == 7).all()  # its own goes before that of gyro and attitude


def test_columns_of_several_rates_in_one_table(tmp_path):
    """Poses in every fifth row, commands in every third; other cells are empty."""
    columns, rows = foreign(T), np.arange(len(T))
    for name, every in (("x [mm]", 5), ("y", 5), ("psi", 5), ("speed", 3), ("turn", 3)):
        columns[name] = [value if k % every == 0 else "" for k, value in zip(rows, columns[name])]
    result = run(write(tmp_path / "mine.csv", columns), "ddr", maps=MAP)
    check(result, 0.0, drive, 1e-9)
    check_held(result, 0.0, "v", T[::3], drive(T[::3])["v"])
    assert result.log.dt == pytest.approx(0.05) and result.ok.all()


def test_rows_at_uneven_times_become_uniform(tmp_path):
    t = np.cumsum(np.random.default_rng(2).uniform(0.005, 0.015, 1000))
    result = run(write(tmp_path / "mine.csv", foreign(t)), "ddr", maps=MAP, rate=100)
    assert np.allclose(np.diff(result.t), 0.01)
    check(result, t[0], drive, 1e-3)
    check_held(result, t[0], "v", t, drive(t)["v"])


@pytest.mark.parametrize(
    "wrong, match",
    [
        ("px=x_mm[mm]", r"no such field; the file has .*x \[mm\]"),
        ("px=X", "no such field; the file has"),
        ("py=y[furlong]", "'furlong' is no unit of what is in m here; there are m, mm, cm, km"),
        ("py=y[deg]", "'deg' is no unit of what is in m here"),
        ("theta=psi[m]", "'m' is no unit of what is in rad here; there are rad, deg, mrad"),
        ("t=ms[mm]", "'mm' is no unit of what is in s here; there are s, min, ms, us, ns"),
        ("py=y*much", "the factor 'much' is not a number"),
        ("gx=psi", "no column 'gx' here; there are t, px, py, theta, v, omega"),
        ("py=", r"write COLUMN=COLUMN\[UNIT\], as in t=mode; or name a .toml file"),
        ("y[cm]", "write COLUMN="),
        ("v=mode", r"mine\.csv:2: could not convert string to float: 'auto'"),
    ],
)  # fmt: skip
def test_a_wrong_map_is_refused(log, wrong, match):
    maps = [text for text in MAP if text.partition("=")[0] != wrong.partition("=")[0]]
    refused(log, "ddr", match, maps=[*maps, wrong])


def test_a_column_that_nothing_maps_is_named(log):
    refused(
        log,
        "ddr",
        r"nothing for py: add the column, or name the field with --map COLUMN=COLUMN\[UNIT\]; .*has mode, ms",
        maps=MAP[:2] + MAP[3:],
    )
    message = refused(log, "ddr", "nothing for t, px, py: ", maps=MAP[3:])
    assert "x [mm]" in message and "usually" not in message


def test_a_column_that_is_mapped_twice_is_refused(log, toml):
    refused(log, "ddr", "px is mapped twice; leave one out", maps=[*MAP, "px=y"])
    refused(log, "ddr", "px is mapped twice", maps=[str(toml), "px=y"])
    toml.write_text(TOML.replace('name = "py"', 'name = "px"'))
    refused(log, "ddr", "px is mapped twice", maps=[str(toml)])


def test_a_name_that_two_columns_have_is_refused(tmp_path):
    log = write(tmp_path / "mine.csv", foreign(T))
    log.write_text(log.read_text().replace("psi", "y", 1))
    refused(log, "ddr", "mine.csv:1: duplicate column 'y'; rename one", maps=[*MAP[:3], "theta=y", *MAP[4:]])


@pytest.mark.parametrize(
    "old, new, match",
    [
        ("[log]", "log", r"map\.toml: Expected '='"),
        ('"deg"', '"degs"', r"map\.toml: \[log\] theta: 'degs' is no unit of what is in rad here; there are rad, deg"),
        ('unit = "cm"', "factor = 1", None),
        ('column = "psi"', 'column = "psii"', "no such field; the file has psi"),
        ("factor = -1", 'factor = "-1"', "turn.*factor must be a number|omega: factor must be a number"),
        ("state = [", "states = [", "unknown key states"),
        ("{name = \"py\", column = \"y\", unit = \"cm\"}", "3", "3 must be a table"),
    ],
)  # fmt: skip
def test_a_wrong_toml_file_is_refused(log, toml, old, new, match):
    toml.write_text(TOML.replace(old, new, 1))
    if match:
        refused(log, "ddr", match, maps=[str(toml)])
    else:  # without a unit a value is in that of the column
        assert run(log, "ddr", maps=[str(toml)]).columns["py"].max() > 50


def test_a_bad_line_is_named_and_a_cut_one_can_be_left_out(log):
    lines = log.read_text().split("\n")
    log.write_text("\n".join([*lines[:7], "auto,60", *lines[8:]]))
    refused(log, "ddr", r"mine\.csv:8: 2 fields under 7 columns; correct or delete the line", maps=MAP)
    log.write_text("\n".join([*lines[:300], lines[300][:20]]))
    refused(log, "ddr", r"mine\.csv:301: the file is truncated in this line; --damaged omits it", maps=MAP)
    assert len(run(log, "ddr", maps=MAP, damaged=True).t) == 299


def test_time_as_text_is_refused_with_its_line(tmp_path):
    columns = foreign(T) | {"ms": ["2026-01-01T12:00:00" for _ in T]}
    refused(write(tmp_path / "mine.csv", columns), "ddr", r"mine\.csv:2: .*2026-01-01", maps=MAP)


def test_command_line_with_both_kinds_of_map(log, toml, tmp_path):
    out = tmp_path / "out.csv"
    for maps in (MAP, [toml]):
        status, said, error = command(log, out, "--platform", "ddr", "--map", *maps)
        assert status == 0 and not error and "400 rows at 100 Hz" in said and "psi * 0.0174533" in said
    out.unlink()
    status, said, error = command(log, out, "--platform", "ddr", "--map", "px=x[furlong]")
    assert status == 2 and not said and error.count("\n") == 1 and not out.exists()
    status, said, error = command(log, out, "--platform", "ddr", "--map", tmp_path / "none.toml")
    assert status == 2 and "none.toml: cannot be read" in error and error.count("\n") == 1


def test_units_are_those_of_the_si_brochure():
    """Factors by exact fractions: a degree is pi/180, a turn per minute 2 pi/60, g 9.80665 m/s2."""
    exact = {
        "deg": np.pi / 180,
        "rpm": np.pi / 30,
        "km/h": 5 / 18,
        "g": 9.80665,
        "ms": 1 / 1000,
        "us": 1e-6,
        "ns": 1e-9,
        "min": 60,
        "%": 1 / 100,
    }
    for unit, factor in exact.items():
        assert units.base(unit)[1] == pytest.approx(factor, rel=1e-15), unit
    for unit, (base, factor) in units.UNITS.items():
        assert base not in units.UNITS and factor > 0, unit
        prefix = {"m": 1e-3, "c": 1e-2, "k": 1e3}.get(unit[0]) if unit[1:] in ("m", "rad", "V", "m/s", "rad/s") else None
        assert prefix is None or factor == prefix, unit


def test_near_names_are_those_that_look_alike():
    assert near("pozition_x", ["time", "position_x", "position_y"]).startswith("position_x")
    assert near("q", ["b", "a"]) == "a, b" and near("q", []) == "none at all"
