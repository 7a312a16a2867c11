"""FMUs as simulators: the example's of FMI 2.0, and a pendulum of FMI 3.0 that is written and built here.

References are the matrix exponential and SciPy's integration: other methods than the FMUs have.
"""

import csv
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from tinykoop.diagnose.platforms import own
from tinykoop.diagnose.platforms.own import Path as LogPath
from tinykoop.diagnose.prediction_errors.fit import Cause
from tinykoop.diagnose.prediction_errors.search import Search
from tinykoop.diagnose.robot import RobotLog, RunsAway
from tinykoop.diagnose.robots import toml
from tinykoop.diagnose.robots.log import read
from tinykoop.plumbing.errors import UserError

fmpy = pytest.importorskip("fmpy", reason="no fmpy here: pip install -r tools/requirements-simulators.txt")

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "examples/own_robot/two_mass"
TINYKOOP = [sys.executable, "-m", "tinykoop.cli"]
HEADERS = Path(fmpy.__file__).parent / "c-code"


def module(name):
    """build.py or make_log.py of the example, as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLE / f"{name}.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Folder with two_mass.toml and drive.fmu."""
    folder = tmp_path_factory.mktemp("two_mass")
    shutil.copy(EXAMPLE / "two_mass.toml", folder)
    module("build").build(folder / "drive.fmu")
    return folder


def edited(folder, target, old="", new="", file="modelDescription.xml"):
    """A copy of the folder's TOML and FMU with another text in one of their files."""
    for source in (*folder.glob("*.toml"), *folder.glob("*.fmu")):
        shutil.copy(source, target)
    if file.endswith(".toml"):
        text = (target / file).read_text()
        assert old in text
        (target / file).write_text(text.replace(old, new))
        return target / file
    (fmu,) = target.glob("*.fmu")
    with zipfile.ZipFile(fmu) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert old.encode() in files[file]
    files[file] = files[file].replace(old.encode(), new.encode())
    with zipfile.ZipFile(fmu, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return next(target.glob("*.toml"))


# ---- FMI 2.0: the drive ------------------------------------------------------------------------------------------


def turned(x, u, dt, load, stiffness, friction):
    """The drive's states (B, 4) after dt, exactly."""
    motor, damping = 0.01, 0.1
    A = np.zeros((5, 5))  # states, then the torque
    A[0, 2] = A[1, 3] = 1
    A[2] = np.array([-stiffness, stiffness, -damping - friction, damping, 1]) / motor
    A[3] = np.array([stiffness, -stiffness, damping, -damping - friction, 0]) / load
    return np.hstack([x, u]) @ expm(A * dt)[:4].T


def rows(seed=1, count=50):
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 4)) * [1, 1, 5, 5], rng.uniform(-2, 2, (count, 1))


@pytest.mark.parametrize("params", [(0.03, 60.0, 0.04), (0.05, 80.0, 0.0)])
@pytest.mark.parametrize("dt", [0.01, 0.0025, 0.010001])
def test_an_fmu_of_fmi_2_steps_as_the_exact_solution_does(drive, params, dt):
    robot, (x, u) = toml.read(drive / "two_mass.toml"), rows()
    np.testing.assert_allclose(robot.simulator.step(x, u, dt, np.array(params)), turned(x, u, dt, *params), rtol=1e-6, atol=1e-6)


def test_parameters_are_those_of_the_fmu(drive):
    assert list(toml.read(drive / "two_mass.toml").nominal) == [0.03, 60.0, 0.04]


def test_rows_do_not_know_of_each_other(drive):
    """Any order, any parameters in between, one by one: the same bits."""
    robot, (x, u) = toml.read(drive / "two_mass.toml"), rows()
    step, p = robot.simulator.step, robot.nominal
    once = step(x, u, 0.01, p)
    order = np.random.default_rng(2).permutation(len(x))
    assert np.array_equal(step(x[order], u[order], 0.01, p), once[order])
    assert not np.array_equal(step(x, u, 0.01, p * 1.1), once)
    assert np.array_equal(np.concatenate([step(x[k : k + 1], u[k : k + 1], 0.01, p) for k in range(len(x))]), once)


def test_an_fmu_without_snapshots_steps_to_the_same_states(drive, tmp_path):
    path = edited(drive, tmp_path, ' canGetAndSetFMUstate="true"', "")
    quick, fresh, (x, u) = toml.read(drive / "two_mass.toml"), toml.read(path), rows()
    for params in (quick.nominal, quick.nominal * 1.2):
        np.testing.assert_array_equal(fresh.simulator.step(x, u, 0.01, params), quick.simulator.step(x, u, 0.01, params))


def test_rows_that_are_not_finite_stay_so_and_are_not_simulated(drive):
    robot, (x, u) = toml.read(drive / "two_mass.toml"), rows()
    whole = robot.simulator.step(x, u, 0.01, robot.nominal)
    x[3, 1], u[7] = np.nan, np.inf
    after = robot.simulator.step(x, u, 0.01, robot.nominal)
    assert np.isnan(after[[3, 7]]).all()
    left = np.delete(np.arange(len(x)), [3, 7])
    assert np.array_equal(after[left], whole[left])
    assert np.isnan(robot.simulator.step(x[3:4], u[3:4], 0.01, robot.nominal)).all()


def test_what_was_unpacked_is_gone_at_the_end(drive, tmp_path):
    code = (
        "import os, sys; from pathlib import Path; from tinykoop.diagnose.robots import toml;"
        "robot = toml.read(Path(sys.argv[1])); print(len(os.listdir(os.environ['TMPDIR'])))"
    )
    for end, status in (("", 0), ("; raise SystemExit(3)", 3), ("; robot.simulator.step", 0)):
        done = subprocess.run(
            [sys.executable, "-c", code + end, drive / "two_mass.toml"],
            env=os.environ | {"TMPDIR": str(tmp_path)},
            capture_output=True,
            text=True,
        )
        assert (done.returncode, done.stdout, os.listdir(tmp_path)) == (status, "1\n", []), done.stderr


LOAD_SPEED = ', "load_speed@rad/s"]\nstates = {motor = "motor.phi", load = "load.phi", motor_speed = "motor.w", load_speed = "load.w"}'
LESS = ']\nstates = {motor = "motor.phi", load = "load.phi", motor_speed = "motor.w"}'


@pytest.mark.parametrize(
    "file, old, new, said",
    [
        ("two_mass.toml", '"motor.w"', '"motr.w"', "for motor_speed .*: there is no variable motr.w; there is motor.w"),
        ("two_mass.toml", '"tau"', '"motor.phi"', "motor.phi cannot be an input: it is output"),
        ("two_mass.toml", 'torque = "tau"', 'torqe = "tau"', "the robot has no torqe; there are torque"),
        ("two_mass.toml", 'inputs = {torque = "tau"}', 'inputs = ["tau"]', 'write inputs = {torque = "VARIABLE"}'),
        ("two_mass.toml", 'field = "shaft.c"', 'field = "shaft.k"', "for a ..parameter..: there is no variable shaft.k"),
        ("two_mass.toml", 'field = "shaft.c"', 'field = "der(load.w)"', "cannot be set: it is local"),
        ("two_mass.toml", "low = 0.005", "low = 0.05", "load_inertia: the model has 0.03, which is not between"),
        ("two_mass.toml", '"drive.fmu"', '"other.fmu"', "other.fmu: cannot be read as an FMU: .*No such file"),
        ("two_mass.toml", '"drive.fmu"', '"two_mass.toml"', "two_mass.toml: cannot be read as an FMU"),
        ("two_mass.toml", LOAD_SPEED, LESS, "has the state load.w, which the robot lacks; add it to"),
        ("modelDescription.xml", 'fmiVersion="2.0"', 'fmiVersion="1.0" numberOfContinuousStates="0"', "is of FMI 1.0; export it"),
        ("modelDescription.xml", "CoSimulation", "ModelExchange", "export it for co-simulation"),
        ("modelDescription.xml", 'modelIdentifier="two_mass"', 'modelIdentifier="three_mass"', "has no binaries/.*three_mass.* built for"),
        ("modelDescription.xml", 'guid="two-mass-drive-1"', 'guid="another"', "cannot be loaded: Failed to instantiate"),
        ("modelDescription.xml", '<Real unit="rad" start="0"/>', '<Integer start="0"/>', "motor.phi cannot be .*: it is Integer"),
    ],
)
def test_an_fmu_or_mapping_that_cannot_be_used_gets_one_line(drive, tmp_path, file, old, new, said):
    path = edited(drive, tmp_path, old, new, file)
    with pytest.raises(UserError, match=said) as raised:
        toml.read(path)
    assert "\n" not in str(raised.value)


def test_a_missing_package_gets_one_line(drive, monkeypatch):
    monkeypatch.setitem(sys.modules, "fmpy", None)
    with pytest.raises(UserError, match="pip install -r tools/requirements-simulators.txt"):
        toml.read(drive / "two_mass.toml")


# ---- FMI 3.0: a pendulum -----------------------------------------------------------------------------------------

PENDULUM = """
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

enum { TIME, ANGLE, SPEED, TORQUE, LENGTH, DAMPING, ANGLE0, VALUES };
typedef struct { double v[VALUES]; int stepping; fmi3LogMessageCallback tell; } Pendulum;
static const double START[VALUES] = {[LENGTH] = 0.8, [DAMPING] = 0.3};

static double pull(const double *v, double angle, double speed)
{
	return -9.81 / v[LENGTH] * sin(angle) - v[DAMPING] * speed + v[TORQUE];
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 now, fmi3Float64 dt, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *ends,
                      fmi3Boolean *early, fmi3Float64 *last)
{
	Pendulum *p = c;
	double *v = p->v;
	*event = *early = 0, *last = now + dt, *ends = v[TORQUE] < -LIMIT;
	if (v[TORQUE] > LIMIT) return p->tell(NULL, fmi3Error, "logStatusError", "the motor burns"), fmi3Error;
	for (int i = 0; i < 200; i++) { /* Verlet's method */
		double h = dt / 200, middle = v[SPEED] + h / 2 * pull(v, v[ANGLE], v[SPEED]);
		v[ANGLE] += h * middle;
		v[SPEED] = (middle + h / 2 * pull(v, v[ANGLE], 0)) / (1 + h / 2 * v[DAMPING]);
	}
	return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 in[], size_t count)
{
	Pendulum *p = c;
	if (n != count) return fmi3Error;
	for (size_t i = 0; i < n; i++) {
		if (p->stepping && STRICT && r[i] != TORQUE) return fmi3Error;
		if (r[i] == ANGLE && STARTED) continue;
		p->v[r[i]] = in[i];
	}
	return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 out[], size_t count)
{
	for (size_t i = 0; i < n; i++) out[i] = ((Pendulum *)c)->v[r[i]];
	return n == count ? fmi3OK : fmi3Error;
}

fmi3Status fmi3Reset(fmi3Instance c)
{
	Pendulum *p = c;
	p->stepping = 0;
	memcpy(p->v, START, sizeof START);
	return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible, fmi3Boolean logging,
                                         fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference required[], size_t n,
                                         fmi3InstanceEnvironment environment, fmi3LogMessageCallback tell,
                                         fmi3IntermediateUpdateCallback update)
{
	Pendulum *p = malloc(sizeof *p);
	fmi3Reset(p);
	p->tell = tell;
	return p;
}

void fmi3FreeInstance(fmi3Instance c) { free(c); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean toleranced, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean stops, fmi3Float64 stop)
{
	return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
	Pendulum *p = c;
	p->stepping = 1;
	if (STARTED) p->v[ANGLE] = p->v[ANGLE0];
	return fmi3OK;
}

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
	if (!*state) *state = malloc(sizeof(Pendulum));
	memcpy(*state, c, sizeof(Pendulum));
	return fmi3OK;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
	memcpy(c, state, sizeof(Pendulum));
	return fmi3OK;
}

fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *state)
{
	free(*state);
	*state = NULL;
	return fmi3OK;
}
"""

VARIABLE = '<Float64 name="{}" valueReference="{}" causality="{}" variability="{}" {}/>'
VARIABLES = (
    ("time", "independent", "continuous", ""),
    ("angle", "output", "continuous", 'initial="exact" start="0"'),
    ("speed", "output", "continuous", 'initial="exact" start="0"'),
    ("torque", "input", "continuous", 'start="0"'),
    ("length", "parameter", "fixed", 'start="0.8"'),
    ("damping", "parameter", "tunable", 'start="0.3"'),
    ("angle0", "parameter", "fixed", 'start="0"'),
)
DESCRIPTION = f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="3.0" modelName="pendulum" instantiationToken="p">
<CoSimulation modelIdentifier="pendulum" canGetAndSetFMUState="true" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>{"".join(VARIABLE.format(name, i, *rest) for i, (name, *rest) in enumerate(VARIABLES))}</ModelVariables>
<ModelStructure/>
</fmiModelDescription>
"""
TOML = """
name = "pendulum"
[log]
time = {column = "t", unit = "s"}
state = [{name = "angle", column = "angle", unit = "rad"}, {name = "speed", column = "speed", unit = "rad/s"}]
command = [{name = "torque", column = "torque", unit = "N m"}]
[simulator]
fmu = "pendulum.fmu"
[[parameter]]
name = "length"
unit = "m"
low = 0.2
high = 2
[[parameter]]
name = "damping"
unit = "1/s"
low = 0
high = 2
"""


def pendulum(folder, strict=0, started=0, limit=100.0, starts=""):
    """The TOML of a pendulum. strict: it takes states only before its start; started: its angle only from angle0; limit of its torque."""
    (folder / "pendulum.c").write_text(PENDULUM)
    names = [name for name in dir(fmpy.fmi3.FMU3Slave) if name.startswith("fmi3")]
    (folder / "stubs.c").write_text("".join(f"int {name}(void) {{ return 3; }}\n" for name in names if f" {name}(" not in PENDULUM))
    flags = [f"-DSTRICT={strict}", f"-DSTARTED={started}", f"-DLIMIT={limit}", f"-I{HEADERS}"]
    subprocess.run(["gcc", "-O1", "-shared", "-fPIC", *flags, "pendulum.c", "stubs.c", "-o", "pendulum.so", "-lm"], cwd=folder, check=True)
    with zipfile.ZipFile(folder / "pendulum.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)
        archive.write(folder / "pendulum.so", f"binaries/{fmpy.platform_tuple}/pendulum.so")
    (folder / "pendulum.toml").write_text(TOML.replace('.fmu"', f'.fmu"\n{starts}'))
    return folder / "pendulum.toml"


def swung(x, u, dt, params):
    """States (B, 2) of the pendulum after dt, by an integration of high order."""
    length, damping = params

    def rate(t, flat):
        angle, speed = flat.reshape(2, -1)
        return np.concatenate([speed, -9.81 / length * np.sin(angle) - damping * speed + u[:, 0]])

    return solve_ivp(rate, (0, dt), x.T.ravel(), "DOP853", rtol=1e-12, atol=1e-12).y[:, -1].reshape(2, -1).T


def swings(count=30):
    rng = np.random.default_rng(4)
    return rng.normal(size=(count, 2)) * [1, 3], rng.uniform(-5, 5, (count, 1))


@pytest.mark.parametrize(
    "options",
    [{}, {"strict": 1}, {"started": 1, "starts": 'starts = {angle = "angle0"}'}],
    ids=["a state is set at any time", "a state is set before the start", "a state starts from a parameter"],
)
def test_an_fmu_of_fmi_3_steps_as_an_independent_integration_does(tmp_path, options):
    robot, (x, u) = toml.read(pendulum(tmp_path, **options)), swings()
    for params in (robot.nominal, robot.nominal * [1.3, 0.5]):
        np.testing.assert_allclose(robot.simulator.step(x, u, 0.02, params), swung(x, u, 0.02, params), rtol=1e-6, atol=1e-7)


def test_a_state_that_does_not_take_its_start_gets_one_line(tmp_path):
    robot, (x, u) = toml.read(pendulum(tmp_path, started=1)), swings()
    with pytest.raises(UserError, match=r"angle is 0 after it was set to .*starts = {STATE = "):
        robot.simulator.step(x, u, 0.02, robot.nominal)


def test_a_state_that_may_not_be_set_gets_one_line(tmp_path):
    pendulum(tmp_path, strict=1)
    (tmp_path / "late").mkdir()
    path = edited(tmp_path, tmp_path / "late", 'valueReference="2" causality="output" variability="continuous" initial="exact" start="0"',
                  'valueReference="2" causality="output" variability="continuous"')  # fmt: skip
    robot, (x, u) = toml.read(path), swings()
    with pytest.raises(UserError, match=r"status 3 \(error\); speed cannot be set; name the parameter"):
        robot.simulator.step(x, u, 0.02, robot.nominal)


def test_a_step_that_fails_is_told_in_the_fmu_s_words_and_is_no_harm_to_the_next(tmp_path):
    robot, (x, u) = toml.read(pendulum(tmp_path, limit=6.0)), swings()
    before = robot.simulator.step(x, u, 0.02, robot.nominal)
    with pytest.raises(RunsAway, match=r"pendulum.fmu: doStep failed with status 3 \(error\): the motor burns, in a step of 0.02 s"):
        robot.simulator.step(x, u + 5, 0.02, robot.nominal)
    with pytest.raises(RunsAway, match=r"doStep failed with status 2 \(discard\), in a step"):
        robot.simulator.step(x, u - 5, 0.02, robot.nominal)
    assert np.array_equal(robot.simulator.step(x, u, 0.02, robot.nominal), before)


def test_a_trial_that_the_fmu_refuses_is_only_a_bad_one(tmp_path):
    robot = toml.read(pendulum(tmp_path, limit=6.0))
    rng = np.random.default_rng(6)
    u, x = np.repeat(rng.uniform(-5, 5, (40, 1)), 10, 0), np.zeros((400, 2))
    for k in range(399):
        x[k + 1] = swung(x[k : k + 1], u[k : k + 1], 0.02, robot.nominal)[0]
    x = x + rng.normal(0, 0.002, x.shape)
    search = Search(LogPath(robot, RobotLog(np.arange(400) * 0.02, x, u, x, np.ones(399, bool), 0.02)))
    state = search.likeliest(search.fitter.fit_of(()))
    before = search.at(state).fit_of(()).cost
    with pytest.raises(RunsAway, match="the motor burns"):
        search.path.about((Cause("gain:torque", (0.5,)),))
    assert search.at(state).fit_of(()).cost == before and search.run().causes == ()


# ---- the example -------------------------------------------------------------------------------------------------


def log_of(folder, robot, seed, **truth):
    """A log of the true drive; truth: values of make_log.py."""
    true = module("make_log")
    for name, value in truth.items():
        setattr(true, name, value)
    with open(folder / "drive.csv", "w", newline="") as file:
        csv.writer(file).writerows([("t", "phi_motor", "phi_load", "torque"), *true.drive(seed)])
    return read(folder / "drive.csv", robot)


def test_a_healthy_drive_is_recognised(drive, tmp_path):
    robot = toml.read(drive / "two_mass.toml")
    report = own.diagnose(log_of(tmp_path, robot, 11, LOAD=0.03), robot).report
    assert report["verdict"] == "none" and not report["effects"]
    assert not report["time_step"]["matters"] and report["passes"] <= 200


def test_the_example_from_its_source_to_its_report(tmp_path):
    """The commands that two_mass.toml names: the heavier load is found, to 5 %, in a minute and in 200 passes."""
    folder = tmp_path / "two_mass"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("*.fmu", "*.csv", "__pycache__"))

    def run(*command):
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout

    run(sys.executable, "build.py")
    run(sys.executable, "make_log.py", "drive.csv")
    start = time.monotonic()
    said = run(*TINYKOOP, "diagnose", "drive.csv", "--robot", "two_mass.toml", "--out", "drive")
    assert time.monotonic() - start < 60
    report = json.loads((folder / "drive/report.json").read_text())
    assert report["verdict"] == "known" and [e["name"] for e in report["effects"]] == ["parameter:load_inertia"]
    assert abs(report["effects"][0]["params"]["change"] / 0.009 - 1) < 0.05
    assert report["log"]["rows"] == 2000 and report["passes"] <= 200
    assert not report["time_step"]["matters"]  # the FMU's own steps are short
    assert report["gap"]["closed_fraction"]["50"] > 0.9 and "parameter:load_inertia" in said
