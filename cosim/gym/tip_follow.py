"""The tip of an inflated arm follows a place that moves."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Measurement
from cosim.gym.arm_task import ArmTask

_RADIUS_m: Final = (0.02, 0.04)
_SPEED_m_s: Final = 0.05


@final
class TipFollow(ArmTask):
    """The tip is to stay within 10 mm of a place that goes round a level circle at 50 mm/s, for 4 s.

    The circle, of 20 to 40 mm, leads through where the tip begins; its centre may be on any side.
    """

    horizon = 200

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        radius, angle = random.uniform(*_RADIUS_m), random.uniform(-np.pi, np.pi)
        turn = random.choice([-1.0, 1.0])
        center = began.tip_position - radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        return np.array([*center, radius, angle, turn])

    def goal(self, drawn: Array, time_s: float) -> Array:
        x, y, z, radius, angle, turn = drawn.tolist()
        now = angle + turn * _SPEED_m_s / radius * time_s
        return np.array([x + radius * np.cos(now), y + radius * np.sin(now), z])
