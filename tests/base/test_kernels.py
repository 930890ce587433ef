"""Kernels have one signature, compile when they are first called, and do the same with any numba."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any, NamedTuple

import numba
import numpy as np
import pytest

from cosim.base import compilation, compile_time, numba_insides
from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Indices, Matrix, Vector, empty_of
from cosim.base.kernels import (
    allocating,
    device_function,
    kernel,
    small_matrix,
    unchecked,
    unchecked_for,
    zero_vector,
)
from cosim.soft.elements.mass_terms import add_gravity
from tests.base.forked_python import run_forked

ROOT = Path(__file__).resolve().parents[2]


class Weights(NamedTuple):
    """What kernels are given."""

    x: Matrix
    mass: Vector
    gravity: Vector
    gradient: Matrix
    scale: float


@allocating
def _copied(vector):  # type: ignore[no-untyped-def]
    copy = np.empty(len(vector))
    copy[:] = vector
    return copy


@device_function
def _sum(vector):  # type: ignore[no-untyped-def]
    work, total = small_matrix(2, 4), zero_vector(3)
    for i in range(len(vector)):
        work[1, i % 4] = vector[i]
        total[i % 3] += work[1, i % 4]
    return total[0] + total[1] + total[2]


@kernel
def weight_of_some(w: Weights) -> float:
    """Return the potential of all nodes but the first."""
    return w.scale * add_gravity(w.x[1:], w.mass[1:], w.gravity, w.gradient[1:])


@kernel(reorder_sums=True, allocates=True)
def weight_and_mass(weights: Weights, at: Indices) -> tuple[float, float, bool]:
    """Return what `weight_of_some` does, and the mass of the others."""
    return weight_of_some(weights), _sum(_copied(weights.mass[at[0] :])), weights.x.shape[0] > 1


def check() -> None:
    """Check kernels with the numba that is there."""
    x, mass = np.random.default_rng(1).normal(size=(5, 3)), np.arange(5.0)
    gravity, gradient, expected = np.array([0.1, 0.2, -9.81]), np.zeros((5, 3)), np.zeros((5, 3))
    found = weight_and_mass(Weights(x, mass, gravity, gradient, 2.0), np.array([1]))
    assert found == (2.0 * add_gravity(x[1:], mass[1:], gravity, expected[1:]), 10.0, True)
    assert (gradient == expected).all()
    assert gradient[1:].any()


def test_kernels_take_records_and_call_one_another() -> None:
    assert numba_insides.KNOWN
    check()


def test_another_numba_does_the_same() -> None:
    code = (
        "import numba; numba.__version__ = '0.99.0'; from cosim.base import numba_insides;"
        "assert not numba_insides.KNOWN; import tests.base.test_kernels as t; t.check();"
        "import tests.base.test_device_code as d; d.test_kernels_take_device_functions_in();"
        "d.test_bits_stay_the_same()"
    )
    done = run_forked(code, ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("numba 0.99.0 is not 0.68: half as long again") <= 1


def test_private_modules_of_numba_are_imported_where_its_version_is_known_alone() -> None:
    """Another version may have moved them: it compiles by public functions, and ends in no traceback."""
    code = (
        "import builtins, numba; numba.__version__ = '0.99.0'; real = builtins.__import__\n"
        "def refusing(name, scope=None, *more):\n"
        "    of_cosim = scope is not None and scope.get('__name__', '').startswith('cosim')\n"
        "    assert not (of_cosim and name.startswith(('numba.core', 'numba.np'))), name\n"
        "    return real(name, scope, *more)\n"
        "builtins.__import__ = refusing\n"
        "import cosim.base.kernels"
    )
    done = run_forked(code, ROOT)
    assert done.returncode == 0, done.stderr


def test_first_calls_are_announced_once(caplog: pytest.LogCaptureFixture, monkeypatch: Any) -> None:
    factor = 3.0

    def tripled(x: float) -> float:
        return factor * x

    monkeypatch.setattr(compilation._Compiling, "last_s", -np.inf)
    compile_time.take_s()
    first, second = kernel(tripled), kernel(tripled)  # a closure is not kept
    assert (first(2.0), second(2.0), first(3.0)) == (6.0, 6.0, 9.0)
    assert [(record.levelno, record.message) for record in caplog.records] == [
        (logging.WARNING, compilation.ANNOUNCEMENT)
    ]
    assert compile_time.take_s() > 0.0
    assert (first(2.0), compile_time.take_s()) == (6.0, 0.0)


def test_what_is_compiled_ahead_is_not_announced_again(caplog: pytest.LogCaptureFixture) -> None:
    compilation.compile_kernels([weight_of_some, len])
    caplog.clear()
    weight_of_some(Weights(np.ones((2, 3)), np.ones(2), np.ones(3), np.ones((2, 3)), 1.0))
    assert not caplog.records


def test_a_signature_is_read_from_annotations() -> None:
    weights = weight_of_some.fixed_signature.args[0]  # type: ignore[attr-defined]
    made = Weights(np.ones((2, 3)), np.ones(2), np.ones(3), np.ones((2, 3)), 1.0)
    assert weights == numba.typeof(made)
    signature = weight_and_mass.fixed_signature  # type: ignore[attr-defined]
    assert signature.return_type == numba.typeof((1.0, 1.0, True))
    assert signature.args == (weights, numba.int64[::1])
    assert [part.shape for part in empty_of(Weights)[:2]] == [(0, 0), (0,)]


def test_an_annotation_that_says_too_little_is_refused() -> None:
    def given(x: Array) -> float:
        return float(x[0])

    def returned(x: Vector) -> IntArray:
        return np.array([len(x)])

    def nothing(x, y: int) -> None:  # type: ignore[no-untyped-def]
        pass

    for function, what in ((given, "ndarray"), (returned, "ndarray"), (nothing, "does not annotate 'x'")):
        with pytest.raises(TypeError, match=rf"{function.__name__}\(\).*{what}"):
            kernel(function)


def test_a_call_without_a_look_at_types_does_the_same() -> None:
    random = np.random.default_rng(5)
    x, mass, gravity = random.normal(size=(4, 3)), random.uniform(size=4), random.normal(size=3)
    found = []
    for call in (add_gravity, unchecked(add_gravity)):
        gradient = np.zeros((4, 3))
        energy = call(x, mass, gravity, gradient)
        found.append((energy, gradient.tobytes()))
    assert found[0] == found[1]


def test_only_a_call_with_the_annotated_types_goes_without_a_look_at_them() -> None:
    x, mass, gravity = np.zeros((4, 3)), np.ones(4), np.ones(3)
    assert unchecked_for(add_gravity, x, mass, gravity, np.zeros((4, 3))) is unchecked(add_gravity)
    for wrong in (np.zeros((4, 3), np.float32), np.zeros((3, 4)).T, np.zeros((4, 6))[:, ::2], np.zeros(12)):
        assert unchecked_for(add_gravity, x, mass, gravity, wrong) is add_gravity
    plain = add_gravity.py_func
    assert unchecked_for(plain, x, mass, gravity, np.zeros((4, 3))) is plain
