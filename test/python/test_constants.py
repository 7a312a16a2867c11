"""The table of the diagnoser's constants."""

import numpy as np
import pytest
from tinykoop.blind import constants
from tinykoop.diagnose.prediction_errors import judge, simpler, states


def test_every_constant_has_its_reason():
    listed = constants.listed()
    assert len(listed) > 100 and [(module, name) for module, name, _, reason in listed if not reason] == []


def test_every_column_of_the_table_has_a_name_of_its_own():
    assert len(set(constants.HEADERS)) == len(constants.HEADERS)


def test_a_constant_is_changed_wherever_it_was_imported_to_and_nowhere_else():
    """MARGIN is of states and used in simpler; judge has a MOST of no one else."""
    before = states.MARGIN
    constants._set(states.__name__, "MARGIN", 2 * before)
    try:
        assert states.MARGIN == simpler.MARGIN == 2 * before
    finally:
        constants._set(states.__name__, "MARGIN", before)
    assert states.MARGIN == simpler.MARGIN == before


def test_constants_of_one_name_in_two_modules_are_two():
    from tinykoop.diagnose.prediction_errors import ahead, candidates

    constants._set(candidates.__name__, "SHOWS", 7.0)
    assert (candidates.SHOWS, ahead.SHOWS) == (7.0, 0.15)
    constants._set(candidates.__name__, "SHOWS", 1.0)


@pytest.mark.parametrize("value, half", [(0.3, 0.15), (8, 4), (1, 1), ((1, 10, 50), (1, 5, 25))])
def test_halves_of_whole_numbers_are_whole_numbers(value, half):
    found = constants._scaled(value, 0.5)
    assert found == half and np.asarray(found).dtype == np.asarray(value).dtype


def test_answers_are_counted_that_change_with_a_constant():
    """An impossible price of evidence: the one effect is named no more."""
    log = _drive()
    (_, base), (_, strict) = constants._answers([log]), constants._answers([log], judge.__name__, "ESTABLISHED", 2.0)
    assert base == [("known", ("yaw_gain",))] and strict != base and judge.ESTABLISHED == 0.5


def _drive():
    from test_diagnose import DT, drive, log_of, usual

    log = log_of(drive(400), usual("yaw_gain"))
    return log.x, log.u, DT
