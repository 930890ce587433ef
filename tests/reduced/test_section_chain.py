"""The chain's kernels against finite differences and rigid motions, with random coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.reduced.section_model import carried
from cosim.reduced.sections.assembly import assemble
from cosim.reduced.sections.chain_arrays import ChainWork, InertiaTerm, LoadedChain
from cosim.reduced.sections.chain_shape import change_frames
from cosim.reduced.sections.coefficients import BENT, COEFFICIENTS, HIGH, LOW
from cosim.reduced.sections.pressure_spline import PressureSpline
from cosim.reduced.sections.section_energy import basis
from cosim.reduced.solve.chain_loads import nothing_touched

FRAMES = 4
SQUARE = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


class Loaded:
    """Frames with everything that acts on them."""

    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        turns = [rotation_from_vector(v) for v in random.normal(0.0, 0.2, (FRAMES, 3))]
        origins = np.array([[0.0, 0.0, 0.02 * f] for f in range(FRAMES)])
        origins += random.normal(0.0, 1e-3, origins.shape)
        self.frames = np.array([np.vstack([r, turn.T]) for r, turn in zip(origins, turns, strict=True)])
        coefficients = self.coefficients = np.zeros((FRAMES - 1, COEFFICIENTS + 3))
        self.coefficients[:, :COEFFICIENTS] = random.normal(size=(FRAMES - 1, COEFFICIENTS))
        self.coefficients[:, 17:20] *= 1e3  # shear is in metres
        self.coefficients[:, [LOW, HIGH, BENT]] = (-10.0, 10.0, 10.0)
        square = random.normal(size=(FRAMES, 4, 6))
        mass, load = square @ square.transpose(0, 2, 1), random.normal(size=(FRAMES, 4, 3))
        self.inertia_term = InertiaTerm(3.0, random.normal(0.0, 0.1, (FRAMES, 4, 3)))
        eyelets, tension = random.normal(0.0, 0.03, (FRAMES - 1, 2, 3)), random.uniform(1.0, 2.0, FRAMES - 1)
        length = np.full(FRAMES - 1, 50.0)
        cables = np.arange(1, FRAMES), eyelets, tension
        rims = np.tile(0.01 * SQUARE, (FRAMES - 1, 1, 1))
        sections = coefficients, length, np.arange(FRAMES - 1), rims
        self.chain = LoadedChain(*sections, mass, load, *cables, *nothing_touched())

    def at(self, frames: Array, *, hessian: bool = False) -> tuple[float, Array, Array]:
        """Return potential, gradient (6 f,) and Hessian (6 f, 6 f)."""
        gradient, work = np.zeros((FRAMES, 6)), ChainWork.room(FRAMES)
        x, diagonal, off = np.ascontiguousarray(frames), work.diagonal, work.off
        energy = assemble(x, self.chain, self.inertia_term, gradient, work, hessian)
        full = np.zeros((FRAMES, 6, FRAMES, 6))
        for f in range(FRAMES):
            full[f, :, f] = diagonal[f]
            if f:
                full[f, :, f - 1], full[f - 1, :, f] = off[f], off[f].T
        return energy, gradient.ravel(), full.reshape(6 * FRAMES, -1)

    def moved(self, step: Array) -> Array:
        """Return the frames after a step (6 f,)."""
        out = np.empty_like(self.frames)
        change_frames(self.frames, step.reshape(FRAMES, 6), 1.0, out)
        return out

    def without_loads(self) -> None:
        """Leave sections and cables only."""
        self.chain.load[:] = 0.0
        self.inertia_term = self.inertia_term._replace(coefficient=0.0)


def unit(k: int, size: float) -> Array:
    step = np.zeros(6 * FRAMES)
    step[k] = size
    return step


def test_the_gradient_is_that_of_the_potential() -> None:
    chain, h = Loaded(), 1e-6
    gradient = chain.at(chain.frames)[1]
    numeric = [
        (chain.at(chain.moved(unit(k, h)))[0] - chain.at(chain.moved(unit(k, -h)))[0]) / (2.0 * h)
        for k in range(6 * FRAMES)
    ]
    # central differences: truncation ~ h^2 F''' and rounding ~ 1e-16 F / h are both below 1e-7 of the largest
    assert gradient == pytest.approx(np.array(numeric), abs=1e-7 * float(np.abs(gradient).max()))


def test_the_hessian_is_that_of_the_potential() -> None:
    chain, h = Loaded(), 2e-5
    hessian = chain.at(chain.frames, hessian=True)[2]
    assert hessian == pytest.approx(hessian.T, abs=1e-12 * float(np.abs(hessian).max()))
    count = 6 * FRAMES
    for i in range(count):
        for k in range(i, count):
            corners = [
                a * b * chain.at(chain.moved(unit(i, a * h) + unit(k, b * h)))[0]
                for a in (1, -1)
                for b in (1, -1)
            ]
            numeric = sum(corners) / (4.0 * h * h)
            # rounding of second differences: 1e-16 F / h^2
            assert hessian[i, k] == pytest.approx(numeric, abs=2e-5 * float(np.abs(hessian).max()))


def test_rigid_motions_cost_nothing_and_turn_the_forces() -> None:
    chain = Loaded()
    chain.without_loads()
    energy, gradient, _ = chain.at(chain.frames)
    motion = Pose(rotation_from_vector(np.array([0.4, -1.1, 0.7])), np.array([0.3, -0.2, 0.9]))
    there, turned, _ = chain.at(carried(chain.frames, motion))
    assert there == pytest.approx(energy, rel=1e-12)
    expected = gradient.reshape(-1, 3) @ motion.rotation.T
    assert turned.reshape(-1, 3) == pytest.approx(expected, abs=1e-11 * float(np.abs(gradient).max()))


def test_inner_forces_balance() -> None:
    chain = Loaded()
    chain.without_loads()
    pull = chain.at(chain.frames)[1].reshape(FRAMES, 2, 3)
    moment = pull[:, 1] + np.cross(chain.frames[:, 0], pull[:, 0])
    scale = float(np.abs(pull).max())
    assert pull[:, 0].sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12 * scale)
    assert moment.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12 * scale)


def test_the_slopes_of_the_terms_are_theirs() -> None:
    strain, h = np.random.default_rng(3).normal(0.0, 0.1, (5, 6)), 1e-6
    strain[:, 2] += 0.25  # rims that do not overlap

    def values(x: Array) -> tuple[Array, Array]:
        value, gradient = np.zeros((5, COEFFICIENTS)), np.zeros((5, 6, COEFFICIENTS))
        basis(x, np.full(5, 10.0), 0.3 * SQUARE, value, gradient)
        return value, gradient

    gradients = values(strain)[1]
    for r in range(6):
        step = h * np.eye(6)[r]
        numeric = (values(strain + step)[0] - values(strain - step)[0]) / (2.0 * h)
        # rounding: values up to some 100, 1e-14 / h
        assert numeric == pytest.approx(gradients[:, r], rel=1e-6, abs=1e-6)


def test_beyond_its_limits_a_section_has_no_energy_to_offer() -> None:
    chain = Loaded()
    chain.coefficients[1, HIGH] = -5.0
    assert chain.at(chain.frames)[0] == np.inf


def test_only_so_many_functions_of_the_spline_are_not_zero() -> None:
    spline, table = PressureSpline(40e3, 6), np.random.default_rng(1).normal(size=(9, 5))
    value, h = np.empty(5), 1e-2
    for pressure in (-10.0, 0.5, 3.0, 999.0, 39e3, 41e3):
        basis_there = spline.basis(pressure)
        spline.fill(pressure, table, value)
        assert value == pytest.approx(basis_there[0] @ table)
        assert basis_there[0].sum() == pytest.approx(1.0)
        numeric = (spline.basis(pressure + h)[0] - spline.basis(pressure - h)[0]) @ table / (2.0 * h)
        assert basis_there[1] @ table == pytest.approx(numeric, rel=1e-4)
