"""Stiff frames: derivatives, invariance, balance, and that a framed ring keeps its shape."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from tests.derivatives import RELATIVE, Evaluate, assembled, derivative_errors
from tests.soft.bodies import hexagon_arm, no_load, random_rotation

STIFFNESS_N_m = 1e4
RADIUS_M = 0.05


def polygon(count: int, seed: int | None = None) -> Array:
    """Return points (count, 3) [m] around a circle in the plane z = 0.01, or near it."""
    angle = 2.0 * np.pi / count * np.arange(count)
    points = np.stack([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), 0.0 * angle + 0.01], axis=1)
    if seed is not None:
        points += 5e-3 * np.random.default_rng(seed).normal(size=points.shape)
    return points


def two_frames(count: int) -> tuple[FrameRings, Array, Evaluate]:
    """Return frames on two rings of interleaved nodes, deformed positions, and the evaluation."""
    drawn = np.empty((2 * count, 3))
    drawn[::2], drawn[1::2] = polygon(count), polygon(count) @ random_rotation(3).T + 0.1
    rings = np.stack([np.arange(0, 2 * count, 2)[::-1], np.arange(1, 2 * count, 2)])
    frames = FrameRings.from_shape(drawn, rings, STIFFNESS_N_m)
    x = drawn + 5e-3 * np.random.default_rng(5).normal(size=drawn.shape)
    return frames, x, assembled(frames.rings, frames.add, 2 * count)


@pytest.mark.parametrize("count", [3, 5, 6, 8, 12])
def test_derivatives(count: int) -> None:
    _, x, evaluate = two_frames(count)
    assert max(derivative_errors(evaluate, x, 1e-5)) < RELATIVE


def test_a_smaller_frame_is_stress_free_at_its_size_only() -> None:
    drawn, ratio = polygon(8), 0.98
    frame = FrameRings.from_shape(drawn, np.arange(8)[None], STIFFNESS_N_m, ratio)
    evaluate = assembled(frame.rings, frame.add, 8)
    energy, gradient, _ = evaluate(ratio * drawn @ random_rotation(4).T)
    assert energy < 1e-25 * STIFFNESS_N_m
    assert np.abs(gradient).max() < 1e-12 * STIFFNESS_N_m
    chord = 2.0 * RADIUS_M * np.sin(np.pi / 4.0)  # to the second next node
    assert evaluate(drawn)[0] == pytest.approx(4.0 * STIFFNESS_N_m * (0.02 * chord) ** 2, rel=1e-10)


def test_rigid_motion_and_balance() -> None:
    _, x, evaluate = two_frames(12)
    turn = random_rotation(2)
    energy, gradient, _ = evaluate(x)
    turned_energy, turned_gradient, _ = evaluate(x @ turn.T + (1.0, -2.0, 0.5))
    # moving by metres costs digits of deviations of millimetres
    assert turned_energy == pytest.approx(energy, rel=1e-11)
    assert turned_gradient == pytest.approx(gradient @ turn.T, abs=1e-11 * np.abs(gradient).max())
    size = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-13 * size
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-13 * size * np.abs(x).max()


@pytest.mark.parametrize("count", [3, 5, 6, 8, 12])
def test_only_rigid_motions_are_free(count: int) -> None:
    drawn = polygon(count)
    frames = FrameRings.from_shape(drawn, np.arange(count)[None], STIFFNESS_N_m)
    energy, gradient, hessian = assembled(frames.rings, frames.add, count)(drawn)
    assert energy < 1e-25 * STIFFNESS_N_m
    assert np.abs(gradient).max() < 1e-13 * STIFFNESS_N_m
    values = np.linalg.eigvalsh(hessian)
    assert np.abs(values[:6]).max() < 1e-10 * STIFFNESS_N_m
    # the weakest way to deform the ring, shear or warp, is nearly as stiff as one spring
    assert values[6] > 0.2 * STIFFNESS_N_m


def test_warping_has_the_energy_of_its_deviation() -> None:
    # A saddle: w = a cos(2 phi) is orthogonal to constants and to the plane's coordinates.
    drawn, amplitude = polygon(12), 1e-5
    frames = FrameRings.from_shape(drawn, np.arange(12)[None], STIFFNESS_N_m)
    bent = drawn.copy()
    bent[:, 2] += amplitude * np.cos(4.0 * np.pi / 12 * np.arange(12))
    energy, _, _ = assembled(frames.rings, frames.add, 12)(bent)
    # chords change by a^2 only: 1e-3 of it at the fourth power
    assert energy == pytest.approx(0.5 * STIFFNESS_N_m * 6.0 * amplitude**2, rel=1e-5)


def inflated_ring(stiffness_N_m: float | None) -> tuple[float, SoftBody, Array]:
    """Return (deviation of the outer ring from a rigid one [m], body, positions) of a unit under gas."""
    body = hexagon_arm(1)
    ring = body.rings["unit_1.outer"]
    if stiffness_N_m is not None:
        frames = FrameRings.from_shape(body.positions, ring[None], stiffness_N_m)
        body = body.with_elements(frames)
    system = FilmPotential(body)
    held = np.zeros(body.nodes, dtype=bool)
    held[body.base] = True
    solver, x, angles = NewtonSolver(system, held), body.positions, system.memory.copy()
    for pressure in np.linspace(0.0, 1e4, 11)[1:]:
        result = solver.solve(
            x, angles, no_load(body, pressure_Pa=(pressure,), gravity=(0.0, 0.0, 0.0)), NewtonOptions()
        )
        assert result.converged
        x, angles = result.positions, result.memory
    drawn, now = (p[ring] - p[ring].mean(axis=0) for p in (body.positions, x))
    u, _, vt = np.linalg.svd(drawn.T @ now)
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.linalg.norm(now - drawn @ turn, axis=1).max()), body, x


def test_a_framed_unit_keeps_its_rim_and_opens_less() -> None:
    free, body, x = inflated_ring(None)
    soft, _, _ = inflated_ring(1e6)
    stiff, framed, y = inflated_ring(1e7)
    assert free > 1e-3
    assert soft < 0.02 * free
    assert stiff == pytest.approx(0.1 * soft, rel=0.1)  # error falls with 1 / k
    assert 0.0 < framed.tip_position(y)[2] < 0.95 * body.tip_position(x)[2]


def test_a_body_without_frames_pays_nothing() -> None:
    body = hexagon_arm(2)
    rings = np.array([body.rings["unit_1.outer"], body.rings["unit_2.outer"]])
    framed = body.with_elements(FrameRings.from_shape(body.positions, rings, STIFFNESS_N_m))
    plain = FilmPotential(body).pattern.blocks
    # 12 nodes a ring: 66 pairs, of which 12 along the rim and 6 across its corners are there already
    assert FilmPotential(framed).pattern.blocks == plain + 2 * (66 - 18)


@pytest.mark.parametrize(
    ("positions", "rings", "stiffness", "message"),
    [
        (polygon(6), [[0, 1]], 1.0, r"shape \(1, 2\)"),
        (polygon(6), [[0, 1, 6]], 1.0, "node 6; there are nodes 0 to 5"),
        (polygon(6), [[0, 1, 2]], 0.0, "stiffness is 0.0"),
        (polygon(6) * [1.0, 0.0, 0.0], [range(6)], 1.0, "frame ring 0 lies on a line"),
        (polygon(4), [range(4)], 1.0, "frame ring 0 can shear"),
    ],
)
def test_impossible_frames_are_refused(
    positions: Array, rings: list[list[int]], stiffness: float, message: str
) -> None:
    with pytest.raises(MeshError, match=message):
        FrameRings.from_shape(positions, np.array([list(ring) for ring in rings]), stiffness)
