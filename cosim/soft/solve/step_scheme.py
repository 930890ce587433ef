"""Time integration schemes: implicit Euler and BDF2, with the options and accuracy of their steps.

Implicit Euler:  y = x_n + h v_n,  M (x - y) / h^2 = f(x),  v = (x - x_n) / h.
BDF2, s = 2 h / 3:  a = (4 x_n - x_n-1) / 3,  y = a + s (4 v_n - v_n-1) / 3,  M (x - y) / s^2 = f(x),
v = (x - a) / s; its first step is implicit Euler.
Drag of air beta adds M beta v. Damping alpha adds M alpha (v - u), see `clamp`.
Source: Hairer and Wanner, Solving ODEs II, chapter III.1.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, final

from cosim.base.frames import Array
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.step_prediction import StepCoefficients

_CLOSE_N = 1e-5  # beam rings that are solved as in motion leave a residual of 2e-6 N
_REUSE_MAX = 30  # iterations with a reused factorisation in an accurate step
_FINE_ITERATIONS_MAX = 4  # new tangents in an accurate step, below an ordinary step's tolerance

Integrator: TypeAlias = Literal["implicit_euler", "bdf2"]


@final
@dataclass(frozen=True)
class StepOptions:
    """Options of time steps.

    Args:
        integrator: "implicit_euler" (first order, damps) or "bdf2" (second order, damps less).
        tolerance_N: residual below which a step is solved.
        iterations: new tangents of an ordinary step, in addition to iterations with a reused one.
        residual_bound_N: residual above which a step continues after those iterations; see `bound_N`.
        left_m_s2: bound of the lightest node's acceleration by the remaining residual.
        newton: bounds of the iteration.
        damping_per_s: alpha [1/s], of motion relative to the flange.
        air_drag_per_s: beta [1/s], of motion in the world.
    """

    integrator: Integrator = "implicit_euler"
    tolerance_N: float = 1e-4
    iterations: int = 1
    residual_bound_N: float = 0.1
    left_m_s2: float = 50.0
    newton: NewtonOptions = NewtonOptions(reuse_max=6)
    damping_per_s: float = 0.0
    air_drag_per_s: float = 0.0

    def bound_N(self, node_mass: Array) -> float:
        """Return the residual [N] with which an ordinary step of nodes (n,) [kg] may end.

        min(residual_bound_N, left_m_s2 times the least mass), at least `tolerance_N`.
        """
        return max(self.tolerance_N, min(self.residual_bound_N, self.left_m_s2 * float(node_mass.min())))

    @property
    def losses_per_s(self) -> float:
        """Rate alpha + beta [1/s] at which motion is damped while the flange rests."""
        return self.damping_per_s + self.air_drag_per_s

    @property
    def whole(self) -> NewtonOptions:
        """Bounds of the iteration of an ordinary step that is solved to its tolerance."""
        return replace(self.newton, tolerance_N=self.tolerance_N)

    @property
    def closely(self) -> bool:
        """Whether internal solutions of elements, as of beam rings, are as accurate as in statics."""
        return self.tolerance_N < _CLOSE_N

    def coefficients(self, step_s: float, *, first: bool = False) -> StepCoefficients:
        """Return the coefficients of a step.

        Args:
            step_s: h [s].
            first: whether there is no step before it.
        """
        two_steps = self.integrator == "bdf2" and not first
        span = 2.0 * step_s / 3.0 if two_steps else step_s
        factor = span / (1.0 + self.losses_per_s * span)
        return StepCoefficients(two_steps, span, factor, self.damping_per_s * span)

    @property
    def gain(self) -> float:
        """Fraction of a step's gain in velocity that moves the nodes; BDF2 moves them with half of it."""
        return 0.5 if self.integrator == "bdf2" else 1.0


def inertia_weight(span: float, losses_per_s: float) -> float:
    """Return (1 + c s) / s^2 [1/s^2], the stiffness of a step's inertia and losses, per mass.

    Args:
        span: s [s], see `StepCoefficients`.
        losses_per_s: c [1/s]: alpha + beta of single nodes, beta of the body as one.
    """
    return (1.0 + losses_per_s * span) / span**2


def mode_decay(
    integrator: Integrator, step_s: float, losses_per_s: float, frequency_Hz: float, own_per_s: float = 0.0
) -> tuple[float, float]:
    """Return the decay [1/s] of a natural mode by its losses, and the numerical decay that steps add.

    The mode's complex eigenvalue is l = -c / 2 + i sqrt(w^2 - c^2 / 4). Steps multiply it by z:
    1 / (1 - l h) with implicit Euler, the larger root of (3/2 - l h) z^2 - 2 z + 1/2 = 0 with BDF2.

    Args:
        integrator: of the steps.
        step_s: h [s].
        losses_per_s: c, see `StepOptions`.
        frequency_Hz: w / 2 pi, without losses.
        own_per_s: losses of the mode's materials, added to c; see `StabilityReport`.
    """
    half = 0.5 * (losses_per_s + own_per_s)
    eigenvalue = -half + cmath.sqrt(half**2 - (2.0 * math.pi * frequency_Hz) ** 2)
    product = eigenvalue * step_s
    if integrator == "bdf2":
        factor = (2.0 + cmath.sqrt(1.0 + 2.0 * product)) / (3.0 - 2.0 * product)
    else:
        factor = 1.0 / (1.0 - product)
    return -eigenvalue.real, eigenvalue.real - math.log(abs(factor)) / step_s


@final
@dataclass(frozen=True)
class StepScheme:
    """Data that the steps of one length have in common.

    Args:
        coefficients: of the scheme.
        inertia: (n,) [N/m], stiffness of the inertia term of each node.
        kind: a number that identifies tangents with this inertia term.
    """

    coefficients: StepCoefficients
    inertia: Array
    kind: float

    @classmethod
    def of(cls, coefficients: StepCoefficients, options: StepOptions, mass: Array) -> StepScheme:
        """Return the scheme of steps with these coefficients, under some losses, of nodes (n,) [kg]."""
        inertia = mass * inertia_weight(coefficients.span, options.losses_per_s)
        return cls(coefficients, inertia, float(inertia.sum()))


@final
@dataclass(frozen=True)
class StepAccuracy:
    """Accuracy and initial guess of a step that is repeated.

    Args:
        tolerance_N: residual below which a step is solved.
        start: (n, 3) [m], result of an earlier trial of the same step; None for the first.
    """

    tolerance_N: float
    start: Array | None = None

    def newton(self, options: StepOptions) -> tuple[NewtonOptions, NewtonOptions]:
        """Return the bounds of Newton's method up to an ordinary step's tolerance, and below it.

        Below it few new tangents are factorised: if films buckle, the tangent is shifted and gains little.
        """
        coarse = max(self.tolerance_N, options.tolerance_N)
        bounds, fine = replace(options.newton, reuse_max=_REUSE_MAX), self.tolerance_N
        return (
            replace(bounds, tolerance_N=coarse, start_tolerance_N=coarse),
            replace(bounds, tolerance_N=fine, start_tolerance_N=fine, iterations_max=_FINE_ITERATIONS_MAX),
        )
