"""Bounds and results of Newton's method."""

import enum
import math
from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array


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
        tolerance_N: largest free component of the residual, and a hundredth of its resultant.
        start_tolerance_N: the same for an initial guess that is accepted without an iteration.
        iterations_max: iterations with a new tangent before giving up.
        shift_start_N_m: first mu tried on an indefinite tangent.
        shift_max_N_m: largest mu tried.
        halvings_max: how often a step is halved before giving up.
        reuse_max: iterations per solution with a reused factorisation; 0 for the plain Newton method.
        reuse_below_N: residual below which such iterations are tried: near several equilibria, iterations
            with new tangents must decide.
        reuse_rate: such an iteration must reduce the residual to this fraction of the last one.
        step_max_m: longest nodal displacement in one iteration.
        search_iterations_max: iterations of all solutions of one search, see `SearchEffort`.
        switches_branches: whether unstable equilibria are replaced by stable ones.
        checks_stability: whether an equilibrium is checked for stability if the iterations do not show it.
    """

    tolerance_N: float = 1e-6
    start_tolerance_N: float = 1e-6
    iterations_max: int = 60
    shift_start_N_m: float = 0.05
    shift_max_N_m: float = 1e8
    halvings_max: int = 30
    step_max_m: float = 0.05
    reuse_max: int = 0
    reuse_rate: float = 0.5
    reuse_below_N: float = math.inf
    search_iterations_max: int = 3000
    switches_branches: bool = False
    checks_stability: bool = True


@final
@dataclass(frozen=True)
class NewtonResult:
    """Result of Newton's method.

    Args:
        positions: (n, 3) [m].
        memory: (values,), internal variables of the elements there.
        outcome: how it ended.
        residual_N: largest free component of the residual.
        iterations: linear solves, including those with a reused factorisation.
        factorisations: of new tangents, including failed attempts.
        potential_J: there, inertia included.
        shifted: iterations in which the tangent was indefinite.
        negative_pivots: 0 if the last tangent, one step before the end, was positive definite; None if not
            known.
        failed: factorisations that found an indefinite tangent.
    """

    positions: Array
    memory: Array
    outcome: Outcome
    residual_N: float
    iterations: int
    factorisations: int
    potential_J: float
    shifted: int
    negative_pivots: int | None = None
    failed: int = 0

    @property
    def converged(self) -> bool:
        """Whether the residual is below its bound."""
        return self.outcome is Outcome.CONVERGED
