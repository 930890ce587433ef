"""How an equilibrium moves with its loads: the implicit function theorem.

At equilibrium gradient(x, q) = 0, so K dx/dq = -d gradient/dq, with K the exact tangent stiffness of the
free nodes. One factorisation serves all parameters.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import ConvergenceError, InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import add_segments
from cosim.soft.solve.equilibrium import Equilibrium
from cosim.soft.solve.newton import NewtonSolver

_NO_SLOTS = np.zeros((0, 0), np.int64)
_NO_BLOCKS = np.zeros((0, 3, 3))


@final
@dataclass(frozen=True)
class TipFrame:
    """Position, direction and frame of the tip ring, and how they move with the nodes.

    Args:
        position: (3,) [m], mean of the ring.
        rotation: (3, 3); the last column is the ring's unit normal, the first points to its first node.
    """

    position: Array
    rotation: Array

    @classmethod
    def of(cls, body: SoftBody, positions: Array) -> TipFrame:
        """Return the tip frame at the given node positions (n, 3) [m]."""
        center = body.tip_position(positions)
        z = body.tip_direction(positions)
        x = positions[body.tip[0]] - center
        x = x - (x @ z) * z
        x = x / np.linalg.norm(x)
        return cls(center, np.stack([x, np.cross(z, x), z], axis=1))

    @property
    def direction(self) -> Array:
        """(3,), unit normal of the ring, away from the base."""
        return np.asarray(self.rotation[:, 2])

    def motion(self, body: SoftBody, positions: Array, displacement: Array) -> Array:
        """Return the tip's (6,) displacement [m] and rotation [rad] under a nodal displacement.

        Args:
            body: whose tip it is.
            positions: (n, 3) [m].
            displacement: (n, 3) [m], infinitesimal.
        """
        ring, moved = positions[body.tip], displacement[body.tip]
        shift = moved.mean(axis=0)
        x, _, z = self.rotation.T
        area = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
        d_area = (
            np.cross(moved, np.roll(ring, -1, axis=0)) + np.cross(ring, np.roll(moved, -1, axis=0))
        ).sum(0)
        dz = (d_area - (d_area @ z) * z) / np.linalg.norm(area)
        arm, d_arm = ring[0] - self.position, moved[0] - shift
        flat = arm - (arm @ z) * z
        d_flat = d_arm - (d_arm @ z + arm @ dz) * z - (arm @ z) * dz
        dx = (d_flat - (d_flat @ x) * x) / np.linalg.norm(flat)
        # the rotation w has w x z = dz and (w x x) . (z x x) = w . z
        spin = float(dx @ np.cross(z, x))
        return np.concatenate([shift, np.cross(z, dz) + spin * z])


@final
class Sensitivity:
    """Derivatives of an equilibrium's tip; keeps the factorised tangent.

    Args:
        solver: Newton's method for the body with the clamp in force.
        equilibrium: where the derivatives are taken.

    Raises:
        ConvergenceError: the tangent is not positive definite there: the equilibrium is not stable.
    """

    def __init__(self, solver: NewtonSolver, equilibrium: Equilibrium) -> None:
        self._solver = solver
        self._equilibrium = equilibrium
        system, state, loads = solver.system, equilibrium.state, equilibrium.loads
        self._positions = state.positions
        # through the solver, which has to know that its factorisation is another one now
        if not solver.factorise(state.positions, state.angles, loads, None, np.eye(3)):
            raise ConvergenceError(
                "the equilibrium is not stable (its tangent stiffness has a negative eigenvalue), so it has "
                "no useful sensitivity; change the pressure or the flange pose",
                equilibrium.residual_N,
                0,
            )
        self.tip = TipFrame.of(system.body, state.positions)

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3) [m s^2/m, rad s^2/m]; the flange stays."""
        mass = self._solver.system.body.node_mass
        columns = []
        for axis in range(3):
            load = np.zeros_like(self._positions)
            load[:, axis] = mass
            columns.append(self._tip_motion(load))
        return np.stack(columns, axis=1)

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables) [m/N, rad/N]; the flange stays.

        Raises:
            InputError: a cable's length is commanded, so that its tension is not free.
        """
        columns = []
        if any(length is not None for length in self._equilibrium.loads.cable_length_m):
            raise InputError(
                "cable tensions are looked for while a cable's length is commanded "
                f"({self._equilibrium.loads.cable_length_m} m); command its tension first"
            )
        for cable in self._solver.system.body.cables:
            gradient = np.zeros_like(self._positions)
            ratio = cable.tension_ratio(self._positions)
            add_segments(self._positions, cable.segments, ratio, _NO_SLOTS, gradient, _NO_BLOCKS)
            columns.append(self._tip_motion(-gradient))
        return np.stack(columns, axis=1) if columns else np.zeros((6, 0))

    def _tip_motion(self, load: Array) -> Array:
        displacement = self._solver.linear.solve(load)
        return self.tip.motion(self._solver.system.body, self._positions, displacement)
