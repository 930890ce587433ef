"""Small arrays of a kernel's own: each call has its own, of the shape asked for, zeros where that is said."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

from cosim.base.kernel_types import Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector, zero_matrix, zero_vector

_ROWS = 4


@device_function
def _sum_of_squares(count):  # type: ignore[no-untyped-def]
    own = small_vector(8)
    for i in range(count):
        own[i] = i * i
    total = 0.0
    for i in range(count):
        total += own[i]
    return total


@kernel
def _twice(count: int) -> float:
    own = small_vector(8)
    own[3] = 100.0
    return _sum_of_squares(count) + _sum_of_squares(count - 1) + own[3]


@kernel
def _fill_by_rows(out: Vector) -> int:
    own = small_matrix(_ROWS, 3)
    for r in range(own.shape[0]):
        for c in range(own.shape[1]):
            own[r, c] = 10.0 * r + c
    flat = own.reshape(own.size)
    for k in range(own.size):
        out[k] = flat[k]
    return own[2].size


@kernel
def _zeros_each_time(times: int) -> bool:
    total = 0.0
    for _ in range(times):
        vector, matrix = zero_vector(3), zero_matrix(2, 2)
        for r in range(2):
            vector[r] += 1.0
            for c in range(2):
                matrix[r, c] += 1.0
        total += vector[0] + vector[1] + vector[2] + matrix[0, 1] + matrix[1, 0]
    return total == 4.0 * times


def test_each_call_has_its_own() -> None:
    assert _twice(5) == 30.0 + 14.0 + 100.0


def test_rows_follow_each_other() -> None:
    out = np.zeros(12)
    assert _fill_by_rows(out) == 3
    assert out.tolist() == [10.0 * r + c for r in range(4) for c in range(3)]


def test_zeros_are_there_in_every_turn_of_a_loop() -> None:
    assert _zeros_each_time(5)


def test_lengths_are_known_beforehand() -> None:
    with pytest.raises(numba.core.errors.TypingError):
        numba.njit(lambda count: small_vector(count)[0])(3)


@pytest.mark.parametrize("returned", [Vector, tuple[Vector, float]])
def test_a_kernel_that_returns_arrays_says_that_it_allocates(returned: Any) -> None:
    def made(x: Any) -> Any:
        return x

    made.__annotations__ = {"x": Vector, "return": returned}
    with pytest.raises(TypeError, match="say that it allocates"):
        kernel(made)
    assert kernel(allocates=True)(made) is not None
