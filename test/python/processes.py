"""Processes that run `tinykoop` or other Python code, each forked from one that has imported the packages.

To start Python and to import them takes longer than most commands do. Everything else is as in a process of its own:
arguments, folder, environment, output, limits, signals, and what the interpreter does at its end.
"""

import atexit
import functools
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

TINYKOOP = "import sys; from tinykoop.cli import main; sys.exit(main())"
MODULES = (
    *(f"tinykoop.{name}" for name in ("diagnose", "logs.replay", "logs.changes", "logs.fit", "convert", "experiments.learn")),
    "matplotlib.backends.backend_agg", "matplotlib.pyplot",
)  # fmt: skip

# Forks at each request, and waits at each other. A child leaves the loop, and ends as a script of its own does.
SERVER = """
import gc, importlib, json, os, resource, socket, sys
for name in sys.argv[2:]:
    importlib.import_module(name)
requests = socket.socket(fileno=int(sys.argv[1]))
gc.freeze()  # else a child copies what it looks at only to release it
while True:
    message, streams, *_ = socket.recv_fds(requests, 1 << 18, 3)
    if not message:
        sys.exit()
    asked = json.loads(message)
    if "wait" in asked:
        pid, status = os.waitpid(asked["wait"], 0 if asked["block"] else os.WNOHANG)
        requests.send(json.dumps(os.waitstatus_to_exitcode(status) if pid else None).encode())
        continue
    pid = os.fork()
    if not pid:
        break
    for stream in streams:
        os.close(stream)
    requests.send(json.dumps(pid).encode())
requests.close()
for to, stream in enumerate(streams):
    os.dup2(stream, to)
    os.close(stream)
os.chdir(asked["folder"])
os.environ.clear()
os.environ.update(asked["environment"])
encoding, _, errors = os.environ.get("PYTHONIOENCODING", "").partition(":")
if encoding:
    sys.stdout.reconfigure(encoding=encoding, errors=errors or "strict")
    sys.stderr.reconfigure(encoding=encoding, errors="backslashreplace")
if asked["largest"] is not None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (asked["largest"],) * 2)
sys.argv[:] = asked["arguments"]
exec(compile(asked["code"], "<test>", "exec"), {"__name__": "__main__"})
"""


@functools.cache
def _server():
    """The socket of the process that forks; it ends with this one."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2] / "tools")}
    command = [sys.executable, "-c", SERVER, str(theirs.fileno()), *MODULES]
    streams = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE}  # as of most of those that it forks: no terminal, no file
    server = subprocess.Popen(command, pass_fds=[theirs.fileno()], env=environment, **streams)
    theirs.close()
    atexit.register(server.wait)
    atexit.register(ours.close)  # first, which ends it
    return ours


def _ask(request, streams=()):
    socket.send_fds(_server(), [json.dumps(request).encode()], streams)
    return json.loads(_server().recv(100))


class Process:
    """One that runs `code` with arguments; output goes to open files, or nowhere. No file of it grows beyond `largest` bytes."""

    def __init__(self, code, *arguments, stdout=None, stderr=None, cwd=None, env=None, largest=None):
        request = {"code": code, "arguments": ["-c", *map(str, arguments)], "folder": str(cwd or os.getcwd()), "largest": largest}
        with open(os.devnull, "r+b") as nothing:
            streams = [nothing.fileno(), *((stream or nothing).fileno() for stream in (stdout, stderr))]
            self.pid = _ask(request | {"environment": dict(os.environ if env is None else env)}, streams)
        self.returncode = None

    def _ended(self, block):
        if self.returncode is None:
            self.returncode = _ask({"wait": self.pid, "block": block})
        return self.returncode

    def wait(self):
        return self._ended(True)

    def kill_after(self, seconds):
        """Unless it ends before."""
        end = time.perf_counter() + seconds
        while time.perf_counter() < end and self._ended(False) is None:
            time.sleep(0.002)
        if self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)
        return self.wait()


def python(code, *arguments, stdout=None, **options):
    """What is left of a process that has ended, with all that it printed."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as error:
        status = Process(code, *arguments, stdout=stdout or out, stderr=error, **options).wait()
        said = [stream.seek(0) or stream.read().decode() for stream in (out, error)]
    return subprocess.CompletedProcess(arguments, status, *said)


def tinykoop(*arguments, **options):
    """`tinykoop ARGUMENTS` in a process."""
    return python(TINYKOOP, *arguments, **options)
