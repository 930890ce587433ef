"""Device functions have no machine code of their own, and say so."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from cosim.base.kernel_types import Vector
from cosim.base.kernels import allocating, device_function, handing_on_views, kernel


@device_function
def _halved(x):  # type: ignore[no-untyped-def]
    return 0.5 * x


@device_function
def _quartered(x):  # type: ignore[no-untyped-def]
    return _halved(_halved(x))


@kernel
def _three_quarters(x: float) -> float:
    return _halved(x) + _quartered(x)


def test_kernels_take_device_functions_in() -> None:
    assert _three_quarters(2.0) == 1.5
    assert numba.njit(lambda x: _quartered(x))(2.0) == 0.5


@pytest.mark.parametrize("hands_on", [lambda x: np.empty(len(x)), lambda x: (x, 1.0)])
def test_arrays_come_from_those_alone_that_say_so(hands_on: Any) -> None:
    silent, said = device_function(hands_on), allocating(hands_on)
    assert numba.njit(lambda x: said(x)[0])(np.ones(2)) is not None
    with pytest.raises((TypeError, numba.core.errors.TypingError)):
        numba.njit(lambda x: silent(x)[0])(np.ones(2))


def _ends(x):  # type: ignore[no-untyped-def]
    return x[:1], x[-1:]


_both_ends = handing_on_views(_ends)


@kernel
def _length(x: Vector) -> float:
    first, last = _both_ends(x)
    return last[0] - first[0]


def test_views_are_handed_on_by_those_alone_that_say_so_to_those_that_count_none() -> None:
    assert _length(np.arange(3.0)) == 2.0
    silent = device_function(_ends)
    with pytest.raises((TypeError, numba.core.errors.TypingError), match="handing on views"):
        numba.njit(lambda x: silent(x)[0][0], _nrt=False)(np.arange(3.0))
    with pytest.raises((TypeError, numba.core.errors.TypingError), match="marked as allocating"):
        numba.njit(lambda x: _both_ends(x)[0][0])(np.arange(3.0))


def test_python_cannot_call_one() -> None:
    with pytest.raises(TypeError, match=r"only kernels can call _halved\(\)"):
        _halved(2.0)


@kernel(taken_in=True)
def _fifths(x: float) -> float:
    return x / 5.0


def test_a_kernel_is_called_by_name_only_where_it_says_so() -> None:
    assert numba.njit(lambda x: _fifths(x))(5.0) == 1.0
    with pytest.raises(TypeError, match=r"_three_quarters\(\) is a kernel of its own: mark it as taken in"):
        numba.njit(lambda x: _three_quarters(x))(2.0)
