"""Kernels take in device functions, which have no machine code of their own, and one another, by name."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from cosim.base.kernel_types import Vector
from cosim.base.kernels import allocating, device_function, inlined, kernel, same_bits


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


def test_python_cannot_call_one() -> None:
    with pytest.raises(TypeError, match=r"only kernels can call _halved\(\)"):
        _halved(2.0)


@kernel
def _add(x: Vector, to: Vector) -> float:
    for i in range(x.shape[0]):
        to[i] += x[i]
    return x[0]


@kernel
def _add_twice(x: Vector, to: Vector) -> float:
    return _add(x, to) + _add(x[1:], to[1:])


def test_kernels_call_others_by_name() -> None:
    to = np.zeros(3)
    assert _add_twice(np.array([1.0, 2.0, 3.0]), to) == 3.0
    assert to.tolist() == [1.0, 4.0, 6.0]
    assert not _add.overloads  # type: ignore[attr-defined]  # it is a part of the other one
    assert _add(np.ones(3), to) == 1.0


@inlined
def _with_sign(value, of):  # type: ignore[no-untyped-def]
    sign = np.uint64(1) << np.uint64(63)
    return same_bits((same_bits(value) & ~sign) | (same_bits(of) & sign))


@kernel
def _minus(x: float) -> float:
    return _with_sign(x, -1.0)  # type: ignore[no-any-return]


def test_bits_stay_the_same() -> None:
    assert _minus(3.0) == _minus(-3.0) == -3.0
