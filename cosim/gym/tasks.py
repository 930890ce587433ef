"""What is to be learned: how actions command a robot, what is observed of it, what counts as reached.

How the tip of an inflated arm is commanded, and what is observed of it.

Soft fingers close around a roll and lift it.

The tip of an inflated arm follows a place that moves.

The tip of an inflated arm goes to a place, by flange, pressure and cables.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Measurement

STEP_S: Final = 0.02
"""Of an environment: 50 Hz."""
ACCELERATION_m_s2: Final = 1.0
"""Of the flange, along each axis."""


class LearningTask(ABC):
    """A task at 50 Hz. Subclasses hold no state: what changes in an episode is in the run and in its goal."""

    scenario: ClassVar[str]
    """That it changes."""
    fidelity: ClassVar[str] = "section"
    """Unless the environment is asked for another one."""
    changes: ClassVar[Mapping[str, Any]]
    """Values of the scenario by key path."""
    horizon: ClassVar[int]
    """Steps of an episode."""
    tolerance_m: ClassVar[float]
    """Distance of achieved and desired goal [m] within which it is a success."""
    actions: ClassVar[tuple[str, ...]]
    """What each number of an action is, and its unit at 1."""

    @abstractmethod
    def command(self, action: Array, seen: Measurement) -> Command:
        """Return what is asked for in a step.

        Args:
            action: (actions,), each within -1 to 1.
            seen: at the start of the step.
        """

    @abstractmethod
    def observation(self, seen: Measurement) -> Array:
        """Return what is observed of the robot (n,); metres, radians, newtons, 10 kPa."""

    @abstractmethod
    def achieved(self, seen: Measurement) -> Array:
        """Return the place (3,) [m] that is to be the goal's."""

    @abstractmethod
    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        """Return the parameters (k,) of a goal.

        Args:
            random: where chance comes from.
            began: as the episode begins.
        """

    def goal(self, drawn: Array, time_s: float) -> Array:
        """Return the goal (3,) [m].

        Args:
            drawn: (k,), see `draw`.
            time_s: since the episode began.
        """
        return drawn

    def reward(self, achieved: Array, desired: Array) -> Array:
        """Return the reward -|desired - achieved| / 0.1 m of each row (..., 3) [m]."""
        return np.asarray(-10.0 * np.linalg.norm(desired - achieved, axis=-1))

    def success(self, achieved: Array, desired: Array) -> bool:
        """Return whether a place (3,) [m] is within the tolerance of the goal."""
        return bool(np.linalg.norm(desired - achieved) < self.tolerance_m)


def task_of(place: str) -> LearningTask:
    """Return the task of a class, "module:Class"."""
    module, _, name = place.partition(":")
    found = getattr(import_module(module), name)()
    assert isinstance(found, LearningTask), f"{place} is no task"
    return found


def arm_observation(seen: Measurement) -> Array:
    """Return what is observed of a soft arm and of what carries it (n,).

    Tip: place, direction, velocity; flange: place, z axis, velocity, force on it; pressures; tensions.
    """
    return np.concatenate([
        seen.tip_position, seen.tip_direction, seen.tip_twist[:3], seen.flange.translation,
        seen.flange.rotation[:, 2], seen.flange_twist[:3], seen.flange_wrench.force,
        1e-4 * np.array(seen.pressure_Pa), list(seen.cable_tension_N.values()),
    ])  # fmt: skip


def within(value: float, rate: float, lowest: float, highest: float) -> float:
    """Return a value after a step at a rate, within bounds."""
    return min(max(value + STEP_S * rate, lowest), highest)


def flange_twist(wanted: Array, seen: Measurement) -> Array:
    """Return the twist (6,) of a flange that takes up a velocity (3,) [m/s] within its acceleration."""
    before = seen.flange_twist[:3]
    change = STEP_S * ACCELERATION_m_s2
    return np.concatenate([before + np.clip(wanted - before, -change, change), np.zeros(3)])


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


_LIFT_SPEED_m_s: Final = 0.2
_FINGER_PRESSURE_Pa: Final = (20e3, 45e3)
_FINGER_TENSION_N: Final = (0.0, 7.0)
_RATES: Final = (20e3, 10.0)
_ROLL: Final = "roll"
_CHAMBERS: Final = ("copy_1", "copy_2", "copy_3")


@final
class GraspLift(LearningTask):
    """The roll is to be within 20 mm of a place 60 to 120 mm above where it stands, within 3 s."""

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
        pressure = within(seen.pressure_Pa[0], _RATES[0] * gas, *_FINGER_PRESSURE_Pa)
        tension = within(max(seen.cable_tension_N.values()), _RATES[1] * pull, *_FINGER_TENSION_N)
        return Command(
            flange_twist=flange_twist(np.array([0.0, 0.0, _LIFT_SPEED_m_s * up]), seen),
            pressure_Pa=dict.fromkeys(_CHAMBERS, pressure),
            cable_tension_N=dict.fromkeys(seen.cable_tension_N, tension),
        )

    def observation(self, seen: Measurement) -> Array:
        return np.concatenate([arm_observation(seen), seen.contact_force_N[_ROLL]])

    def achieved(self, seen: Measurement) -> Array:
        return seen.body_pose[_ROLL].translation

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        return np.add(began.body_pose[_ROLL].translation, [0.0, 0.0, random.uniform(0.06, 0.12)])


_RADIUS_m: Final = (0.02, 0.04)
_TARGET_SPEED_m_s: Final = 0.05


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
        now = angle + turn * _TARGET_SPEED_m_s / radius * time_s
        return np.array([x + radius * np.cos(now), y + radius * np.sin(now), z])


_SPREAD_m: Final = np.array([0.06, 0.06, 0.04])


@final
class TipReach(ArmTask):
    """The tip is to be within 10 mm of a place up to 60 mm to the sides and 40 mm up or down, for 2 s."""

    horizon = 100

    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        return began.tip_position + random.uniform(-_SPREAD_m, _SPREAD_m)
