"""`Attempts`: numbers in order, who is needed, and when a collection is complete."""

import pytest

from embodichain.recording.demos.attempts import Attempts


def begun(attempts: Attempts, count: int) -> list[int]:
    return [attempts.begin() for _ in range(count)]


def test_numbers_are_given_in_order() -> None:
    assert begun(Attempts(3), 5) == [0, 1, 2, 3, 4]


def test_a_resumed_collection_fills_the_gaps_first() -> None:
    attempts = Attempts(4, succeeded=[1, 4], failed=[0, 5])
    assert begun(attempts, 4) == [2, 3, 6, 7]


def test_failures_belong_to_it_if_fewer_than_wanted_can_succeed_before_them() -> None:
    attempts = Attempts(2)
    begun(attempts, 4)
    attempts.end(1, False)
    assert attempts.is_needed(1)  # of 0 at most one succeeds
    attempts.end(3, False)
    assert attempts.is_needed(3) is None  # 0 and 2 may be the two
    attempts.end(0, False)
    assert attempts.is_needed(3)
    assert not attempts.complete


def test_successes_beyond_the_wanted_ones_do_not_belong_to_it() -> None:
    attempts = Attempts(2)
    begun(attempts, 4)
    attempts.end(3, True)
    attempts.end(2, True)
    assert attempts.is_needed(2) is None and not attempts.complete
    attempts.end(0, True)
    assert attempts.is_needed(0) and not attempts.complete  # 1 still runs
    attempts.end(1, False)
    assert attempts.complete
    assert [attempts.is_needed(n) for n in (0, 1, 2, 3)] == [True, True, True, False]


def test_the_lowest_ones_are_waited_for() -> None:
    """Those that end first are not better than those that take long."""
    attempts = Attempts(1)
    begun(attempts, 3)
    attempts.end(2, True)
    attempts.end(1, True)
    assert not attempts.complete
    attempts.end(0, True)
    assert attempts.complete
    assert [attempts.is_needed(n) for n in (0, 1, 2)] == [True, False, False]


@pytest.mark.parametrize("wanted", [2, 3])
def test_what_was_collected_before_counts(wanted: int) -> None:
    attempts = Attempts(wanted, succeeded=[0, 2], failed=[1])
    assert attempts.complete == (wanted == 2)
    if wanted == 3:
        number = attempts.begin()
        assert number == 3
        attempts.end(number, True)
        assert attempts.complete


def test_fewer_wanted_than_there_are_is_complete() -> None:
    assert Attempts(1, succeeded=[3, 7]).complete
