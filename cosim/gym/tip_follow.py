"""The tip of an inflated arm follows a place that moves."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Measurement
from cosim.gym.task import LearningTask, arm_observation
from cosim.gym.tip_reach import ACTIONS, CHANGES, arm_command

_RADIUS_m: Final = (0.02, 0.04)
_SPEED_m_s: Final = 0.05


@final
class TipFollow(LearningTask):
    """The tip is to stay within 10 mm of a place that goes round a level circle at 50 mm/s, for 4 s.

    The circle, of 20 to 40 mm, leads through where the tip begins; its centre may be on any side.
    """

    scenario = "ur5e_hexagon_arm"
    changes = CHANGES
    horizon = 200
    tolerance_m = 0.01
    actions = ACTIONS

    def command(self, action: Array, seen: Measurement) -> Command:
        return arm_command(action, seen)

    def observation(self, seen: Measurement) -> Array:
        return arm_observation(seen)

    def achieved(self, seen: Measurement) -> Array:
        return seen.tip_position

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        radius, angle = random.uniform(*_RADIUS_m), random.uniform(-np.pi, np.pi)
        turn = random.choice([-1.0, 1.0])
        center = began.tip_position - radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        return np.array([*center, radius, angle, turn])

    def goal(self, drawn: Array, time_s: float) -> Array:
        x, y, z, radius, angle, turn = drawn.tolist()
        now = angle + turn * _SPEED_m_s / radius * time_s
        return np.array([x + radius * np.cos(now), y + radius * np.sin(now), z])
