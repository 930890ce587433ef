"""Solved bodies against formulas: sphere and cylinder under pressure, a cantilever that bends far."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray, Pose
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.geometry.surface import check_mesh, interior_hinges
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import SoftState
from tests.soft.bodies import FILM, held, icosphere
from tests.soft.enclosed_volume import enclosed_volume

RADIUS_M = 0.05
PRESSURE_Pa = 1000.0
ELONGATION = PRESSURE_Pa * RADIUS_M / (FILM.young_modulus_Pa * FILM.thickness_m)
"""p R / (E t), 3.5e-4: small, so that the formulas' linear theory holds to 1e-3."""
NU = FILM.poisson_ratio


def blown_up(positions: Array, triangles: IntArray, caps: tuple[IntArray, ...] = ()) -> Array:
    """Return the positions under pressure, with nothing held: the shift sees to the rigid motions."""
    body = SoftBody.from_arrays(positions, triangles, FILM, caps=caps)
    solver = NewtonSolver(SoftSystem(body), np.zeros(body.nodes, dtype=bool))
    result = solver.solve(positions, np.zeros(0), Loads((PRESSURE_Pa,), (), (0.0, 0.0, 0.0)), NewtonOptions())
    assert result.converged
    return result.positions


def sphere_ratio(levels: int) -> float:
    """Return (growth of the radius) / (p R (1 - nu) / 2 E t)."""
    x, triangles = icosphere(levels, RADIUS_M)
    growth = np.cbrt(enclosed_volume(blown_up(x, triangles), triangles) / enclosed_volume(x, triangles)) - 1.0
    return float(growth / (0.5 * (1.0 - NU) * ELONGATION))


def test_sphere() -> None:
    errors = [abs(sphere_ratio(levels) - 1.0) for levels in (1, 2, 3)]
    assert errors[-1] < 0.005
    # second order in the edge length: a quarter per level
    assert np.array(errors[1:]) / np.array(errors[:-1]) == pytest.approx(0.25, abs=0.06)


def tube(around: int, along: int, length: float) -> tuple[Array, IntArray, tuple[IntArray, IntArray]]:
    """Return positions, outward triangles and caps of a cylinder; every other ring is turned half a step."""
    rings = []
    for k in range(along + 1):
        angle = 2.0 * np.pi / around * (np.arange(around) + 0.5 * (k % 2))
        height = np.full(around, length * k / along)
        rings.append(np.stack([RADIUS_M * np.cos(angle), RADIUS_M * np.sin(angle), height], axis=1))
    triangles = []
    for k in range(along):
        low = k * around + np.arange(around)
        high, low_next, high_next = low + around, np.roll(low, -1), np.roll(low + around, -1)
        pairs = [(low, low_next, high), (low_next, high_next, high)]
        if k % 2:
            pairs = [(low, high_next, high), (low, low_next, high_next)]
        triangles += [np.stack(pair, axis=1) for pair in pairs]
    caps = (np.arange(around)[::-1], along * around + np.arange(around))
    return np.concatenate(rings), np.concatenate(triangles), caps


def cylinder_ratios(count: int) -> tuple[float, float]:
    """Return (growth of radius, of length) over (p R / E t) (1 - nu / 2, 1 / 2 - nu), in the middle."""
    length = 4.0 * RADIUS_M
    x, triangles, caps = tube(count, count, length)
    check_mesh(x, triangles)
    rings = blown_up(x, triangles, caps).reshape(count + 1, count, 3)
    middle = rings[count // 2, :, :2]
    radius = np.linalg.norm(middle - middle.mean(axis=0), axis=1).mean()
    quarter = count // 4
    span = (rings[3 * quarter, :, 2] - rings[quarter, :, 2]).mean()
    return (
        float((radius / RADIUS_M - 1.0) / ((1.0 - 0.5 * NU) * ELONGATION)),
        float((span / (0.5 * length) - 1.0) / ((0.5 - NU) * ELONGATION)),
    )


def test_closed_cylinder() -> None:
    # half the axial stretch comes from the caps' thrust: without it 1/2 - nu would be -nu
    coarse, fine = (np.abs(np.array(cylinder_ratios(count)) - 1.0) for count in (8, 24))
    assert (fine < 0.01).all()
    assert (fine < 0.2 * coarse).all()  # second order: a ninth


def cantilever(rows: int, alpha: float) -> Array:
    """Return the tip (x, drop) over the length of a strip of springs with P L^2 / E I = alpha at its end."""
    length, width, stiffness = 0.1, 0.01, 1e-4
    step = length / rows
    x = np.array([[step * k, side * width / 2, 0.0] for k in range(-1, rows + 1) for side in (-1, 1)])
    cells = 2 * np.arange(rows + 1)[:, None]
    triangles = np.concatenate([cells + np.array(corners) for corners in ((0, 2, 1), (1, 2, 3))])
    hinges = interior_hinges(triangles)
    across = hinges[:, 1] // 2 == hinges[:, 2] // 2
    # springs across the strip bend; diagonals within a row are stiff; half a row's bending sits at the root
    springs = np.where(across, stiffness / step, 1e3 * stiffness / step)
    springs[across & (hinges[:, 1] // 2 == 1)] *= 2.0
    mass = np.zeros(len(x))
    mass[-2:] = 0.5 * alpha * stiffness / length**2 / 9.81
    strip = held(
        SoftBody.from_arrays(
            x, triangles, FILM, hinge_nodes=hinges, hinge_stiffness=springs, node_mass=mass, base=np.arange(4)
        )
    )
    weightless = strip.equilibrium.solve(
        SoftState.drawn(strip.body, Pose()), Pose(), Loads(gravity=(0.0, 0.0, 0.0))
    )
    tip = strip.equilibrium.follow(weightless, Pose(), Loads()).state.positions[-2:].mean(axis=0) / length
    return np.array([tip[0], -tip[2]])


@pytest.mark.parametrize(
    ("alpha", "along", "drop"), [(0.5, 0.98408, 0.16214), (2.0, 0.83936, 0.49346), (5.0, 0.61237, 0.71379)]
)
def test_cantilever_of_bisshopp_and_drucker(alpha: float, along: float, drop: float) -> None:
    # the diagonals' give, a thousandth, stays when rows are added
    coarse, fine = (np.abs(cantilever(rows, alpha) - (along, drop)) for rows in (10, 40))
    assert (fine < 1.2e-3).all()
    assert fine[1] < 0.5 * coarse[1]
