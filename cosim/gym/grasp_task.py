"""Task of soft fingers: they close around a roll and lift it."""

from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Measurement
from cosim.gym.tasks import LearningTask, flange_twist, robot_observation, within

_LIFT_SPEED_m_s: Final = 0.2
_FINGER_PRESSURE_Pa: Final = (20e3, 45e3)
_FINGER_TENSION_N: Final = (0.0, 7.0)
_PRESSURE_RATE_Pa_s: Final = 20e3
_TENSION_RATE_N_s: Final = 10.0
_ROLL: Final = "roll"
_CHAMBERS: Final = ("copy_1", "copy_2", "copy_3")


@final
class GraspLift(LearningTask):
    """Lifts the roll to within 20 mm of a goal 60 to 120 mm above its start, within 3 s."""

    scenario = "gripper_lifts_roll"
    fidelity = "lumped"
    changes = {  # noqa: RUF012  # nobody changes it
        "phase": [],
        "clock.tick_s": 0.01,
        "start.flange.position_m": [0.45, 0.0, 0.308],
        "start.pressure_Pa": 40e3,
    }
    horizon = 150
    tolerance_m = 0.02
    actions = (
        "flange velocity along z, 0.2 m/s", "rate of all pressures, 20 kPa/s", "of all tensions, 10 N/s",
    )  # fmt: skip

    def command(self, action: Array, seen: Measurement) -> Command:
        up, gas, pull = action.tolist()
        pressure = within(seen.pressure_Pa[0], _PRESSURE_RATE_Pa_s * gas, *_FINGER_PRESSURE_Pa)
        tension = within(max(seen.cable_tension_N.values()), _TENSION_RATE_N_s * pull, *_FINGER_TENSION_N)
        return Command(
            flange_twist=flange_twist(np.array([0.0, 0.0, _LIFT_SPEED_m_s * up]), seen),
            pressure_Pa=dict.fromkeys(_CHAMBERS, pressure),
            cable_tension_N=dict.fromkeys(seen.cable_tension_N, tension),
        )

    def observation(self, seen: Measurement) -> Array:
        return np.concatenate([robot_observation(seen), seen.contact_force_N[_ROLL]])

    def achieved(self, seen: Measurement) -> Array:
        return seen.body_pose[_ROLL].translation

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        return np.add(began.body_pose[_ROLL].translation, [0.0, 0.0, random.uniform(0.06, 0.12)])
