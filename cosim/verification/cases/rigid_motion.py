"""Potential of a chamber: the same after a rigid motion, and consistent with its derivatives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final, get_args

import numpy as np

from cosim.base.frames import Array, rotation_from_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film, FilmLaw
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.geometry.surface import dihedral_angle, interior_hinges
from cosim.soft.solve.assembly import SoftSystem
from cosim.verification.support.case import Case, Figure, observed_order

LOADS = Loads((20e3,), (2.0, 3.0), (0.0, 0.0, 0.0))
STEPS_M = (4e-6, 2e-6)


def chamber(law: FilmLaw = "plain") -> tuple[SoftBody, Array]:
    """Return two hexagonal units with film, hinges, fold barrier, gas and cables, and a deformed shape.

    The shape is the drawn one, drawn out five times and scattered by 1 mm.
    """
    mesh = PolygonalStack(6, 2, 0.05, 0.01, 0.002, 0.95).mesh()
    body = SoftBody.from_arrays(
        mesh.positions, mesh.triangles, Film(1.3e9, 0.2, 1.1e-4, law),
        wrinkle_panel_m=mesh.face_values["wrinkle_panel_m"],
        hinge_nodes=interior_hinges(mesh.triangles, mesh.seam), hinge_stiffness=1.4e-3,
        fold_barrier_rad=0.02 * math.pi, caps=mesh.caps,
        cables=tuple(Cable(mesh.line(f"corner_{k}"), 0.8) for k in (0, 1)), node_mass=2e-3,
    )  # fmt: skip
    scatter = 1e-3 * np.random.default_rng(0).normal(size=mesh.positions.shape)
    return body, np.ascontiguousarray(mesh.positions * (1.0, 1.0, 5.0) + scatter)


def potential(system: SoftSystem, x: Array, angles: Array, *, hessian: bool = False) -> float:
    """Return the potential [J] at positions (n, 3) [m]; gradient and Hessian stay in the system."""
    return system.evaluate(x, LOADS, system.segment_share(x, LOADS), angles, hessian=hessian)


def taylor_remainder(system: SoftSystem, x: Array, angles: Array, step: float) -> float:
    """Return |F(x + d) - F(x - d) - 2 g . d| [J] for |d| = step along a random direction; it is O(step^3)."""
    direction = np.random.default_rng(1).normal(size=x.shape)
    d = step * direction / np.abs(direction).max()
    ahead, behind = potential(system, x + d, angles), potential(system, x - d, angles)
    potential(system, x, angles)
    return abs(ahead - behind - 2.0 * float((system.gradient * d).sum()))


def hessian_remainder(system: SoftSystem, x: Array, angles: Array, step: float) -> float:
    """Return max |g(x + d) - g(x - d) - 2 H d| [N]; it is O(step^3)."""
    direction = np.random.default_rng(2).normal(size=x.shape)
    d = step * direction / np.abs(direction).max()
    potential(system, x + d, angles)
    ahead = system.gradient.copy()
    potential(system, x - d, angles)
    behind = system.gradient.copy()
    potential(system, x, angles, hessian=True)
    row, column, blocks = system.pattern.row, system.pattern.column, system.blocks
    product = np.zeros_like(x)
    np.add.at(product, row, np.einsum("brc,bc->br", blocks, d[column]))
    other = row != column
    np.add.at(product, column[other], np.einsum("bcr,bc->br", blocks[other], d[row[other]]))
    return float(np.abs(ahead - behind - 2.0 * product).max())


def change_by_rigid_motion(law: FilmLaw) -> float:
    """Return the relative change of the potential when the chamber is turned and shifted."""
    body, x = chamber(law)
    system, angles = SoftSystem(body), dihedral_angle(x, body.hinges.nodes)
    rotation = rotation_from_vector(np.array([0.7, -1.1, 0.4]))
    moved = np.ascontiguousarray(x @ rotation.T + np.array([0.3, -0.2, 0.5]))
    return abs(potential(system, moved, angles) / potential(system, x, angles) - 1.0)


@final
@dataclass(frozen=True)
class RigidMotion(Case):
    """A turned and shifted chamber has the same potential; its inner forces have no resultant.

    Both hold only if every term is written in lengths and angles, if gas is closed in, and if cables pull in
    pairs. The remainders of Taylor's series fall with the cube of the step only if gradient and Hessian are
    exact.
    """

    name: ClassVar[str] = "rigid_motion"
    title: ClassVar[str] = "Invariance, balance and exact derivatives of the whole potential"
    source: ClassVar[str] = "Noether's theorem; Taylor's theorem"

    def run(self) -> tuple[Figure, ...]:
        change = max(change_by_rigid_motion(law) for law in get_args(FilmLaw))
        body, x = chamber()
        system, angles = SoftSystem(body), dihedral_angle(x, body.hinges.nodes)
        potential(system, x, angles)
        force = system.gradient
        scale = float(np.abs(force).sum())
        resultant = float(np.linalg.norm(force.sum(axis=0))) / scale
        moment = float(np.linalg.norm(np.cross(x - x.mean(axis=0), force).sum(axis=0))) / (scale * 0.05)
        gradients = [taylor_remainder(system, x, angles, step) for step in STEPS_M]
        hessians = [hessian_remainder(system, x, angles, step) for step in STEPS_M]
        return (
            Figure("change of the potential, worst film law", "1", change, 0.0, 1e-11, absolute=True),
            Figure("resultant of all forces / their sum", "1", resultant, 0.0, 1e-12, absolute=True),
            Figure("moment of all forces / (sum x radius)", "1", moment, 0.0, 1e-12, absolute=True),
            Figure(
                "order of the gradient's remainder", "1", observed_order(*gradients), 3.0, 0.15, absolute=True
            ),
            Figure(
                "order of the Hessian's remainder", "1", observed_order(*hessians), 3.0, 0.15, absolute=True
            ),
        )
