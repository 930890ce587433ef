"""Bounds of Newton's method, and how it ends."""

from __future__ import annotations

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
        tolerance_N: largest free component of the out-of-balance force, and a hundredth of its resultant.
        start_tolerance_N: the same for a start that is taken as it is, without an iteration.
        iterations_max: iterations with a new tangent before giving up.
        shift_start_N_m: first mu tried on an indefinite tangent.
        shift_max_N_m: largest mu tried.
        halvings_max: how often a step is halved before giving up.
        reuse_max: iterations per solution with a factorisation that is kept; 0 for Newton's method proper.
        reuse_below_N: residual from which on such iterations are tried: near several equilibria, those
            with new tangents decide.
        reuse_rate: such an iteration must bring the residual below this share of the last one.
        step_max_m: longest nodal displacement in one iteration.
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


@final
@dataclass(frozen=True)
class NewtonResult:
    """Where Newton's method ended.

    Args:
        positions: (n, 3) [m].
        memory: (values,), what the elements remember there.
        outcome: how it ended.
        residual_N: largest free out-of-balance component.
        iterations: linear solves, those with a kept factorisation included.
        factorisations: of new tangents, attempts included.
        potential_J: there, inertia included.
        shifted: iterations in which the tangent was indefinite.
        negative_pivots: of the tangent: directions in which the potential falls, 0 at a minimum. That of the
            last tangent on the way if it was positive definite, otherwise where it ended; None for steps in
            time, loads without a potential, and what has not converged.
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

    @property
    def converged(self) -> bool:
        """Whether the residual is below its bound."""
        return self.outcome is Outcome.CONVERGED
