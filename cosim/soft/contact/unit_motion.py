"""Relative motion of a film's units, which bounds how long neighbour lists stay valid.

Relative to one unit, rotated and moved by the mean motion of its nodes, another unit may have moved a little
only, although the film has been carried far; see `rigid_motion`.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, Indices, Masks, Matrix, Vector
from cosim.base.kernels import copy_rows, device_function, kernel, small_matrix, zero_matrix
from cosim.soft.contact import rigid_motion
from cosim.soft.contact.self_contact_candidates import square_between

_FITTED = 24  # smallest number of nodes to which a rigid motion is fitted


class Units(NamedTuple):
    """Nodes of a film's units, and the motion of units.

    Args:
        nodes: of all units.
        start: (u + 1,), start of each unit's nodes.
        deviation: (u,) [m], of each unit from its rigid motion; scratch.
        relative: (u, u) [m], relative motion of two units, in the upper triangle.
        rigid: (u, 5, 3), mean now and before of each unit, and its rotation in between; scratch.
    """

    nodes: Indices
    start: Indices
    deviation: Vector
    relative: Matrix
    rigid: Blocks


class Allowance(NamedTuple):
    """Relative motion of units up to which a list, or another result, stays valid.

    Args:
        before: (n, 3) [m], nodes at the time of the result.
        radius: (u,) [m], of each unit at that time.
        allowed: (u, u) [m], largest relative motion of two units since then; symmetric.
    """

    before: Matrix
    radius: Vector
    allowed: Matrix

    @classmethod
    def empty(cls, nodes: int, units: int) -> "Allowance":
        """Return allocated arrays for a film, given its numbers of nodes and units."""
        return cls(np.zeros((nodes, 3)), np.empty(units), np.empty((units, units)))


@device_function
def _fitted(start: Indices, unit: int) -> tuple[int, int, int]:
    """Return begin, end and step of the nodes of a unit to which a rigid motion is fitted."""
    return start[unit], start[unit + 1], max(1, (start[unit + 1] - start[unit]) // _FITTED)


@kernel
def store_shape(x: Matrix, units: Units, allowance: Allowance) -> None:
    """Store the nodes, and the radius of each unit around the mean of its fitted nodes, in an allowance.

    Args:
        x: (n, 3) [m].
        units: of the film.
        allowance: filled, except `allowed`.
    """
    copy_rows(x, allowance.before)
    for unit in range(allowance.radius.shape[0]):
        begin, end, step = _fitted(units.start, unit)
        weight, u, v, w, largest_square = 1.0 / len(range(begin, end, step)), 0.0, 0.0, 0.0, 0.0
        for k in range(begin, end, step):
            n = units.nodes[k]
            u, v, w = u + weight * x[n, 0], v + weight * x[n, 1], w + weight * x[n, 2]
        for k in range(begin, end):
            n = units.nodes[k]
            largest_square = max(largest_square, (x[n, 0] - u) ** 2 + (x[n, 1] - v) ** 2 + (x[n, 2] - w) ** 2)
        allowance.radius[unit] = np.sqrt(largest_square)


@kernel(allocates=True)
def allow_motion(
    x: Matrix,
    units: Units,
    meet: Masks,
    margins: tuple[float, float, float, float],
    long: Matrix,
    short: Matrix,
) -> None:
    """Fill the allowed relative motions of units for a new long list.

    Args:
        x: (n, 3) [m].
        units: of the film.
        meet: (u, u), which units can meet.
        margins: distance up to which the long list is complete, the margin for motion in it, the motion that
            is left to the short list [m], and the motion of a foot per motion of the corners.
        long: (u, u) [m], allowed for the long list, and
        short: (u, u) [m], for the short list, which gets the rest; filled.
    """
    room, margin, short_m, follow = margins
    boxes, least_long = np.empty((units.start.shape[0] - 1, 6)), margin / follow - short_m
    for unit in range(boxes.shape[0]):
        low, high = boxes[unit], boxes[unit, 3:]
        low[:3], high[:] = np.inf, -np.inf
        for k in range(units.start[unit], units.start[unit + 1]):
            for r in range(3):
                coordinate = x[units.nodes[k], r]
                low[r], high[r] = min(low[r], coordinate), max(high[r], coordinate)
    for a in range(boxes.shape[0]):
        for b in range(boxes.shape[0]):
            low, high = boxes[b], boxes[b, 3:]
            square = square_between(boxes, a, low[0], low[1], low[2], high[0], high[1], high[2])
            further = max(np.sqrt(square) - room, 0.0) if meet[a, b] else np.inf
            allowed = (margin + further) / follow
            # near units leave little motion to the short list, far ones half
            short[a, b] = min(0.5 * allowed, allowed - least_long)
            long[a, b] = max(0.5 * allowed, least_long)


@kernel
def units_stay(x: Matrix, units: Units, allowance: Allowance, less: float) -> bool:
    """Return whether the relative motions of all units are below the allowed ones, less a tolerance.

    The relative motion of two units is the sum of the largest deviations of their nodes from a common rigid
    motion, that of the first. For most pairs a bound by the difference of their rigid motions is enough.

    Args:
        x: (n, 3) [m].
        units: of the film; their relative motion is filled.
        allowance: to check.
        less: tolerance [m].
    """
    nodes, start, before, deviations = units.nodes, units.start, allowance.before, units.deviation
    minors, rigid = small_matrix(3, 3), units.rigid
    count = start.shape[0] - 1
    for a in range(count):
        rigid_motion.fit_motion(x, before, nodes, _fitted(start, a), rigid[a], minors)
        deviations[a] = rigid_motion.deviation(x, before, nodes, start[a], start[a + 1], rigid[a])
    for a in range(count):
        is_refitted = False
        for b in range(a + 1, count):
            allowed = allowance.allowed[a, b] - less
            if allowed == np.inf:
                continue
            rigid_part = rigid_motion.rigid_difference(rigid[a], rigid[b], allowance.radius[b])
            relative = deviations[a] + deviations[b] + rigid_part
            if not relative <= allowed:
                if not is_refitted:
                    rigid_motion.fit_motion(x, before, nodes, (start[a], start[a + 1], 1), rigid[a], minors)
                    deviations[a] = rigid_motion.deviation(x, before, nodes, start[a], start[a + 1], rigid[a])
                    is_refitted = True
                relative = deviations[a] + rigid_motion.deviation(
                    x, before, nodes, start[b], start[b + 1], rigid[a]
                )
            if not relative <= allowed:
                return False
            units.relative[a, b] = relative
    return True


@kernel
def largest_deviation(x: Matrix, before: Matrix, nodes: Indices) -> float:
    """Return the largest distance [m] of some nodes from their common rigid motion.

    Args:
        x: (n, 3) [m], now.
        before: (n, 3) [m].
        nodes: indices.
    """
    rigid, count = zero_matrix(5, 3), nodes.shape[0]
    span = 0, count, max(1, count // _FITTED)
    rigid_motion.fit_motion(x, before, nodes, span, rigid, small_matrix(3, 3))
    return rigid_motion.deviation(x, before, nodes, 0, count, rigid)


@kernel
def least_remaining(allowed: Matrix, relative: Matrix) -> float:
    """Return the smallest remaining relative motion [m] of two units, over the upper triangle."""
    least_motion = np.inf
    for a in range(relative.shape[0]):
        for b in range(a + 1, relative.shape[0]):
            least_motion = min(least_motion, allowed[a, b] - relative[a, b])
    return least_motion
