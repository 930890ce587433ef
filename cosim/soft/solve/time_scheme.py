"""Time schemes: what a step makes of positions and velocities, and how closely it is solved.

Implicit Euler:  y = x_n + h v_n,  M (x - y) / h^2 = f(x),  v = (x - x_n) / h.
BDF2, s = 2 h / 3:  a = (4 x_n - x_n-1) / 3,  y = a + s (4 v_n - v_n-1) / 3,  M (x - y) / s^2 = f(x),
v = (x - a) / s; its first step is implicit Euler.
Mass-proportional damping alpha adds M alpha v. Source: Hairer and Wanner, Solving ODEs II, chapter III.1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, final

from cosim.base.frames import Array
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import SoftState

_CLOSE_N = 1e-5  # rings of beams that end their search as in motion leave 2e-6 N
_REUSE_MAX = 30  # iterations with a kept factorisation in a step that is solved closely
_FINE_ITERATIONS_MAX = 4  # new tangents in it below an ordinary step's tolerance

Integrator: TypeAlias = Literal["implicit_euler", "bdf2"]


@final
@dataclass(frozen=True)
class StepOptions:
    """How a time step is solved.

    Args:
        integrator: "implicit_euler" (first order, damps) or "bdf2" (second order, damps less).
        tolerance_N: a step whose residual is below this is done.
        iterations: new tangents of an ordinary step, besides iterations with a kept one.
        residual_bound_N: a step whose residual is above this after them goes on iterating.
        newton: bounds of the iteration.
        damping_per_s: alpha [1/s].
        substep_error_m: a step whose error is larger is cut into pieces; None: never (see `step_error`).
    """

    integrator: Integrator = "implicit_euler"
    tolerance_N: float = 1e-4
    iterations: int = 1
    residual_bound_N: float = 0.1
    newton: NewtonOptions = NewtonOptions(reuse_max=6)
    damping_per_s: float = 0.0
    substep_error_m: float | None = None

    @property
    def whole(self) -> NewtonOptions:
        """Bounds of the iteration of an ordinary step until it is solved."""
        return replace(self.newton, tolerance_N=self.tolerance_N)

    @property
    def closely(self) -> bool:
        """Whether what elements find by themselves is to be found as in statics."""
        return self.tolerance_N < _CLOSE_N

    @property
    def gain(self) -> float:
        """Fraction of a step's gain in velocity that moves the nodes; BDF2 moves them with half of it."""
        return 0.5 if self.integrator == "bdf2" else 1.0


def difference_scheme(integrator: Integrator, state: SoftState, h: float) -> tuple[bool, float]:
    """Return whether the next step looks back over two, and its span s; see `fill_bed`.

    Args:
        integrator: see the module's text.
        state: at the beginning of the step.
        h: its length [s].
    """
    two_steps = integrator == "bdf2" and state.earlier is not None
    return two_steps, 2.0 * h / 3.0 if two_steps else h


def inertia_weight(span: float, damping_per_s: float) -> float:
    """Return (1 + alpha s) / s^2 [1/s^2]: what a step's inertia and damping add to the stiffness, per mass.

    Args:
        span: s [s], of `difference_scheme`.
        damping_per_s: alpha [1/s].
    """
    return (1.0 + damping_per_s * span) / span**2


@final
@dataclass(frozen=True)
class StepScheme:
    """What the steps of one length have in common.

    Args:
        two_steps: whether they look back over two.
        span: s [s].
        factor: s / (1 + alpha s) [s].
        inertia: (n,) [N/m], coefficient of the bed that inertia is.
        kind: tells apart tangents of different beds.
    """

    two_steps: bool
    span: float
    factor: float
    inertia: Array
    kind: float

    @classmethod
    def of(cls, two_steps: bool, span: float, damping_per_s: float, mass: Array) -> StepScheme:
        """Return the scheme of steps with a span, under a damping, of nodes (n,) [kg]."""
        inertia = mass * inertia_weight(span, damping_per_s)
        return cls(two_steps, span, span / (1.0 + damping_per_s * span), inertia, float(inertia.sum()))


@final
@dataclass(frozen=True)
class StepAim:
    """How closely a step is solved that is taken again and again.

    Args:
        tolerance_N: a step whose residual is below this is done.
        start: (n, 3) [m], where an earlier try of the same step ended; None for the first.
    """

    tolerance_N: float
    start: Array | None = None

    def newton(self, options: StepOptions) -> tuple[NewtonOptions, NewtonOptions]:
        """Return the bounds of Newton's method up to an ordinary step's tolerance, and beyond it.

        Beyond, few new tangents are spent: where films buckle, the tangent is shifted and gains little.
        """
        coarse = max(self.tolerance_N, options.tolerance_N)
        given, fine = replace(options.newton, reuse_max=_REUSE_MAX), self.tolerance_N
        return (
            replace(given, tolerance_N=coarse, start_tolerance_N=coarse),
            replace(given, tolerance_N=fine, start_tolerance_N=fine, iterations_max=_FINE_ITERATIONS_MAX),
        )
