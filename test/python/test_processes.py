"""A forked process is, to a test, as one that Python was started for."""

import os
import subprocess
import sys

import processes
import pytest

SHOW = """
import os, resource, signal, sys
print(sys.argv, os.getcwd(), os.environ["MINE"], sorted(os.environ), __name__)
print(*((s.encoding, s.errors, s.line_buffering) for s in (sys.stdout, sys.stderr)), sys.stdin.read())
print(signal.getsignal(signal.SIGPIPE), signal.getsignal(signal.SIGINT), sorted(map(int, os.listdir("/proc/self/fd")))[:3])
print("this too", file=sys.stderr)
"""
ENDS = {
    "a status": "raise SystemExit(3)", "a line": "raise SystemExit('no')", "an error": "1 / 0", "a signal": "os.kill(os.getpid(), signal.SIGTERM)",
    "nobody reads": "os.dup2(os.open('/dev/full', os.O_WRONLY), 1)", "at its end": "import atexit; atexit.register(print, 'late')",
}  # fmt: skip


@pytest.mark.parametrize("end", ENDS)
def test_a_forked_process_is_as_one_of_its_own(end, tmp_path):
    code, environment = SHOW + ENDS[end], {**os.environ, "MINE": "é", "PYTHONIOENCODING": "utf-8:strict"}
    forked = processes.python(code, "a", "\udcff", cwd=tmp_path, env=environment)
    command = [sys.executable, "-c", code, "a", "\udcff"]
    own = subprocess.run(command, cwd=tmp_path, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert (forked.returncode, forked.stdout) == (own.returncode, own.stdout)
    assert forked.stderr.splitlines()[:1] == own.stderr.splitlines()[:1] == ["this too"]
    assert forked.stderr.splitlines()[-1] == own.stderr.splitlines()[-1]


def test_a_file_may_not_grow_beyond_its_limit(tmp_path):
    done = processes.python("import pathlib, sys; pathlib.Path(sys.argv[1]).write_bytes(bytes(3000))", tmp_path / "a", largest=2000)
    assert done.returncode == 1 and "File too large" in done.stderr and (tmp_path / "a").stat().st_size == 2000


def test_what_does_not_end_is_killed():
    assert processes.Process("import time; time.sleep(600)").kill_after(0.05) == -9
    assert processes.Process("raise SystemExit(5)").kill_after(60) == 5
