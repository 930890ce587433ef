"""Newton's method with exact Hessians on the potential of a soft body.

Each iteration solves (K + mu 1) d = -gradient. mu is zero while K is positive definite and grows until
the factor exists otherwise (inertia correction); the step is then halved until the potential falls
(or, for loads without a potential, the work of the
out-of-balance force along the step). A step that lets films cross at a hinge has an
infinite potential and is halved as well.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 3.4 and 3.5.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.frames import Array, Mask
from cosim.soft.body import Loads
from cosim.soft.linear_solver import BandedCholesky, GeneralLU, LinearSolver
from cosim.soft.system import Inertia, SoftSystem


class Outcome(enum.Enum):
    """How Newton's method ended, as a sentence."""

    CONVERGED = "the residual is below its bound"
    ITERATION_LIMIT = "the iteration limit was reached above the residual's bound"
    NO_DESCENT = "no step along the Newton direction lowers the potential"
    INDEFINITE = "no shift up to its bound makes the tangent positive definite"
    NOT_FINITE = "positions or forces are not finite"


@final
@dataclass(frozen=True)
class NewtonOptions:
    """Bounds of Newton's method.

    Args:
        tolerance_N: largest component of the out-of-balance force on a free node.
        iterations_max: iterations before giving up.
        shift_start_N_m: first mu tried on an indefinite tangent.
        shift_max_N_m: largest mu tried.
        halvings_max: how often a step is halved before giving up.
        step_max_m: longest nodal displacement in one iteration.
    """

    tolerance_N: float = 1e-6
    iterations_max: int = 60
    shift_start_N_m: float = 0.05
    shift_max_N_m: float = 1e8
    halvings_max: int = 30
    step_max_m: float = 0.05


@final
@dataclass(frozen=True)
class NewtonResult:
    """Where Newton's method ended.

    Args:
        positions: (n, 3) [m].
        angles: (h,) [rad], unwrapped hinge angles there.
        outcome: how it ended.
        residual_N: largest out-of-balance component on a free node.
        iterations: linear solves.
        factorisations: attempts included.
        potential_J: there, inertia included.
        shifted: iterations in which the tangent was indefinite.
    """

    positions: Array
    angles: Array
    outcome: Outcome
    residual_N: float
    iterations: int
    factorisations: int
    potential_J: float
    shifted: int

    @property
    def converged(self) -> bool:
        """Whether the residual is below its bound."""
        return self.outcome is Outcome.CONVERGED


@final
class NewtonSolver:
    """Newton's method for one body with a given set of clamped nodes; owns the factorisation.

    Args:
        system: assembled body.
        clamped: (n,) bool, nodes whose positions are given.
    """

    def __init__(self, system: SoftSystem, clamped: Mask) -> None:
        self.system = system
        self.clamped = clamped
        self.free = ~clamped
        kind: type[LinearSolver] = BandedCholesky if system.conservative else GeneralLU
        self.linear: LinearSolver = kind(system.pattern, self.free)

    def solve(
        self,
        start: Array,
        reference_angles: Array,
        loads: Loads,
        options: NewtonOptions,
        inertia: Inertia | None = None,
    ) -> NewtonResult:
        """Find the stationary point of the potential near `start`.

        Args:
            start: (n, 3) [m], clamped nodes where they shall be.
            reference_angles: (h,) [rad], unwrapped angles of the last accepted state.
            loads: pressure, tension, gravity.
            options: bounds.
            inertia: of an implicit step; None in statics.
        """
        system = self.system
        tension = system.segment_tension(start, loads)
        x, angles = np.ascontiguousarray(start), reference_angles
        energy = system.evaluate(x, loads, tension, angles, inertia=inertia, hessian=False)
        residual = self._residual()
        iterations = factorisations = shifted = 0
        while True:
            outcome = self._verdict(residual, energy, iterations, options)
            if outcome is not None:
                break
            angles = system.angles.copy()
            system.evaluate(x, loads, tension, angles, inertia=inertia)
            attempts = self._factor(options)
            factorisations += abs(attempts)
            shifted += abs(attempts) > 1
            if attempts < 0:
                outcome = Outcome.INDEFINITE
                break
            step = self.linear.solve(-system.gradient)
            iterations += 1
            found = self._search(x, step, energy, residual, loads, tension, angles, options, inertia)
            if found is None:
                system.evaluate(x, loads, tension, angles, inertia=inertia, hessian=False)
                outcome = Outcome.NO_DESCENT
                break
            x, energy, residual = found
        return NewtonResult(
            x, system.angles.copy(), outcome, residual, iterations, factorisations, energy, shifted
        )

    @staticmethod
    def _verdict(residual: float, energy: float, iterations: int, options: NewtonOptions) -> Outcome | None:
        if not (np.isfinite(residual) and np.isfinite(energy)):
            return Outcome.NOT_FINITE
        if residual < options.tolerance_N:
            return Outcome.CONVERGED
        if iterations >= options.iterations_max:
            return Outcome.ITERATION_LIMIT
        return None

    def _residual(self) -> float:
        return float(np.abs(self.system.gradient[self.free]).max(initial=0.0))

    def _factor(self, options: NewtonOptions) -> int:
        """Factorise with growing shift; return the number of attempts, negative if all failed."""
        if isinstance(self.linear, GeneralLU):
            # d(gradient)/dx gains what the missing caps take away
            self.linear.extra = self.system.open_cap_stiffness
        attempts, shift = 1, 0.0
        while not self.linear.factor(self.system.blocks, shift):
            shift = max(options.shift_start_N_m, 6.0 * shift)
            if shift > options.shift_max_N_m:
                return -attempts
            attempts += 1
        return attempts

    def _search(
        self,
        x: Array,
        step: Array,
        energy: float,
        residual: float,
        loads: Loads,
        tension: Array,
        angles: Array,
        options: NewtonOptions,
        inertia: Inertia | None,
    ) -> tuple[Array, float, float] | None:
        """Return accepted (positions, energy, residual) along the step, or None."""
        system = self.system
        longest = float(np.abs(step).max())
        slope = float(np.einsum("nr,nr->", system.gradient, step))
        factor = min(1.0, options.step_max_m / longest) if longest > 0.0 else 1.0
        # what rounding can hide in a sum of terms of this size
        rounding = 1e-13 * (1.0 + abs(energy))
        for _ in range(options.halvings_max):
            trial = x + factor * step
            trial_energy = system.evaluate(trial, loads, tension, angles, inertia=inertia, hessian=False)
            trial_residual = self._residual()
            if system.conservative:
                enough = trial_energy <= energy + 1e-4 * factor * slope + rounding
            else:
                # work of the out-of-balance force along the step (Crisfield's line search)
                work = float(np.einsum("nr,nr->", system.gradient, step))
                enough = bool(np.isfinite(trial_energy)) and abs(work) <= 0.9 * abs(slope)
            if enough or (np.isfinite(trial_energy) and trial_residual < 0.1 * residual):
                return trial, trial_energy, trial_residual
            factor *= 0.5
        return None
