"""Sensitivity of an equilibrium's tip to cable tensions and gravity, by the implicit function theorem.

At equilibrium g(x, p) = 0, so K dx/dp = -dg/dp. One factorisation of the tangent K is enough.
"""

from itertools import pairwise
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import ConvergenceError, InputError
from cosim.soft.body.places import TipFrame
from cosim.soft.elements import eyelets
from cosim.soft.elements.cable import add_segments
from cosim.soft.film.inertia import Inertia
from cosim.soft.solve import newton
from cosim.soft.solve.state import Equilibrium

_NO_SLOTS = np.zeros((0, 0), np.int64)
_NO_BLOCKS = np.zeros((0, 3, 3))


def factorise_at(
    solver: newton.NewtonSolver, equilibrium: Equilibrium, inertia: Inertia | None = None
) -> None:
    """Factorise the tangent at an equilibrium, or with inertia at the end of an implicit step.

    Raises:
        ConvergenceError: it is not positive definite: the equilibrium is not stable.
    """
    # by the solver, whose stored factorisation changes
    state, frame = equilibrium.state, equilibrium.world_from_flange.rotation
    if not solver.factorise(state.positions, state.memory, equilibrium.loads, inertia, frame):
        raise ConvergenceError(
            "the equilibrium is not stable (its tangent stiffness has a negative eigenvalue), so it has "
            "no useful sensitivity; change the pressure or the flange pose",
            equilibrium.residual_N,
            0,
        )


@final
class Sensitivity:
    """Derivatives of an equilibrium's tip; keeps the factorised tangent.

    Args:
        solver: Newton's method for the body with the clamp in force.
        equilibrium: of the derivatives.

    Raises:
        ConvergenceError: the tangent is not positive definite there: the equilibrium is not stable.
    """

    def __init__(self, solver: newton.NewtonSolver, equilibrium: Equilibrium) -> None:
        self._solver = solver
        self._equilibrium = equilibrium
        self._positions = equilibrium.state.positions
        factorise_at(solver, equilibrium)
        self.tip = TipFrame.of(solver.film.body, self._positions)

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3) [m s^2/m, rad s^2/m] for a fixed flange."""
        mass = self._solver.film.body.node_mass
        columns = []
        for axis in range(3):
            load = np.zeros_like(self._positions)
            load[:, axis] = mass
            columns.append(self._tip_motion(load))
        return np.stack(columns, axis=1)

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables) [m/N, rad/N] for a fixed flange.

        A cable that has slid through an eyelet is assumed to slide on; in reverse it would stick at first.

        Raises:
            InputError: a cable's length is commanded, so that its tension is not free.
        """
        columns = []
        if any(length is not None for length in self._equilibrium.loads.cable_length_m):
            raise InputError(
                "cable tensions are looked for while a cable's length is commanded "
                f"({self._equilibrium.loads.cable_length_m} m); command its tension first"
            )
        film, equilibrium = self._solver.film, self._equilibrium
        rows = film.losses_at(self._positions, equilibrium.loads, equilibrium.state.memory)
        routes = film.eyelets.routes.tolist()
        for cable, (first, last) in zip(film.body.cables, pairwise(routes), strict=True):
            gradient, ratio = np.zeros_like(self._positions), rows[first:last, eyelets.RATIO].copy()
            add_segments(self._positions, cable.segments, ratio, _NO_SLOTS, gradient, _NO_BLOCKS)
            columns.append(self._tip_motion(-gradient))
        return np.stack(columns, axis=1) if columns else np.zeros((6, 0))

    def _tip_motion(self, load: Array) -> Array:
        displacement = self._solver.linear.solve(load)
        return self.tip.motion(self._solver.film.body, self._positions, displacement)
