"""`make determinism`: how it reads what the programs print, and what it lets pass."""

import math

import pytest
from tinykoop.assure import determinism
from tinykoop.plumbing.errors import UserError

PRINTED = "part float32 lift-poly-ddr 0123 0x1p+0 -0x1p-1\npart float64 lift-poly-ddr 4567 nan\n"
GCC = determinism.Build("gcc -O2", "gcc", ("-O2",))
CONTRACTED = determinism.Build("gcc contracted", "gcc", ("-O2", determinism.CONTRACTED))


def row(part="loop-poly-newton", other="0x1p+0", digest="4567", build=GCC):
    ours = determinism.read_parts(f"part float32 {part} 0123 0x1p+0 0x1p-2\n")
    theirs = determinism.read_parts(f"part float32 {part} {digest} {other} 0x1p-2\n")
    (only,) = determinism.compare(ours, build, theirs)
    return only


def test_reads_digests_and_values():
    parts = determinism.read_parts("noise\n" + PRINTED)
    assert parts["float32", "lift-poly-ddr"] == determinism.Part("0123", [1.0, -0.5])
    assert math.isnan(parts["float64", "lift-poly-ddr"].values[0])


def test_two_parts_of_one_name_are_refused():
    with pytest.raises(UserError, match="two parts"):
        determinism.read_parts(PRINTED + PRINTED)


def test_a_build_that_prints_the_same_holds():
    parts = determinism.read_parts(PRINTED)
    rows = determinism.compare(parts, GCC, parts)
    assert [r["equal"] for r in rows] == [True, True]
    assert [r["largest_difference"] for r in rows] == [0, 0]
    assert not any(map(determinism.broken, rows))


def test_one_other_bit_is_told_even_if_no_printed_value_shows_it():
    assert determinism.broken(row()) == "gcc -O2: loop-poly-newton in float32 has other bits"
    assert determinism.broken(row(digest="0123")) is None


@pytest.mark.parametrize("printed", ["", PRINTED.splitlines()[0] + "\n", PRINTED + "part float32 more 0 0x1p+0\n"])
@pytest.mark.parametrize("build", [GCC, CONTRACTED])
def test_a_part_that_is_missing_or_new_is_told(printed, build):
    rows = determinism.compare(determinism.read_parts(PRINTED), build, determinism.read_parts(printed))
    assert sum(bool(determinism.broken(r)) for r in rows) == {0: 2, 1: 1, 3: 1}[printed.count("\n")]


@pytest.mark.parametrize("other, told", [("0x1.0004p+0", False), ("0x1.01p+0", True), ("nan", True), ("inf", True)])
def test_contracted_values_must_be_close(other, told):
    assert bool(determinism.broken(row(other=other, build=CONTRACTED))) == told


def test_windup_of_the_plain_form_is_bounded_only_where_nothing_is_contracted():
    assert determinism.broken(row("update-ef-plain-refuse", "0x1p+4", build=CONTRACTED)) is None
    assert determinism.broken(row("update-ef-plain-refuse", "0x1p+4"))
    assert determinism.broken(row("update-ef-sqrt-refuse", "0x1p+4", build=CONTRACTED))
    assert determinism.broken(row("update-none-plain-refuse", "0x1p+4", build=CONTRACTED))


def test_a_difference_is_relative_to_the_largest_value():
    assert determinism.largest_difference([2.0, 0.5], [2.0, 1.0]) == 0.25
    assert determinism.largest_difference([0.0], [0.5]) == 0.5
    assert determinism.largest_difference([1.0], [1.0, 2.0]) == math.inf


def test_what_is_missing_is_named_and_left_out():
    nothing = determinism.missing_here(which=lambda name: None)
    assert nothing == {"cortex-m4f": "gcc-arm-none-eabi picolibc-arm-none-eabi qemu-system-arm", "clang": "clang"}
    assert {build.compiler for build in determinism.builds(nothing)} == {"gcc"}
    assert determinism.missing_here(which=lambda name: name) == {}


def test_builds_are_those_that_are_promised():
    named = [build.name for build in determinism.builds({"clang": "", "cortex-m4f": ""})]
    assert len(set(named)) == len(named)
    for way in ("-O0", "-O1", "-O2", "-O3", "-Os", "-O2 -DKOOP_VECTORS=0", "-O0, run again"):
        assert f"gcc {way}" in named
    cortex = determinism.cortex_builds()
    assert [build.name for build in cortex] == ["cortex-m4f -O2", "cortex-m4f -Os", "cortex-m4f -O2 -ffp-contract=fast"]
    assert cortex[0].runner[0] == "qemu-system-arm" and cortex[0].runner[-1] == "-kernel"


def test_reads_errors_of_the_elementary_functions():
    (only,) = determinism.read_errors("error float32 sine 0.001 10 0.75 2.5\n")
    assert only == {"precision": "float32", "function": "sine", "from": 0.001, "to": 10.0, "ulp": 0.75, "x": 2.5}
    with pytest.raises(UserError):
        determinism.read_errors("")


class Printing(determinism.Build):
    """A build whose name is what its programs print."""

    def parts(self):
        return determinism.read_parts(self.name)


@pytest.mark.parametrize(
    "second, ulp, told",
    [
        (PRINTED, 0.9, None),
        (PRINTED.replace("4567", "4568"), 0.9, "other bits"),
        (PRINTED, 1.1, "off by 1.1 ulp"),
        (PRINTED, math.nan, "ulp"),
    ],
)
def test_what_does_not_hold_is_said_after_the_results_are_written(second, ulp, told, tmp_path, monkeypatch):
    monkeypatch.setattr(determinism, "builds", lambda missing: [Printing(PRINTED, "gcc", ()), Printing(second + " ", "gcc", ())])
    monkeypatch.setattr(determinism, "accuracy", lambda precision: determinism.read_errors(f"error {precision} sine 0 1 {ulp} 2.5\n"))
    if told:
        with pytest.raises(UserError, match=told):
            determinism.run(tmp_path)
    else:
        determinism.run(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"determinism.json", "elementary.json"}


def test_one_build_against_itself_without_vectors(tmp_path, monkeypatch):
    """The promise itself, on the two builds that differ most on one machine."""
    monkeypatch.setattr(determinism, "BUILD", tmp_path)
    first, scalar = GCC.parts(), determinism.Build("scalar", "gcc", ("-O1", "-DKOOP_VECTORS=0")).parts()
    assert len(first) > 100 and first == scalar
