"""How the tip of an inflated arm is commanded, and what is observed of it."""

from __future__ import annotations

from abc import ABC
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Measurement
from cosim.gym.task import LearningTask, arm_observation, flange_twist, within

_SPEED_m_s: Final = 0.1
_PRESSURE_Pa: Final = (20e3, 40e3)
_TENSION_N: Final = (0.0, 3.0)
_PRESSURE_RATE_Pa_s: Final = 20e3
_TENSION_RATE_N_s: Final = 4.0
_CHANGES: Final = {
    "phase": [],
    "soft_robot": "light_hexagon_arm",
    "clock.tick_s": 0.01,
    "contact.enabled": False,
    "solver.damping_per_s": 5.0,
    "start.flange.position_m": [0.45, 0.1, 0.5],
    "start.pressure_Pa": 30e3,
    "start.cable_tension_N": [0.5, 0.5],
}


class ArmTask(LearningTask, ABC):
    """The tip of an inflated arm is to be within 10 mm of a goal; subclasses say where that is."""

    scenario = "ur5e_hexagon_arm"
    changes = _CHANGES
    tolerance_m = 0.01
    actions = (
        "flange velocity along x, 0.1 m/s", "along y", "along z", "rate of the pressure, 20 kPa/s",
        "rate of the tension of cable right, 4 N/s", "of cable left",
    )  # fmt: skip

    def command(self, action: Array, seen: Measurement) -> Command:
        x, y, z, gas, *cables = action.tolist()
        pressure = within(seen.pressure_Pa[0], _PRESSURE_RATE_Pa_s * gas, *_PRESSURE_Pa)
        pairs = zip(seen.cable_tension_N.items(), cables, strict=True)
        return Command(
            flange_twist=flange_twist(_SPEED_m_s * np.array([x, y, z]), seen),
            pressure_Pa={"chamber": pressure},
            cable_tension_N={
                name: within(now, _TENSION_RATE_N_s * rate, *_TENSION_N) for (name, now), rate in pairs
            },
        )

    def observation(self, seen: Measurement) -> Array:
        return arm_observation(seen)

    def achieved(self, seen: Measurement) -> Array:
        return seen.tip_position
