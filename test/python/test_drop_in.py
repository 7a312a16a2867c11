"""Each way into a firmware's build is walked: the amalgamated pair, CMake, pkg-config and the package managers.

The consumer in test/consumer learns and controls; what it prints must be the same to the last digit, whichever way it
came by the library and however that was optimised.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONSUMER = ROOT / "test/consumer"
PACKAGERS = ROOT / "build/packagers/bin"
WARNINGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wdouble-promotion", "-Werror"]
LANGUAGES = {
    "gcc": ["gcc", "-std=c99", "-Wc++-compat"],
    "g++": ["g++", "-x", "c++", "-std=c++11"],
    "clang": ["clang", "-std=c99"],
    "clang++": ["clang++", "-x", "c++", "-std=c++11"],
}
CORTEX_M4F = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]


def run(*command, **options):
    """Standard output of a command that must succeed."""
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, **options)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}"
    return done.stdout


def needs(tool):
    """Skips the test where the tool is absent."""
    if not shutil.which(str(tool)):
        pytest.skip(f"no {tool} here")
    return tool


def amalgamate(out, *arguments):
    return run(sys.executable, ROOT / "tools/amalgamate.py", "--out", out, *arguments)


def symbols(*objects, defined=True):
    """(all, exported) names that the objects define, or the names that they lack."""
    lines = [line.split() for line in run("nm", *objects).splitlines() if line and not line.endswith(":")]
    if not defined:
        return {line[-1] for line in lines if line[-2] == "U"}
    held = [line for line in lines if line[-2] != "U"]
    return {line[-1] for line in held}, {line[-1] for line in held if line[-2].isupper()}


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Folder of the amalgamated pair."""
    out = tmp_path_factory.mktemp("amalgamated")
    amalgamate(out)
    return out


@pytest.fixture(scope="module")
def said(tmp_path_factory, firmware):
    """What the consumer prints with lib/ compiled as the README says; and that it has learned and controlled."""
    program = tmp_path_factory.mktemp("plain") / "consumer"
    include = f"-I{ROOT / 'lib/include'}"
    run("gcc", "-std=c99", "-O2", include, CONSUMER / "main.c", firmware("koopf"), "-o", program, "-lm")
    line = run(program)
    speed, off = map(float, re.fullmatch(r"speed (\S+) off (\S+) m\n", line).groups())
    assert 1.4 < speed < 1.6  # of a path that goes on at 1.5 m/s
    assert off < 0.1
    return line


# ---- The amalgamated pair ----------------------------------------------------------


def test_the_pair_is_the_same_every_time(pair, tmp_path):
    amalgamate(tmp_path)
    for path in sorted(pair.iterdir()):
        assert (tmp_path / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_pair_compiles_without_a_warning(pair, language, tmp_path):
    needs(LANGUAGES[language][0])
    for options in ([], ["-DKOOP_NO_DOUBLE"], ["-DKOOP_NO_FLOAT"]):
        command = [*LANGUAGES[language], *WARNINGS, *options]
        run(*command, f"-I{pair}", "-fsyntax-only", pair / "tinykoop.c")
        (tmp_path / "alone.c").write_text('#include "tinykoop.h"\nint alone = KOOP_OK;\n')
        run(*command, f"-I{pair}", "-fsyntax-only", tmp_path / "alone.c")


def machine_code(source, *options):
    """({name: [what gcc makes of it]} of the functions and tables in a source, the names that it exports).

    Labels are numbered by their order in a function, and constants stand in their own place. A table within a function
    is named with a dot and without its number: two may share a name.
    """
    text = run("gcc", "-O0", "-fno-pie", "-fno-asynchronous-unwind-tables", *options, "-S", source, "-o", "-")
    data = r"^([\w.]+):\n((?:\t\.(?:byte|value|long|quad|string|ascii|zero)\t.*\n)+)"
    values, made = dict(re.findall(data, text, re.M)), {}
    for name, body in values.items():
        if not name.startswith("."):
            made.setdefault(re.sub(r"\d+$", "", name) if "." in name else name, []).append(body)
    for name, body in re.findall(r"^(\w+):\n(.*?)^\t\.size\t\1,", text, re.M | re.S):
        labels = {}
        body = re.sub(r"\.LC\d+", lambda label: values[label[0]], body)
        body = re.sub(r"\.L\w+", lambda label: labels.setdefault(label[0], f".L{len(labels)}"), body)
        made[name] = [re.sub(r"\b([a-z]\w*\.)\d+\b", r"\1", body)]
    return made, set(re.findall(r"^\t\.globl\t(\w+)", text, re.M))


@pytest.mark.parametrize("vectors", [1, 0])
def test_the_pair_is_the_library(pair, vectors):
    """The same machine code but for the names of what is static: what the C tests found of lib/ holds for the pair."""
    library, exported, option = {}, set(), f"-DKOOP_VECTORS={vectors}"
    for unit in ("koopf", "koopd", "koopf_supervisor", "koopd_supervisor"):
        made, names = machine_code(ROOT / f"lib/{unit}.c", f"-I{ROOT / 'lib/include'}", option)
        exported |= names
        hidden = [name for name in made.keys() - names if "." not in name and not name.startswith("koop")]  # those have the precision
        own = re.compile(rf"\b({'|'.join(hidden)})\b")
        for name, bodies in made.items():
            library.setdefault(own.sub(rf"{unit}_\1", name), []).extend(own.sub(rf"{unit}_\1", body) for body in bodies)
    made, names = machine_code(pair / "tinykoop.c", option)
    assert names == exported
    assert made.keys() == library.keys()
    assert [name for name in made if sorted(made[name]) != sorted(library[name])] == []
    assert len(made) > 400


@pytest.mark.parametrize("option, absent", [("KOOP_NO_DOUBLE", "koopd_"), ("KOOP_NO_FLOAT", "koopf_")])
def test_one_precision_has_nothing_of_the_other(pair, option, absent, tmp_path):
    run("gcc", "-O0", f"-D{option}", "-c", pair / "tinykoop.c", "-o", tmp_path / "one.o")
    held, exported = symbols(tmp_path / "one.o")
    assert len(exported) > 30
    assert not [name for name in held if name.startswith(absent)]
    assert absent not in run("gcc", "-E", "-P", f"-D{option}", pair / "tinykoop.h")


def test_no_precision_at_all_is_refused(pair):
    command = ["gcc", "-DKOOP_NO_DOUBLE", "-DKOOP_NO_FLOAT", "-fsyntax-only", str(pair / "tinykoop.h")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode != 0
    assert "drop one of them" in done.stderr


@pytest.mark.parametrize("language", ["gcc", "g++"])
def test_consumer_of_the_pair(pair, said, language, tmp_path):
    needs(LANGUAGES[language][0])
    command = [*LANGUAGES[language], *WARNINGS, "-O2", "-DKOOP_NO_DOUBLE", f"-I{pair}"]
    run(*command, CONSUMER / "main.c", pair / "tinykoop.c", "-o", tmp_path / "consumer", "-lm")
    assert run(tmp_path / "consumer") == said


def test_two_prefixes_in_one_program(pair, said, tmp_path):
    amalgamate(tmp_path, "--prefix", "my_")
    main = (CONSUMER / "main.c").read_text()
    plain = main.replace("int main(", "int first(void);\nint first(")
    mine = re.sub(r"\b(?=koop|tinykoop\.h)", "my_", main)
    mine = re.sub(r"\b(?=KOOP_)", "MY_", mine).replace("int main(", "int second(void);\nint second(")
    (tmp_path / "plain.c").write_text(plain)
    (tmp_path / "mine.c").write_text(mine)
    (tmp_path / "both.c").write_text("int first(void);\nint second(void);\nint main(void) {\n\treturn first() || second();\n}\n")
    include = [f"-I{pair}", f"-I{tmp_path}"]
    sources = [*(tmp_path / f"{name}.c" for name in ("plain", "mine", "both", "my_tinykoop")), pair / "tinykoop.c"]
    run("gcc", "-std=c99", *WARNINGS, *include, *sources, "-o", tmp_path / "both", "-lm")
    assert run(tmp_path / "both") == 2 * said
    # and both headers in one file
    (tmp_path / "headers.c").write_text('#include "tinykoop.h"\n#include "my_tinykoop.h"\nint same = (int)KOOP_OK == (int)MY_KOOP_OK;\n')
    run("gcc", "-std=c99", *WARNINGS, *include, "-fsyntax-only", tmp_path / "headers.c")


@pytest.mark.parametrize("prefix", ["/usr/local", "1st_", "a-b"])
def test_a_prefix_that_is_no_name_is_refused(prefix, tmp_path):
    command = [sys.executable, ROOT / "tools/amalgamate.py", "--out", tmp_path / "out", "--prefix", prefix]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 2
    assert prefix in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_the_pair_for_a_cortex_m4f(pair, tmp_path):
    gcc = needs("arm-none-eabi-gcc")
    target = tmp_path / "tinykoop.o"
    command = [gcc, *CORTEX_M4F, "-std=c99", "-Os", *WARNINGS, "-DKOOP_NO_DOUBLE"]
    run(*command, "-c", pair / "tinykoop.c", "-o", target)
    lacking = {line.split()[-1] for line in run("arm-none-eabi-nm", "-u", target).splitlines()}
    assert lacking <= {"sqrtf", "memcpy", "memset", "memcmp", "strlen"}, "no soft double, no heap, no printf"
    _, data, bss = map(int, run("arm-none-eabi-size", target).splitlines()[1].split()[:3])
    assert data == bss == 0


# ---- CMake and pkg-config ------------------------------------------------------------


def cmake_consumer(build, way, *arguments):
    """What the consumer prints that CMake has built this way."""
    needs("cmake")
    run("cmake", "-S", CONSUMER, "-B", build, f"-DWAY={way}", "-DCMAKE_BUILD_TYPE=Debug", *arguments)
    run("cmake", "--build", build)
    return run(build / "consumer")


def test_add_subdirectory(said, tmp_path):
    assert cmake_consumer(tmp_path, "add_subdirectory", f"-DTINYKOOP={ROOT}") == said


def test_fetch_content(said, tmp_path):
    """From an archive of what the library consists of."""
    archive = tmp_path / "tinykoop.tar.gz"
    run("tar", "czf", archive, "-C", ROOT, "CMakeLists.txt", "LICENSE", "cmake", "lib")
    assert cmake_consumer(tmp_path / "build", "FetchContent", f"-DTINYKOOP={archive}") == said


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """An installed tree that has been moved since."""
    needs("cmake")
    folder = tmp_path_factory.mktemp("install")
    options = ["-DTINYKOOP_HOST=OFF", "-DCMAKE_BUILD_TYPE=Debug", "-DCMAKE_INSTALL_LIBDIR=lib"]
    run("cmake", "-S", ROOT, "-B", folder / "build", *options)
    run("cmake", "--build", folder / "build")
    run("cmake", "--install", folder / "build", "--prefix", folder / "first")
    (folder / "first").rename(folder / "moved")
    return folder / "moved"


def test_find_package(installed, said, tmp_path):
    assert cmake_consumer(tmp_path, "find_package", f"-DCMAKE_PREFIX_PATH={installed}") == said


def test_find_package_refuses_another_version(installed, tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.21)\nproject(other LANGUAGES C)\nfind_package(TinyKoop 0.2 REQUIRED)\n"
    )
    command = ["cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={installed}"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode != 0
    assert 'compatible with requested version "0.2"' in done.stderr


def test_pkg_config(installed, said, tmp_path):
    needs("pkg-config")
    environment = {**os.environ, "PKG_CONFIG_PATH": str(installed / "lib/pkgconfig")}
    run("pkg-config", "--validate", "tinykoop", env=environment)
    flags = run("pkg-config", "--cflags", "--libs", "tinykoop", env=environment).split()
    run("gcc", "-std=c99", CONSUMER / "main.c", *flags, "-o", tmp_path / "consumer")
    assert run(tmp_path / "consumer") == said


# ---- Package managers ------------------------------------------------------------------


def test_versions_agree():
    patterns = {
        "lib/include/tinykoop.h": r'KOOP_VERSION "(.*)"',
        "CMakeLists.txt": r"project\(TinyKoop VERSION (\S+)",
        "library.json": r'"version": "(.*)"',
        "idf_component.yml": r'version: "(.*)"',
        "arduino/library.properties": r"version=(.*)",
        "CITATION.cff": r"\nversion: (.*)",
    }
    versions = {name: re.search(pattern, (ROOT / name).read_text())[1] for name, pattern in patterns.items()}
    assert len(set(versions.values())) == 1, versions


BOARD = """
#include <cmath>
#include <cstddef>
#include <iostream>
struct Port {
	void begin(long) {}
	template <class T> void print(T x, int = 0) { std::cout << x; }
	template <class T> void println(T x, int = 0) { std::cout << x << '\\n'; }
};
static Port Serial;
static void delay(int) {}
"""


def test_arduino_library(pair, tmp_path):
    """Its layout and manifest as the library specification wants them; its sketch runs on a board of paper."""
    needs("g++")
    with zipfile.ZipFile(pair / "TinyKoop-arduino.zip") as archive:
        archive.extractall(tmp_path)
    library = tmp_path / "TinyKoop"
    manifest = dict(line.split("=", 1) for line in (library / "library.properties").read_text().splitlines())
    required = ["name", "version", "author", "maintainer", "sentence", "paragraph", "category", "architectures"]
    assert "url" in manifest and not [key for key in required if not manifest.get(key)]  # there is no public address yet
    assert (library / "src" / manifest["includes"]).exists()
    assert sorted(path.name for path in (library / "src").iterdir()) == ["tinykoop.c", "tinykoop.h"]
    (sketch,) = library.glob("examples/*/*.ino")
    assert sketch.stem == sketch.parent.name

    run("gcc", "-c", library / "src/tinykoop.c", "-o", tmp_path / "tinykoop.o")
    main = "\nint main() {\n\tsetup();\n\tfor (int k = 0; k < 400; k++) { loop(); }\n}\n"
    (tmp_path / "sketch.cpp").write_text(BOARD + sketch.read_text() + main)
    source = [tmp_path / "sketch.cpp", tmp_path / "tinykoop.o"]
    run("g++", "-std=c++11", "-Wall", "-Wextra", "-Werror", f"-I{library / 'src'}", *source, "-o", tmp_path / "sketch")
    told = run(tmp_path / "sketch").splitlines()
    assert told[0] == "ok"
    across = [float(line.split()[3]) for line in told[1:]]
    assert max(map(abs, across[:200])) > 0.05  # driven about
    assert max(map(abs, across[-50:])) < 0.05  # kept on the line


IDF = """
set(ESP_PLATFORM 1)
macro(idf_component_register)
	cmake_parse_arguments(component "" "" "SRCS;INCLUDE_DIRS" ${ARGN})
	%s
	return()
endmacro()
"""


def test_esp_idf_component(said, tmp_path):
    """CMakeLists.txt as ESP-IDF reads it, first as a script for what is required, then in the build. ESP-IDF itself is
    stood in for: a macro of the same name that takes the same lists."""
    needs("cmake")
    script = IDF % 'message("SRCS ${component_SRCS}")' + f"include({ROOT}/CMakeLists.txt)\n"
    (tmp_path / "requirements.cmake").write_text(script)
    done = subprocess.run(["cmake", "-P", tmp_path / "requirements.cmake"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "lib/koopf.c" in done.stderr

    take = "add_library(tinykoop STATIC ${component_SRCS})\n"
    take += "\ttarget_include_directories(tinykoop PUBLIC ${component_INCLUDE_DIRS})"
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.21)\nproject(app LANGUAGES C)\n"
        + IDF % take
        + f"add_subdirectory({ROOT} component)\nadd_executable(consumer {CONSUMER}/main.c)\n"
        + "target_link_libraries(consumer tinykoop m)\n"
    )
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build", "-DCMAKE_BUILD_TYPE=Debug")
    run("cmake", "--build", tmp_path / "build")
    assert run(tmp_path / "build/consumer") == said


ZEPHYR = """
cmake_minimum_required(VERSION 3.21)
project(app LANGUAGES C)
function(zephyr_include_directories)
	include_directories(${ARGN})
endfunction()
macro(zephyr_library)
	add_library(module STATIC)
endmacro()
function(zephyr_library_sources_ifdef option)
	if(${option})
		target_sources(module PRIVATE ${ARGN})
	endif()
endfunction()
"""


@pytest.mark.parametrize(
    "chosen, units",
    [
        ({"FLOAT", "SUPERVISOR"}, {"koopf.c", "koopf_supervisor.c"}),
        ({"FLOAT"}, {"koopf.c"}),
        ({"FLOAT", "DOUBLE", "SUPERVISOR"}, {"koopf.c", "koopd.c", "koopf_supervisor.c", "koopd_supervisor.c"}),
    ],
)
def test_zephyr_module(said, chosen, units, tmp_path):
    """zephyr/CMakeLists.txt with stand-ins for Zephyr's functions; module.yml names files that are there."""
    needs("cmake")
    for _, name in re.findall(r"(cmake|kconfig): (\S+)", (ROOT / "zephyr/module.yml").read_text()):
        assert (ROOT / name).exists()
    (tmp_path / "CMakeLists.txt").write_text(
        ZEPHYR
        + f"add_subdirectory({ROOT}/zephyr module)\nadd_executable(consumer {CONSUMER}/main.c)\n"
        + f"target_include_directories(consumer PRIVATE {ROOT}/lib/include)\ntarget_link_libraries(consumer module m)\n"
    )
    options = [f"-DCONFIG_TINYKOOP{name}=y" for name in ["", *(f"_{name}" for name in sorted(chosen))]]
    run("cmake", "-S", tmp_path, "-B", tmp_path / "build", "-DCMAKE_BUILD_TYPE=Debug", *options)
    run("cmake", "--build", tmp_path / "build")
    assert {path.name.removesuffix(".o") for path in tmp_path.glob("build/module/**/*.c.o")} == units
    assert run(tmp_path / "build/consumer") == said


# What follows needs the package managers themselves: `make packagers`.


def packager(name):
    """The command of a package manager, or a skip."""
    if not (PACKAGERS / name).exists():
        pytest.skip("no package managers here: make packagers")
    return PACKAGERS / name


def test_zephyr_kconfig():
    script = (
        "import json, kconfiglib\n"
        f"config = kconfiglib.Kconfig('{ROOT / 'zephyr/Kconfig'}')\n"
        "config.syms['TINYKOOP'].set_value(2)\n"
        "print(json.dumps([config.warnings, {k: s.str_value for k, s in config.syms.items() if 'TINYKOOP' in k}]))\n"
    )
    warnings, values = json.loads(run(packager("python"), "-c", script))
    assert not warnings
    assert values == {"TINYKOOP": "y", "TINYKOOP_FLOAT": "y", "TINYKOOP_DOUBLE": "n", "TINYKOOP_SUPERVISOR": "y"}


def test_esp_idf_component_manager(tmp_path):
    """Checks the manifest and packs what it says; it passes over keys that it does not know, so these are looked up."""
    compote = packager("compote")
    known = json.loads(run(compote, "manifest", "schema"))["properties"]
    assert set(re.findall(r"^(\w+):", (ROOT / "idf_component.yml").read_text(), re.M)) <= set(known)
    tree = tmp_path / "tinykoop"
    tree.mkdir()
    for name in ("CMakeLists.txt", "LICENSE", "README.md", "idf_component.yml"):
        shutil.copy(ROOT / name, tree)
    for name in ("lib", "zephyr"):
        shutil.copytree(ROOT / name, tree / name)
    environment = {**os.environ, "IDF_COMPONENT_CHECK_NEW_VERSION": "0"}
    run(compote, "component", "pack", "--name", "tinykoop", "--project-dir", tree, env=environment)
    (archive,) = tree.glob("dist/*.tgz")
    packed = {name.removeprefix("./") for name in run("tar", "tzf", archive).split()}
    assert {"CMakeLists.txt", "lib/koopf.c", "lib/src/rls.c", "lib/include/tinykoop.h", "LICENSE"} <= packed
    assert "zephyr/module.yml" not in packed


PLATFORM = {
    "platform/platform.json": json.dumps({"name": "host", "version": "1.0.0", "title": "Host", "description": "gcc"}),
    "platform/platform.py": "from platformio.public import PlatformBase as HostPlatform\n",
    "platform/builder/main.py": "from SCons.Script import Default, DefaultEnvironment\n\n"
    'env = DefaultEnvironment()\nenv.Replace(PROGSUFFIX="")\nDefault(env.BuildProgram())\n',
    "core/packages/tool-scons/scons.py": "import SCons.Script\n\nSCons.Script.main()\n",
    "core/packages/tool-scons/.piokeep": "",
}
PACK = """
import sys
from platformio.__main__ import main
from platformio.package.manifest.schema import ManifestSchema
ManifestSchema.load_spdx_licenses = staticmethod(lambda: {"licenses": [{"licenseId": "MIT"}]})  # else fetched
sys.exit(main(["pio", *sys.argv[1:]]))
"""


def test_platformio(said, tmp_path):
    """PlatformIO packs the library, installs the package and builds the consumer with it. Its own host platform and its
    SCons come from a registry of its own, so a platform of four lines and the SCons of PyPI stand in."""
    python = packager("python")
    packager("pio")
    for name, text in PLATFORM.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    dependencies = "from platformio.dependencies import get_core_dependencies as d; print(d()['tool-scons'])"
    version = run(python, "-c", dependencies).strip().lstrip("~^")
    tool = tmp_path / "core/packages/tool-scons"
    tool.joinpath("package.json").write_text(json.dumps({"name": "tool-scons", "version": version}))
    spec = {"owner": "platformio", "id": 0, "name": "tool-scons", "requirements": None, "uri": None}
    meta = {"type": "tool", "name": "tool-scons", "version": version, "spec": spec}
    tool.joinpath(".piopm").write_text(json.dumps(meta))

    environment = {
        **os.environ,
        "PLATFORMIO_CORE_DIR": str(tmp_path / "core"),
        "PLATFORMIO_SETTING_ENABLE_TELEMETRY": "no",
        "PLATFORMIO_SETTING_CHECK_PLATFORMIO_INTERVAL": "9999",
    }
    package = tmp_path / "tinykoop.tar.gz"
    run(python, "-c", PACK, "pkg", "pack", ROOT, "-o", package, env=environment)
    packed = run("tar", "tzf", package).split()
    assert {Path(name).parts[0] for name in packed} <= {"lib", "LICENSE", "README.md", "library.json", ".piopm"}

    project = tmp_path / "project"
    project.joinpath("src").mkdir(parents=True)
    shutil.copy(CONSUMER / "main.c", project / "src")
    project.joinpath("platformio.ini").write_text(
        f"[env:host]\nplatform = symlink://{tmp_path}/platform\nlib_deps = file://{package}\nbuild_flags = -O2 -lm\n"
    )
    run(PACKAGERS / "pio", "run", "-d", project, env=environment)
    built = project / ".pio/build/host"
    assert {path.stem for path in built.rglob("*.o")} == {"main", "koopf", "koopd", "koopf_supervisor", "koopd_supervisor"}
    assert run(built / "program") == said
