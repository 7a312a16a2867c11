"""Makes the tools importable without installing them, and computes as they do: in one thread."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools"))
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ["COLUMNS"] = "80"

# Files that take longest, in processor time: a worker that begins with one of them at the end leaves the others idle.
SLOWEST = (
    "test_diagnose", "test_diagnose_input", "test_own_robot", "test_real_flights", "test_docs", "test_functions", "test_host_faults",
    "test_install", "test_drop_in", "test_effect_forms", "test_links", "test_examples_own", "test_objects", "test_flight",
    "test_quadrotor_diagnosis", "test_own_dictionaries", "test_convert", "test_simulators_mujoco", "test_simulators_fmu",
    "test_own_links", "test_blind_own", "test_pooled", "test_simulators_recorded", "test_long_logs", "test_assure_flips",
)  # fmt: skip


def pytest_collection_modifyitems(items):
    """Slow files first; xdist is told to leave that order as it is (Makefile)."""
    place = {name: k for k, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: place.get(item.path.stem, len(SLOWEST)))


@pytest.fixture
def tinykoop_in(monkeypatch, capsys):
    """What a process that runs `tinykoop ARGUMENTS` in a folder returns, without one: to start Python takes longer than most commands."""
    from tinykoop import cli

    def run(folder, *arguments):
        monkeypatch.chdir(folder)
        monkeypatch.setattr(sys, "argv", ["tinykoop", *map(str, arguments)])
        capsys.readouterr()
        status = cli.main()
        said = capsys.readouterr()
        assert not [line for line in said.out.splitlines() if "───" in line and len(line) > 80] and "…" not in said.out
        return subprocess.CompletedProcess(arguments, status, *said)

    return run


@pytest.fixture(scope="session")
def firmware(tmp_path_factory):
    """firmware("koopf"): object of lib/koopf.c, compiled as a firmware does: once, whoever links it."""
    from tinykoop.plumbing.locks import locked

    base = tmp_path_factory.getbasetemp()
    folder = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base

    def get(unit):
        path = folder / f"{unit}.o"
        with locked(folder / f"{unit}.lock"):
            if not path.exists():
                command = ["gcc", "-std=c99", "-O2", "-I", ROOT / "lib/include", "-c", ROOT / f"lib/{unit}.c", "-o", path]
                subprocess.run(command, check=True)
        return path

    return get


@pytest.fixture(autouse=True, scope="session")
def titles_fit():
    """Every title of a plot that a test makes ends within the figure."""
    from tinykoop.plumbing import plots

    save = plots.save

    def checked(figure, path):
        save(figure, path)
        titles = [figure._suptitle, *(title for ax in figure.axes for title in (ax.title, ax._left_title))]
        wide = [title.get_text() for title in titles if title and title.get_text() and title.get_window_extent().x1 > figure.bbox.x1 + 1]
        assert not wide, f"{path}: too long for the figure"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plots, "save", checked)
        yield
