"""What the joints carry while ticks are taken in a row."""

from __future__ import annotations

from typing import NamedTuple

from cosim.base.frames import Array


class AddedInertiaRow(NamedTuple):
    """What the joints carry in a row of ticks.

    Args:
        inertia: (joints, joints) [kg m^2], algorithmic mass; (0, 0) for none.
        weights: (k,) of the last accelerations, see `answer_weights.expecting_no_change`.
        past: (k, joints) [rad/s^2], those of the ticks before the last one; kept up to date.
    """

    inertia: Array
    weights: Array
    past: Array
