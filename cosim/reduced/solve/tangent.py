"""The tangent of a chain of frames, as a matrix and as a factor, and the sensitivities of the tip
to loads.
"""

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.errors import ConvergenceError
from cosim.reduced.sections.assembly import factorise_tangent, solve_tangent
from cosim.reduced.sections.chain_arrays import InertiaTerm
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame


@final
@dataclass(frozen=True)
class HeldLengths:
    """Stiffness of cables with commanded length in a tangent: sum_c k_c g_c g_c^T.

    Args:
        gradient: g (c, 6 f) [1, m].
        stiffness: k (c,) [N/m].
    """

    gradient: Array
    stiffness: Array

    @property
    def matrix(self) -> Array:
        """(6 f, 6 f)."""
        return np.asarray(self.gradient.T @ (self.stiffness[:, None] * self.gradient))


@final
@dataclass(frozen=True)
class ChainPoint:
    """The state at which a tangent is computed.

    Args:
        frames: (f, 4, 3).
        loads: with tensions of all cables.
        pressure_Pa: pressure of the gas; that of a sealed gas is constant.
        lengths: stiffness of cables with commanded length, or None.
    """

    frames: Array
    loads: Loads
    pressure_Pa: float
    lengths: HeldLengths | None = None


def whole_tangent(solver: ChainSolver, at: ChainPoint, inertia: InertiaTerm | None = None) -> Array:
    """Return the tangent (6 f, 6 f) of a chain; `inertia` of an implicit step, None in statics."""
    solver.evaluate(at.frames, at.loads, at.pressure_Pa, inertia, hessian=True)
    count, work = len(at.frames), solver.work
    full = np.zeros((count, 6, count, 6))
    for f in range(count):
        full[f, :, f] = work.diagonal[f]
        if f:
            full[f, :, f - 1] = work.off[f]
            full[f - 1, :, f] = work.off[f].T
    matrix = full.reshape(6 * count, -1)
    return matrix if at.lengths is None else matrix + at.lengths.matrix


class TangentError(ValueError):
    """A tangent is not positive definite."""


@final
class ChainTangent:
    """The factorised tangent of a chain.

    Args:
        solver: of the chain.
        at: frames, loads and pressure of the tangent.
        free: (f,) frames that can move.
        inertia: of an implicit step; None in statics.

    Raises:
        TangentError: it is not positive definite at constant tensions.
    """

    def __init__(
        self, solver: ChainSolver, at: ChainPoint, free: Mask, inertia: InertiaTerm | None = None
    ) -> None:
        solver.evaluate(at.frames, at.loads, at.pressure_Pa, inertia, hessian=True)
        work = solver.work
        self._work = work._replace(low=np.zeros_like(work.low), side=np.zeros_like(work.side))
        self._free, self._lengths = free, at.lengths
        if not factorise_tangent(free, self._work):
            raise TangentError("the tangent of the chain is not positive definite")

    def solve(self, load: Array) -> Array:
        """Return the steps (k, f, 6) under loads (k, f, 6); zero where held."""
        step, lengths = np.empty(load.shape), self._lengths
        solve_tangent(self._free, self._work, np.ascontiguousarray(load), step)
        if lengths is None:
            return step
        # (K + G^T k G)^-1 = K^-1 - K^-1 G^T (1 + k G K^-1 G^T)^-1 k G K^-1
        gradient, pulled = lengths.gradient, np.empty((len(lengths.gradient), *load.shape[1:]))
        solve_tangent(self._free, self._work, gradient.reshape(pulled.shape), pulled)
        flat, gain = pulled.reshape(gradient.shape), lengths.stiffness[:, None] * gradient
        tension = np.linalg.solve(np.eye(len(gain)) + gain @ flat.T, gain @ step.reshape(len(step), -1).T)
        return np.asarray(step - (tension.T @ flat).reshape(step.shape))


@final
class ChainSensitivity:
    """Derivatives of an equilibrium's tip.

    Args:
        solver: of the chain.
        at: the equilibrium.
        free: (f,) frames that can move.

    Raises:
        ConvergenceError: the equilibrium is not stable.
    """

    def __init__(self, solver: ChainSolver, at: ChainPoint, free: Mask) -> None:
        self._solver, self._at = solver, at
        try:
            self._tangent = ChainTangent(solver, at, free)
        except TangentError as error:
            raise ConvergenceError(
                "the equilibrium is not stable (its tangent stiffness has a negative eigenvalue), so it has "
                "no useful sensitivity; change the pressure or the flange pose",
                0.0,
                0,
            ) from error
        section = solver.section
        self.tip = TipFrame.of(section.body, section.positions(at.frames, at.pressure_Pa))

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3); the flange stays."""
        gx, gy, gz = self._at.loads.gravity
        return self._motion(
            [
                replace(self._at.loads, gravity=moved)
                for moved in ((gx + 1.0, gy, gz), (gx, gy + 1.0, gz), (gx, gy, gz + 1.0))
            ]
        )

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables); the flange stays."""
        tension = self._at.loads.cable_tension_N
        if not tension:
            return np.zeros((6, 0))
        one_newton_more = [
            tuple(t + 1.0 if k == c else t for k, t in enumerate(tension)) for c in range(len(tension))
        ]
        return self._motion([replace(self._at.loads, cable_tension_N=pulled) for pulled in one_newton_more])

    def _motion(self, loads: list[Loads]) -> Array:
        """Return the tip's motion (6, k) with loads that are one unit up; the gradient is linear in them."""
        frames, pressure = self._at.frames, self._at.pressure_Pa
        gradient_at_rest = self._solver.evaluate(frames, self._at.loads, pressure)
        change = [self._solver.evaluate(frames, load, pressure) - gradient_at_rest for load in loads]
        return np.asarray(self._tangent.solve(-np.array(change))[:, -1].T)
