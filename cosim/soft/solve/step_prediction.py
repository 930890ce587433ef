"""Prediction of a time step: the target of the inertia term, and the initial guess of Newton's method.

Inertia and losses of a step are a quadratic term: `inertia_weight` times the mass about the target
y = base + s / (1 + (alpha + beta) s) (speed + alpha s u), with the velocity v = (x - base) / s at the end;
see `step_scheme`. The initial guess is free flight, corrected where it would close folds.
"""

from typing import Final, NamedTuple

from cosim.base.kernel_types import IndexTable, Matrix, Vector
from cosim.base.kernels import kernel
from cosim.soft.geometry.surface import TURN

# Range of motion by acceleration in a step in which the acceleration is assumed constant. Below it, guesses
# that are accepted as solutions would repeat it for ever, so a resting body would drift. Above it, films
# flutter, and the acceleration will reverse.
_LEAST_EVEN_m, _MOST_EVEN_m = 1e-7, 1e-4
FOLD_SWEEPS: Final = 3
"""How often folds that the initial guess closes are corrected."""
_LEAST_OPEN = 0.3  # fraction of a fold's angle that free flight must leave
_STAYS = 0.9  # fraction of the angle above which a fold is not closing
_CLOSED = 1e-3  # angle over theta1 of a closed fold


class StepCoefficients(NamedTuple):
    """Coefficients of a time step.

    Args:
        two_steps: whether the scheme uses two earlier states.
        span: s [s].
        factor: s / (1 + (alpha + beta) s) [s].
        alpha_s: alpha s, weight of damping relative to the flange.
    """

    two_steps: bool
    span: float
    factor: float
    alpha_s: float


@kernel
def fill_inertia_target(
    x: Matrix,
    velocity: Matrix,
    earlier_x: Matrix,
    earlier_velocity: Matrix,
    along: Matrix,
    numbers: StepCoefficients,
    base: Matrix,
    target: Matrix,
) -> None:
    """Fill base and target (n, 3) [m] of a step from positions and velocities, now and one step earlier.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_x: one step earlier; not used by one-step schemes.
        earlier_velocity: the same.
        along: (n, 3) [m/s], u of `fill_flange_velocity`; finite, but not used without damping.
        numbers: coefficients of the step.
        base: filled.
        target: filled.
    """
    for i in range(x.shape[0]):
        for r in range(3):
            position, speed = x[i, r], velocity[i, r]
            if numbers.two_steps:
                position = (4.0 * position - earlier_x[i, r]) / 3.0
                speed = (4.0 * speed - earlier_velocity[i, r]) / 3.0
            base[i, r] = position
            target[i, r] = position + numbers.factor * (speed + numbers.alpha_s * along[i, r])


@kernel
def fill_flight(
    x: Matrix, velocity: Matrix, earlier_velocity: Matrix, h: float, fraction: float, flight: Matrix
) -> None:
    """Fill flight (n, 3) [m], positions after a step at constant acceleration, or else constant velocity.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_velocity: one step of h [s] earlier; `velocity` if that is not known.
        h: [s].
        fraction: of the step's change of velocity that moves nodes: 1/2 with BDF2, which moves them at the
            velocity in the middle of the step, 1 with implicit Euler.
        flight: filled.
    """
    largest_change = 0.0
    for i in range(x.shape[0]):
        for r in range(3):
            flight[i, r] = x[i, r] + h * velocity[i, r]
            largest_change = max(
                largest_change, abs(fraction * h * (velocity[i, r] - earlier_velocity[i, r]))
            )
    if _LEAST_EVEN_m < largest_change < _MOST_EVEN_m:
        for i in range(x.shape[0]):
            for r in range(3):
                flight[i, r] += fraction * h * (velocity[i, r] - earlier_velocity[i, r])


@kernel
def keep_folds_open(
    x: Matrix, hinges: IndexTable, theta1: float, before: Vector, angles: Vector, flight: Matrix
) -> bool:
    """Move the nodes of folds that close in free flight by their mean; return whether there are any.

    As the moment is proportional to 1 / angle, Newton's method would only double the angle per iteration.

    Args:
        x: (n, 3) [m], before the step.
        hinges: (h, 4) nodes.
        theta1: [rad], where the barrier of folds begins.
        before: (h,) [rad], their angles before the step.
        angles: (h,) [rad], in flight.
        flight: (n, 3) [m], changed.
    """
    closes = False
    for h in range(hinges.shape[0]):
        # distance in angle from the closed fold, on either side
        gap, flight_gap = min(before[h], TURN - before[h]), min(angles[h], TURN - angles[h])
        if gap > theta1 or flight_gap > _LEAST_OPEN * max(gap, _CLOSED * theta1) or flight_gap > _STAYS * gap:
            continue
        closes = True
        for r in range(3):
            move = 0.0
            for a in range(4):
                move += 0.25 * (flight[hinges[h, a], r] - x[hinges[h, a], r])
            for a in range(4):
                flight[hinges[h, a], r] = x[hinges[h, a], r] + move
    return closes
