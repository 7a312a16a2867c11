"""The size calculator: what the library asks for, and what was measured."""

import json

import processes
import pytest
from tinykoop import bridge
from tinykoop.firmware import size
from tinykoop.plumbing.errors import UserError


def known(target, config):
    rows = json.loads(size.FOOTPRINT.read_text())
    return next(row for row in rows if (row["target"], row["config"]) == (target, config))


@pytest.mark.parametrize(("config", "lifted"), size.MEASURED)
@pytest.mark.parametrize("level", size.LEVELS)
def test_estimates_pass_through_what_was_measured(config, lifted, level):
    rows = [known("cortex-m4f", f"{name}_{level}") for name, _ in size.MEASURED]
    counts = size.instructions(rows, lifted, 3, 2, 50)
    measured = known("cortex-m4f", f"{config}_{level}")["instructions"]
    assert counts["update, square root, dz_cs"] == pytest.approx(measured["rls_update"]["dz_cs"])
    assert counts["update, plain, diagonal checked, sift"] == pytest.approx(measured["rls_update_plain"]["sift"])
    assert counts["MPC, warm"] == pytest.approx(measured["mpc_solve"]["warm"])


def test_estimates_grow_with_the_work():
    rows = [known("cortex-m4f", f"{name}_O2") for name, _ in size.MEASURED]
    small, large = size.instructions(rows, 10, 4, 2, 20), size.instructions(rows, 40, 10, 4, 60)
    assert all(0 < small[what] < large[what] for what in small)


def test_storage_of_a_learner_is_that_of_its_matrices():
    # Theta N x d and half of S d x d, in rows and tiles padded to four, and six vectors
    d = 14 + 2
    assert bridge.storage(14, 3, 2, 50)["learner_sqrt"] == d * 16 + d * (d + 4) // 2 + 16 + 5 * d
    assert bridge.storage(14, 3, 2, 50)["gate_sqrt"] == bridge.storage(14, 3, 2, 50)["learner_sqrt"] + 3 * 14
    assert bridge.storage(14, 3, 2, 50)["model"] == 14 * d


@pytest.mark.parametrize("sizes", [(3, 4, 2, 50), (22, 3, 0, 50), (254, 3, 2, 50), (22, 3, 2, 0), (22, 3, 2, 1001), (-1, 3, 2, 5)])
def test_sizes_that_the_library_refuses(sizes):
    with pytest.raises(UserError, match="do not fit|does not fit"):
        bridge.storage(*sizes)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ("-N 22 -n 3 -m 2", f"{4 * bridge.storage(22, 3, 2, 50)['mpc_newton']:,}"),
        ("-N 9 -n 6 -m 2 -H 20 --target cortex-m0plus --precision 64", "koopd_rls"),
    ],
)
def test_command(arguments, says):
    done = processes.tinykoop("size", *arguments.split())
    assert done.returncode == 0 and says in done.stdout


def test_unknown_target_is_one_line():
    done = processes.tinykoop("size", "-N", "22", "-n", "3", "-m", "2", "--target", "esp")
    assert done.returncode == 2 and done.stdout == "" and "cortex-m4f" in done.stderr and done.stderr.count("\n") == 1
