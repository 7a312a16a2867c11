"""`make mutants` without a build of lib/: which mutants there are, how they are drawn, counted, and argued away."""

import shutil
import subprocess
from collections import Counter

import pytest
from tinykoop.assure import mutants, trial
from tinykoop.assure.mutation import Mutant
from tinykoop.assure.mutation import mutants as mutants_of
from tinykoop.plumbing.errors import UserError


def after(line, text=None):
    """What the mutants of one line in a function make of it."""
    source = text or f"void f(void) {{\n{line}\n}}\n"
    return {mutant.after for mutant in mutants_of("lib/src/a.c", source) if mutant.before == line}


# ---- each operator -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "line, expected",
    [
        ("y = a + b;", "y = a - b;"),
        ("y = a * b;", "y = a / b;"),
        ("y = f(x) % n;", "y = f(x) * n;"),
        ("y = *x++ - *z;", "y = *x++ + *z;"),
        ("y += a;", "y -= a;"),
        ("y *= a;", "y /= a;"),
        ("i++;", "i--;"),
        ("y = a >> 8;", "y = a << 8;"),
        ("y = a & b;", "y = a ^ b;"),
        ("y = a < b;", "y = a <= b;"),
        ("y = a < b;", "y = a >= b;"),
        ("y = a == b;", "y = a != b;"),
        ("y = a && b;", "y = a || b;"),
        ("y = -x;", "y = x;"),
        ("y = !x;", "y = x;"),
        ("for (size_t i = 0; i < n; i++) { x[i] = 0; }", "for (size_t i = 0; i <= n; i++) { x[i] = 0; }"),
    ],
)
def test_signs_are_replaced_or_dropped(line, expected):
    assert expected in after(line)


@pytest.mark.parametrize(
    "line, expected",
    [
        ("y = 0;", {"y = 1;"}),
        ("y = 3u;", {"y = 4u;", "y = 2u;"}),
        ("y = 0x10u;", {"y = 17u;", "y = 15u;"}),
        ("y = 0.7;", {"y = 1.4;"}),
        ("y = 1.5f;", {"y = 3.0f;"}),
        ("y = 1e-5f;", {"y = 2e-05f;"}),
    ],
)
def test_constants_are_changed(line, expected):
    assert after(line) == expected | {";"}  # or the statement is dropped


def test_a_true_result_becomes_false_only():
    assert after("return 1;") == {"return 0;"}


def test_indices_are_off_by_one():
    assert "y = x[i + 1];" in after("y = x[i];")
    assert "y = x[n - i + 1];" in after("y = x[n - i];")
    assert {"y = x[3];", "y = x[5];"} <= after("y = x[4];")


@pytest.mark.parametrize(
    "line, expected",
    [
        ("return a && b < c && d;", {"return 1 && b < c && d;", "return a && 1 && d;", "return a && b < c && 1;"}),
        ("return a || f(b, c) && d;", {"return 0 || f(b, c) && d;", "return a || 0;", "return a || 1 && d;", "return a || f(b, c) && 1;"}),
    ],
)
def test_sides_of_a_condition_are_dropped(line, expected):
    assert expected <= after(line)


def test_conditions_are_negated():
    assert "if (!(a && b)) { return; }" in after("if (a && b) { return; }")
    assert "while (!(*x)) {}" in after("while (*x) {}")
    assert "y = !(a > b) ? a : b;" in after("y = a > b ? a : b;")


@pytest.mark.parametrize(
    "line, expected",
    [
        ("if (a) { y = b; }", "if (a) { ; }"),
        ("if (a) y = b;", "if (a) ;"),
        ("for (;;) { if (a) { break; } }", "for (;;) { if (a) { ; } }"),
        ("for (;;) { f(a, b); x++; }", "for (;;) { ; x++; }"),
        ("for (;;) { f(a, b); x++; }", "for (;;) { f(a, b); ; }"),
        ("if (a) { (void)KOOP(reset)(a); }", "if (a) { ; }"),
        ("LANES_8(ADD) x += dx;", "; x += dx;"),
        ("LANES_8(ADD) x += dx;", "LANES_8(ADD) ;"),
        ("y[0] = f({1, 2}); y = 1;", "; y = 1;"),
    ],
)
def test_statements_are_dropped(line, expected):
    assert expected in after(line)


@pytest.mark.parametrize("line", ["real x = 1;", "const KOOP(step) x = {1};", "KOOP(mpc) *x = y;", "return f(x);", "if (a) { return 1; }"])
def test_declarations_and_returns_are_not_dropped(line):
    assert not [changed for changed in after(line) if changed in (";", "if (a) { ; }")]


def test_arguments_are_swapped():
    assert {"f(b, a[1], c);", "f(a[1], c, b);"} <= after("f(a[1], b, c);")
    assert "KOOP(f)(g(y, z), x);" in after("KOOP(f)(x, g(y, z));")
    assert "y = max_of(b, a);" not in after("y = max_of(a, b);")
    declared = "static real f(const real *x, size_t n) {"
    assert not after(declared, f"{declared}\n}}\n")


# ---- what is left alone --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "/* a + b; x = 1 */\n",
        "// a + b\n",
        "#if A > 1 && B\n#include <a.h>\n#else\n#error 1 + 1\n#endif\n",
        'static const char t[] = "a + 1 \\" b";\n',
        "char c = '+';\n",
        "#define NAME_1(a, b2)\n",
        "void f(void) {\n\treal sum[4];\n}\n",
        "void f(const real *x, KOOP(mpc) *y) {\n}\n",
    ],
)
def test_what_is_no_code_is_never_mutated(text):
    assert mutants_of("lib/src/a.c", text) == []


def test_strings_and_comments_beside_code_stay():
    line = 'f("1 + 1", x); /* 2 + 2 */'
    assert after(line) == {'f(x, "1 + 1"); /* 2 + 2 */', "; /* 2 + 2 */"}


def test_bodies_of_macros_are_code():
    text = "#define ADD(lane) \\\n\ts##lane += a * x[lane]; \\\n\tt = 1;\n#define TWO 2\n"
    found = mutants_of("lib/src/a.c", text)
    assert {mutant.function for mutant in found} == {"ADD", "TWO"}
    assert "#define TWO 3" in {mutant.after for mutant in found}
    assert "s##lane -= a * x[lane];" in {mutant.after for mutant in found}


def test_a_mutant_knows_its_place():
    text = "static int KOOP(f)(int a) {\n\treturn a +\n\t       b;\n}\n\nint g(void) { return h(1); }\n"
    found = {mutant.after: mutant for mutant in mutants_of("lib/src/a.c", text)}
    assert (found["return a -"].place, found["return a -"].function) == ("lib/src/a.c:2", "f")
    assert found["int g(void) { return h(2); }"].function == "g"
    assert found["return a -"].mutated == text.replace("+", "-")


def test_each_mutant_is_another_text_and_none_is_the_original():
    for path in (mutants.LIB / "src").glob("*.c"):
        text = path.read_text()
        changed = [mutant.mutated for mutant in mutants_of(path.name, text)]
        assert text not in changed and len(set(changed)) == len(changed)


# ---- drawing and counting ------------------------------------------------------------------------------------


def test_same_seed_same_mutants():
    known = mutants.all_mutants()
    assert len(known) > 1000
    assert mutants.draw(known, 3) == mutants.draw(known, 3)
    assert mutants.draw(known, 3) != mutants.draw(known, 4)
    assert sorted(map(hash, mutants.draw(known, 3))) == sorted(map(hash, known))


def test_one_that_does_not_compile_is_replaced_by_the_next(monkeypatch):
    verdicts = {"a": "killed", "b": None, "c": "survived", "d": "killed"}
    monkeypatch.setattr(mutants, "judge", lambda mutant, kernels: verdicts[mutant])
    assert mutants.try_all(list("abcd"), 3, []) == [("a", "killed"), ("c", "survived"), ("d", "killed")]
    assert len(mutants.try_all(list("abcd"), 9, [])) == 3


def test_the_score_is_of_those_that_can_be_killed():
    assert mutants.score(Counter(killed=96, survived=9, equivalent=5)) == pytest.approx(100 * 96 / 105)
    assert mutants.score(Counter(equivalent=5)) == 100


# ---- arguments for equivalence -------------------------------------------------------------------------------


LINE = "lib/src/a.c:f | i <= n | i < n | x[n] is 0"


def test_an_argument_is_known_by_the_text_of_the_line():
    name = LINE.rpartition(" | ")[0]
    assert mutants.read_equivalent(f"# why\n\n{LINE}\n", {name}) == {name: "x[n] is 0"}


def test_an_argument_for_nothing_is_refused():
    with pytest.raises(UserError, match="equivalent.txt:2: not a mutant.*i <= n"):
        mutants.read_equivalent(f"# why\n{LINE}\n", set())


def test_the_committed_arguments_are_for_mutants_of_lib():
    mutants.read_equivalent(mutants.EQUIVALENT.read_text(), {mutants.key(mutant) for mutant in mutants.all_mutants()})


def first_mutant():
    return mutants_of("lib/src/a.c", "int f(void) { return 1; }\n")[0]


def test_survivors_with_an_argument_are_equivalent():
    mutant = first_mutant()
    assert mutants.with_reasons([(mutant, "survived")], {mutants.key(mutant): "why"}) == [(mutant, "equivalent")]
    assert mutants.with_reasons([(mutant, "survived")], {}) == [(mutant, "survived")]


def test_an_argument_that_a_test_disproves_is_named():
    mutant = first_mutant()
    tried, reasons = [(mutant, "killed")], {mutants.key(mutant): "why"}
    assert mutants.disproved(tried, reasons) == [mutants.key(mutant)]
    assert mutants.with_reasons(tried, reasons) == tried
    assert mutants.disproved([(mutant, "survived")], reasons) == [] == mutants.disproved(tried, {})


# ---- the command ---------------------------------------------------------------------------------------------


@pytest.fixture
def judged(monkeypatch):
    """Puts a verdict for all in place of builds and runs."""

    def use(verdict):
        monkeypatch.setattr(mutants, "prepare", list)
        monkeypatch.setattr(mutants, "judge", lambda mutant, kernels: verdict)

    return use


def test_writes_what_was_found(judged, tmp_path, monkeypatch):
    (tmp_path / "equivalent.txt").write_text("")  # else a mutant that is drawn and argued to be equivalent would contradict the tests
    monkeypatch.setattr(mutants, "EQUIVALENT", tmp_path / "equivalent.txt")
    judged("killed")
    assert mutants.run(tmp_path, 20, 1)["killed"] == 20
    assert (tmp_path / "mutants.json").read_text() == '{\n "mutants": 20,\n "killed": 20,\n "equivalent": 0,\n "survivors": []\n}\n'


def test_too_many_survivors_fail_the_command(judged, tmp_path):
    judged("survived")
    with pytest.raises(UserError, match="0 % of the mutants are killed(.|\n)*lib/src/status.c:status_message | "):
        mutants.run(tmp_path, 20, 1, "lib/src/status.c")
    assert '"place": "lib/src/status.c:' in (tmp_path / "mutants.json").read_text()


@pytest.mark.parametrize("n, file, said", [(0, None, "--n 0"), (1, "lib/src/nothing.c", "--file lib/src/nothing.c")])
def test_bad_arguments_are_refused(judged, tmp_path, n, file, said):
    judged("killed")
    with pytest.raises(UserError, match=said):
        mutants.run(tmp_path, n, 1, file)


# ---- a library of three lines ----------------------------------------------------------------------------------


@pytest.fixture
def tiny(monkeypatch, tmp_path):
    """A kernel whose only test wants f(2) to be 3; judges what f returns instead."""
    if not shutil.which("gcc") or not shutil.which("prlimit"):
        pytest.skip("needs gcc and prlimit")
    lib, build = tmp_path / "lib", tmp_path / "build"
    for folder in (lib / "src", lib / "include", build / "vectors"):
        folder.mkdir(parents=True)
    (lib / "src/a.c").write_text("int NAME(int x) {\n\treturn x + 1;\n}\n")
    for precision in trial.PRECISIONS:
        (lib / f"{precision}.c").write_text(f'#define NAME {precision}\n#include "src/a.c"\n')
        (lib / f"{precision}_supervisor.c").write_text("")
    monkeypatch.setattr(trial, "LIB", lib)
    monkeypatch.setattr(trial, "BUILD", build)
    monkeypatch.setattr(trial, "WORK", build)
    kernel = trial.Kernel("vectors")
    for unit in ("koopf", "koopf_supervisor", "koopd", "koopd_supervisor"):
        assert kernel.compile(lib, unit, kernel.folder)
    kernel.link(kernel.folder)
    program = kernel.folder / "test"
    main = "int koopd(int x); int main(void) { return koopd(2) != 3; }"
    command = ["gcc", "-x", "c", "-", "-x", "none", str(kernel.folder / trial.SHARED), "-o", str(program)]
    subprocess.run(command, input=main, text=True, check=True)
    kernel.limits = {"koopf": {}, "koopd": {program: 1}}

    def judge(returned):
        changed = Mutant("lib/src/a.c", "f", (lib / "src/a.c").read_text(), 18, 31, returned)
        return trial.judge(changed, [kernel])

    return judge


@pytest.mark.parametrize(
    "returned, verdict",
    [
        ("return x - 1;", "killed"),
        ("return 1 + x;", "equivalent"),
        ("return x | 1;", "survived"),
        ("return x +;", None),
        ("while (x != 7) {} return 3;", "killed"),  # by its time
    ],
)
def test_verdicts(tiny, returned, verdict):
    assert tiny(returned) == verdict


def test_the_program_that_found_most_mutants_for_its_time_is_asked_first():
    kernel = trial.Kernel("vectors", {"koopf": {"fast": 3, "idle": 3, "slow": 9}})
    assert [program for program, _ in kernel.in_order("koopf")] == ["fast", "idle", "slow"]
    kernel.kills.update({"slow": 8, "fast": 1})
    assert kernel.in_order("koopf") == [("slow", 9), ("fast", 3), ("idle", 3)]


def test_a_mutant_is_found_once_and_the_program_that_found_it_is_counted(monkeypatch):
    asked, kernel = [], trial.Kernel("vectors", {"koopf": {"blind": 3, "sharp": 3, "late": 3}})
    monkeypatch.setattr(trial.Kernel, "fails", lambda kernel, program, seconds, folder: asked.append(program) or program == "sharp")
    assert kernel.kill("koopf", None) and asked == ["blind", "sharp"] and kernel.kills["sharp"] == 1
