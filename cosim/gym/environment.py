"""A task as a Gymnasium environment."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, TypeAlias, final

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from cosim.app.simulation import SavedState, Simulation
from cosim.base.frames import Array
from cosim.base.kept_parts import KeptParts
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import row_of_numbers, shown
from cosim.devices.controller import Measurement
from cosim.errors import InputError, SolverError
from cosim.gym.tasks import STEP_S, LearningTask, task_of

Observation: TypeAlias = dict[str, Array]
_BOUND: Final = 1e6
"""Bound of all observed numbers, far beyond those of a robot."""
_ROUNDING_S: Final = 1e-9
_OPTIONS: Final = ("start", "changes", "goal")


@final
class TaskEnvironment(gymnasium.Env[Observation, NDArray[Any]]):
    """Steps a robot at 50 Hz towards goals; made by `gymnasium.make("cosim/TipReach-v0")` and the like.

    Observations are {"observation", "achieved_goal", "desired_goal"}. Actions are within -1 to 1, each a rate
    or velocity that the task's `actions` describe. `info` has "is_success" and "limits", text on commands
    that are not followed. If the physics of a step cannot be solved, `info` has "failure", the error's name
    and text. The episode is then truncated in the state before that step, rewarded as if it stayed there, and
    no success.

    An episode ends with a failure or after the task's `horizon`, not when a goal is reached. If the scenario
    has sensors, observations and rewards are computed from their readings, "is_success" from exact values.
    Observations contain the colour image of every camera of the scenario, by its name.

    Args:
        task: the task.
        scenario: the scenario; whole ticks must make 20 ms.
        overrides: values of the scenario by key path.
        kept: parts that environments of a process share, see `Simulation`.

    Raises:
        InputError: whole ticks do not make 20 ms.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  # as Gymnasium declares it

    def __init__(
        self,
        task: LearningTask,
        scenario: Scenario | str,
        overrides: Mapping[str, Any],
        kept: KeptParts | None = None,
    ) -> None:
        self.task = task
        self._simulation = Simulation(scenario, overrides=overrides, kept=kept)
        self._made = self._simulation.scenario
        self._ticks = ticks_of_step(self._made)
        self._measured = self._simulation.measure()
        self._began_s, self._steps = self._measured.time_s, 0
        self._sensors = tuple(sensor.name for sensor in self._made.sensors)
        self._cameras = tuple(camera.name for camera in self._made.cameras)
        self._goal = task.draw(np.random.default_rng(0), self._measured)
        sizes = {"observation": len(task.observation(self._measured)), "achieved_goal": 3, "desired_goal": 3}
        boxes: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(-_BOUND, _BOUND, (size,), np.float64) for name, size in sizes.items()
        }
        for camera in self._made.cameras:
            boxes[camera.name] = spaces.Box(0, 255, (*reversed(camera.size), 3), np.uint8)
        self.observation_space: spaces.Space[Any] = spaces.Dict(boxes)
        self.action_space = spaces.Box(-1.0, 1.0, (len(task.actions),), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: of this and all further goals; None: the random numbers continue.
            options: "start", a saved state or a file of one; "changes", values by key path for this episode;
                "goal", parameters of the goal instead of random ones.

        Raises:
            InputError: an option is unknown, or an option or the seed is invalid; the episode continues.
        """
        checked = checked_options(options, seed)
        goal, changes = checked.get("goal"), checked.get("changes")
        if goal is not None:
            goal = finite_row(goal, len(self._goal), "options: goal")
        ticks = ticks_of_step(self._made if changes is None else load_scenario(self._made, changes))
        start: SavedState | str | Path | None = checked.get("start")
        self._simulation.reset(start, changes)
        super().reset(seed=seed)
        if self._sensors:
            self._simulation.seed_sensors(int(self.np_random.integers(2**31)))
        self._ticks, self._measured = ticks, self._simulation.measure()
        self._began_s, self._steps = self._measured.time_s, 0
        drawn = self.task.draw(self.np_random, self._measured)
        self._goal = drawn if goal is None else goal
        observation = self._observation()
        return observation, self._info(observation)

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take a step; an episode ends after the task's `horizon`, or if the physics cannot be solved.

        Args:
            action: (actions,), clipped to -1 to 1.

        Raises:
            InputError: the action is not a row of this many finite numbers; the episode continues.
        """
        clipped = np.clip(finite_row(action, len(self.task.actions), "action"), -1.0, 1.0)
        failure = None
        try:
            self._simulation.step(self.task.command(clipped, self._measured), ticks=self._ticks)
        except (SolverError, InputError) as error:  # InputError: the arm cannot follow the command from here
            failure = f"{type(error).__name__}: {error}"
        self._measured = self._simulation.measure()
        self._steps += 1
        observation = self._observation()
        reward = float(self.task.reward(observation["achieved_goal"], observation["desired_goal"]))
        info = self._info(observation)
        if failure is not None:
            info |= {"failure": failure, "is_success": False}
            reward *= 1 + self.task.horizon - self._steps
        return observation, reward, False, failure is not None or self._steps >= self.task.horizon, info

    def compute_reward(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Array:
        """Return the reward of goals (..., 3) [m], for hindsight experience replay."""
        return self.task.reward(achieved_goal, desired_goal)

    def save(self) -> SavedState:
        """Return the present state, for `options={"start": ...}`."""
        return self._simulation.save()

    @property
    def measured(self) -> Measurement:
        """The present measurement."""
        return self._simulation.measure()

    def _observation(self) -> Observation:
        seen = self._simulation.measure(self._sensors) if self._sensors else self._measured
        observation = {
            "observation": self.task.observation(seen),
            "achieved_goal": np.array(self.task.achieved(seen)),
            "desired_goal": np.array(self.task.goal(self._goal, seen.time_s - self._began_s)),
        }
        for name in self._cameras:
            observation[name] = np.array(self._simulation.image(name).rgb)
        return observation

    def _info(self, observation: Observation) -> dict[str, Any]:
        achieved = self.task.achieved(self._measured) if self._sensors else observation["achieved_goal"]
        reached = self.task.success(achieved, observation["desired_goal"])
        return {"is_success": reached, "limits": self._measured.limits}


def ticks_of_step(scenario: Scenario) -> int:
    """Return the number of ticks of a scenario in a step of 20 ms.

    Raises:
        InputError: it is not a whole number.
    """
    tick_s = scenario.clock.tick_s
    ticks = round(STEP_S / tick_s)
    if abs(ticks * tick_s - STEP_S) > _ROUNDING_S:
        raise InputError(
            f"clock.tick_s is {tick_s:g}; whole ticks must make a step of {STEP_S:g} s: give {STEP_S:g} s "
            "or a whole fraction of it"
        )
    return ticks


def finite_row(values: Any, count: int, name: str) -> Array:
    """Return a row (count,) of finite numbers.

    Raises:
        InputError: the values are no such row; the message begins with `name`.
    """
    row = np.array(row_of_numbers(values, count, name))
    if not np.isfinite(row).all():
        raise InputError(f"{name} is {row.tolist()}; its {count} numbers must be finite")
    return row


def checked_options(options: Any, seed: Any) -> Mapping[str, Any]:
    """Return the options of a reset.

    Raises:
        InputError: an option is unknown, the options are no mapping, or the seed is invalid.
    """
    if not (seed is None or (isinstance(seed, int) and seed >= 0)):
        raise InputError(f"seed is {shown(seed)}; must be a whole number from 0 on, or None")
    if options is not None and not isinstance(options, Mapping):
        raise InputError(f"options are {shown(options)}; give values by name: {', '.join(_OPTIONS)}")
    for name in options or {}:
        if name not in _OPTIONS:
            raise InputError(f"options: there is no {shown(name)}; there are: {', '.join(_OPTIONS)}")
    return options or {}


def environment(
    task: str,
    fidelity: str | None = None,
    overrides: Mapping[str, Any] | None = None,
    scenario: str | Path | None = None,
    kept: KeptParts | None = None,
) -> TaskEnvironment:
    """Return the environment of a task.

    Args:
        task: its class, "module:Class".
        fidelity: of the soft robot; None: the task's.
        overrides: further values of the scenario by key path.
        scenario: name or path of a scenario that replaces the task's.
        kept: parts that environments of a process share, see `Simulation`.
    """
    made = task_of(task)
    changes = {**made.changes, "fidelity": fidelity or made.fidelity, **(overrides or {})}
    return TaskEnvironment(made, str(scenario or made.scenario), changes, kept)
