"""A task as a Gymnasium environment."""

from __future__ import annotations

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
from cosim.config.schema.scenario import Scenario
from cosim.devices.controller import Measurement
from cosim.errors import InputError, SolverError
from cosim.gym.task import STEP_S, LearningTask, task_of

Observation: TypeAlias = dict[str, Array]
_BOUND: Final = 1e6
"""Of what is observed: it is finite, and far beyond what a robot does."""
_OPTIONS: Final = ("start", "changes", "goal")


@final
class TaskEnvironment(gymnasium.Env[Observation, NDArray[Any]]):
    """Steps a robot at 50 Hz towards goals; made by `gymnasium.make("cosim/TipReach-v0")` and the like.

    Observations are {"observation", "achieved_goal", "desired_goal"}; actions lie within -1 to 1, each of
    them a rate or velocity as the task's `actions` say. `info` holds "is_success"; "limits", what did not go
    as commanded, in words; and in a step whose physics could not be solved "failure", the error's name and
    text: the episode is then truncated where it was before that step, and rewarded as if it stayed there.
    Nothing else but the task's `horizon` ends an episode: goals that are reached do not.

    Args:
        task: what is to be learned.
        scenario: what runs; whole ticks make 20 ms.
        overrides: values of it by key path.
        kept: parts that environments of a process share, see `Simulation`.

    Raises:
        InputError: they do not.
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
        tick_s = self._simulation.scenario.clock.tick_s
        self._ticks = round(STEP_S / tick_s)
        if abs(self._ticks * tick_s - STEP_S) > 1e-9:
            raise InputError(f"clock.tick_s is {tick_s:g}; whole ticks have to make a step of {STEP_S:g} s")
        self._seen = self._simulation.measure()
        self._began_s, self._steps, self._drawn = self._seen.time_s, 0, np.zeros(3)
        sizes = {"observation": len(task.observation(self._seen)), "achieved_goal": 3, "desired_goal": 3}
        boxes: dict[str, spaces.Space[Any]] = {
            name: spaces.Box(-_BOUND, _BOUND, (size,), np.float64) for name, size in sizes.items()
        }
        self.observation_space: spaces.Space[Any] = spaces.Dict(boxes)
        self.action_space = spaces.Box(-1.0, 1.0, (len(task.actions),), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: of the goals from here on; None: chance goes on.
            options: "start", a saved state or a file of one; "changes", values by key path for this episode;
                "goal", parameters of the goal instead of drawn ones.

        Raises:
            InputError: an option is unknown, or one of them does not fit.
        """
        super().reset(seed=seed)
        options = options or {}
        for name in options:
            if name not in _OPTIONS:
                raise InputError(f"options: there is no '{name}'; there are: {', '.join(_OPTIONS)}")
        start: SavedState | str | Path | None = options.get("start")
        self._simulation.reset(start, options.get("changes"))
        self._seen = self._simulation.measure()
        self._began_s, self._steps = self._seen.time_s, 0
        drawn = self.task.draw(self.np_random, self._seen)
        self._drawn = np.array(options.get("goal", drawn), dtype=float)
        observation = self._observation()
        return observation, self._info(observation)

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take a step; an episode ends after the task's `horizon`, or where the physics cannot be solved."""
        asked = np.clip(np.asarray(action, dtype=float), -1.0, 1.0)
        if not np.isfinite(asked).all():
            raise InputError(f"an action is {asked.tolist()}; its numbers must be finite")
        failure = None
        try:
            self._simulation.step(self.task.command(asked, self._seen), ticks=self._ticks)
        except (SolverError, InputError) as error:  # InputError: where the arm has got to, it cannot go on so
            failure = f"{type(error).__name__}: {error}"
        self._seen = self._simulation.measure()
        self._steps += 1
        observation = self._observation()
        reward = float(self.task.reward(observation["achieved_goal"], observation["desired_goal"]))
        info = self._info(observation)
        if failure is not None:
            info["failure"] = failure
            reward *= 1 + self.task.horizon - self._steps
        return observation, reward, False, failure is not None or self._steps >= self.task.horizon, info

    def compute_reward(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Array:
        """Return the reward of goals (..., 3) [m], as learning from other goals in hindsight asks for."""
        return self.task.reward(achieved_goal, desired_goal)

    def save(self) -> SavedState:
        """Return the present state, for `options={"start": ...}`."""
        return self._simulation.save()

    @property
    def measured(self) -> Measurement:
        """What is measured at present."""
        return self._seen

    def _observation(self) -> Observation:
        seen = self._seen
        return {
            "observation": self.task.observation(seen),
            "achieved_goal": np.array(self.task.achieved(seen)),
            "desired_goal": np.array(self.task.goal(self._drawn, seen.time_s - self._began_s)),
        }

    def _info(self, observation: Observation) -> dict[str, Any]:
        reached = self.task.success(observation["achieved_goal"], observation["desired_goal"])
        return {"is_success": reached, "limits": self._seen.limits}


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
        scenario: name or path of one to take the place of the task's.
        kept: parts that environments of a process share, see `Simulation`.
    """
    found = task_of(task)
    given = {**found.changes, "fidelity": fidelity or found.fidelity, **(overrides or {})}
    return TaskEnvironment(found, str(scenario or found.scenario), given, kept)
