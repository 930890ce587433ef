"""The tip of an inflated arm goes to a place, by flange, pressure and cables."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Measurement
from cosim.gym.arm_task import ArmTask

_SPREAD_m: Final = np.array([0.06, 0.06, 0.04])


@final
class TipReach(ArmTask):
    """The tip is to be within 10 mm of a place up to 60 mm to the sides and 40 mm up or down, for 2 s."""

    horizon = 100

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        return began.tip_position + random.uniform(-_SPREAD_m, _SPREAD_m)
