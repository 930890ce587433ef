"""Tasks of an inflated arm on a robot: its tip reaches or follows a goal, by flange, pressure and cables."""

from abc import ABC
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Measurement
from cosim.gym.tasks import LearningTask, flange_twist, robot_observation, within

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
_RADIUS_m: Final = (0.02, 0.04)
_TARGET_SPEED_m_s: Final = 0.05
_SPREAD_m: Final = np.array([0.06, 0.06, 0.04])


class ArmTask(LearningTask, ABC):
    """Moves the tip of an inflated arm to within 10 mm of a goal, which subclasses define."""

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
        return robot_observation(seen)

    def achieved(self, seen: Measurement) -> Array:
        return seen.tip_position


@final
class TipFollow(ArmTask):
    """Keeps the tip within 10 mm of a goal that moves on a level circle at 50 mm/s, for 4 s.

    The circle has a radius of 20 to 40 mm and starts at the tip; its centre is in a random direction.
    """

    horizon = 200

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        radius, angle = random.uniform(*_RADIUS_m), random.uniform(-np.pi, np.pi)
        turn = random.choice([-1.0, 1.0])
        center = began.tip_position - radius * np.array([np.cos(angle), np.sin(angle), 0.0])
        return np.array([*center, radius, angle, turn])

    def goal(self, drawn: Array, time_s: float) -> Array:
        x, y, z, radius, angle, turn = drawn.tolist()
        now = angle + turn * _TARGET_SPEED_m_s / radius * time_s
        return np.array([x + radius * np.cos(now), y + radius * np.sin(now), z])


@final
class TipReach(ArmTask):
    """Moves the tip to within 10 mm of a goal up to 60 mm to the sides and 40 mm up or down, within 2 s."""

    horizon = 100

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        return began.tip_position + random.uniform(-_SPREAD_m, _SPREAD_m)
