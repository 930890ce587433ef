"""What is to be learned: how actions command a robot, what is observed of it, and what counts as reached."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Final

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
