"""The Crazyflie example: compiled as the firmware compiles it, against stand-ins for the firmware's headers,
and flown on the host. Its vehicle and its stock controller are the stand-ins', not the firmware's."""

import ctypes
import math
import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from tinykoop.firmware import callgraph

ROOT = Path(__file__).resolve().parents[2]
EXAMPLE = ROOT / "targets" / "crazyflie"
SOURCES = ("learner", "planner", "library")
INCLUDE = [f"-I{EXAMPLE / 'stand_in'}", f"-I{ROOT / 'lib' / 'include'}"]
FLAGS = ["-std=gnu11", "-Os", "-Wall", "-Wextra", "-Wdouble-promotion", "-Werror", "-fno-math-errno", *INCLUDE]
CORTEX_M4F = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
STABILIZER_STACK = 1800  # bytes, for everything that the firmware does in that task
MODE = {"disabled": 0, "planned": 1, "not following": 2, "bad state": 3, "warming up": 4,
        "learner refused": 5, "model poor": 6, "plan late": 7, "plan refused": 8, "returning": 9}  # fmt: skip

needs_gcc = pytest.mark.skipif(not shutil.which("gcc"), reason="gcc is not installed")
needs_arm = pytest.mark.skipif(not shutil.which("arm-none-eabi-gcc"), reason="arm-none-eabi-gcc is not installed")


def run(*command, text=True):
    done = subprocess.run([str(part) for part in command], capture_output=True, text=text)
    assert done.returncode == 0, done.stderr
    return done.stdout


def compiled(folder, prefix, *flags):
    """The object files by source."""
    objects = {name: folder / f"{name}.o" for name in SOURCES}
    for name, out in objects.items():
        run(f"{prefix}gcc", *FLAGS, *flags, "-c", EXAMPLE / "src" / f"{name}.c", "-o", out)
    return objects


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    flags = [*CORTEX_M4F, "-ffunction-sections", "-fdata-sections", "-fcallgraph-info=su"]
    return compiled(tmp_path_factory.mktemp("arm"), "arm-none-eabi-", *flags)


# ---- what the compiler makes of it -------------------------------------------------------------------


@needs_gcc
def test_the_host_compiles_it(tmp_path):
    symbols = [run("nm", "--defined-only", "-g", out) for out in compiled(tmp_path, "").values()]
    names = re.findall(r" [A-Z] (\w+)$", "".join(symbols), re.M)
    assert {"controllerOutOfTree", "appMain", "koopf_rls_update"} <= set(names)
    assert len(names) == len(set(names))


@needs_arm
def test_no_heap_no_double_no_print(arm):
    undefined = set(re.findall(r" U (\w+)", "".join(run("arm-none-eabi-nm", out) for out in arm.values())))
    assert not {n for n in undefined if re.match(r"__aeabi_(d|[fliu]+2d)|malloc|calloc|free$|\w*printf", n)}


@needs_arm
def test_state_lies_in_ccm_without_initial_values(arm, tmp_path):
    """The firmware clears that section and would drop an initial value in silence."""
    ram = 0
    for name, out in arm.items():
        sizes = re.findall(r"^(\.\S+)\s+(\d+)", run("arm-none-eabi-size", "-A", out), re.M)
        ram += sum(int(size) for section, size in sizes if section.startswith((".data", ".bss")))
        if name != "library":
            run("arm-none-eabi-objcopy", "-O", "binary", "-j", ".ccmbss", out, tmp_path / "ccm")
            image = (tmp_path / "ccm").read_bytes()
            assert len(image) > 1000 and not any(image)
    assert ram <= 32  # parameters and the handles of the queues


@needs_arm
def test_stack(arm):
    """Half of each task's stack is left: the stabilizer's to the firmware around it, the application's to spare."""
    graph = "".join(out.with_suffix(".ci").read_text() for out in arm.values())
    relocations = "".join(run("arm-none-eabi-objdump", "-r", out) for out in arm.values())
    depths = callgraph.deepest(graph, callgraph.held_in_tables(relocations), ("controllerOutOfTree", "appMain"))
    (words,) = re.findall(r"CONFIG_APP_STACKSIZE=(\d+)", (EXAMPLE / "app-config").read_text())
    for function, stack in {"controllerOutOfTree": STABILIZER_STACK, "appMain": 4 * int(words)}.items():
        size, path = depths[function]
        assert len(path) > 2 and 200 < size <= stack / 2, f"{function}: {size} bytes, {' > '.join(path)}"


# ---- how the firmware's build finds it ---------------------------------------------------------------


def objects_of(kbuild):
    return re.findall(r"^obj-y \+= (\S+)$", kbuild.read_text(), re.M)


def test_kbuild_names_the_sources_of_the_folder():
    assert objects_of(EXAMPLE / "Kbuild") == ["src/"]
    assert {name.removesuffix(".o") for name in objects_of(EXAMPLE / "src/Kbuild")} == {p.stem for p in (EXAMPLE / "src").glob("*.c")}


@pytest.mark.parametrize("switch, last", [((), "planner.o"), (("BENCHMARK=1",), "benchmark.o")])
def test_the_benchmark_takes_the_place_of_the_planner(switch, last):
    read = f"include {EXAMPLE}/src/Kbuild\nall: ; @echo $(obj-y)\n"
    done = subprocess.run(["make", "--no-print-directory", "-f", "-", *switch], input=read, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["learner.o", last, "library.o"]


@needs_gcc
def test_the_benchmark_is_a_task_that_makes_no_plans(tmp_path):
    for prefix, flags in {"": [], **({"arm-none-eabi-": CORTEX_M4F} if shutil.which("arm-none-eabi-gcc") else {})}.items():
        out = tmp_path / f"{prefix}benchmark.o"
        run(f"{prefix}gcc", *FLAGS, *flags, "-c", EXAMPLE / "src/benchmark.c", "-o", out)
        assert re.findall(r" [A-Z] (\w+)$", run("nm", "--defined-only", "-g", out), re.M) == ["appMain"]
        undefined = set(re.findall(r" U (\w+)", run("nm", out)))
        assert "plans" not in undefined and not {n for n in undefined if re.match(r"__aeabi_(d|[fliu]+2d)|malloc", n)}


@pytest.fixture
def firmware(tmp_path):
    """Stands in for the firmware's checkout: configures with the app's file, then builds, as its oot.mk is documented to do."""
    (tmp_path / "tools/make").mkdir(parents=True)
    (tmp_path / "tools/make/oot.mk").write_text(
        "OOT_CONFIG ?= $(OOT)/oot-config\n"
        "all cload: ; @$(MAKE) --no-print-directory -C $(CRAZYFLIE_BASE) OOT=$(OOT) CONFIG_FILE=$(OOT_CONFIG) firmware-$@\n"
        "any: ; @OOT_CONFIG=/of/another/vehicle $(MAKE) --no-print-directory all\n"
    )
    (tmp_path / "Makefile").write_text('firmware-%: ; @echo "$* $(OOT) $(CONFIG_FILE)"; test -f $(OOT)/Kbuild\n')
    return tmp_path


def make(*arguments, base=None):
    command = ["make", "--no-print-directory", "-C", EXAMPLE, *arguments, *([f"CRAZYFLIE_BASE={base}"] if base else [])]
    return subprocess.run([str(part) for part in command], capture_output=True, text=True, cwd="/")


@pytest.mark.parametrize("target", ["all", "cload"])
def test_makefile_names_the_folder_and_its_configuration(firmware, target):
    """From wherever make is called, and by a path to the firmware that is relative to the folder too."""
    for base in (firmware, os.path.relpath(firmware, EXAMPLE)):
        done = make(target, base=base)
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == [target, str(EXAMPLE), str(EXAMPLE / "app-config")]


def test_makefile_leaves_the_configuration_of_another_vehicle_to_the_firmware(firmware):
    assert make("any", base=firmware).stdout.split()[-1] == "/of/another/vehicle"


def test_makefile_without_the_firmware_says_what_is_missing(tmp_path):
    for base in (None, tmp_path):
        done = make(base=base)
        assert done.returncode == 2 and done.stderr.count("\n") == 1
        assert "CRAZYFLIE_BASE" in done.stderr


# ---- how it flies ---------------------------------------------------------------------------------------


class Circumstances(ctypes.Structure):
    _fields_ = [
        ("wind", ctypes.c_double * 2),
        *[(name, ctypes.c_double) for name in ("drag", "period", "glitch", "fault")],
        *[(name, ctypes.c_int) for name in
          ("broken_setpoint", "held_up", "on_ground", "by_velocity")],
    ]  # fmt: skip


class Flight(ctypes.Structure):
    _fields_ = [(name, ctypes.c_double) for name in ("error", "planned", "stock_untouched", "finite")]


class Vehicle:
    """One flight of the example; each has the library's variables to itself."""

    def __init__(self, library, seed=1, period=12):
        self.library = ctypes.CDLL(str(library))
        self.library.fly.restype = Flight
        self.library.begin.argtypes = [ctypes.c_uint64]
        self.library.read_variable.restype = ctypes.c_double
        self.library.set_parameter.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_double]
        self.around = Circumstances.in_dll(self.library, "around")
        self.library.begin(seed)
        self.around.period = period
        self.around.drag = 0.3

    def fly(self, seconds):
        flight = self.library.fly(round(1000 * seconds))
        self.share = flight.planned / (1000 * seconds)
        self.stock = flight.stock_untouched / (1000 * seconds)
        return flight

    def log(self, name):
        return self.library.read_variable(b"log", b"koopman", name.encode())

    def set(self, name, value):
        assert self.library.set_parameter(b"koopman", name.encode(), value)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    if not shutil.which("gcc"):
        pytest.skip("gcc is not installed")
    out = tmp_path_factory.mktemp("flight") / "flight.so"
    sources = [EXAMPLE / "src" / f"{name}.c" for name in SOURCES]
    run("gcc", *FLAGS, "-fPIC", "-shared", *sources, EXAMPLE / "stand_in" / "host.c", "-lm", "-o", out)
    return out


@pytest.fixture
def vehicle(library, tmp_path):
    def begin(seed=1, period=12):
        own = tmp_path / f"flight{len(list(tmp_path.iterdir()))}.so"
        shutil.copy(library, own)
        return Vehicle(own, seed, period)

    return begin


@pytest.fixture
def planned(vehicle):
    """A vehicle that has learned and flies the plan."""
    flying = vehicle()
    flying.set("enable", 1)
    flying.fly(24)
    assert flying.log("mode") == MODE["planned"]
    return flying


def test_disabled_it_is_the_stock_controller(vehicle):
    flying = vehicle()
    flying.fly(24)
    assert flying.stock == 1 and flying.share == 0 and flying.log("mode") == MODE["disabled"]
    assert flying.log("samples") > 2000  # but it learns


def test_no_plan_before_it_is_warm(vehicle):
    flying = vehicle()
    flying.set("enable", 1)
    flying.fly(5)
    assert flying.share == 0 and flying.stock == 1 and flying.log("mode") == MODE["warming up"]
    flying.fly(7)
    assert flying.share > 0


@pytest.mark.parametrize("seed", [11, 12, 13])
@pytest.mark.parametrize("drag", [0.1, 0.6])
def test_learned_plan_keeps_closer_than_stock(vehicle, seed, drag):
    flying = vehicle(seed)
    flying.around.drag = drag
    flying.fly(12)
    stock = flying.fly(12).error
    flying.set("enable", 1)
    flying.fly(12)
    error = flying.fly(12).error
    assert flying.share == 1 and error < stock / 5
    flying.around.wind[0] = 1.5
    flying.fly(12)  # one lap to learn the wind
    assert flying.fly(12).error < stock / 5
    assert flying.share == 1 and flying.log("refusals") == 0


def test_hover_for_long_and_then_go(planned):
    planned.around.period = 0
    assert planned.fly(300).finite == 300000
    assert planned.fly(10).error < 0.01 and planned.share == 1
    planned.around.period = 12
    planned.fly(12)
    assert planned.fly(12).error < 0.05


def test_hover_from_the_start_teaches_nothing_to_plan_on(vehicle):
    flying = vehicle(period=0)
    flying.set("enable", 1)
    flying.fly(60)
    assert flying.share < 0.05 and flying.log("mode") in (MODE["plan refused"], MODE["model poor"])


@pytest.mark.parametrize(
    "what, value, mode, within",
    [
        ("fault", math.nan, "bad state", 0.01),
        ("fault", 1e6, "bad state", 0.01),
        ("on_ground", 1, "not following", 0.01),
        ("by_velocity", 1, "not following", 0.01),
        ("held_up", 1, "plan late", 0.16),
    ],
)
def test_falls_back_and_comes_back(planned, what, value, mode, within):
    before = {name: planned.log(name) for name in ("fallbacks", "samples", "refusals")}
    setattr(planned.around, what, value)
    planned.fly(within)
    assert planned.fly(0.5).finite == 500
    assert planned.log("mode") == MODE[mode] and planned.stock == 1
    learned = planned.log("samples") - before["samples"]
    assert learned > 40 if what == "held_up" else learned <= 1
    setattr(planned.around, what, 0)
    planned.fly(0.1)
    planned.fly(0.5)
    assert planned.log("mode") == MODE["returning"] and planned.share == 0
    planned.fly(2.5)
    assert planned.log("mode") == MODE["planned"]
    assert planned.log("fallbacks") == before["fallbacks"] + 1 and planned.log("refusals") == before["refusals"]
    planned.fly(12)
    assert planned.fly(12).error < 0.05 and planned.share == 1


def test_a_model_that_does_not_hold_is_not_flown(vehicle):
    """What was learned in a hover, on a path."""
    flying = vehicle(period=0)
    flying.set("enable", 1)
    flying.fly(100)
    flying.around.period = 12
    modes = []
    for _ in range(1200):
        flying.fly(0.01)
        modes.append(flying.log("mode"))
    assert modes.count(MODE["model poor"]) > 100
    flying.fly(12)
    assert flying.fly(12).error < 0.05 and flying.share == 1


def test_a_jump_of_the_position_is_not_learned(planned):
    """A sensor that is off by 0.5 m for one tick."""
    planned.around.glitch = 0.5
    planned.fly(0.01)
    assert planned.log("mode") == MODE["bad state"]
    planned.around.glitch = 0
    planned.fly(1.5)
    assert planned.share > 0.3 and planned.log("mode") == MODE["planned"]
    assert planned.fly(12).error < 0.05


def test_disable_hands_back_at_once(planned):
    planned.set("enable", 0)
    planned.fly(0.01)
    planned.fly(1)
    assert planned.stock == 1 and planned.log("mode") == MODE["disabled"]
    planned.set("enable", 1)
    planned.fly(0.01)
    planned.fly(1)
    assert planned.share == 1


def test_a_setpoint_that_is_nan_reaches_the_stock_controller_as_it_came(planned):
    planned.around.broken_setpoint = 1
    planned.fly(0.02)
    assert planned.log("mode") == MODE["bad state"]
    planned.around.broken_setpoint = 0
    planned.fly(3)
    assert planned.log("mode") == MODE["planned"]


@pytest.mark.parametrize("value", [0, 2, math.nan])
def test_lambda_out_of_range_is_refused_and_stock_flies(planned, value):
    planned.set("lambda", value)
    planned.set("reset", 1)
    planned.fly(0.01)
    planned.fly(2)
    assert planned.log("mode") == MODE["learner refused"] and planned.log("learn") < 0 and planned.stock == 1
    planned.set("lambda", 0.99)
    planned.set("reset", 1)
    planned.fly(24)
    assert planned.log("mode") == MODE["planned"] and planned.fly(12).error < 0.05


def test_reset_forgets(planned):
    planned.set("reset", 1)
    planned.fly(0.1)
    assert planned.log("samples") < 20 and planned.share < 0.1
    assert planned.library.read_variable(b"param", b"koopman", b"reset") == 0


# ---- its page -------------------------------------------------------------------------------------------


def test_page_lists_every_log_variable_and_parameter():
    source = (EXAMPLE / "src" / "learner.c").read_text()
    page = (EXAMPLE / "README.md").read_text()
    names = re.findall(r"(?:LOG|PARAM)_ADD\(\w+, (\w+),", source)
    assert len(names) > 15
    for name in names:
        assert f"`{name}`" in page
    for mode, number in MODE.items():
        assert re.search(rf"\b{number} {mode}", page)
