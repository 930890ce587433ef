"""Jacobians of outputs by parameters, at equilibria of one model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.bench.outputs import Output, OutputShape, read
from cosim.bench.parameters import AnyParameter, Sides, StaticModel
from cosim.soft.solve.implicit import EquilibriumSlope, Side
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Clamp, Equilibrium


@final
class Slopes:
    """Jacobians of the same outputs by the same parameters, at any equilibria of one model.

    Args:
        parameters: of the columns.
        outputs: of the rows.
        model: that has both.
    """

    def __init__(
        self, parameters: Sequence[AnyParameter], outputs: Sequence[Output], model: StaticModel
    ) -> None:
        self._names, self._outputs = [each.name for each in parameters], outputs
        self._sides: list[Sides] = [each.sides(model) for each in parameters]

    def at(self, solver: NewtonSolver, clamp: Clamp, here: Equilibrium) -> tuple[Array, Array]:
        """Return the outputs (m,), and their Jacobian (m, parameters), at an equilibrium."""
        slopes, columns = EquilibriumSlope(solver, clamp, here), []
        for name, sides_at in zip(self._names, self._sides, strict=True):
            sides = sides_at(here, clamp)
            slope = slopes.by(sides, name)
            columns.append(
                sum(side.weight * self._read(side, slopes.moved(side, slope), here) for side in sides)
            )
        own = Side(0.0, 0.0, 0.0, solver.system, clamp, here.loads)
        found = self._read(own, (here.state.positions, slopes.gradient), here)
        return found, np.stack(columns, axis=1) if columns else np.zeros((len(found), 0))

    def _read(self, side: Side, moved: tuple[Array, Array], here: Equilibrium) -> Array:
        return read(self._outputs, OutputShape(side, *moved, here.world_from_flange))
