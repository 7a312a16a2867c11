"""The CSV contract of logs: what is read, what is refused and with what words, and that nothing crashes."""

import os
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest
from tinykoop import bridge, platforms
from tinykoop.plumbing.errors import UserError

DATA = Path(__file__).resolve().parents[3] / "shared/data"
COLUMNS = {
    "ddr": "t,px,py,theta,v,omega",
    "fwmav": "t,gx,gy,gz,ax,ay,az,pitch,roll,yaw,yaw_rate,u",
    "quadrotor": "t,m1,m2,m3,m4,vbat,px,py,pz,vx,vy,vz,ax,ay,az,roll,pitch,yaw,gx,gy,gz",
}


LOG_STATES = {"ddr": 3, "fwmav": 10, "quadrotor": 15}
STATES = {"ddr": slice(1, 4), "fwmav": slice(1, 11), "quadrotor": slice(6, 21)}
INPUTS = {"ddr": slice(4, 6), "fwmav": slice(11, 12), "quadrotor": slice(1, 6)}
MAY_LACK = COLUMNS["quadrotor"].split(",")[5:]
# of each column: what no robot has in SI units
LIMITS = {"ddr": [1e11, 1e8, 1e8, 1e7, 1e7, 1e7], "fwmav": [1e11, *[1e4] * 3, *[1e5] * 3, *[1e7] * 3, 1e4, 1e7]}
LIMITS["quadrotor"] = [1e11, *[1e7] * 4, 1e5, *[1e8] * 3, *[1e5] * 6, *[1e7] * 3, *[1e4] * 3]


def table(platform="ddr", rows=6, dt=0.05, seed=0):
    """A good log as a list of rows of text, the header first."""
    header = COLUMNS[platform].split(",")
    values = np.random.default_rng(seed).normal(0, 10, (rows, len(header)))
    return [header] + [[f"{k * dt:.2f}"] + [repr(float(v)) for v in row[1:]] for k, row in enumerate(values)]


def text_of(rows, end="\n"):
    return end.join(",".join(row) for row in rows) + end


@pytest.fixture
def read(tmp_path):
    """Reads a log given as text, bytes or rows."""

    def get(content, platform="ddr"):
        path = tmp_path / "log.csv"
        if isinstance(content, list):
            content = text_of(content)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return bridge.read_log(path, platform)

    return get


def check_same(log, rows):
    """The log holds the numbers of these rows bit for bit: Python's own parser is the judge."""
    expected = np.array([[float(v) for v in row] for row in rows[1:]])
    platform = next(name for name, count in LOG_STATES.items() if count == log.x.shape[1])
    assert np.array_equal(log.t, expected[:, 0])
    assert np.array_equal(log.x, expected[:, STATES[platform]])
    assert np.array_equal(log.u, expected[:, INPUTS[platform]])


# ---- what is read ----------------------------------------------------------------------------------


@pytest.mark.parametrize("platform", COLUMNS)
def test_plain_file(read, platform):
    rows = table(platform)
    log = read(rows, platform)
    check_same(log, rows)
    assert log.dt == pytest.approx(0.05)
    assert log.usable.tolist() == [True] * 5


@pytest.mark.parametrize("platform", COLUMNS)
def test_columns_in_any_order(read, platform):
    rows = table(platform)
    order = np.random.default_rng(1).permutation(len(rows[0]))
    check_same(read([[row[i] for i in order] for row in rows], platform), rows)


def test_line_ends_byte_order_mark_blanks_and_last_line(read):
    rows = table()
    check_same(read(text_of(rows, "\r\n")), rows)
    check_same(read("\ufeff" + text_of(rows)), rows)
    check_same(read("\ufeff" + text_of(rows, "\r\n").rstrip()), rows)
    check_same(read(text_of(rows).rstrip()), rows)
    check_same(read(text_of(rows) + "\n"), rows)
    check_same(read(text_of(rows).replace(",", " ,\t")), rows)


def test_extra_columns_are_not_looked_at(read):
    rows = table()
    extra = [["note", *rows[0], "flag"]] + [["hello NaN", *row, ""] for row in rows[1:]]
    check_same(read(extra), rows)


@pytest.mark.parametrize("number", ["1", "-1", "+1", "1.", ".5", "1e-3", "-1.5E+2", "007", "4.9e-324", "-0.0"])
def test_ways_to_write_a_number(read, number):
    rows = table()
    rows[3][2] = number
    log = read(rows)
    assert log.x[2, 1] == float(number) and np.signbit(log.x[2, 1]) == np.signbit(float(number))


def test_transition_is_not_usable_across_a_change_of_seg(read):
    seg = ["seg", "0", "0", "0", "1", "1", "1"]
    log = read([[*row, s] for row, s in zip(table(), seg)])
    assert log.usable.tolist() == [True, True, False, True, True]


def test_masked_row_spoils_both_of_its_transitions(read):
    ok = ["pose_ok", "1", "1", "0", "1", "1", "1"]
    rows = table()
    log = read([[*row, p] for row, p in zip(rows, ok)])
    check_same(log, rows)
    assert log.usable.tolist() == [True, False, False, True, True]


def test_masked_pose_may_be_missing_but_not_the_time_or_the_command(read):
    ok = ["pose_ok", "1", "1", "0", "1", "1", "1"]
    rows = [[*row, p] for row, p in zip(table(), ok)]
    rows[3][1], rows[3][2], rows[3][3] = "", "nan", "-"
    log = read(rows)
    assert np.isnan(log.x[2]).all() and np.isfinite(np.delete(log.x, 2, 0)).all()
    for column in (0, 4):
        bad = [row.copy() for row in rows]
        bad[3][column] = "nan"
        with pytest.raises(UserError, match=r"log\.csv:4: .*'nan'"):
            read(bad)


def test_gap_in_time_is_not_usable_and_jitter_is(read):
    rows = table()
    for row, t in zip(rows[1:], ("0", "0.05", "0.101", "0.30", "0.349", "0.40")):
        row[0] = t
    log = read(rows)
    assert log.dt == pytest.approx(0.05, rel=0.03)
    assert log.usable.tolist() == [True, True, False, True, True]


@pytest.mark.parametrize("platform, sizes, dt", [("ddr", (3, 2), 0.05), ("fwmav", (10, 1), 0.01), ("quadrotor", (15, 5), 0.01)])
def test_round_trip_is_bit_exact(tmp_path, platform, sizes, dt):
    rng = np.random.default_rng(2)
    x, u = (rng.normal(0, 1, (3000, k)) * 10.0 ** rng.integers(-30, 3, (3000, k)) for k in sizes)
    x[0, 0], x[1, 0], x[2, 0] = -0.0, 5e-324, LIMITS[platform][STATES[platform].start]
    bridge.write_log(tmp_path / "a.csv", x, u, dt, platform)
    log = bridge.read_log(tmp_path / "a.csv", platform)
    assert log.x.tobytes() == x.tobytes() and log.u.tobytes() == u.tobytes()
    assert np.max(np.abs(log.t - np.arange(3000) * dt)) < 1e-9
    assert log.dt == pytest.approx(dt, rel=1e-6) and log.usable.all()
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]


def test_write_where_nothing_can_be_written(tmp_path):
    with pytest.raises(UserError, match="no_folder"):
        bridge.write_log(tmp_path / "no_folder/a.csv", np.zeros((3, 3)), np.zeros((3, 2)), 0.05)


def test_write_refuses_what_read_would_refuse(tmp_path):
    for value in (np.nan, np.inf, 1e9):
        x = np.zeros((3, 3))
        x[1, 1] = value
        with pytest.raises(UserError, match=r"a\.csv: row 1: column 'py'"):
            bridge.write_log(tmp_path / "a.csv", x, np.zeros((3, 2)), 0.05)


# ---- a quadrotor's log, which may lack columns -----------------------------------------------------


def test_columns_that_a_quadrotor_lacks_are_nan_and_its_rows_usable(read):
    rows = table("quadrotor")
    for lacks in ([name] for name in MAY_LACK):
        kept = [i for i, name in enumerate(rows[0]) if name not in lacks]
        log = read([[row[i] for i in kept] for row in rows], "quadrotor")
        expected = np.array([[float(v) if name not in lacks else np.nan for name, v in zip(rows[0], row)] for row in rows[1:]])
        assert np.array_equal(log.x, expected[:, STATES["quadrotor"]], equal_nan=True)
        assert np.array_equal(log.u, expected[:, INPUTS["quadrotor"]], equal_nan=True)
        assert log.usable.all()


def test_a_quadrotors_log_without_any_state_is_refused(read):
    rows = [row[:6] for row in table("quadrotor")]
    with pytest.raises(UserError, match=r"log\.csv:1: no column of the state, such as 'px'"):
        read(rows, "quadrotor")
    assert np.isfinite(read([row[:7] for row in table("quadrotor")], "quadrotor").x[:, 0]).all()


def test_what_a_quadrotors_log_lacks_is_not_written(tmp_path):
    rng = np.random.default_rng(3)
    x, u = rng.normal(size=(50, 15)), rng.normal(size=(50, 5))
    x[:, [10, 12, 13, 14]], u[:, 4] = np.nan, np.nan
    bridge.write_log(tmp_path / "a.csv", x, u, 0.01, "quadrotor")
    assert (tmp_path / "a.csv").read_text().split("\n")[0] == "t,m1,m2,m3,m4,px,py,pz,vx,vy,vz,ax,ay,az,roll,yaw"
    log = bridge.read_log(tmp_path / "a.csv", "quadrotor")
    assert np.array_equal(log.x, x, equal_nan=True)
    assert np.array_equal(log.u, u, equal_nan=True) and log.usable.all()
    x[7, 0] = np.nan
    with pytest.raises(UserError, match=r"a\.csv: row 7: column 'px'"):
        bridge.write_log(tmp_path / "a.csv", x, u, 0.01, "quadrotor")


def test_a_short_header_of_a_quadrotor_is_one(tmp_path):
    (tmp_path / "log.csv").write_text("t,m1,m2,m3,m4,px,py,vx\n")
    assert platforms.of_log(tmp_path / "log.csv") == "quadrotor"


# ---- what is refused, and with what words ----------------------------------------------------------


@pytest.mark.parametrize("platform", COLUMNS)
def test_missing_column_is_named(read, platform):
    for i, name in enumerate(COLUMNS[platform].split(",")):
        if platform == "quadrotor" and name in MAY_LACK:
            continue
        without = [row[:i] + row[i + 1 :] for row in table(platform)]
        with pytest.raises(UserError, match=rf"log\.csv:1: .*'{name}'"):
            read(without, platform)


@pytest.mark.parametrize(
    "field",
    ["abc", "nan", "NaN", "inf", "-Infinity", "0x10", "0x1p3", "", " ", "1,5", "1 2", "1e", "--1", "1e400",
     "1_0", "'1'", "٣", "1;2", "infinity", "1d3", "1f", "true"],
)  # fmt: skip
def test_bad_number_is_refused_with_file_line_and_column(read, field):
    rows = table()
    rows[4][3] = field
    if "," in field:
        with pytest.raises(UserError, match=r"log\.csv:5: 7 fields.* 6 columns"):
            read(rows)
        return
    with pytest.raises(UserError, match=r"log\.csv:5: .*'theta' \(4\)") as refusal:
        read(rows)
    assert f"'{field.strip()}'" in str(refusal.value)


@pytest.mark.parametrize("platform", COLUMNS)
def test_number_that_no_robot_has_is_refused_with_file_line_column_and_remedy(read, platform):
    for i, (name, limit) in enumerate(zip(COLUMNS[platform].split(","), LIMITS[platform])):
        for value in (limit, -limit) if i else (limit,):
            rows = table(platform)
            rows[-1][i] = repr(value)
            check_same(read(rows, platform), rows)
            for beyond in (repr(float(np.nextafter(value, 2 * value))), "-1e150", "1" + "0" * 200):
                rows[-1][i] = beyond
                mend = "mask the row by pose_ok 0$" if i in range(*STATES[platform].indices(99)) else "SI units$"
                with pytest.raises(UserError, match=rf"log\.csv:7: column '{name}' \({i + 1}\): .*beyond 1[0e].*{mend}") as refusal:
                    read(rows, platform)
                assert len(str(refusal.value)) < 300


def test_number_that_no_robot_has_may_stand_in_a_masked_pose(read):
    rows = [[*row, ok] for row, ok in zip(table(), ["pose_ok", "1", "1", "0", "1", "1", "1"])]
    rows[3][2] = "1e150"
    log = read(rows)
    assert np.isnan(log.x[2, 1]) and log.usable.tolist() == [True, False, False, True, True]
    rows[3][4] = "1e150"
    with pytest.raises(UserError, match=r"log\.csv:4: column 'v' \(5\): .*SI units$"):
        read(rows)


@pytest.mark.parametrize("column", ["seg", "pose_ok"])
def test_optional_columns_are_checked_too(read, column):
    rows = [[*row, "1"] for row in table()]
    rows[0][-1] = column
    rows[2][-1] = "no"
    with pytest.raises(UserError, match=rf"log\.csv:3: .*'{column}' \(7\).*'no'"):
        read(rows)


@pytest.mark.parametrize("time", ["0.05", "0.04", "-1"])
def test_time_must_increase(read, time):
    rows = table()
    rows[3][0] = time
    with pytest.raises(UserError, match=r"log\.csv:4: .*'t' \(1\).*time"):
        read(rows)


def test_wrong_number_of_fields(read):
    for change, count in ((lambda row: row.pop(), 5), (lambda row: row.append("1"), 7)):
        rows = table()
        change(rows[2])
        with pytest.raises(UserError, match=rf"log\.csv:3: {count} fields.* 6 columns"):
            read(rows)


@pytest.mark.parametrize("extra, name, at", [(["px", "note"], "px", 7), (["seg", "seg"], "seg", 8)])
def test_duplicate_column(read, extra, name, at):
    rows = [[*row, "1", "1"] for row in table()]
    rows[0][-2:] = extra
    with pytest.raises(UserError, match=rf"log\.csv:1: duplicate column '{name}' \(again at column {at}\)"):
        read(rows)


def test_nothing_or_too_little_in_it(read):
    with pytest.raises(UserError, match=r"log\.csv.*empty"):
        read("")
    for rows in (0, 1, 2):
        with pytest.raises(UserError, match=rf"log\.csv: {rows} rows.*at least 3"):
            read(table(rows=rows))
    read(table(rows=3))


def test_empty_line_in_the_middle(read):
    rows = table()
    with pytest.raises(UserError, match=r"log\.csv:4: .*empty"):
        read(text_of(rows[:3]) + "\n" + text_of(rows[3:]))


def test_zero_byte(read):
    with pytest.raises(UserError, match=r"log\.csv.*zero byte"):
        read(text_of(table()).replace(".", "\0", 3).encode())


def test_field_of_10000_characters_is_quoted_in_part(read):
    for field in ("x" * 10_000, "9" * 10_000):
        rows = table()
        rows[2][5] = field
        with pytest.raises(UserError, match=r"log\.csv:3: .*'omega' \(6\)") as refusal:
            read(rows)
        assert len(str(refusal.value)) < 500
    rows = table()
    rows[2][5] = "0." + "3" * 10_000
    check_same(read(rows), rows)


def test_text_that_is_not_utf8_is_refused_in_words(read):
    """Latin-1 from a spreadsheet: in a needed field refused, in an ignored column nobody's business."""
    rows = table()
    bad = text_of(rows).replace(rows[2][3], "5\u00b0").encode("latin-1")
    with pytest.raises(UserError, match=r"log\.csv:3: .*'theta' \(4\)"):
        read(bad)
    noted = [[*row, "5\u00b0"] for row in rows]
    check_same(read(text_of(noted).encode("latin-1")), rows)


def test_more_columns_than_can_be_read(read):
    rows = table()
    check_same(read([row + [f"c{i}" for i in range(58)] for row in rows]), rows)
    with pytest.raises(UserError, match=r"log\.csv:1: 65 columns"):
        read([row + [f"c{i}" for i in range(59)] for row in rows])


def test_not_a_file(tmp_path):
    with pytest.raises(UserError, match="missing.csv"):
        bridge.read_log(tmp_path / "missing.csv")
    with pytest.raises(UserError, match=tmp_path.name):
        bridge.read_log(tmp_path)


def test_long_path_does_not_crowd_out_the_reason(tmp_path):
    folder = tmp_path / ("a" * 200) / ("b" * 200) / ("c" * 200)
    folder.mkdir(parents=True)
    rows = table()
    rows[4][3] = "abc"
    (folder / "log.csv").write_text(text_of(rows))
    with pytest.raises(UserError, match=r"log\.csv:5: .*'theta' \(4\).*'abc'"):
        bridge.read_log(folder / "log.csv")


def test_unknown_platform_is_refused_by_the_reader_and_by_the_tools_alike(tmp_path):
    for refusal in (lambda: bridge.read_log(tmp_path / "a.csv", "submarine"), lambda: platforms.check("submarine")):
        with pytest.raises(UserError, match=f"'submarine': use {', '.join([*COLUMNS][:-1])} or {[*COLUMNS][-1]}$"):
            refusal()


@pytest.mark.parametrize("platform", COLUMNS)
def test_tools_know_the_columns_of_the_reader(platform):
    assert ["t", *platforms.COLUMNS[platform]] == COLUMNS[platform].split(",")
    assert platforms.sizes(platform)[0] == LOG_STATES[platform]


@pytest.mark.parametrize("platform", COLUMNS)
@pytest.mark.parametrize("more", [[], ["gx", "u"], ["px", "v"], ["imu_gx", "pitch", "roll"]], ids=" ".join)
def test_columns_tell_the_platform(tmp_path, platform, more):
    """Others beside them do not, and the order, blanks and a byte order mark do not matter."""
    names = COLUMNS[platform].split(",")
    for header in (names + more, [*more, *reversed(names)], [f" {name} " for name in names], ["\ufeff" + names[1], *names[2:]]):
        path = tmp_path / "log.csv"
        path.write_text(",".join(dict.fromkeys(header)) + "\n")
        assert platforms.of_log(path) == platform


def test_platform_of_no_file(tmp_path):
    for path in (tmp_path / "missing.csv", tmp_path):
        with pytest.raises(UserError, match=f"{path.name}: cannot be opened"):
            platforms.of_log(path)


def test_other_platforms_log(read):
    with pytest.raises(UserError, match=r"log\.csv:1: column 'px' is missing"):
        read(table("fwmav"))


# ---- a program that writes numbers with a comma -----------------------------------------------------

COMMA = textwrap.dedent("""
    import locale, sys
    import numpy as np
    from tinykoop import platforms
    from tinykoop import bridge

    locale.setlocale(locale.LC_NUMERIC, "comma")
    assert locale.localeconv()["decimal_point"] == ","
    x, u = np.full((4, 3), 1.5), np.full((4, 2), 0.25)
    bridge.write_log(sys.argv[1], x, u, 0.05)
    log = bridge.read_log(sys.argv[1])
    assert (log.x == x).all() and (log.u == u).all() and abs(log.dt - 0.05) < 1e-12
    assert locale.localeconv()["decimal_point"] == ","
""")


def test_locale_with_a_decimal_comma(tmp_path):
    """strtod() and printf() follow the program's locale; a log does not."""
    source = tmp_path / "comma.txt"
    source.write_text('LC_NUMERIC\ndecimal_point ","\nthousands_sep ""\ngrouping -1\nEND LC_NUMERIC\n')
    if not shutil.which("localedef"):
        pytest.skip("no localedef to make a locale with")
    subprocess.run(["localedef", "-c", "-i", source, "-f", "UTF-8", tmp_path / "comma"], capture_output=True)
    if not (tmp_path / "comma/LC_NUMERIC").is_file():
        pytest.skip("localedef makes no locale here")
    environment = os.environ | {"PYTHONPATH": str(Path(bridge.__file__).resolve().parents[2]), "LOCPATH": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", COMMA, tmp_path / "log.csv"], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "log.csv").read_text().splitlines()[2] == "0.05,1.5,1.5,1.5,0.25,0.25"


# ---- what nobody thought of ------------------------------------------------------------------------

FUZZ = textwrap.dedent(r"""
    import sys
    import numpy as np
    from tinykoop import platforms
    from tinykoop import bridge
    from tinykoop.plumbing.errors import UserError

    folder, seed, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    rng = np.random.default_rng(seed)
    header = b"t,px,py,theta,v,omega,seg,pose_ok\n"
    row = b"%.2f,1.5,-2e-3,0.1,1,0,%d,1\n"
    good = header + b"".join(row % (k / 20, k // 4) for k in range(8))
    pieces = [b",", b"\n", b"\r\n", b"\r", b"-", b".", b"e", b"E+", b"nan", b"inf", b"1e309", b"1e308", b"0x1",
              b"\0", b"\xff", b"\xef\xbb\xbf", b" ", b"\t", b"9" * 400, b"," * 80, b"t", b"px", b"\"", b"%s%n"]
    read = refused = 0
    for _ in range(count):
        text = bytearray(good)
        for _ in range(rng.integers(1, 4)):
            at, to = sorted(rng.integers(0, len(text) + 1, 2))
            what = rng.integers(5)
            if what == 0 and at < len(text):
                text[at] = rng.integers(256)
            elif what == 1:
                text[at:at] = pieces[rng.integers(len(pieces))]
            elif what == 2:
                del text[at : at + rng.integers(1, 6)]
            elif what == 3:
                text[at:at] = text[at:to]
            else:
                del text[at:]
        with open(folder + "/f.csv", "wb") as file:
            file.write(text)
        try:
            log = bridge.read_log(folder + "/f.csv")
        except UserError as refusal:
            message = str(refusal)
            assert "f.csv" in message and len(message) < 600, message
            assert min(message) >= " ", f"control characters in {message!r}"
            refused += 1
            continue
        read += 1
        assert len(log.t) >= 3 and (np.diff(log.t) > 0).all() and 0 < log.dt < np.inf, bytes(text)
        assert np.isfinite(log.t).all() and np.isfinite(log.u).all(), bytes(text)
        used = np.append(log.usable, False) | np.append(False, log.usable)
        assert np.isfinite(log.x[used]).all(), bytes(text)
    print(read, refused)
""")


def test_damaged_files_are_read_or_refused(tmp_path):
    """2000 mutations of a good file, in a process of its own so that a crash is a failure."""
    command = [sys.executable, "-X", "utf8", "-c", FUZZ, str(tmp_path), "7", "2000"]
    environment = os.environ | {"PYTHONPATH": str(Path(bridge.__file__).resolve().parents[2])}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
    read, refused = map(int, done.stdout.split())
    assert read > 50 and refused > 500 and read + refused == 2000


# ---- real logs --------------------------------------------------------------------------------------


def real_logs():
    files = {"ddr": ("norlab_drive", "utias_mrclam"), "fwmav": ("flapper",)}
    return [
        pytest.param(path, platform, id=path.stem)
        for platform, folders in files.items()
        for folder in folders
        for path in sorted((DATA / folder).glob("*.csv"))
        if not path.stem.endswith("_aux")
    ]


@pytest.mark.parametrize("path, platform", real_logs())
def test_real_log(path, platform):
    """Recorded by others; NumPy's own CSV reader is the judge."""
    log = bridge.read_log(path, platform)
    table = np.genfromtxt(path, delimiter=",", names=True)
    names = COLUMNS[platform].split(",")
    ours = np.column_stack([log.t, log.x, log.u])
    assert np.array_equal(ours, np.column_stack([table[name] for name in names]), equal_nan=True)
    usable = np.ones(len(log.t) - 1, bool)
    for name, keep in (("seg", lambda s: s[1:] == s[:-1]), ("pose_ok", lambda p: (p[1:] * p[:-1]) != 0)):
        if name in table.dtype.names:
            usable &= keep(table[name])
    usable &= np.abs(np.diff(table["t"]) - log.dt) < 0.5 * log.dt
    assert np.array_equal(log.usable, usable)
    assert log.dt == pytest.approx(0.05 if platform == "ddr" else 0.01, rel=1e-6)
    assert usable.mean() > 0.5


def test_real_logs_were_there():
    if not real_logs():
        pytest.skip("no real logs beside the project (../shared/data): the tests of them did not run")
