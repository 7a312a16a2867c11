"""Makes the tools importable without installing them, and computes as they do: in one thread."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture
def tinykoop_in(monkeypatch, capsys):
    """What a process that runs `tinykoop ARGUMENTS` in a folder returns, without one: to start Python takes longer than most commands."""
    from tinykoop import cli

    def run(folder, *arguments):
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", ["tinykoop", *map(str, arguments)])
        capsys.readouterr()
        status = cli.main()
        return subprocess.CompletedProcess(arguments, status, *capsys.readouterr())

    return run
