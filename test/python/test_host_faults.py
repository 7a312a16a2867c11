"""Killed half-way, full disk, read-only folder, two runs at once: no half result is ever taken for a whole one."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import processes
import pytest
from tinykoop import bridge
from tinykoop.experiments import scenario
from tinykoop.plumbing import results
from tinykoop.plumbing.errors import UserError

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / "tools")}
TINYKOOP = [sys.executable, "-m", "tinykoop.cli"]
AMALGAMATE = f"import runpy; runpy.run_path({str(ROOT / 'tools/amalgamate.py')!r}, run_name='__main__')"
PLOTS = ["learn_adaptation.png", "learn_covariance.png", "learn_error.png", "learn_operator.png", "learn_paths.png", "learn_precision.png"]


def one_line(done):
    """Whether a failure is what a user is to see."""
    return done.returncode == 2 and done.stderr.count("\n") == 1 and "Traceback" not in done.stderr


def python(code, *arguments):
    """A process that runs `code`."""
    return subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)


def ran(process):
    """Its exit status, and what it said on standard error."""
    _, error = process.communicate(timeout=300)
    return process.returncode, error


def parts(folder):
    return sorted(folder.rglob("*.part"))


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "drive.csv"
    u = scenario.commands(400)
    x = bridge.simulate(u, 0.05, active=[bridge.usual_effect("pacejka_slip")])
    bridge.write_log(path, x[:-1], u, 0.05)
    return path


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    path = tmp_path_factory.mktemp("flight") / "hover.csv"
    flown, _ = bridge.fwmav("hover", 12.0, 1, [])
    bridge.write_log(path, flown.x, flown.u, flown.dt, "fwmav")
    return path


# ---- killed ------------------------------------------------------------------------------------------

DIE_IN_WRITE = """
import os, signal, sys
from tinykoop.plumbing import results
die = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
setattr(os, sys.argv[2], die)
results.write_json(sys.argv[1], ["new"] * 100000)
"""


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_killed_in_a_write_leaves_the_old_result(call, tmp_path):
    path = tmp_path / "a.json"
    results.write_json(path, ["old"])
    assert processes.python(DIE_IN_WRITE, path, call).returncode == -signal.SIGKILL
    assert json.loads(path.read_text()) == ["old"]
    assert len(parts(tmp_path)) == 1
    results.write_json(path, ["newer"])
    assert json.loads(path.read_text()) == ["newer"]
    assert not parts(tmp_path), "what the killed run left is swept away"


def test_the_part_of_a_run_that_goes_on_is_left_alone(tmp_path):
    theirs = tmp_path / f"a.json.{os.getppid()}.part"
    theirs.write_text("half")
    results.write_json(tmp_path / "a.json", [])
    assert parts(tmp_path) == [theirs]


DIE_AFTER_PLOTS = """
import os, signal, sys
from pathlib import Path
from tinykoop.experiments import learn
from tinykoop.plumbing import plots
left, save = int(sys.argv[2]), plots.save
def saves(figure, path):
    global left
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    left -= 1
    save(figure, path)
plots.save = saves
learn.run(Path(sys.argv[1]))
"""


@pytest.mark.parametrize("plots", [0, 3])
def test_killed_between_plots_leaves_no_figures_beside_them(plots, tmp_path):
    """Old figures never stand beside new plots: learn.json is the last to be written."""
    for name in PLOTS:
        (tmp_path / name).write_bytes(b"old")
    results.write_json(tmp_path / "learn.json", ["old"])
    assert processes.python(DIE_AFTER_PLOTS, tmp_path, plots).returncode == -signal.SIGKILL
    assert not (tmp_path / "learn.json").exists()
    assert sum((tmp_path / name).read_bytes() != b"old" for name in PLOTS) == plots


def test_killed_at_any_time(log, tmp_path):
    """Whenever it dies, what is there is whole; and before it has begun to write, it is what was there."""
    name = f"replay_{log.stem}"
    whole = 300.0  # s, until a run was left alone
    for part in (1.0, 0.1, 0.7, 0.8, 0.9, 0.97):
        results.write_json(tmp_path / f"{name}.json", ["old"])
        begun = time.perf_counter()
        processes.Process(processes.TINYKOOP, "replay", log, "--out", tmp_path).kill_after(part * whole)
        whole = time.perf_counter() - begun if part == 1 else whole
        if (tmp_path / f"{name}.json").exists():
            rows = json.loads((tmp_path / f"{name}.json").read_text())
            assert rows == ["old"] or (len(rows) > 30 and (tmp_path / f"{name}.png").read_bytes().endswith(b"IEND\xaeB`\x82"))


def test_diagnose_writes_its_report_last(log, tmp_path, monkeypatch):
    from tinykoop import diagnose

    (tmp_path / "report.json").write_text("old")
    seen = []
    monkeypatch.setattr(diagnose, "write_bytes", lambda path, data: seen.append((tmp_path / "report.json").exists()))
    monkeypatch.setattr(diagnose, "show", lambda *_: None)
    diagnose.run(log, tmp_path)
    assert seen == [False]
    assert json.loads((tmp_path / "report.json").read_text())["verdict"]


def test_a_killed_installation_is_not_taken_for_ready(tmp_path):
    """The Makefile's environment is ready only when all of it is installed, and is made anew until then."""
    shutil.copy(ROOT / "Makefile", tmp_path)
    for name in ("tools/requirements.txt", "pyproject.toml", "lib/include/tinykoop.h"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    interpreter = tmp_path / "python"
    interpreter.write_text(f"""#!/bin/sh
test "$1" = -c && exit 0
mkdir -p "$3/bin" && cp {tmp_path}/pip "$3/bin/pip"
""")
    (tmp_path / "pip").write_text("#!/bin/sh\nkill -9 $$\n")
    interpreter.chmod(0o755)
    (tmp_path / "pip").chmod(0o755)
    make = ["make", "-s", f"PYTHON={interpreter}", "build/venv/ready"]
    assert subprocess.run(make, cwd=tmp_path, capture_output=True).returncode != 0
    assert not (tmp_path / "build/venv/ready").exists()
    (tmp_path / "build/venv/left-over").touch()
    (tmp_path / "pip").write_text("#!/bin/sh\nexit 0\n")
    assert subprocess.run(make, cwd=tmp_path, capture_output=True).returncode == 0
    assert (tmp_path / "build/venv/ready").exists()
    assert not (tmp_path / "build/venv/left-over").exists()


# ---- no room, no rights --------------------------------------------------------------------------------


@contextmanager
def mounted(folder, options):
    """A small file system in memory on `folder`; skips where that is not allowed."""
    mount = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("only root can mount a file system")
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def commands(log, flight, out):
    """Code and arguments of every kind of writer: JSON with plots, page, model, log, table, source."""
    return {
        "learn": [processes.TINYKOOP, "learn", "--out", out],
        "replay": [processes.TINYKOOP, "replay", log, "--out", out],
        "diagnose": [processes.TINYKOOP, "diagnose", log, "--out", out],
        "changes": [processes.TINYKOOP, "changes", flight, "--out", out],
        "fit": [processes.TINYKOOP, "fit", log, out / "model.h"],
        "fly": [processes.TINYKOOP, "fly", "hover", out / "flight.csv", "--seconds", "5"],
        "amalgamate": [AMALGAMATE, "--out", out],
    }


WRITERS = list(commands(Path(), Path(), Path()))


@pytest.mark.parametrize("writer", WRITERS)
def test_no_room_for_a_file(writer, log, flight, tmp_path):
    done = processes.python(*commands(log, flight, tmp_path)[writer], largest=2000)
    assert one_line(done), done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("writer", WRITERS)
def test_full_disk(writer, log, flight, tmp_path):
    with mounted(tmp_path, "size=8k"):
        (tmp_path / "filler").write_bytes(bytes(4096))
        done = processes.python(*commands(log, flight, tmp_path)[writer])
        assert one_line(done), done.stderr
        assert [path.name for path in tmp_path.iterdir()] == ["filler"]


@pytest.mark.parametrize("writer", WRITERS)
def test_read_only_folder(writer, log, flight, tmp_path):
    with mounted(tmp_path, "ro"):
        done = processes.python(*commands(log, flight, tmp_path)[writer])
        assert one_line(done), done.stderr
        assert str(tmp_path) in done.stderr


def test_blind_check_in_a_read_only_folder(tmp_path):
    with mounted(tmp_path, "ro"):
        for platform in ("ddr", "fwmav"):
            done = processes.tinykoop("blind", "--platform", platform, "--n", "1", "--out", tmp_path)
            assert one_line(done), done.stderr


def test_terminal_that_takes_nothing(log, tmp_path):
    with open("/dev/full", "w") as full:
        done = processes.tinykoop("replay", log, "--out", tmp_path, stdout=full)
    assert one_line(done), done.stderr
    assert not list(tmp_path.iterdir())  # it fails in the progress bar, before there are results


# ---- names that are not UTF-8 ----------------------------------------------------------------------------

STRICT = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}  # in the C locale Python prints such names as they are


def named(log, folder, suffix=".csv"):
    """A copy of the log whose name is Latin-1."""
    path = Path(os.fsdecode(os.fsencode(folder) + b"/drive-\xff" + os.fsencode(suffix)))
    shutil.copy(log, path)
    return path


@pytest.mark.parametrize("writer", ["replay", "diagnose", "fresh", "changes", "healthy", "fit", "fly", "convert"])
def test_a_name_that_is_not_utf8_is_shown_escaped(writer, log, flight, tmp_path):
    """Of the log, of the folder for results and of what is written: pages and JSON are UTF-8 all the same."""
    out = Path(os.fsdecode(os.fsencode(tmp_path) + b"/out-\xfe"))
    drive, hover = named(log, tmp_path), named(flight, tmp_path, ".flight.csv")
    more = {
        "fresh": [processes.TINYKOOP, "diagnose", log, "--fresh", drive, "--out", out],
        "healthy": [processes.TINYKOOP, "diagnose", hover, "--healthy", hover, "--platform", "fwmav", "--out", out],
        "convert": [processes.TINYKOOP, "convert", drive, out.with_suffix(".csv"), "--platform", "ddr"],
    }
    done = processes.python(*(commands(drive, hover, out) | more)[writer], env=STRICT)
    assert done.returncode == 0, done.stderr
    said = done.stdout + done.stderr
    assert "Traceback" not in said
    assert r"drive-\xff" in said or writer not in ("convert", "fit")
    for path in out.glob("*") if out.exists() else ():
        if path.suffix in (".json", ".html", ".h"):
            text = path.read_text(encoding="utf-8")
            if path.suffix == ".json":
                text = json.dumps(json.loads(text), ensure_ascii=False)
                assert text.encode(), "half of a surrogate pair is no text"
            assert "drive-" not in text or re.search(r"drive-\\{1,2}xff", text)


def test_brackets_in_a_name_are_no_style(flight, tmp_path):
    name = tmp_path / "a[/red].csv"
    done = processes.tinykoop("fly", "hover", name, "--seconds", "5")
    assert done.returncode == 0, done.stderr
    assert name.name in done.stdout.replace("\n", "")


# ---- nobody reads on -------------------------------------------------------------------------------------


@pytest.fixture
def closed_pipe():
    """A pipe that nobody reads."""
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "w") as pipe:
        yield pipe


@pytest.mark.parametrize("writer", [writer for writer in WRITERS if writer != "amalgamate"])
def test_output_closed_early_ends_quietly(writer, log, flight, tmp_path, closed_pipe):
    """With the status that a shell gives for SIGPIPE, as after `yes | head -1`."""
    shell = subprocess.run(["bash", "-c", "yes | head -1; exit ${PIPESTATUS[0]}"], capture_output=True).returncode
    done = processes.python(*commands(log, flight, tmp_path)[writer], stdout=closed_pipe)
    assert (done.returncode, done.stderr) == (shell, "")
    assert not parts(tmp_path)


def test_help_closed_early_ends_quietly(closed_pipe):
    """In a process of its own, not one that was forked."""
    done = subprocess.run([*TINYKOOP, "--help"], env=ENVIRONMENT, stdout=closed_pipe, stderr=subprocess.PIPE, text=True)
    assert done.stderr == ""


def test_no_output_at_all_is_no_fault(log, tmp_path):
    """`>&-`: Python then has no standard output."""
    closed = f"exec {' '.join(map(str, [*TINYKOOP, 'fit', log, tmp_path / 'model.h']))} >&-"
    done = subprocess.run(["bash", "-c", closed], env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    assert (done.returncode, done.stderr) == (0, "")


# ---- two at once ---------------------------------------------------------------------------------------

WRITE_SETS = """
import sys, time
from pathlib import Path
from tinykoop.plumbing import results
out, tag = Path(sys.argv[1]), sys.argv[2]
for k in range(40):
    with results.replacing(out / "set.json", {"tag": tag, "k": k}):
        for name in ("a", "b"):
            results.write_bytes(out / name, f"{tag} {k}".encode())
            time.sleep(0.002)
"""


def test_two_runs_at_once_leave_the_set_of_one(tmp_path):
    begun = [python(WRITE_SETS, tmp_path, tag) for tag in "xy"]
    while any(process.poll() is None for process in begun):
        try:
            before = json.loads((tmp_path / "set.json").read_text())
            plots = {(tmp_path / name).read_text() for name in "ab"}
            after = json.loads((tmp_path / "set.json").read_text())
        except FileNotFoundError:
            continue  # being replaced
        if before == after:
            assert plots == {f"{before['tag']} {before['k']}"}
    assert [ran(process) for process in begun] == [(0, ""), (0, "")]
    assert not parts(tmp_path)
    last = json.loads((tmp_path / "set.json").read_text())
    assert {(tmp_path / name).read_text() for name in "ab"} == {f"{last['tag']} {last['k']}"}


WRITE_LOGS = """
import sys
import numpy as np
from tinykoop import bridge
rows = int(sys.argv[2])
for _ in range(30):
    bridge.write_log(sys.argv[1], np.full((rows, 3), rows), np.zeros((rows, 2)), 0.1)
"""


def test_two_writers_of_one_log_leave_one_of_them(tmp_path):
    """They used to write into the same file beside it."""
    path = tmp_path / "log.csv"
    begun = [python(WRITE_LOGS, path, rows) for rows in (2000, 3000)]
    assert [ran(process) for process in begun] == [(0, ""), (0, "")]
    x = bridge.read_log(path).x
    assert len(x) in (2000, 3000) and (x == len(x)).all()
    assert not parts(tmp_path)


def test_a_second_campaign_into_a_folder_is_refused(tmp_path):
    with results.alone(tmp_path / "blind.json"):
        with pytest.raises(UserError, match="another run is at work on it"):
            with results.alone(tmp_path / "blind.json"):
                pass
    with results.alone(tmp_path / "blind.json"):
        pass
