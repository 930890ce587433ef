"""The tip of an inflated arm goes to a place, by flange, pressure and cables."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Measurement
from cosim.gym.task import LearningTask, arm_observation, flange_twist, within

SPEED_m_s: Final = 0.1
PRESSURE_Pa: Final = (20e3, 40e3)
TENSION_N: Final = (0.0, 3.0)
PRESSURE_RATE_Pa_s: Final = 20e3
TENSION_RATE_N_s: Final = 4.0
ACTIONS: Final = (
    "flange velocity along x, 0.1 m/s", "along y", "along z", "rate of the pressure, 20 kPa/s",
    "rate of the tension of cable right, 4 N/s", "of cable left",
)  # fmt: skip
CHANGES: Final = {
    "phase": [],
    "soft_robot": "light_hexagon_arm",
    "clock.tick_s": 0.01,
    "contact.enabled": False,
    "solver.damping_per_s": 5.0,
    "start.flange.position_m": [0.45, 0.1, 0.5],
    "start.pressure_Pa": 30e3,
    "start.cable_tension_N": [0.5, 0.5],
}
_SPREAD_m: Final = np.array([0.06, 0.06, 0.04])


@final
class TipReach(LearningTask):
    """The tip is to be within 10 mm of a place up to 60 mm to the sides and 40 mm up or down, for 2 s."""

    scenario = "ur5e_hexagon_arm"
    changes = CHANGES
    horizon = 100
    tolerance_m = 0.01
    actions = ACTIONS

    def command(self, action: Array, seen: Measurement) -> Command:
        return arm_command(action, seen)

    def observation(self, seen: Measurement) -> Array:
        return arm_observation(seen)

    def achieved(self, seen: Measurement) -> Array:
        return seen.tip_position

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        return began.tip_position + random.uniform(-_SPREAD_m, _SPREAD_m)


def arm_command(action: Array, seen: Measurement) -> Command:
    """Return the rates of an action (6,) as values at the end of a step."""
    x, y, z, gas, *cables = action.tolist()
    pressure = within(seen.pressure_Pa[0], PRESSURE_RATE_Pa_s * gas, *PRESSURE_Pa)
    pairs = zip(seen.cable_tension_N.items(), cables, strict=True)
    return Command(
        flange_twist=flange_twist(SPEED_m_s * np.array([x, y, z]), seen),
        pressure_Pa={"chamber": pressure},
        cable_tension_N={
            name: within(now, TENSION_RATE_N_s * rate, *TENSION_N) for (name, now), rate in pairs
        },
    )
