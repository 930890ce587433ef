"""The search for the shift that makes a tangent definite: the same wherever it begins, in fewer attempts."""

from __future__ import annotations

import pytest

from cosim.soft.linear.linear_solver import ShiftSearch

START = 0.05


def found(search: ShiftSearch, needed: float, most: float = 1e8) -> tuple[int, list[float]]:
    """Return the attempts as counted and as made, for a matrix that needs a shift."""
    tried: list[float] = []

    def definite(shift: float) -> bool:
        tried.append(shift)
        return shift >= needed

    return search.factor(definite, START, most), tried


def least(needed: float) -> float:
    """Return the first of the shifts that serves, one by one."""
    shift = START
    while shift < needed:
        shift *= 6.0
    return shift


def test_the_shift_does_not_depend_on_where_the_search_begins() -> None:
    search = ShiftSearch()
    for needed in (0.04, 2000.0, 2000.0, 0.04, 100.0, 5e4, 60.0, 1.0, 0.06):
        count, tried = found(search, needed)
        assert count == len(tried)
        assert tried[0] == 0.0
        assert tried[-1] == pytest.approx(least(needed), rel=1e-12)


def test_a_shift_near_the_last_one_takes_few_attempts() -> None:
    search = ShiftSearch()
    assert found(search, 2000.0)[0] == 8
    assert found(search, 2000.0)[0] == 3
    assert found(search, 2500.0)[0] == 4  # one larger
    assert found(search, 2000.0)[0] == 4  # one smaller
    assert found(search, 0.0) == (1, [0.0])
    assert found(search, 2000.0)[0] == 3


def test_no_shift_beyond_the_largest_is_tried() -> None:
    count, tried = found(ShiftSearch(), 1e9)
    assert count == -len(tried)
    assert max(tried) <= 1e8 < 6.0 * max(tried)
