"""How an equilibrium moves with its loads: the implicit function theorem.

At equilibrium gradient(x, q) = 0, so K dx/dq = -d gradient/dq, with K the exact tangent stiffness of the
free nodes. One factorisation serves all parameters.
"""

from __future__ import annotations

from itertools import pairwise
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import InputError
from cosim.soft.body.places import TipFrame
from cosim.soft.elements.cable import add_segments
from cosim.soft.elements.eyelets import RATIO
from cosim.soft.solve.implicit import factorise_at
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Equilibrium

_NO_SLOTS = np.zeros((0, 0), np.int64)
_NO_BLOCKS = np.zeros((0, 3, 3))


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
        self._positions = equilibrium.state.positions
        factorise_at(solver, equilibrium)
        self.tip = TipFrame.of(solver.system.body, self._positions)

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

        Where a cable has slid through an eyelet, it is taken to slide on; back, it would stick at first.

        Raises:
            InputError: a cable's length is commanded, so that its tension is not free.
        """
        columns = []
        if any(length is not None for length in self._equilibrium.loads.cable_length_m):
            raise InputError(
                "cable tensions are looked for while a cable's length is commanded "
                f"({self._equilibrium.loads.cable_length_m} m); command its tension first"
            )
        system, here = self._solver.system, self._equilibrium
        rows = system.segment_share(self._positions, here.loads, here.state.memory)
        routes = system.film.eyelets.routes.tolist()
        for cable, (first, last) in zip(system.body.cables, pairwise(routes), strict=True):
            gradient, ratio = np.zeros_like(self._positions), rows[first:last, RATIO].copy()
            add_segments(self._positions, cable.segments, ratio, _NO_SLOTS, gradient, _NO_BLOCKS)
            columns.append(self._tip_motion(-gradient))
        return np.stack(columns, axis=1) if columns else np.zeros((6, 0))

    def _tip_motion(self, load: Array) -> Array:
        displacement = self._solver.linear.solve(load)
        return self.tip.motion(self._solver.system.body, self._positions, displacement)
