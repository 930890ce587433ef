"""Film triangles: derivatives, rigid motions, closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.elements.membrane import Membranes
from cosim.soft.film.film import FilmPotential
from tests.derivatives import RELATIVE, Evaluate, dense, derivative_errors
from tests.soft.bodies import FILM, hexagon_arm, random_rotation, shapes

UNITS = 2
ONE = np.array([[0, 1, 2]])
STEP_M = 5e-6
"""A thousandth of the shortest edges. The energy is a quartic polynomial, so only rounding is left."""


def evaluation(drawn: Array, triangles: IntArray) -> Evaluate:
    """Return the evaluation of a body that is nothing but film."""
    system = FilmPotential(SoftBody.from_arrays(drawn, triangles, FILM))
    nothing = Loads((), (), (0.0, 0.0, 0.0))

    def evaluate(x: Array) -> tuple[float, Array, Array]:
        energy = system.evaluate(np.ascontiguousarray(x), nothing, np.zeros(0), np.zeros(0))
        return energy, system.gradient.copy(), dense(system.pattern, system.blocks)

    return evaluate


@pytest.mark.parametrize("shape", ["random", "nearly flat", "inflated"])
def test_derivatives_of_every_triangle(shape: str) -> None:
    x, body, random = shapes(UNITS)[shape], hexagon_arm(UNITS), np.random.default_rng(1)
    for triangle in body.triangles:
        order = random.permutation(3)  # alone, with its three nodes numbered anyhow
        nodes = np.empty(3, dtype=np.int64)
        nodes[order] = triangle
        evaluate = evaluation(body.positions[nodes], order[None])
        assert max(derivative_errors(evaluate, x[nodes], STEP_M)) < RELATIVE, triangle


def test_rigid_motion_changes_nothing_but_the_axes() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    evaluate, turn = evaluation(body.positions, body.triangles), random_rotation(2)
    energy, gradient, _ = evaluate(x)
    turned_energy, turned_gradient, _ = evaluate(x @ turn.T + (1.0, -2.0, 0.5))
    # moving by metres costs digits of strains of 1e-2 on edges of 1e-2 m
    assert turned_energy == pytest.approx(energy, rel=1e-11)
    assert turned_gradient == pytest.approx(gradient @ turn.T, abs=1e-11 * np.abs(gradient).max())


def test_film_forces_balance() -> None:
    x, body = shapes(UNITS)["random"], hexagon_arm(UNITS)
    _, gradient, _ = evaluation(body.positions, body.triangles)(x)
    size = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-14 * size
    assert np.abs(np.cross(x, gradient).sum(axis=0)).max() < 1e-14 * size * np.abs(x).max()


@pytest.mark.parametrize("angle", [0.0, 0.4, 2.0])
def test_one_triangle_in_uniaxial_tension(angle: float) -> None:
    # Stretched by s along u and by r across, r^2 = 1 - nu (s^2 - 1), the lateral stress vanishes, so
    # W = E t A ((s^2 - 1) / 2)^2 / 2; the triangle lies askew in space and to u.
    drawn = np.array([[0.0, 0.0, 0.0], [0.03, 0.004, 0.0], [0.007, 0.02, 0.0]]) @ random_rotation(3).T
    membranes = Membranes.from_shape(drawn, ONE, FILM)
    e1 = (drawn[1] - drawn[0]) / np.linalg.norm(drawn[1] - drawn[0])
    normal = np.cross(drawn[1] - drawn[0], drawn[2] - drawn[0])
    area = 0.5 * float(np.linalg.norm(normal))
    e2 = np.cross(normal / (2.0 * area), e1)
    along = np.cos(angle) * e1 + np.sin(angle) * e2
    across = np.cos(angle) * e2 - np.sin(angle) * e1
    stretch = 1.02
    strain = 0.5 * (stretch**2 - 1.0)
    narrowing = np.sqrt(1.0 - 2.0 * FILM.poisson_ratio * strain)
    x = np.outer(drawn @ along, stretch * along) + np.outer(drawn @ across, narrowing * across)
    energy, gradient, _ = evaluation(drawn, ONE)(x)
    assert energy == pytest.approx(
        0.5 * FILM.young_modulus_Pa * FILM.thickness_m * area * strain**2, rel=1e-12
    )
    # virtual work of stretching by ds along u alone: dW/ds = E t A strain s
    assert np.einsum("nr,nr->", gradient, np.outer(drawn @ along, along)) == pytest.approx(
        FILM.young_modulus_Pa * FILM.thickness_m * area * strain * stretch, rel=1e-12
    )
    assert gradient @ across == pytest.approx(np.zeros(3), abs=1e-9)  # no stress across; forces near 30 N
    first, second = membranes.principal_stress(x)[0]
    assert first == pytest.approx(FILM.young_modulus_Pa * strain, rel=1e-12)
    assert second == pytest.approx(0.0, abs=1e-6 * first)


def test_shear_stores_the_energy_of_the_shear_modulus() -> None:
    drawn = np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0], [0.0, 0.01, 0.0]])
    gamma = 1e-3
    lean = np.array([[1.0, gamma, 0.0], [0.0, np.sqrt(1.0 - gamma**2), 0.0], [0.0, 0.0, 1.0]])
    energy, _, _ = evaluation(drawn, ONE)(drawn @ lean.T)
    modulus = FILM.young_modulus_Pa / (2.0 * (1.0 + FILM.poisson_ratio))
    assert energy == pytest.approx(0.5 * modulus * FILM.thickness_m * 0.5e-4 * gamma**2, rel=1e-9)


def test_a_sheared_patch_is_uniform() -> None:
    # constant-strain patch test over triangles of every shape and node order
    body, random = hexagon_arm(1), np.random.default_rng(4)
    flat = body.positions * (1.0, 1.0, 0.0)
    flat += random.normal(size=flat.shape) * (1e-3, 1e-3, 0.0)
    membranes = Membranes.from_shape(flat, body.triangles, FILM)
    stretched = flat @ np.array([[1.01, 0.004, 0.0], [0.0, 0.99, 0.0], [0.0, 0.0, 1.0]]).T
    stress = membranes.principal_stress(stretched)
    assert np.ptp(stress, axis=0) == pytest.approx([0.0, 0.0], abs=1e-9 * stress.max())


def test_drawn_shape_is_free_of_stress() -> None:
    body = hexagon_arm(UNITS)
    # rounding of coordinates near 0.05 m on edges near 1 mm
    assert body.strain(body.positions) == pytest.approx(0.0, abs=1e-13)


def test_bending_stiffness_is_the_papers() -> None:
    assert Film(1.3e9, 0.2, 0.11e-3).bending_stiffness_Nm == pytest.approx(1.4419e-4, rel=1e-4)


def test_a_triangle_without_area_is_named() -> None:
    line = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [2.0, 0.0, 0.0]])
    with pytest.raises(MeshError, match=r"triangle 1 \(nodes \[0, 1, 3\]\)"):
        Membranes.from_shape(line, np.array([[0, 1, 2], [0, 1, 3]]), FILM)
