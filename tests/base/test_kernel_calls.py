"""A kernel that is called by its address does what it does when it is called by its name."""

from __future__ import annotations

import numpy as np

from cosim.base.kernel_calls import address_of, caller
from cosim.base.kernels import INDICES, MATRIX, REAL, VECTOR, kernel
from cosim.soft.elements.mass_terms import add_gravity

_add_gravity = caller(add_gravity)


@kernel(REAL(INDICES, MATRIX, VECTOR, VECTOR, MATRIX))
def _weight_of_some(calls, x, mass, gravity, gradient):  # type: ignore[no-untyped-def]
    return _add_gravity(calls[0], (x[1:], mass[1:], gravity, gradient[1:]))


def test_a_kernel_calls_another_by_its_address() -> None:
    x, mass = np.random.default_rng(1).normal(size=(5, 3)), np.arange(5.0)
    gravity, gradient, expected = np.array([0.1, 0.2, -9.81]), np.zeros((5, 3)), np.zeros((5, 3))
    energy = _weight_of_some(np.array([address_of(add_gravity)]), x, mass, gravity, gradient)
    assert energy == add_gravity(x[1:], mass[1:], gravity, expected[1:])
    assert (gradient == expected).all()
    assert gradient[1:].any()
