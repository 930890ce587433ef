"""One implicit step of a body as a matrix, about a shape at rest, in any coordinates z (m,) of its motion.

Some of z are held by the flange. With the scheme of `step_scheme`, base and speed from the last one or two
states, and the target y = base + s / (1 + (alpha + beta) s) (speed + alpha s u) of inertia, the free ones end
at

    (K + D / s + c M) z' = c M y + D base / s - G du - (held columns) R df,     rate' = (z' - base) / s,

with K the tangent including sealed gas and commanded lengths, M the mass, D the viscous losses of materials,
R df the held coordinates on the moved flange, and G the gradient's derivative by pressures and tensions. At
rest a point and its target coincide, so inertia has no geometric stiffness. Losses along cables are frozen.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.soft.solve.step_prediction import StepCoefficients

LoadName: TypeAlias = tuple[str, int]


@final
@dataclass(frozen=True)
class LinearStep:
    """A linearised step of a body.

    The state is z, its rate and, with two-step integrators, both one step before.

    Args:
        matrix: (states + 18, states + 6 + loads). Columns: the state, the flange's motion (dr, phi) up to the
            end, the loads at the end. Rows: the next state, then wrench on the flange, centre and inertia.
        loads: name and index of chamber or cable of each: ("pressure_Pa", 0), ("cable_tension_N", 1).
        tip: (3, m + loads), the tip's position by z and loads at the same instant.
        nodes: (n, 3, m), the film's nodes by z.
    """

    matrix: Array
    loads: tuple[LoadName, ...]
    tip: Array
    nodes: Array

    @property
    def states(self) -> int:
        """Number of states."""
        return self.matrix.shape[1] - 6 - len(self.loads)


@final
@dataclass(frozen=True)
class RestingBody:
    """A linearised body at rest, in coordinates z (m,).

    Args:
        stiffness: K (m, m).
        mass: M (m, m).
        losses: D (m, m), of materials.
        carried: R (m, 6): z of a body that moves with the flange.
        slopes: G (m, loads).
        held: (m,), which coordinates the flange holds.
        supplied: gradient (m, columns), and z (m, columns) -> change (6, columns) of the flange's reaction.
        moments: (12, m), centre and inertia of the mass by z.
        loads: see `LinearStep`.
        tip: see `LinearStep`.
        nodes: see `LinearStep`.
    """

    stiffness: Array
    mass: Array
    losses: Array
    carried: Array
    slopes: Array
    held: Mask
    supplied: Callable[[Array, Array], Array]
    moments: Array
    loads: tuple[LoadName, ...]
    tip: Array
    nodes: Array

    def linear_step(self, coefficients: StepCoefficients) -> LinearStep:
        """Return the step.

        Args:
            coefficients: of the step.
        """
        size, carried, held, span = len(self.held), self.carried, self.held, coefficients.span
        count = size * (4 if coefficients.two_steps else 2)
        columns = np.eye(count + 6 + len(self.loads))
        begin = [columns[k * size : (k + 1) * size] for k in range(count // size)]
        flange, loads = columns[count : count + 6], columns[count + 6 :]
        flange_from_held = np.linalg.pinv(carried[held])  # motion of the flange from the held coordinates
        base, speed = begin[0], begin[1]
        rigid_velocity = carried @ (flange - flange_from_held @ begin[0][held]) / span
        if coefficients.two_steps:
            base, speed = (
                (4.0 * last - first) / 3.0 for last, first in ((base, begin[2]), (speed, begin[3]))
            )
            rigid_velocity = (
                4.0 * rigid_velocity - carried @ (flange - flange_from_held @ begin[2][held]) / span
            ) / 3.0
        target = base + coefficients.factor * (speed + coefficients.alpha_s * rigid_velocity)
        inertia, losses = self.mass / (coefficients.factor * span), self.losses / span
        tangent = self.stiffness + losses + inertia
        end, rest = carried @ flange, self.slopes @ loads - inertia @ target - losses @ base
        pushed = tangent[np.ix_(~held, held)] @ end[held] + rest[~held]
        end[~held] = -np.linalg.solve(tangent[np.ix_(~held, ~held)], pushed)
        rate = (end - base) / span
        dragged = coefficients.alpha_s / span * (carried.T @ (self.mass @ (rate - rigid_velocity)))
        wrench = dragged - self.supplied(tangent @ end + rest, end)
        rows = np.concatenate([end, rate, *begin[:2]])[:count]
        matrix = np.concatenate([rows, wrench, self.moments @ end])
        return LinearStep(matrix, self.loads, self.tip, self.nodes)
