"""Nothing that Windows lacks is in the way of the command there. Windows itself is not tested: its modules are stood in for."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WINDOWS = """
import os, signal, sys, types
sys.path.insert(0, {tools!r})
from tinykoop import bridge  # NumPy and SciPy are those of this system
import multiprocessing, joblib, rich.console, matplotlib
for name in [name for name in sys.modules if name.startswith("tinykoop")]:
    del sys.modules[name]
owners = {{}}
def locking(file, mode, size):
    place = os.fstat(file).st_ino
    if owners.setdefault(place, file) != file:
        raise PermissionError(13, "locked")
sys.modules.update(fcntl=None, resource=None, msvcrt=types.SimpleNamespace(locking=locking, LK_NBLCK=2))
sys.platform = "win32"
del signal.SIGPIPE
"""


def on_windows(program, folder):
    code = WINDOWS.format(tools=str(ROOT / "tools")) + program
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True)


def test_the_command_needs_no_module_that_windows_lacks(tmp_path):
    done = on_windows("from tinykoop import cli\nsys.argv = ['tinykoop', 'diagnose', '--help']\ncli.main()", tmp_path)
    assert done.returncode == 0 and "usage: tinykoop diagnose" in done.stdout, done.stderr


@pytest.mark.parametrize("path", ["", "file"])
def test_a_lock_that_another_has_is_refused_there(tmp_path, path):
    program = f"""
from tinykoop.plumbing.locks import locked
with locked({path!r} or "."):
    try:
        with locked({path!r} or ".", wait=False):
            print("both")
    except BlockingIOError:
        print("refused")
"""
    done = on_windows(program, tmp_path)
    assert done.stdout == "refused\n", done.stderr


def test_results_are_written_there(tmp_path):
    program = """
from tinykoop.plumbing.results import alone, replacing, write_json
with alone("blind"), replacing("rows.json", [1]):
    write_json("other.json", [2])
print(sorted(os.listdir(".")))
"""
    done = on_windows(program, tmp_path)
    assert done.stdout == "['.blind.lock', '.lock', 'other.json', 'rows.json']\n", done.stderr
