"""Base class of tasks for learning: how actions command a robot, its observations, goals and rewards."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from importlib import import_module
from typing import Any, ClassVar, Final

import numpy as np

from cosim.base.frames import Array
from cosim.devices.controller import Command, Measurement
from cosim.errors import InputError

STEP_S: Final = 0.02
"""Length of an environment's step: 50 Hz."""
ACCELERATION_m_s2: Final = 1.0
"""Largest acceleration of the flange along each axis."""


class LearningTask(ABC):
    """A task at 50 Hz. Subclasses have no state: the run and the goal of the episode have it."""

    scenario: ClassVar[str]
    """Name of the scenario."""
    fidelity: ClassVar[str] = "section"
    """Fidelity of the soft robot, unless the environment is made with another one."""
    changes: ClassVar[Mapping[str, Any]]
    """Values of the scenario by key path."""
    horizon: ClassVar[int]
    """Steps of an episode."""
    tolerance_m: ClassVar[float]
    """Distance of achieved and desired goal [m] that counts as success."""
    actions: ClassVar[tuple[str, ...]]
    """Meaning of each number of an action, and its value at 1."""

    @abstractmethod
    def command(self, action: Array, seen: Measurement) -> Command:
        """Return the command of a step.

        Args:
            action: (actions,), each within -1 to 1.
            seen: measurement at the start of the step.
        """

    @abstractmethod
    def observation(self, seen: Measurement) -> Array:
        """Return the observation of the robot (n,); metres, radians, newtons, 10 kPa."""

    @abstractmethod
    def achieved(self, seen: Measurement) -> Array:
        """Return the achieved position (3,) [m], to be compared with the goal."""

    @abstractmethod
    def draw(self, random: np.random.Generator, began: Measurement) -> Array:
        """Return the parameters (k,) of a random goal.

        Args:
            random: source of random numbers.
            began: measurement at the start of the episode.
        """

    def goal(self, drawn: Array, time_s: float) -> Array:
        """Return the goal (3,) [m].

        Args:
            drawn: (k,), see `draw`.
            time_s: since the start of the episode.
        """
        return drawn

    def reward(self, achieved: Array, desired: Array) -> Array:
        """Return the reward -|desired - achieved| / 0.1 m of each row (..., 3) [m]."""
        return np.asarray(-10.0 * np.linalg.norm(desired - achieved, axis=-1))

    def success(self, achieved: Array, desired: Array) -> bool:
        """Return whether the achieved position (3,) [m] is within the tolerance of the goal."""
        return bool(np.linalg.norm(desired - achieved) < self.tolerance_m)


def task_of(path: str) -> LearningTask:
    """Return the task of a class, "module:Class".

    Raises:
        InputError: there is no such class, or it is not one of tasks.
    """
    module, _, name = path.partition(":")
    try:
        kind = getattr(import_module(module), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"task '{path}': {error}; give module:Class") from error
    if not (isinstance(kind, type) and issubclass(kind, LearningTask)):
        raise InputError(f"task '{path}': is no subclass of cosim.gym.tasks.LearningTask")
    return kind()


def robot_observation(seen: Measurement) -> Array:
    """Return the observation (n,) of a soft robot and its flange.

    Tip: position, direction, velocity; flange: position, z axis, velocity, force; pressures; tensions.
    """
    return np.concatenate([
        seen.tip_position, seen.tip_direction, seen.tip_twist[:3], seen.flange.translation,
        seen.flange.rotation[:, 2], seen.flange_twist[:3], seen.flange_wrench.force,
        1e-4 * np.array(seen.pressure_Pa), list(seen.cable_tension_N.values()),
    ])  # fmt: skip


def within(value: float, rate: float, lowest: float, highest: float) -> float:
    """Return a value after a step at a rate, clipped to bounds."""
    return min(max(value + STEP_S * rate, lowest), highest)


def flange_twist(wanted: Array, seen: Measurement) -> Array:
    """Return the twist (6,) of a flange whose velocity approaches (3,) [m/s] at most at its acceleration."""
    before = seen.flange_twist[:3]
    change = STEP_S * ACCELERATION_m_s2
    return np.concatenate([before + np.clip(wanted - before, -change, change), np.zeros(3)])
