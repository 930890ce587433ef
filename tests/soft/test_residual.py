"""The residual of a point: its largest component, or a hundredth of the resultant where that is larger."""

from __future__ import annotations

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions

COUNT = 400
FORCE_N = 1e-3


def residual_under(force: Array) -> float:
    """Return that of a drawn strip of pairs of nodes, 1 mm apart, under dead loads (n, 3) [N]."""
    x = np.repeat(np.arange(COUNT), 2) * 1e-3
    positions = np.stack([x, np.tile([0.0, 1e-3], COUNT), np.zeros(2 * COUNT)], axis=1)
    first = 2 * np.arange(COUNT - 1)[:, None]
    triangles = np.concatenate([first + np.array([0, 2, 1]), first + np.array([1, 2, 3])])
    body = SoftBody.from_arrays(positions, triangles, Film(1e6, 0.3, 1e-4))
    solver = NewtonSolver(FilmPotential(body), np.zeros(body.nodes, dtype=bool))
    loads = Loads((), (), (0.0, 0.0, 0.0), force)
    return solver.solve(positions, body.first_memory(), loads, NewtonOptions(iterations_max=0)).residual_N


def test_a_single_force_counts_in_full() -> None:
    force = np.zeros((2 * COUNT, 3))
    force[7, 1] = FORCE_N
    assert residual_under(force) == pytest.approx(FORCE_N)


def test_forces_that_add_up_count_by_their_resultant() -> None:
    force = np.zeros((2 * COUNT, 3))
    force[:, 2] = FORCE_N
    assert residual_under(force) == pytest.approx(1e-2 * 2 * COUNT * FORCE_N)


def test_forces_that_turn_the_body_count_by_their_moment() -> None:
    # pairs of opposite forces add up to nothing; about the first node, over the distance of the farthest
    force = np.zeros((2 * COUNT, 3))
    force[:COUNT, 2], force[COUNT:, 2] = -FORCE_N, FORCE_N
    pull_m = 1e-3 * COUNT / 2.0  # between the middles of both halves
    size_m = float(np.hypot(1e-3 * (COUNT - 1), 1e-3))
    assert residual_under(force) == pytest.approx(1e-2 * COUNT * FORCE_N * pull_m / size_m)
    assert residual_under(force) > FORCE_N  # more than any component
