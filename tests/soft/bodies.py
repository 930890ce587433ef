"""Small soft bodies that the tests of the soft model share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.film.film import FilmPotential
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.surface import interior_hinges
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium, SoftState

FILM = Film(1.3e9, 0.2, 0.11e-3)
WEIGHT_PER_NODE_N = 0.02
HANGING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.3, 0.0, 0.7]))
PRESSURE_Pa = 30e3


def hexagon_arm(units: int, **changes: Any) -> SoftBody:
    """Return the paper's hexagonal arm with fewer units, closed, with its two cables."""
    mesh = PolygonalStack(6, units, 0.05, 0.01, 0.002, 0.95).mesh()
    lines = (mesh.line("corner_0"), mesh.line("corner_1")) if units > 1 else ()
    given: dict[str, Any] = {
        "hinge_nodes": interior_hinges(mesh.triangles, mesh.seam),
        "hinge_stiffness": 10.0 * FILM.bending_stiffness_Nm,
        "fold_barrier_rad": 0.02 * np.pi,
        "caps": mesh.caps,
        "cables": tuple(Cable(line, 0.8) for line in lines),
        "node_mass": WEIGHT_PER_NODE_N / 9.81,
        "base": mesh.ring("unit_1.hole"),
        "tip": mesh.ring("tip"),
        "rings": mesh.rings,
    }
    body = SoftBody.from_arrays(mesh.positions, mesh.triangles, FILM, **{**given, **changes})
    return replace(body, center_rings=mesh.center_rings, frame_rings=mesh.seam_rings)


@dataclass(frozen=True)
class Held:
    """A body with its solvers, held by its base."""

    body: SoftBody
    film: FilmPotential
    clamp: Clamp
    newton: NewtonSolver
    equilibrium: EquilibriumSolver


def held(body: SoftBody, options: NewtonOptions | None = None) -> Held:
    """Return the solvers of a body held by its base."""
    system, clamp = FilmPotential(body), Clamp.of_base(body)
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    return Held(body, system, clamp, newton, EquilibriumSolver(newton, clamp, options or NewtonOptions()))


def no_load(body: SoftBody, **changes: Any) -> Loads:
    """Return gravity alone, unless told otherwise."""
    return Loads(**{"cable_tension_N": (0.0,) * len(body.cables), **changes})


def hung(arm: Held, **loads: Any) -> Equilibrium:
    """Return the equilibrium of an arm hung up first and then loaded."""
    drawn = SoftState.drawn(arm.body, HANGING)
    return arm.equilibrium.follow(
        arm.equilibrium.solve(drawn, HANGING, no_load(arm.body)), HANGING, no_load(arm.body, **loads)
    )


@cache
def inflated_positions(units: int) -> Array:
    """Return the arm's node positions (n, 3) [m] hanging under its gas."""
    positions = hung(held(hexagon_arm(units)), pressure_Pa=(PRESSURE_Pa,)).state.positions
    positions.setflags(write=False)
    return positions


def shapes(units: int) -> dict[str, Array]:
    """Return the node positions (n, 3) [m] at which derivatives are checked."""
    random = np.random.default_rng(0)
    drawn = hexagon_arm(units).positions
    scattered = drawn * (1.0, 1.0, 5.0) + 1e-3 * random.normal(size=drawn.shape)
    return {
        "random": np.ascontiguousarray(scattered),
        "nearly flat": drawn + 1e-5 * random.normal(size=drawn.shape),
        "inflated": np.array(inflated_positions(units)),
    }


def icosphere(levels: int, radius: float) -> tuple[Array, IntArray]:
    """Return positions and outward triangles of an icosahedron, refined and thrown onto a sphere."""
    golden = 0.5 * (1.0 + 5.0**0.5)
    points = [(0.0, s, t * golden) for s in (-1.0, 1.0) for t in (-1.0, 1.0)]
    x = np.array([np.roll(p, k) for k in range(3) for p in points])
    edge = 2.0 * (1.0 + 1e-9)
    near = np.linalg.norm(x[:, None] - x[None], axis=2) < edge
    found = [
        (a, b, c)
        for a in range(12)
        for b in range(a)
        for c in range(b)
        if near[a, b] and near[b, c] and near[a, c]
    ]
    triangles = [t if np.linalg.det(x[list(t)]) > 0.0 else (t[0], t[2], t[1]) for t in found]
    positions, cells = list(x), [list(t) for t in triangles]
    for _ in range(levels):
        middle: dict[tuple[int, int], int] = {}

        def between(a: int, b: int, middle: dict[tuple[int, int], int] = middle) -> int:
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(positions)
                point = positions[a] + positions[b]
                positions.append(point * np.linalg.norm(positions[a]) / np.linalg.norm(point))
            return middle[key]

        finer = []
        for a, b, c in cells:
            ab, bc, ca = between(a, b), between(b, c), between(c, a)
            finer += [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
        cells = finer
    sphere = np.array(positions)
    return radius * sphere / np.linalg.norm(sphere, axis=1)[:, None], np.array(cells)


def random_rotation(seed: int) -> Array:
    """Return a rotation (3, 3)."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return np.asarray(q * np.sign(np.linalg.det(q)))
