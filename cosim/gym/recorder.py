"""Records the episodes of an environment, to write them as a data set for learning."""

from pathlib import Path
from typing import Any, final

import gymnasium
import numpy as np
from numpy.typing import NDArray

from cosim.gym.environment import Observation, TaskEnvironment
from cosim.gym.tasks import STEP_S
from cosim.results.episodes import LearningEpisode, write_episodes


@final
class EpisodeRecorder(gymnasium.Wrapper[Observation, NDArray[Any], Observation, NDArray[Any]]):
    """Wraps an environment of a task and records its steps.

    The row of a step has the observation before it, the action, and the results: "next.reward",
    "next.done", "next.success".

    Args:
        environment: of `gymnasium.make("cosim/...")`.
        task: in words.
    """

    def __init__(self, environment: gymnasium.Env[Observation, NDArray[Any]], task: str) -> None:
        super().__init__(environment)
        self.episodes: list[LearningEpisode] = []
        """Episodes that have ended."""
        self._task, self._rows = task, list[dict[str, Any]]()
        self._observation: Observation = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode, which ends the one before."""
        observation, info = super().reset(seed=seed, options=options)
        self._end()
        self._observation = observation
        return observation, info

    def step(self, action: NDArray[Any]) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Take a step, and record it."""
        observation, reward, terminated, truncated, info = super().step(action)
        done = terminated or truncated
        after = {"next.reward": reward, "next.done": done, "next.success": info["is_success"]}
        self._rows.append({**self._observation, "action": action, **after})
        self._observation = observation
        if done:
            self._end()
        return observation, reward, terminated, truncated, info

    def write(self, directory: str | Path, *, video: bool = False) -> None:
        """Write all episodes, with the unfinished present one, in LeRobot's layout; see `write_episodes`.

        Args:
            directory: of the data set.
            video: whether pictures are written as videos.

        Raises:
            InputError: the directory is not empty, or no step has been taken.
            OutputError: the directory cannot be written.
        """
        self._end()
        write_episodes(directory, self.episodes, 1.0 / STEP_S, video=video)

    def _end(self) -> None:
        if not self._rows:
            return
        rows = {name: np.array([row[name] for row in self._rows]) for name in self._rows[0]}
        self._rows = []
        images = {name: rows.pop(name) for name in [*rows] if rows[name].ndim == 4}
        columns = {
            "observation.state": rows.pop("observation"),
            "observation.environment_state": np.hstack([rows.pop("achieved_goal"), rows.pop("desired_goal")]),
            **rows,
        }
        inner = self.unwrapped
        assert isinstance(inner, TaskEnvironment), "an environment of a task"
        names = {"action": inner.task.actions}
        self.episodes.append(LearningEpisode(self._task, columns, images, names))
