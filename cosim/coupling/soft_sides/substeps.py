"""Cutting a tick into pieces: halves of one that does not converge, the flange within it, a piece's error.

The error of an implicit step is its distance from an explicit prediction of the same order, weighted.
Implicit Euler leaves -h^2 x''/2 of the exact solution, free flight x + h v leaves +h^2 x''/2: half their
distance is the error. BDF2 leaves -2 h^3 x'''/9, the explicit x + h (3 v_n - v_n-1) / 2 leaves 5 h^3 x'''/12:
8/23 of it.
Source: Hairer, Norsett and Wanner, Solving ODEs I, section III.2 (error constants; Milne's device).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

from cosim.base.frames import Pose, rotation_from_vector, vector_from_rotation
from cosim.errors import ConvergenceError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.time_scheme import Integrator, StepAim

Drive: TypeAlias = tuple[Pose, Loads]
_HALVINGS_MAX = 5
_PIECES_MAX = 16
_SAFETY = 1.2
_RELAXED = 0.25  # of the bound: then longer pieces are tried in the next step


def step_or_halves(
    step: Callable[[Drive, Drive, float, StepAim | None], int],
    restart: Callable[[], None],
    begin: Drive,
    end: Drive,
    step_s: float,
    aim: StepAim | None,
    halvings: int = _HALVINGS_MAX,
) -> int:
    """Take one step, or two halves where it does not converge; return the Newton iterations.

    Args:
        step: takes a step between two flange poses and loads, or leaves the state as it is.
        restart: lets the next step be the first one: a two-step integrator cannot look back over a change of
            step.
        begin: flange pose and loads at the beginning.
        end: at the end.
        step_s: length [s].
        aim: what the step is asked for; None for nothing.
        halvings: how often it may be halved.

    Raises:
        ConvergenceError: not even the shortest pieces converge.
    """
    try:
        return step(begin, end, step_s, aim)
    except ConvergenceError as error:
        if halvings == 0:
            raise error.at(f"even in steps of {1e3 * step_s:.3g} ms") from None
        spent = error.iterations
    middle = (begin[0].interpolated(end[0], 0.5), begin[1].interpolated(end[1], 0.5))
    restart()
    part = None if aim is None else StepAim(aim.tolerance_N)
    for first, last in ((begin, middle), (middle, end)):
        spent += step_or_halves(step, restart, first, last, 0.5 * step_s, part, halvings - 1)
    restart()
    return spent


def pose_within(before: Pose | None, begin: Pose, end: Pose, fraction: float) -> Pose:
    """Return the pose at a fraction s of a tick: x = x0 + s d1 + s (s - 1) (d1 + d_-1) / 2; `end` at 1.

    d1 and d_-1 are the displacements from the tick's beginning to its end and to the beginning of the tick
    before, of the origin and as rotation vectors.

    Args:
        before: one tick before the tick's beginning; None: the way is straight.
        begin: at the tick's beginning.
        end: at its end.
        fraction: 0 to 1.
    """
    if before is None or fraction >= 1.0:
        return begin.interpolated(end, fraction)
    bend = 0.5 * fraction * (fraction - 1.0)
    ahead, back = end.translation - begin.translation, before.translation - begin.translation
    turn_ahead = vector_from_rotation(end.rotation @ begin.rotation.T)
    turn_back = vector_from_rotation(before.rotation @ begin.rotation.T)
    turn = fraction * turn_ahead + bend * (turn_ahead + turn_back)
    shift = fraction * ahead + bend * (ahead + back)
    return Pose(rotation_from_vector(turn) @ begin.rotation, begin.translation + shift)


def step_error(integrator: Integrator, before: SoftState, after: SoftState, step_s: float) -> float:
    """Return the largest error of a node's position made in a step [m].

    Args:
        integrator: that took the step.
        before: state at its beginning.
        after: state at its end.
        step_s: h [s].
    """
    if integrator == "implicit_euler" or before.earlier is None:
        predicted, fraction = before.positions + step_s * before.velocities, 0.5
    else:
        flight = 1.5 * before.velocities - 0.5 * before.earlier[1]
        predicted, fraction = before.positions + step_s * flight, 8.0 / 23.0
    away = after.positions - predicted
    return fraction * math.sqrt(float(np.einsum("nr,nr->n", away, away).max()))


def pieces_after(pieces: int, error_m: float, bound_m: float, order: int) -> int:
    """Return into how many pieces a step should be cut, judging by its error in so many.

    Args:
        pieces: it was cut into.
        error_m: largest of a piece.
        bound_m: that a piece shall keep.
        order: of the integrator; the error of a piece goes with its length to the power order + 1.
    """
    if error_m > bound_m:
        wanted: float = pieces * _SAFETY * (error_m / bound_m) ** (1.0 / (order + 1))
        return min(_PIECES_MAX, max(pieces + 1, math.ceil(wanted)))
    return max(1, pieces // 2) if error_m < _RELAXED * bound_m / 2.0**order else pieces
