"""A kernel called by its address does what it does when it is called by its name, with any numba."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import NamedTuple

import numba
import numpy as np
import pytest

from cosim.base import compilation, numba_insides
from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Indices, Matrix, Vector, nothing_of
from cosim.base.kernels import (
    RecordStore,
    address_of,
    allocating,
    device_function,
    handing_on_views,
    inlined,
    kernel,
    record_at,
    small_matrix,
    unchecked,
    zero_vector,
)
from cosim.base.numba_insides import call_native, caller, same_bits
from cosim.soft.elements.mass_terms import add_gravity
from tests.base.forked_python import run_forked

ROOT = Path(__file__).resolve().parents[2]
_add_gravity = caller(add_gravity)


class Weights(NamedTuple):
    """What the chain of kernels is given."""

    x: Matrix
    mass: Vector
    gravity: Vector
    gradient: Matrix
    scale: float


@handing_on_views
def _all_but_first(w):  # type: ignore[no-untyped-def]
    return Weights(w.x[1:], w.mass[1:], w.gravity, w.gradient[1:], w.scale)


@allocating
def _copied(vector):  # type: ignore[no-untyped-def]
    copy = np.empty(len(vector))
    copy[:] = vector
    return copy


@inlined
def _with_sign(value, of):  # type: ignore[no-untyped-def]
    sign = np.uint64(1) << np.uint64(63)
    return same_bits((same_bits(value) & ~sign) | (same_bits(of) & sign))


@device_function
def _sum(vector):  # type: ignore[no-untyped-def]
    work, total = small_matrix(2, 4), zero_vector(3)
    for i in range(len(vector)):
        work[1, i % 4] = vector[i]
        total[i % 3] += work[1, i % 4]
    return total[0] + total[1] + total[2]


@kernel
def weight_of_some(calls: Indices, weights: Weights) -> float:
    """Return the potential of all nodes but the first."""
    w = _all_but_first(weights)
    return w.scale * _add_gravity(calls[0], (w.x, w.mass, w.gravity, w.gradient))  # type: ignore[no-any-return]


_weight_of_some = caller(weight_of_some)


@kernel(reorder_sums=True, allocates=True)
def weight_and_mass(calls: Indices, weights: Weights, native: int) -> tuple[float, float, bool]:
    """Return what `weight_of_some` does, by its address, and minus the mass of the others."""
    call_native(native, calls[2], calls[3])
    mass = _sum(_copied(weights.mass[1:]))
    return _weight_of_some(calls[1], (calls, weights)), _with_sign(mass, -1.0), weights.x.shape[0] > 1


class Held(NamedTuple):
    """A record with another one in it, read where it lies."""

    calls: Indices
    weights: Weights
    several: bool


@kernel
def weight_of_held(at: int) -> tuple[float, float, bool]:
    """Return what `weight_of_some` does for a record at an address, and two of its numbers."""
    held = record_at(at, Held)
    some = _weight_of_some(held.calls[1], (held.calls, held.weights))
    return some, held.weights.scale + held.weights.mass[1], held.several


def check_records(calls: IntArray, weights: Weights) -> None:
    """Check that kernels read records at their addresses, those that have changed as well."""
    store = RecordStore(Held)
    for scale, several in ((2.0, True), (3.0, False)):
        given = weights._replace(scale=scale)
        expected = weight_of_some(calls, given)
        assert weight_of_held(store.address(Held(calls, given, several))) == (expected, scale + 1.0, several)
    shorter = weights._replace(x=weights.x[:4].copy(), mass=weights.mass[:4].copy())
    expected = weight_of_some(calls, shorter)
    assert weight_of_held(store.address(Held(calls, shorter, True)))[0] == expected
    with pytest.raises(TypeError, match="is none of"):
        store.address(Held(calls, weights._replace(x=weights.x[:, ::2]), True))
    with pytest.raises(TypeError, match="is none of"):
        store.address(Held(calls.astype(np.float64), weights, True))


def check() -> None:
    """Check the chain with the numba that is there."""
    x, mass = np.random.default_rng(1).normal(size=(5, 3)), np.arange(5.0)
    gravity, gradient, expected = np.array([0.1, 0.2, -9.81]), np.zeros((5, 3)), np.zeros((5, 3))
    called: list[tuple[int, int]] = []
    note = ctypes.CFUNCTYPE(None, ctypes.c_size_t, ctypes.c_size_t)(lambda *given: called.append(given))
    native = ctypes.cast(note, ctypes.c_void_p).value
    calls = np.array([address_of(add_gravity), address_of(weight_of_some), 7, 8])
    found = weight_and_mass(calls, Weights(x, mass, gravity, gradient, 2.0), native or 0)
    assert found == (2.0 * add_gravity(x[1:], mass[1:], gravity, expected[1:]), -10.0, True)
    assert (gradient == expected).all()
    assert gradient[1:].any()
    assert called == [(7, 8)]
    check_records(calls, Weights(x, mass, gravity, gradient, 2.0))


def test_kernels_call_others_by_their_addresses() -> None:
    assert numba_insides.KNOWN
    check()


def check_first_calls() -> None:
    """Check a kernel that is not compiled when it is called: at first it cannot be, then it is."""
    gradient = np.zeros((5, 3))
    weights = Weights(np.ones((5, 3)), np.ones(5), np.array([0.0, 0.0, -10.0]), gradient, 1.0)
    calls = np.array([address_of(add_gravity), address_of(weight_of_some), 0, 0])
    weight_of_some.compile(weight_of_some.fixed_signature)  # type: ignore[attr-defined]
    compile_modules, note = compilation.compile_modules, ctypes.CFUNCTYPE(None, *[ctypes.c_size_t] * 2)
    native = note(lambda _first, _second: None)

    def fail(*_given: object) -> None:
        raise OSError("no room")

    compilation.compile_modules = fail
    with pytest.raises(RuntimeError, match="could not be compiled"):  # two calls further in
        weight_and_mass(calls, weights, ctypes.cast(native, ctypes.c_void_p).value or 0)
    compilation.compile_modules = compile_modules
    assert not add_gravity.overloads  # type: ignore[attr-defined]
    assert weight_of_some(calls, weights) == 40.0
    assert add_gravity.overloads  # type: ignore[attr-defined]


def test_what_is_called_first_is_compiled_then_and_told(tmp_path: Path) -> None:
    code = "import tests.base.test_kernel_calls as t; t.check_first_calls()"
    done = run_forked(code, ROOT, COSIM_CACHE_DIR=str(tmp_path))
    assert done.returncode == 0, done.stderr
    assert "add_gravity() could not be compiled" in done.stderr
    assert "OSError: no room" in done.stderr
    assert "Compiling 3 kernels, once per machine" in done.stderr


def test_another_numba_does_the_same_by_their_names() -> None:
    code = (
        "import numba; numba.__version__ = '0.99.0'; from cosim.base import numba_insides;"
        "assert not numba_insides.KNOWN; import tests.base.test_kernel_calls as t; t.check();"
        "from cosim.base import compilation; "
        "[compilation.compile_modules(print, (t.weight_of_some,)) for _ in range(2)]"
    )
    done = run_forked(code, ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("numba 0.99.0 is not 0.68: kernels compile by its public functions") == 1
    assert "install numba>=0.68,<0.69" in done.stdout


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


def test_a_signature_is_read_from_annotations() -> None:
    weights = weight_of_some.fixed_signature.args[1]  # type: ignore[attr-defined]
    made = Weights(np.ones((2, 3)), np.ones(2), np.ones(3), np.ones((2, 3)), 1.0)
    assert weights == numba.typeof(made)
    signature = weight_and_mass.fixed_signature  # type: ignore[attr-defined]
    assert signature.return_type == numba.typeof((1.0, 1.0, True))
    assert signature.args == (numba.int64[::1], weights, numba.int64)
    assert [part.shape for part in nothing_of(Weights)[:2]] == [(0, 0), (0,)]


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


def test_a_run_with_nothing_to_touch_compiles_no_distances(tmp_path: Path) -> None:
    scenario = tmp_path / "hang.toml"
    scenario.write_text(
        'schema = 2\ntitle = "Hang"\nrobot = "ur5e"\nsoft_robot = "square_core"\n'
        "[start]\nflange = { position_m = [0.4, 0.0, 0.6], direction = [0.0, 0.0, -1.0] }\n"
        '[[phase]]\nname = "hang"\nduration_s = 0.01\n'
    )
    run = f"""
import cosim
from cosim.rigid.distance.signed_distance import points_near
done = cosim.run({str(scenario)!r}, error=False)
assert done.summary["status"] == "completed"
print(len(points_near.overloads))
"""
    done = run_forked(run, ROOT)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == "0"


def test_a_call_without_a_look_at_types_does_the_same() -> None:
    random = np.random.default_rng(5)
    x, mass, gravity = random.normal(size=(4, 3)), random.uniform(size=4), random.normal(size=3)
    found = []
    for call in (add_gravity, unchecked(add_gravity)):
        gradient = np.zeros((4, 3))
        energy = call(x, mass, gravity, gradient)
        found.append((energy, gradient.tobytes()))
    assert found[0] == found[1]
