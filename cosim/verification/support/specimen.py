"""A soft body held at given components, and its equilibria: what every static case needs."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask, Pose
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState
from cosim.soft.solve.time_scheme import Integrator, StepOptions

UNLOADED = Loads(gravity=(0.0, 0.0, 0.0))
"""No pressure, no weight, no forces."""

NO_CLAMP = Clamp(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3), dtype=bool))
"""Nothing follows a flange: what is held stays where it starts."""


def exact_steps(integrator: Integrator, tolerance_N: float) -> StepOptions:
    """Return options under which every time step is solved to a tolerance [N]."""
    newton = NewtonOptions(tolerance_N=tolerance_N)
    return StepOptions(
        integrator, tolerance_N=tolerance_N, iterations=20, residual_bound_N=tolerance_N, newton=newton
    )


@final
class Specimen:
    """A body whose clamped components stay where they start.

    Args:
        body: the soft body.
        clamped: (n,) or (n, 3) bool.
        options: bounds of Newton's method; steps may be as long as the body.
    """

    def __init__(self, body: SoftBody, clamped: Mask, options: NewtonOptions) -> None:
        self.body = body
        self.system = SoftSystem(body)
        self.newton = NewtonSolver(self.system, clamped)
        self.equilibria = EquilibriumSolver(self.newton, NO_CLAMP, options)

    def drawn(self, positions: Array | None = None) -> SoftState:
        """Return the drawn shape at rest, with other positions (n, 3) [m] if given."""
        state = SoftState.drawn(self.body, Pose())
        return state if positions is None else replace(state, positions=np.ascontiguousarray(positions))

    def solve(self, state: SoftState, loads: Loads) -> Equilibrium:
        """Return the equilibrium near a state."""
        return self.equilibria.solve(state, Pose(), loads)

    def follow(self, begin: Equilibrium, loads: Loads, steps: int = 1) -> Equilibrium:
        """Return the equilibrium under other loads, reached in at least `steps` equal steps."""
        here = begin
        for k in range(1, steps + 1):
            here = self.equilibria.follow(here, Pose(), begin.loads.interpolated(loads, k / steps))
        return here

    def gradient(self, equilibrium: Equilibrium) -> Array:
        """Return the gradient of the potential (n, 3) [N]: what the supports supply."""
        x, loads = equilibrium.state.positions, equilibrium.loads
        tension = self.system.segment_share(x, loads)
        self.system.evaluate(x, loads, tension, equilibrium.state.memory, hessian=False)
        return self.system.gradient.copy()

    def stable(self, equilibrium: Equilibrium) -> bool:
        """Return whether the tangent stiffness is positive definite there."""
        x, loads = equilibrium.state.positions, equilibrium.loads
        self.system.evaluate(x, loads, self.system.segment_share(x, loads), equilibrium.state.memory)
        return self.newton.linear.factor(self.system.blocks, low_rank=self.system.low_rank)

    def stiffness(self, equilibrium: Equilibrium) -> Array:
        """Return the dense tangent stiffness (3 n, 3 n) [N/m] of all components, free or not."""
        x, loads, pattern = equilibrium.state.positions, equilibrium.loads, self.system.pattern
        self.system.evaluate(x, loads, self.system.segment_share(x, loads), equilibrium.state.memory)
        dense = np.zeros((pattern.nodes, 3, pattern.nodes, 3))
        dense[pattern.row, :, pattern.column] = self.system.blocks
        dense[pattern.column, :, pattern.row] = self.system.blocks.transpose(0, 2, 1)
        matrix = dense.reshape(3 * pattern.nodes, 3 * pattern.nodes)
        if self.system.low_rank is not None:
            matrix += self.system.low_rank.matrix()
        return matrix
