"""Dictionaries of one's own in every command: C sources against NumPy and firmware, and the C code of parts."""

import copy
import json
import pickle
import re
import subprocess
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import tinykoop as tk
from tinykoop import bridge, dictionaries
from tinykoop.experiments import learn, scenario, windup
from tinykoop.logs import choose, fit, replay

ROOT, DT = Path(__file__).resolve().parents[2], 0.05
STRICT = "-std=c99 -pedantic -Wall -Wextra -Wconversion -Wshadow -Wdouble-promotion -Werror -O1".split()
REAL = {"f32": ("koopf", "float"), "f64": ("koopd", "double")}

# In float alone, static, of a file that is a whole firmware.
FLOAT = """
#include <math.h>

#include "tinykoop.h"
#include "count.h"

static void lift(const koopf_dictionary *self, const float *x, float *psi) {
	const float *scale = self->context;
	for (int i = 0; i < STATES; i++) { psi[i] = x[i]; }
	psi[3] = *scale * sinf(x[2]);
	psi[4] = *scale * cosf(x[2]);
}

static const float half = 0.5f;
static const koopf_dictionary turning = {.name = "turning", .n_states = 3, .n_lifted = 5, .lift = lift, .context = &half};

int main(void) { return turning.n_lifted != 5; }
"""

# In both precisions, by the names that the library's own sources use, with one of its parts.
BOTH = """
#include "tinykoop.h"

#ifndef KOOP /* firmware compiles it in float */
#define KOOP(name) koopf_##name
#define KOOP_REAL float
#endif

static void lift(const KOOP(dictionary) *self, const KOOP_REAL *x, KOOP_REAL *psi) {
	static const unsigned char heading[] = {2};
	static const KOOP(angles) turn = {heading, 1, 0};
	(void)self;
	for (int i = 0; i < 3; i++) { psi[i] = x[i]; }
	psi[3] = x[0] * x[1] / 3;
	KOOP(part_angles).write(&turn, x, psi + 4);
}

const KOOP(dictionary) KOOP(mine) = {"mine", 3, 6, lift, NULL};
"""

PARTS = """
import numpy as np
from tinykoop import RBF, Angles, Constant, Poly, Products

parts = Constant() + Angles([2, 0], wrapped=True) + Products([(0, 1), (2, 2)]) + Poly(3, low=0, states=[0, 2])
for kernel, sigma in {"gaussian": 1.5, "inverse_quadratic": 0.1, "inverse_multiquadric": 2, "multiquadric": 3, "thin_plate": 0.7}.items():
    parts = parts + RBF([[0.1, 0.2], [1 / 3, -1.7], [2.0, 1e-3]], sigma, states=[1, 2], kernel=kernel)

def lifted(X):
    return np.column_stack([X, np.sin(X[:, 2])])

def same(X):  # as `mine` of both.c
    return np.column_stack([X, X[:, 0] * X[:, 1] / 3, np.sin(X[:, 2]), np.cos(X[:, 2])])

def broken(X):
    return X[:, 7]

def logarithm(X):
    return np.column_stack([X, np.log(X[:, 0])])

beyond = Products([(0, 9)])
größe = Poly(2)
text = "rbf"
"""


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A folder with dictionaries and a log."""
    folder, rng = tmp_path_factory.mktemp("own"), np.random.default_rng(4)
    for name, text in {"float.c": FLOAT, "both.c": BOTH, "own.py": PARTS, "count.h": "enum { STATES = 3 };"}.items():
        (folder / name).write_text(text)
    u = np.repeat(rng.uniform((0.2, -1), (1.2, 1), (75, 2)), 20, axis=0)
    bridge.write_log(folder / "log.csv", bridge.simulate(u[:-1], DT) + rng.normal(size=(1500, 3)) * 0.002, u, DT)
    return folder


def states(count=200):
    return np.random.default_rng(1).normal(size=(count, 3)).astype(np.float32).astype(float) * 2


def lifted_by_c(firmware, folder, precision, before, dictionary, x):
    """psi (K, N) of a program by gcc, which has this C code before it and a dictionary by this expression."""
    koop, real = REAL[precision]
    (folder / "main.c").write_text(f"""{before}
#include <stdio.h>
int main(void) {{
	{koop}_dictionary made;
	const {koop}_dictionary *dictionary = &made;
	{dictionary}
	double read[3];
	while (scanf("%lf %lf %lf", read, read + 1, read + 2) == 3) {{
		const {real} x[3] = {{({real})read[0], ({real})read[1], ({real})read[2]}};
		{real} psi[KOOP_MAX_DIM];
		if ({koop}_lift(dictionary, x, psi) != KOOP_OK) {{ return 1; }}
		for (size_t i = 0; i < dictionary->n_lifted; i++) {{ printf("%a ", (double)psi[i]); }}
		printf("\\n");
	}}
	return 0;
}}
""")
    command = ["gcc", *STRICT, "-I", ROOT / "lib/include", "main.c", firmware(koop), "-lm", "-o", "main"]
    subprocess.run(command, cwd=folder, check=True)
    rows = "\n".join(" ".join(float(v).hex() for v in row) for row in x)
    said = subprocess.run([folder / "main"], input=rows, text=True, capture_output=True, check=True).stdout
    return np.array([[float.fromhex(v) for v in line.split()] for line in said.splitlines()])


def lift(given, precision, x):
    return bridge.Estimator(given.own(3), "none", {"f32": 32, "f64": 64}[precision]).lift(x)


# ---- C sources -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_c_source_lifts_the_bits_of_firmware(own, precision, firmware):
    x = states()
    define = "" if precision == "f32" else "#define KOOP(name) koopd_##name\n#define KOOP_REAL double"
    before = f'#include "tinykoop.h"\n{define}\n{BOTH}'
    flown = lifted_by_c(firmware, own, precision, before, f"made = {REAL[precision][0]}_mine;", x)
    np.testing.assert_array_equal(lift(tk.CSource(own / "both.c", "mine"), precision, x), flown)
    exact = np.column_stack([x, x[:, 0] * x[:, 1] / 3, np.sin(x[:, 2]), np.cos(x[:, 2])])
    np.testing.assert_allclose(flown, exact, rtol=0, atol={"f32": 1e-6, "f64": 2e-15}[precision])


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_the_example_in_c_lifts_the_bits_of_the_one_in_python(precision):
    sources = (
        tk.CSource(ROOT / "examples/drive_dictionary.c", "drive"),
        dictionaries.from_file(f"{ROOT}/examples/drive_dictionary.py:drive"),
    )
    np.testing.assert_array_equal(*(lift(source, precision, states()) for source in sources))


def test_source_in_float_alone_keeps_the_state_in_double(own):
    x = np.random.default_rng(2).normal(size=(50, 3))
    f32, f64 = (lift(tk.CSource(own / "float.c", "turning"), precision, x) for precision in ("f32", "f64"))
    np.testing.assert_array_equal(f64[:, :3], x)
    np.testing.assert_array_equal(f64[:, 3:], f32[:, 3:])
    np.testing.assert_allclose(f32[:, 3:], 0.5 * np.column_stack([np.sin(x[:, 2]), np.cos(x[:, 2])]), atol=1e-7)


@pytest.mark.parametrize("name", ["mine", "koopf_mine", "koopd_mine"])
def test_constant_is_named_with_or_without_its_prefix(own, name):
    assert lift(tk.CSource(own / "both.c", name), "f64", states(2)).shape == (2, 6)


def test_file_that_changes_is_compiled_again(own, tmp_path):
    for scale in (0.5, 0.25):
        (tmp_path / "a.c").write_text(FLOAT.replace("half = 0.5f", f"half = {scale}f").replace('"count.h"', f'"{own / "count.h"}"'))
        psi = lift(tk.CSource(tmp_path / "a.c", "turning"), "f32", np.array([[0.0, 0.0, 0.0]]))
        assert psi[0, 4] == scale


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda m: pickle.loads(pickle.dumps(m))])
def test_learner_with_a_c_source_is_copied(own, copied):
    log = bridge.read_log(own / "log.csv")
    model = tk.RLS(tk.CSource(own / "both.c", "mine"), 2).fit(log.x, log.u)
    other = copied(model)
    np.testing.assert_array_equal(other.predict(log.x, log.u), model.predict(log.x, log.u))
    assert model.score(log.x, log.u) > 0.99


def test_functions_of_the_source_do_not_meet_those_of_the_process(tmp_path):
    text = FLOAT.replace('#include "count.h"', "#define STATES 3").replace("psi[3] =", "psi[3] = tk_message() *")
    (tmp_path / "a.c").write_text(text.replace("static void", "float tk_message(void);\nfloat tk_message(void) { return 1; }\nstatic void"))
    np.testing.assert_array_equal(lift(tk.CSource(tmp_path / "a.c", "turning"), "f32", np.zeros((1, 3))), [[0, 0, 0, 0, 0.5]])


LIFT = "static void lift(const koopf_dictionary *self, const float *x, float *psi) {{ (void)self; {} }}\n"
GOOD = "for (int i = 0; i < 3; i++) { psi[i] = x[i]; } psi[3] = 1 / x[0];"


@pytest.mark.parametrize("body, fields, said", [
    (GOOD, "3, 5, lift", r"n_lifted is 5, but lift\(\) does not write psi\[4\]"), (GOOD, "3, 3, lift", r"n_lifted is 3, but lift\(\) also writes psi\[3\]"),
    (GOOD, "3, 2, lift", "makes 2 lifted states of 3"), (GOOD, "3, 256, lift", "at most 255"), (GOOD, "0, 4, lift", "makes 4 lifted states of 0"),
    (GOOD.replace("= x", "= -x"), "3, 4, lift", r"psi\[0\] is not x\[0\]"), ("psi[0] = x[0];", "3, 4, NULL", "'lift' defined but not used|unused function"),
    ("for (int i = 0; i < 2; i++) { psi[i] = x[i]; }", "2, 2, lift", "a.c:mine: it lifts states of 2 values, but these have 3"),
    ("psi[0] = sin(x[0]);", "3, 4, lift", r"a.c:3: conversion from 'double'"), ("psi[0] = x[0]", "3, 4, lift", r"a.c:3: expected ';'"),
    ("extern float far(void); psi[0] = far() + x[0];", "3, 4, lift", "cannot be loaded: undefined symbol: far"),
])  # fmt: skip
def test_source_that_cannot_be_used_is_refused_in_one_line(tmp_path, body, fields, said):
    constant = f'const koopf_dictionary mine = {{"mine", {fields}, NULL}};'
    (tmp_path / "a.c").write_text(f'#include <math.h>\n#include "tinykoop.h"\n{LIFT.format(body)}{constant}\n')
    with pytest.raises(tk.UserError, match=said) as error:
        tk.CSource(tmp_path / "a.c", "mine").own(3)
    assert "\n" not in str(error.value) and str(error.value).startswith(str(tmp_path / "a.c"))


def test_dictionary_that_is_made_at_run_time_is_refused(tmp_path):
    (tmp_path / "a.c").write_text('#include "tinykoop.h"\nkoopf_dictionary mine;\n')
    with pytest.raises(tk.UserError, match="name and lift must be filled in where the constant is defined"):
        tk.CSource(tmp_path / "a.c", "mine").own(3)


@pytest.mark.parametrize("name, said", [
    ("absent", "defines no 'absent'"), ("lift", "incompatible"), ("a b", "NAME is the name of a constant"), ("", "give poly, rbf, affine, FILE.py:NAME"),
])  # fmt: skip
def test_name_that_is_no_dictionary_of_the_source_is_refused(own, name, said):
    with pytest.raises(tk.UserError, match=said) as error:
        dictionaries.named(f"{own / 'float.c'}:{name}", "ddr", 3)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("compiler, said", [
    ("no-such-compiler -O1", "there is no C compiler 'no-such-compiler': install gcc"), ("false", "the compiler says nothing"),
])  # fmt: skip
def test_compiler_that_is_missing_or_fails_gets_one_line(tmp_path, monkeypatch, compiler, said):
    (tmp_path / "a.c").write_text(BOTH)
    monkeypatch.setenv("CC", compiler)
    with pytest.raises(tk.UserError, match=said):
        tk.CSource(tmp_path / "a.c", "mine").own(3)


def test_missing_source_is_refused(tmp_path):
    with pytest.raises(tk.UserError, match="none.c: No such file"):
        tk.CSource(tmp_path / "none.c", "mine").own(3)


# ---- the code of parts ---------------------------------------------------------------------------------


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_exported_code_lifts_the_bits_of_python(own, tinykoop_in, precision, tmp_path, firmware):
    x = states()
    arguments = ("-o", tmp_path / "parts.h", "--platform", "ddr", "--precision", precision[1:])
    said = tinykoop_in(own, "dictionary", "export", "own.py:parts", *arguments)
    assert said.returncode == 0 and "n = 3, N = 37" in said.stdout
    before = '#include "parts.h"\n#include "parts.h"\ntypedef char right_size[parts_n_states == 3 && parts_n_lifted == 37 ? 1 : -1];'
    flown = lifted_by_c(firmware, tmp_path, precision, before, "if (parts_dictionary(&made) != KOOP_OK) { return 2; }", x)
    expected = lift(dictionaries.from_file(f"{own / 'own.py'}:parts"), precision, x)
    assert expected.shape == (len(x), 37)
    np.testing.assert_array_equal(flown, expected)


@pytest.mark.parametrize("text, n, said", [
    ("own.py:lifted", 3, "no C code for a Python function; put it together of parts"), ("float.c:turning", 3, "it is C already"),
    ("own.py:beyond", 3, "own.py:beyond, for states of 3 values: .*out of range|outside its range"), ("own.py:parts", 0, "for states of 0 values"),
    ("own.py:größe", 3, "ASCII"), ("own.py:absent", 3, "defines no 'absent'"), ("rbf", 3, "in the library, as koopf_rbf_ddr"), ("own.py:text", 3, "it is a text"),
])  # fmt: skip
def test_what_has_no_c_code_is_refused_with_a_remedy(own, tinykoop_in, text, n, said, tmp_path):
    done = tinykoop_in(own, "dictionary", "export", text, "-o", tmp_path / "a.h", "-n", n)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and not (tmp_path / "a.h").exists()
    assert re.search(said, done.stderr)


def test_header_needs_its_ending(own, tinykoop_in):
    done = tinykoop_in(own, "dictionary", "export", "own.py:parts", "-o", "parts.c", "-n", 3)
    assert done.returncode == 2 and "choose the ending .h" in done.stderr


# ---- every command -------------------------------------------------------------------------------------

MODEL = """
#include "tinykoop.h"
{source}
#include "model.h"
static {real} storage[KOOP_RLS_REALS_SQRT(6, 2)];
int main(void) {{
	{koop}_rls rls;
	{koop}_dictionary other = {koop}_mine;
	other.name = "other";
	const {koop}_dictionary *both[] = {{&other, &{koop}_mine}};
	int status[2];
	for (int i = 0; i < 2; i++) {{
		const {koop}_config config = {{.dictionary = both[i], .n_inputs = 2, .regulator = &{koop}_reg_none, .form = &{koop}_form_sqrt, .lambda = 1, .p0 = 100}};
		if ({koop}_rls_init(&rls, &config, storage, sizeof storage / sizeof *storage) != KOOP_OK) {{ return 3; }}
		status[i] = {koop}_model_load(&rls, koop_model, sizeof koop_model);
	}}
	return status[0] != KOOP_E_MODEL || status[1] != KOOP_OK;
}}
"""


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_fitted_model_loads_in_firmware_with_its_source_alone(own, precision, tmp_path, firmware):
    koop, real = REAL[precision]
    fit.run(own / "log.csv", tmp_path / "model.h", f"{own / 'both.c'}:mine", int(precision[1:]))
    header = (tmp_path / "model.h").read_text()
    assert f'only with the dictionary "mine": {own / "both.c"}:mine' in header and "koop_model_dictionary" not in header
    define = "" if precision == "f32" else "#define KOOP(name) koopd_##name\n#define KOOP_REAL double"
    (tmp_path / "main.c").write_text(MODEL.format(source=define + BOTH, koop=koop, real=real))
    command = ["gcc", *STRICT, "-I", ROOT / "lib/include", "main.c", firmware(koop), "-lm", "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "main"], check=True)
    assert tk.RLS(tk.CSource(own / "both.c", "mine"), 2, precision=precision).load(tmp_path / "model.h", 3).theta.shape == (6, 8)


FACTOR = """
static void lift(const koopf_dictionary *self, const float *x, float *psi) {
	(void)self;
	for (size_t i = 0; i < 3; i++) { psi[i] = x[i]; }
	psi[3] = %sf * x[0] * x[1];
}
const koopf_dictionary mine = {"mine", 3, 4, lift, NULL};
"""
FUNCTION = "import numpy as np\ndef mine(x):\n    assert np.abs(x).max() < 2  # only where the robot drives\n    return np.column_stack([x, %s * x[:, 0] * x[:, 1]])\n"


@pytest.mark.parametrize("ending, text", [("c", '#include "tinykoop.h"\n' + FACTOR), ("py", FUNCTION)])
def test_model_is_refused_where_the_functions_have_changed_under_the_same_name(own, tmp_path, ending, text):
    def learner(name, factor):
        (tmp_path / name).mkdir(exist_ok=True)
        (tmp_path / name / f"own.{ending}").write_text(text % factor)
        return tk.RLS(dictionaries.from_file(f"{tmp_path / name / f'own.{ending}'}:mine"), 2, regulator="none")

    fitted, same, changed = learner("a", "0.5"), learner("b", "0.5"), learner("c", "0.5005")
    x = np.random.default_rng(5).uniform(-1, 1, (60, 3))
    fitted.fit(x, x[:-1, :2]).export(tmp_path / "model.h")
    np.testing.assert_array_equal(same.load(tmp_path / "model.h", 3).theta, fitted.theta.astype(np.float32))
    changed.fit(x[::-1], x[:-1, :2])
    theta, P = changed.theta, changed.P
    with pytest.raises(
        tk.UserError, match=r"model.h: the functions of dictionary .* have changed since this model was fitted; fit it again"
    ):
        changed.load(tmp_path / "model.h")
    np.testing.assert_array_equal(changed.theta, theta)
    np.testing.assert_array_equal(changed.P, P)
    assert np.isfinite(dictionaries.fingerprint(changed._core)[0]).sum() >= 6  # a state that a function is not made for does not end it


def test_pickle_is_refused_where_the_functions_have_changed(own, tmp_path):
    file = tmp_path / "own.c"
    file.write_text('#include "tinykoop.h"\n' + FACTOR % "0.5")
    x = np.random.default_rng(6).uniform(-1, 1, (60, 3))
    kept = pickle.dumps(tk.RLS(tk.CSource(file, "mine"), 2).fit(x, x[:-1, :2]))
    assert pickle.loads(kept).theta.shape == (4, 6)
    file.write_text('#include "tinykoop.h"\n' + FACTOR % "0.25")
    with pytest.raises(tk.UserError, match="pickle: the functions of dictionary .* have changed"):
        pickle.loads(kept)


def test_model_of_parts_carries_the_settings_and_sizes(own, tmp_path):
    fit.run(own / "log.csv", tmp_path / "model.h", f"{own / 'own.py'}:parts")
    header = (tmp_path / "model.h").read_text()
    assert "enum { koop_model_n_states = 3, koop_model_n_lifted = 37 };" in header
    assert all(float(np.float32(v)).hex() + "f" in header for v in (0.1, 1 / 3, -1.7, 1e-3, 1.5, 0.7))


def test_name_of_a_file_does_not_end_the_comment_of_a_header(own, tmp_path):
    folder = tmp_path / "a*/*b"
    folder.mkdir(parents=True)
    (folder / "own.py").write_text(PARTS)
    fit.run(own / "log.csv", tmp_path / "model.h", f"{folder}/own.py:parts")
    subprocess.run(["gcc", *STRICT, "-fsyntax-only", "-I", ROOT / "lib/include", "-x", "c", tmp_path / "model.h"], check=True)


def test_replay_of_a_c_source_is_that_of_the_same_functions_in_python(own, tmp_path):
    names = f"{own / 'both.c'}:mine", f"{own / 'own.py'}:same"
    rows = [[row for row in replay.run_log(own / "log.csv", tmp_path, dictionary=name) if "regulator" in row] for name in names]
    assert {row["regulator"] for row in rows[0]} == {"offline", *scenario.REGULATORS} and len(rows[0]) == len(rows[1])
    errors = [[row["mean_error"] for row in some if row["precision"] == "f64"] for some in rows]
    np.testing.assert_allclose(*errors, rtol=1e-6)


def test_choose_compares_a_c_source(own, tmp_path, monkeypatch):
    monkeypatch.setattr(choose, "LAMBDAS", (0.98,))
    text = f"{own / 'both.c'}:mine"
    rows = choose.run([own / "log.csv"], tmp_path, dictionary=text)
    assert {row["dictionary"] for row in rows} == {"poly", "rbf", "affine", text}


@pytest.mark.parametrize("name", ["own.py:parts", "own.py:lifted", "both.c:mine"])
def test_learn_runs_it_beside_the_built_in_ones(own, tmp_path, name, monkeypatch):
    text = f"{own}/{name}"
    monkeypatch.setattr(scenario, "METHODS", scenario.METHODS[:1])
    drive = scenario.drive(600)
    monkeypatch.setattr(scenario, "drive", lambda: drive)
    monkeypatch.setattr(learn, "draw", lambda *_: None)
    mine = [row for row in learn.run(tmp_path, dictionary=text) if row["dictionary"] == text]
    assert {(row["regulator"], row["precision"]) for row in mine} == {(r, p) for r in ("offline", *scenario.REGULATORS) for p in REAL}
    (row,) = [row for row in mine if (row["regulator"], row["precision"]) == ("ef", "f64")]
    estimator = bridge.Estimator(dictionaries.from_file(text).own(3), "ef", 64)
    np.testing.assert_allclose(row["mean_error"], textbook(estimator.lift(drive[0]), *drive), rtol=1e-6)


def textbook(psi, x, u, lam=0.98):
    """Mean one-step error of exponential forgetting, eq. (4) of the paper."""
    zeta, theta, errors = np.column_stack([psi[:-1], u]), np.zeros((psi.shape[1], psi.shape[1] + 2)), []
    P = 100 * np.eye(zeta.shape[1])
    for k, z in enumerate(zeta):
        left = psi[k + 1] - theta @ z
        errors.append(np.linalg.norm(left[:3]))
        gain = P @ z / (lam + z @ P @ z)
        theta = theta + np.outer(left, gain)
        P = (P - np.outer(gain, z @ P)) / lam
        P = (P + P.T) / 2
    return np.mean(errors)


@pytest.mark.parametrize("command", ["learn", "ablate", "windup"])
def test_figures_and_tables_of_the_paper_have_room_for_it(own, tinykoop_in, tmp_path, monkeypatch, command):
    monkeypatch.setattr(windup, "GROWTH_STEPS", 9000)
    monkeypatch.setattr(windup, "SOAK_UPDATES", 2000)
    done = tinykoop_in(own, command, "--dictionary", "both.c:mine", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    rows = json.loads((tmp_path / f"{command}.json").read_text())
    assert {row["dictionary"] for row in rows} == {"poly", "rbf", "both.c:mine"}
    counts = Counter(row["dictionary"] for row in rows if row["regulator"] != "offline")
    assert len(set(counts.values())) == 1 and "mine" in done.stdout and list(tmp_path.glob("*.png"))


@pytest.mark.parametrize("command", ["learn", "ablate", "windup"])
@pytest.mark.parametrize("name, said", [
    ("own.py:logarithm", "own.py:logarithm: lift, row 0: the result would not be finite"), ("own.py:broken", "for states of 3 values: IndexError"),
    ("rbf", "give one of your own"), ("none.c:mine", "none.c: No such file"),
])  # fmt: skip
def test_dictionary_that_cannot_lift_the_drive_is_one_line(own, tinykoop_in, command, name, said, tmp_path):
    done = tinykoop_in(own, command, "--dictionary", name, "--out", tmp_path)
    assert done.returncode == 2 and len(done.stderr.splitlines()) == 1 and said in done.stderr


def test_row_of_a_log_that_cannot_be_lifted_is_named(own, tmp_path):
    log = bridge.read_log(own / "log.csv")
    x = log.x + (1 - log.x.min(0)) * (1, 0, 0)
    x[700, 0] = -0.5
    bridge.write_log(tmp_path / "log.csv", x, log.u, DT)
    with pytest.raises(tk.UserError, match="own.py:logarithm: lift, row 700: .*finite"):
        fit.run(tmp_path / "log.csv", tmp_path / "model.h", f"{own / 'own.py'}:logarithm")


def test_pages_are_not_written_with_a_dictionary_of_ones_own(own, tinykoop_in):
    done = tinykoop_in(own, "learn", "--dictionary", "both.c:mine", "--update")
    assert done.returncode == 2 and "leave out --dictionary" in done.stderr
