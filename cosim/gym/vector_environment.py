"""Many environments of a task in worker processes, as a vector environment of Gymnasium."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, TypeAlias, final

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cosim.app.workers import Workers
from cosim.base.frames import Array, Mask
from cosim.base.kept_parts import KeptParts
from cosim.devices.command_checks import shown
from cosim.errors import InputError
from cosim.gym.environment import Observation, TaskEnvironment, checked_options, environment, finite_row

_Step: TypeAlias = tuple[Observation, float, bool, bool, dict[str, Any]]


@final
class AutoresetEnvironment:
    """An environment that begins another episode by itself, as Gymnasium's mode of autoreset says.

    Args:
        one: the environment.
        mode: what follows the end of an episode.
    """

    def __init__(self, one: TaskEnvironment, mode: AutoresetMode) -> None:
        self._one, self._mode, self._ended = one, mode, False

    def spaces(self) -> tuple[Any, Any]:
        """Return the spaces of observations and actions."""
        return self._one.observation_space, self._one.action_space

    def reset(self, seed: int | None, options: dict[str, Any] | None) -> _Step:
        """Begin an episode."""
        self._ended = False
        observation, info = self._one.reset(seed=seed, options=options)
        return observation, 0.0, False, False, info

    def step(self, action: NDArray[Any]) -> _Step:
        """Take a step, or begin an episode instead."""
        if self._ended and self._mode is AutoresetMode.NEXT_STEP:
            return self.reset(None, None)
        observation, reward, terminated, truncated, info = self._one.step(action)
        self._ended = terminated or truncated
        if self._ended and self._mode is AutoresetMode.SAME_STEP:
            last = {"final_obs": observation, "final_info": info}
            observation, *_, info = self.reset(None, None)
            info = {**info, **last}
        return observation, reward, terminated, truncated, info


def _environment(
    mode: AutoresetMode, arguments: Mapping[str, Any], kept: KeptParts, _number: int
) -> AutoresetEnvironment:
    """Return an environment; all environments of a process share the kept parts."""
    return AutoresetEnvironment(environment(**arguments, kept=kept), mode)


@final
class TaskVectorEnvironment(VectorEnv[Observation, NDArray[Any], Array]):
    """Environments in processes, each bit-identical to the same one alone; all three modes of autoreset.

    If a process ends, its environments stay truncated, with the last observation and "failure" in `info`,
    until one of them is reset, which starts another process.

    Args:
        count: number of environments.
        workers: number of processes that hold them.
        mode: what follows the end of an episode.
        arguments: of `environment`.
    """

    def __init__(self, count: int, workers: int, mode: AutoresetMode, arguments: Mapping[str, Any]) -> None:
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.num_envs = count
        make = partial(_environment, mode, arguments, KeptParts(on_disk=True))
        self._workers: Workers[AutoresetEnvironment] = Workers(make, count, workers)
        spaces = self._workers.call(AutoresetEnvironment.spaces, {0: ()})[0]
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
        """Begin episodes of all environments, or of those in `options["reset_mask"]`.

        Environment k gets the seed `seed` + k.

        Raises:
            InputError: an option is unknown, or an option or a seed is invalid.
        """
        others = dict(options) if isinstance(options, Mapping) else options
        mask = others.pop("reset_mask", None) if isinstance(others, dict) else None
        chosen = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        listed = seed if isinstance(seed, Sequence) else [seed] * self.num_envs
        if len(listed) != self.num_envs or isinstance(seed, str | bytes):
            raise InputError(f"seed is {shown(seed)}; give one, or one for each of {self.num_envs}")
        if chosen.shape != (self.num_envs,) or chosen.dtype != bool:
            raise InputError(
                f"options: reset_mask is {shown(mask)}; must be {self.num_envs} times True or False"
            )
        for one in listed:
            checked_options(others, one)
        further = [0] * self.num_envs if isinstance(seed, Sequence) else range(self.num_envs)
        seeds = [None if one is None else one + k for one, k in zip(listed, further, strict=True)]
        arguments = {k: (seeds[k], others or None) for k in np.flatnonzero(chosen).tolist()}
        self._workers.replace(arguments)
        observation, *_, info = self._call(AutoresetEnvironment.reset, arguments)
        return observation, info

    def step(  # type: ignore[override]  # flags are flags
        self, actions: NDArray[Any]
    ) -> tuple[Observation, Array, Mask, Mask, dict[str, Any]]:
        """Take a step of all environments.

        Args:
            actions: (environments, actions), clipped to -1 to 1.

        Raises:
            InputError: the actions are not this many rows of finite numbers; no environment has taken a step.
        """
        rows = list(actions) if np.iterable(actions) else []
        if len(rows) != self.num_envs:
            raise InputError(f"actions are {shown(actions)}; must have the shape {self.action_space.shape}")
        count = math.prod(self.single_action_space.shape or ())
        arguments = {k: (finite_row(row, count, f"actions[{k}]"),) for k, row in enumerate(rows)}
        return self._call(AutoresetEnvironment.step, arguments)

    @property
    def processes(self) -> tuple[int, ...]:
        """Process number of each worker; environment k is in worker k modulo the number of workers."""
        return self._workers.processes

    def close_extras(self, **kwargs: Any) -> None:
        """End the processes."""
        self._workers.close()

    def _call(
        self, function: Callable[..., _Step], arguments: Mapping[int, tuple[Any, ...]]
    ) -> tuple[Observation, Array, Mask, Mask, dict[str, Any]]:
        """Reset or step some environments; the others return their last observation, and no reward."""
        results = self._workers.call(function, arguments)
        reward, info = np.zeros(self.num_envs), dict[str, Any]()
        terminated, truncated = np.zeros((2, self.num_envs), dtype=bool)
        for k, result in results.items():
            if isinstance(result, InputError) and function is AutoresetEnvironment.reset:
                raise result
            if isinstance(result, Exception):
                truncated[k] = True
                info = self._add_info(info, {"failure": f"{type(result).__name__}: {result}"}, k)
                continue
            self._last[k], reward[k], terminated[k], truncated[k], added = result
            info = self._add_info(info, added, k)
        stacked = {name: np.stack([one[name] for one in self._last]) for name in self._last[0]}
        return stacked, reward, terminated, truncated, info


def vector_environment(
    num_envs: int = 1,
    workers: int = 1,
    autoreset_mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    **arguments: Any,
) -> TaskVectorEnvironment:
    """Return environments of a task.

    Args:
        num_envs: number of environments.
        workers: number of processes that hold them.
        autoreset_mode: what follows the end of an episode.
        arguments: of `environment`.
    """
    return TaskVectorEnvironment(num_envs, workers, AutoresetMode(autoreset_mode), arguments)
