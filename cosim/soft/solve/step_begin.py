"""How a step begins, in kernels: the elastic bed that inertia is, and where Newton's method starts.

The formulas are those of `state`: inertia and damping are a bed of `inertia_weight` times the mass
about the target y = base + s / (1 + (alpha + beta) s) (speed + alpha s u), from which the nodes move by
v = (x - base) / s.
"""

from typing import Final, NamedTuple

from cosim.base.kernel_types import IndexTable, Matrix, Vector
from cosim.base.kernels import kernel
from cosim.soft.geometry.surface import TURN

# An acceleration is taken to stay where it moves nodes by so much in a step. Below, starts that are near
# enough would carry it on for ever: a resting body would wander. Above, films flutter: it will turn round.
_LEAST_EVEN_m, _MOST_EVEN_m = 1e-7, 1e-4
FOLD_SWEEPS: Final = 3
"""How often the folds that a start closes are looked for again."""
_LEAST_OPEN = 0.3  # of a fold's angle that free flight may leave
_STAYS = 0.9  # of its angle: a fold that is left so much is not being closed
_CLOSED = 1e-3  # of theta1: a fold may be closed further than this


class BedNumbers(NamedTuple):
    """Numbers of the bed that inertia and losses are in a step.

    Args:
        two_steps: whether the step looks back over two.
        span: s [s].
        factor: s / (1 + (alpha + beta) s) [s].
        share: alpha s, of the flange's motion in that of a node.
    """

    two_steps: bool
    span: float
    factor: float
    share: float


@kernel
def fill_bed(
    x: Matrix,
    velocity: Matrix,
    earlier_x: Matrix,
    earlier_velocity: Matrix,
    along: Matrix,
    numbers: BedNumbers,
    base: Matrix,
    target: Matrix,
) -> None:
    """Fill base and target (n, 3) [m] of a step from positions and velocities, now and one step earlier.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_x: one step earlier; of one step alone: anything.
        earlier_velocity: the same.
        along: (n, 3) [m/s], u of `follow_flange`; without damping: anything finite.
        numbers: of the step.
        base: filled.
        target: filled.
    """
    for i in range(x.shape[0]):
        for r in range(3):
            place, speed = x[i, r], velocity[i, r]
            if numbers.two_steps:
                place = (4.0 * place - earlier_x[i, r]) / 3.0
                speed = (4.0 * speed - earlier_velocity[i, r]) / 3.0
            base[i, r] = place
            target[i, r] = place + numbers.factor * (speed + numbers.share * along[i, r])


@kernel
def fill_flight(
    x: Matrix, velocity: Matrix, earlier_velocity: Matrix, h: float, fraction: float, flight: Matrix
) -> None:
    """Fill flight (n, 3) [m]: where nodes get if their acceleration stays, or their velocity where it won't.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_velocity: one step of h [s] earlier; where that is not known, `velocity`.
        h: [s].
        fraction: of the step's gain in velocity that moves them: 1/2 with BDF2, which moves them with the
            velocity in the middle of the step, 1 with implicit Euler.
        flight: filled.
    """
    most = 0.0
    for i in range(x.shape[0]):
        for r in range(3):
            flight[i, r] = x[i, r] + h * velocity[i, r]
            most = max(most, abs(fraction * h * (velocity[i, r] - earlier_velocity[i, r])))
    if _LEAST_EVEN_m < most < _MOST_EVEN_m:
        for i in range(x.shape[0]):
            for r in range(3):
                flight[i, r] += fraction * h * (velocity[i, r] - earlier_velocity[i, r])


@kernel
def keep_folds_open(
    x: Matrix, hinges: IndexTable, theta1: float, before: Vector, angles: Vector, flight: Matrix
) -> bool:
    """Let the nodes of folds that close in free flight move as one; return whether there are any.

    From a closed fold Newton's method doubles the angle per iteration, as the moment goes with 1 / angle.

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
        # how far from where its films meet, whichever way it folds
        gap, left = min(before[h], TURN - before[h]), min(angles[h], TURN - angles[h])
        if gap > theta1 or left > _LEAST_OPEN * max(gap, _CLOSED * theta1) or left > _STAYS * gap:
            continue
        closes = True
        for r in range(3):
            move = 0.0
            for a in range(4):
                move += 0.25 * (flight[hinges[h, a], r] - x[hinges[h, a], r])
            for a in range(4):
                flight[hinges[h, a], r] = x[hinges[h, a], r] + move
    return closes
