"""A task as a Gymnasium environment, alone or many at once in processes."""

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeAlias, final

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cosim.app.simulation import SavedState, Simulation
from cosim.app.workers import Workers
from cosim.base.frames import Array, Mask
from cosim.base.kept_parts import KeptParts
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import row_of_numbers, shown
from cosim.devices.controller import Measurement
from cosim.errors import InputError, SolverError
from cosim.gym.tasks import STEP_S, LearningTask, task_of

Observation: TypeAlias = dict[str, Array]
_BOUND: Final = 1e6
"""Of what is observed: it is finite, and far beyond what a robot does."""
_ROUNDING_S: Final = 1e-9
_OPTIONS: Final = ("start", "changes", "goal")


@final
class TaskEnvironment(gymnasium.Env[Observation, NDArray[Any]]):
    """Steps a robot at 50 Hz towards goals; made by `gymnasium.make("cosim/TipReach-v0")` and the like.

    Observations are {"observation", "achieved_goal", "desired_goal"}; actions lie within -1 to 1, each of
    them a rate or velocity as the task's `actions` say. `info` holds "is_success"; "limits", what did not go
    as commanded, in words; and in a step whose physics could not be solved "failure", the error's name and
    text: the episode is then truncated where it was before that step, rewarded as if it stayed there, and no
    success.
    Nothing else but the task's `horizon` ends an episode: goals that are reached do not. Of a scenario with
    sensors, observations and rewards are those of their readings, and "is_success" is that of the truth.
    Observations hold the colours of every camera of the scenario, by its name.

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
        self._made = self._simulation.scenario
        self._ticks = ticks_of_step(self._made)
        self._seen = self._simulation.measure()
        self._began_s, self._steps = self._seen.time_s, 0
        self._sensors = tuple(sensor.name for sensor in self._made.sensors)
        self._cameras = tuple(camera.name for camera in self._made.cameras)
        self._drawn = task.draw(np.random.default_rng(0), self._seen)
        sizes = {"observation": len(task.observation(self._seen)), "achieved_goal": 3, "desired_goal": 3}
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
            seed: of the goals from here on; None: chance continues.
            options: "start", a saved state or a file of one; "changes", values by key path for this episode;
                "goal", parameters of the goal instead of drawn ones.

        Raises:
            InputError: an option is unknown, or one of them or the seed does not fit; the episode continues.
        """
        given = checked_options(options, seed)
        goal, changes = given.get("goal"), given.get("changes")
        if goal is not None:
            goal = finite_row(goal, len(self._drawn), "options: goal")
        ticks = ticks_of_step(self._made if changes is None else load_scenario(self._made, changes))
        start: SavedState | str | Path | None = given.get("start")
        self._simulation.reset(start, changes)
        super().reset(seed=seed)
        if self._sensors:
            self._simulation.seed_sensors(int(self.np_random.integers(2**31)))
        self._ticks, self._seen = ticks, self._simulation.measure()
        self._began_s, self._steps = self._seen.time_s, 0
        drawn = self.task.draw(self.np_random, self._seen)
        self._drawn = drawn if goal is None else goal
        observation = self._observation()
        return observation, self._info(observation)

    def step(self, action: NDArray[Any]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Take a step; an episode ends after the task's `horizon`, or where the physics cannot be solved.

        Args:
            action: (actions,), cut down to -1 to 1.

        Raises:
            InputError: it is no row of as many finite numbers; the episode continues.
        """
        asked = np.clip(finite_row(action, len(self.task.actions), "action"), -1.0, 1.0)
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
            info |= {"failure": failure, "is_success": False}
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
        return self._simulation.measure()

    def _observation(self) -> Observation:
        seen = self._simulation.measure(self._sensors) if self._sensors else self._seen
        found = {
            "observation": self.task.observation(seen),
            "achieved_goal": np.array(self.task.achieved(seen)),
            "desired_goal": np.array(self.task.goal(self._drawn, seen.time_s - self._began_s)),
        }
        for name in self._cameras:
            found[name] = np.array(self._simulation.image(name).rgb)
        return found

    def _info(self, observation: Observation) -> dict[str, Any]:
        here = self.task.achieved(self._seen) if self._sensors else observation["achieved_goal"]
        reached = self.task.success(here, observation["desired_goal"])
        return {"is_success": reached, "limits": self._seen.limits}


def ticks_of_step(scenario: Scenario) -> int:
    """Return how many ticks of a scenario make a step of 20 ms.

    Raises:
        InputError: no whole number of them does.
    """
    tick_s = scenario.clock.tick_s
    ticks = round(STEP_S / tick_s)
    if abs(ticks * tick_s - STEP_S) > _ROUNDING_S:
        raise InputError(
            f"clock.tick_s is {tick_s:g}; whole ticks have to make a step of {STEP_S:g} s: give {STEP_S:g} s "
            "or a whole part of it"
        )
    return ticks


def finite_row(given: Any, count: int, place: str) -> Array:
    """Return a row (count,) of finite numbers.

    Raises:
        InputError: it is none; `place` says what.
    """
    row = np.array(row_of_numbers(given, count, place))
    if not np.isfinite(row).all():
        raise InputError(f"{place} is {row.tolist()}; its {count} numbers must be finite")
    return row


def checked_options(options: Any, seed: Any) -> Mapping[str, Any]:
    """Return the options of a reset.

    Raises:
        InputError: one is unknown, they are none, or the seed is none.
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
        scenario: name or path of one to take the place of the task's.
        kept: parts that environments of a process share, see `Simulation`.
    """
    found = task_of(task)
    given = {**found.changes, "fidelity": fidelity or found.fidelity, **(overrides or {})}
    return TaskEnvironment(found, str(scenario or found.scenario), given, kept)


_Step: TypeAlias = tuple[Observation, float, bool, bool, dict[str, Any]]


@final
class VectorRun:
    """One environment of many, in the process that holds it; begins again as its mode says.

    Args:
        one: the environment.
        mode: what follows the end of an episode.
    """

    def __init__(self, one: TaskEnvironment, mode: AutoresetMode) -> None:
        self._one, self._mode, self._ended = one, mode, False

    @classmethod
    def of(cls, mode: AutoresetMode, given: Mapping[str, Any], kept: KeptParts, k: int) -> "VectorRun":
        """Return number k; those of one process share the parts that are kept there."""
        return cls(environment(**given, kept=kept), mode)

    def spaces(self) -> tuple[Any, Any]:
        """Return those of observations and actions."""
        return self._one.observation_space, self._one.action_space

    def reset(self, seed: int | None, options: dict[str, Any] | None) -> _Step:
        """Begin an episode."""
        self._ended = False
        observation, info = self._one.reset(seed=seed, options=options)
        return observation, 0.0, False, False, info

    def step(self, action: NDArray[Any]) -> _Step:
        """Take a step, or begin an episode in its place."""
        if self._ended and self._mode is AutoresetMode.NEXT_STEP:
            return self.reset(None, None)
        observation, reward, terminated, truncated, info = self._one.step(action)
        self._ended = terminated or truncated
        if self._ended and self._mode is AutoresetMode.SAME_STEP:
            last = {"final_obs": observation, "final_info": info}
            observation, *_, info = self.reset(None, None)
            info = {**info, **last}
        return observation, reward, terminated, truncated, info


@final
class TaskVectorEnvironment(VectorEnv[Observation, NDArray[Any], Array]):
    """Environments in processes, each bit for bit what it is alone; all three modes of autoreset.

    Where a process ends, its environments stay truncated, with the last observation and "failure" in `info`,
    until a reset of one of them starts another process.

    Args:
        count: of environments.
        workers: processes that hold them.
        mode: what follows the end of an episode.
        given: arguments of `environment`.
    """

    def __init__(self, count: int, workers: int, mode: AutoresetMode, given: Mapping[str, Any]) -> None:
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.num_envs = count
        kept = KeptParts(on_disk=True)
        self._workers = Workers(partial(VectorRun.of, mode, given, kept), count, workers)
        spaces = self._workers.call("spaces", {0: ()})[0]
        if isinstance(spaces, Exception):
            self._workers.close()
            raise spaces
        self.single_observation_space, self.single_action_space = spaces
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)
        self._last: list[Observation] = [self.single_observation_space.sample()] * count

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin episodes: of all, or of those in `options["reset_mask"]`; `seed` + k is that of number k.

        Raises:
            InputError: an option is unknown, or one of them or a seed does not fit.
        """
        given = dict(options) if isinstance(options, Mapping) else options
        mask = given.pop("reset_mask", None) if isinstance(given, dict) else None
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        listed = seed if isinstance(seed, Sequence) else [seed] * self.num_envs
        if len(listed) != self.num_envs or isinstance(seed, str | bytes):
            raise InputError(f"seed is {shown(seed)}; give one, or one for each of {self.num_envs}")
        if chosen.shape != (self.num_envs,) or chosen.dtype != bool:
            raise InputError(
                f"options: reset_mask is {shown(mask)}; must be {self.num_envs} times True or False"
            )
        for one in listed:
            checked_options(given, one)
        further = [0] * self.num_envs if isinstance(seed, Sequence) else range(self.num_envs)
        seeds = [None if one is None else one + k for one, k in zip(listed, further, strict=True)]
        asked = {k: (seeds[k], given or None) for k in np.flatnonzero(chosen).tolist()}
        self._workers.replace(asked)
        observation, *_, info = self._called("reset", asked)
        return observation, info

    def step(  # type: ignore[override]  # flags are flags
        self, actions: NDArray[Any]
    ) -> tuple[Observation, Array, Mask, Mask, dict[str, Any]]:
        """Take a step of all.

        Args:
            actions: (environments, actions), cut down to -1 to 1.

        Raises:
            InputError: they are not as many rows of finite numbers; no environment has taken a step.
        """
        rows = list(actions) if np.iterable(actions) else []
        if len(rows) != self.num_envs:
            raise InputError(f"actions are {shown(actions)}; must have the shape {self.action_space.shape}")
        count = math.prod(self.single_action_space.shape or ())
        asked = {k: (finite_row(row, count, f"actions[{k}]"),) for k, row in enumerate(rows)}
        return self._called("step", asked)

    @property
    def processes(self) -> tuple[int, ...]:
        """Number of the process of each worker; environment k is in worker k modulo their number."""
        return self._workers.processes

    def close_extras(self, **kwargs: Any) -> None:
        """End the processes."""
        self._workers.close()

    def _called(
        self, method: str, arguments: Mapping[int, tuple[Any, ...]]
    ) -> tuple[Observation, Array, Mask, Mask, dict[str, Any]]:
        found = self._workers.call(method, arguments)
        reward, info = np.zeros(self.num_envs), dict[str, Any]()
        terminated, truncated = np.zeros((2, self.num_envs), dtype=bool)
        for k, answer in found.items():
            if isinstance(answer, InputError) and method == "reset":
                raise answer
            if isinstance(answer, Exception):
                truncated[k] = True
                info = self._add_info(info, {"failure": f"{type(answer).__name__}: {answer}"}, k)
                continue
            self._last[k], reward[k], terminated[k], truncated[k], own = answer
            info = self._add_info(info, own, k)
        stacked = {name: np.stack([one[name] for one in self._last]) for name in self._last[0]}
        return stacked, reward, terminated, truncated, info


def vector_environment(
    num_envs: int = 1, workers: int = 1, autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP, **given: Any
) -> TaskVectorEnvironment:
    """Return environments of a task.

    Args:
        num_envs: how many.
        workers: processes that hold them.
        autoreset_mode: what follows the end of an episode.
        given: arguments of `environment`.
    """
    return TaskVectorEnvironment(num_envs, workers, AutoresetMode(autoreset_mode), given)
