"""`pip install .`: sdist and wheel hold what they need, and the wheel's command works outside the checkout."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from tinykoop import cli
from tinykoop.plumbing import checkout

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
VERSION = re.search(r'KOOP_VERSION "(.*)"', (ROOT / "lib/include/tinykoop.h").read_text())[1]
# Paths that lead into the checkout.
LEFT_OUT = ("PYTHONPATH", "TINYKOOP_SIM", "MAKEFLAGS")


def run(*command, folder=ROOT, status=0, **variables):
    environment = {name: value for name, value in os.environ.items() if name not in LEFT_OUT} | {"COLUMNS": "80"} | variables
    done = subprocess.run([str(part) for part in command], cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == status, done.stdout + done.stderr
    return done


@pytest.fixture(scope="module")
def dist(tmp_path_factory):
    """Folder with the sdist, and the wheel that is built out of it."""
    folder = tmp_path_factory.mktemp("dist")
    run(sys.executable, "-c", f"import scikit_build_core.build as b; b.build_sdist({str(folder)!r})")
    (sdist,) = folder.glob("*.tar.gz")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check")
    run(*pip, "wheel", "--no-build-isolation", "--no-deps", "--no-index", "-w", folder, sdist, folder=folder)
    return folder


@pytest.fixture(scope="module")
def wheel(dist):
    (path,) = dist.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def command(wheel, tmp_path_factory):
    """The tinykoop of a fresh environment, which has the other packages from that of the tests, behind its own."""
    folder = tmp_path_factory.mktemp("installed") / "venv"
    venv.create(folder, symlinks=True)
    python = folder / "bin/python"
    run(sys.executable, "-m", "pip", "--python", python, "install", "--no-deps", "--no-index", "--disable-pip-version-check", wheel)
    (packages,) = folder.glob("lib/python*/site-packages")
    (packages / "others.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "bin/tinykoop"


def names(archive):
    with zipfile.ZipFile(archive) as file:
        return file.namelist()


# ---- what is in them -----------------------------------------------------------------------------------


def test_one_wheel_serves_every_python(wheel):
    assert re.fullmatch(rf"tinykoop-{re.escape(VERSION)}-py3-none-\w+\.whl", wheel.name)
    assert wheel.stat().st_size < 2e6


def test_wheel_holds_the_package_its_library_and_its_data(wheel):
    sources = {f"tinykoop/{path.relative_to(checkout.PACKAGE).as_posix()}" for path in checkout.PACKAGE.rglob("*.py")}
    sources |= {f"tinykoop/_lib/c/{path.relative_to(ROOT / 'lib').as_posix()}" for path in (ROOT / "lib").rglob("*.[ch]")}
    rest = {name for name in names(wheel) if ".dist-info/" not in name} - sources
    assert sources <= set(names(wheel))
    vehicles = {f"tinykoop/vehicles/{path.name}" for path in (ROOT / "tools/tinykoop/vehicles").glob("*.toml")}
    assert rest == {"tinykoop/_lib/libtinykoop_sim.so", "tinykoop/firmware/footprint.json", "tinykoop/py.typed", *vehicles} and vehicles
    assert [name for name in names(wheel) if name.endswith("licenses/LICENSE")]


def test_sdist_holds_sources_alone(dist):
    (sdist,) = dist.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert {"lib/koopf.c", "host_sim/CMakeLists.txt", "tools/tinykoop/cli.py", "pyproject.toml", "CMakeLists.txt", "LICENSE"} <= held
    assert all((ROOT / name).exists() for name in held - {"PKG-INFO"})
    if (ROOT / ".git").exists():  # which knows the sources; unpacked sources have none
        tracked = set(run("git", "ls-files", "--cached", "--others", "--exclude-standard").stdout.splitlines())
        assert held - tracked == {"PKG-INFO"}
    assert sdist.stat().st_size < 2e6


# ---- requirements --------------------------------------------------------------------------------------


def pins(name):
    """{package: version} of a file of requirements."""
    lines = (ROOT / "tools" / f"{name}.txt").read_text().splitlines()
    return {package.lower(): version for package, _, version in (line.partition("==") for line in lines) if version}


def unmet(wanted, have):
    """Requirements that the versions do not meet, or that have no lower bound."""
    parsed = [Requirement(text) for text in wanted]
    return [str(one) for one in parsed if ">=" not in str(one) or not one.specifier.contains(have.get(one.name.lower(), "0"))]


def test_requirements_of_the_wheel_are_those_of_make():
    (builds,) = PROJECT["build-system"]["requires"]
    have = pins("requirements")
    assert f"scikit-build-core=={have.pop('scikit-build-core')}" == builds
    wanted = PROJECT["project"]["dependencies"]
    assert {Requirement(text).name.lower() for text in wanted} == set(have)
    assert unmet(wanted, have) == []


@pytest.mark.parametrize("extra", PROJECT["project"]["optional-dependencies"])
def test_extras_are_those_of_make(extra):
    assert unmet(PROJECT["project"]["optional-dependencies"][extra], pins(f"requirements-{extra}")) == []


def test_every_extra_that_a_message_names_exists():
    sources = "".join(path.read_text() for path in checkout.PACKAGE.rglob("*.py"))
    named = re.findall(r"""(?:install\(|asked\.package\([^)]*, |package\("[\w.]+", )["'](\w+)["']\)""", sources)
    assert len(named) > 4 and set(named) <= set(PROJECT["project"]["optional-dependencies"])


# ---- outside the checkout ------------------------------------------------------------------------------


def test_package_calls_its_own_library(command, tmp_path):
    """The simulator of the wheel computes what that of the checkout does, bit for bit."""
    program = """
import json, sys, tinykoop
from tinykoop import bridge
u = [[1.5, 0.4]] * 20
print(json.dumps([tinykoop.__file__, sys.path, bridge.simulate(u, 0.05, active=[bridge.usual_effect("pacejka_slip", 0.0)]).tolist()]))
"""
    ours, theirs = (
        json.loads(run(python, "-c", program, folder=tmp_path).stdout) for python in (sys.executable, command.parent / "python")
    )
    assert Path(theirs[0]).is_relative_to(command.parents[1]) and str(ROOT / "tools") not in theirs[1]
    assert ours[2] == theirs[2]


def test_every_module_can_be_imported(command, tmp_path):
    program = """
import importlib, pkgutil, tinykoop
for module in pkgutil.walk_packages(tinykoop.__path__, "tinykoop.", onerror=lambda name: None):
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        assert not error.name.startswith("tinykoop"), error
"""
    run(command.parent / "python", "-c", program, folder=tmp_path)


def test_commands_work(command, tmp_path):
    assert run(command, "--version", folder=tmp_path).stdout == f"tinykoop {VERSION}\n"
    assert "pacejka_slip" in run(command, "effects", folder=tmp_path).stdout
    assert "KOOP_RLS_REALS_SQRT(22, 2)" in run(command, "size", "-N", 22, "-n", 3, "-m", 2, folder=tmp_path).stdout
    run(command, "fly", "pitch", "flight.csv", "--seconds", 12, folder=tmp_path)
    run(command, "fit", "flight.csv", "model.h", folder=tmp_path)
    run(command, "diagnose", "flight.csv", folder=tmp_path)
    assert (tmp_path / "tinykoop-out/diagnose/report.html").stat().st_size > 10_000
    assert json.loads((tmp_path / "tinykoop-out/diagnose/report.json").read_text())["platform"] == "fwmav"


def test_robots_of_your_own_work(command, tmp_path):
    run(command, "robot", "new", "bot", folder=tmp_path)
    assert "lag" in run(command, "effects", "--robot", "bot.toml", folder=tmp_path).stdout


def test_dictionaries_in_c_are_compiled_against_the_sources_inside(command, tmp_path):
    (tmp_path / "own.c").write_text((ROOT / "examples/drive_dictionary.c").read_text())
    program = "import tinykoop as tk; print(tk.RLS(tk.CSource('own.c', 'drive'), 2).begin(3).theta.shape)"
    assert run(command.parent / "python", "-c", program, folder=tmp_path).stdout == "(6, 8)\n"


@pytest.mark.parametrize(
    "arguments", [*cli.DEVELOPERS, "learn --update", "demo --update", "blind --robot car"], ids=lambda arguments: arguments.replace(" ", "")
)
def test_developers_commands_refuse_with_one_line(command, tmp_path, arguments):
    done = run(command, *arguments.split(), folder=tmp_path, status=2)
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"tinykoop: {' '.join(arguments.split()[:2])}: needs a checkout of TinyKoop") and not done.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package_is_named_with_its_extra(command, tmp_path):
    (tmp_path / "mcap.py").write_text("raise ImportError\n")
    (tmp_path / "drive.csv").write_text("t,px,py,theta,v,omega\n")
    done = run(command, "diagnose", "drive.csv", "--mcap", "out.mcap", folder=tmp_path, status=2, PYTHONPATH=str(tmp_path))
    assert 'pip install "tinykoop[mcap]"' in done.stderr


def test_a_missing_library_is_named(command, tmp_path):
    done = run(command, "effects", folder=tmp_path, status=2, TINYKOOP_SIM="absent.so")
    assert done.stderr == "tinykoop: absent.so is missing: pip install --force-reinstall --no-deps tinykoop\n"
