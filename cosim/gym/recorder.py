"""Keeps the episodes of an environment, to be written as a data set for learning.

A file by itself: `results.episodes`, which writes them, does not need Gymnasium.
"""

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
    """Passes everything on to an environment of a task, and keeps what it returns.

    A step's row holds what was observed before it, the action, and what followed: "next.reward",
    "next.done", "next.success".

    Args:
        environment: of `gymnasium.make("cosim/...")`.
        task: in words.
    """

    def __init__(self, environment: gymnasium.Env[Observation, NDArray[Any]], task: str) -> None:
        super().__init__(environment)
        self.episodes: list[LearningEpisode] = []
        """Those that have ended."""
        self._task, self._rows = task, list[dict[str, Any]]()
        self._seen: Observation = {}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; the steps since the last reset are one that has ended."""
        found = super().reset(seed=seed, options=options)
        self._end()
        self._seen = found[0]
        return found

    def step(self, action: NDArray[Any]) -> tuple[Observation, Any, bool, bool, dict[str, Any]]:
        """Take a step, and keep it."""
        found = super().step(action)
        seen, reward, terminated, truncated, info = found
        done = terminated or truncated
        after = {"next.reward": reward, "next.done": done, "next.success": info["is_success"]}
        self._rows.append({**self._seen, "action": action, **after})
        self._seen = seen
        if done:
            self._end()
        return found

    def write(self, directory: str | Path, *, video: bool = False) -> None:
        """Write all episodes, the present one as far as it is, in LeRobot's layout; see `write_episodes`.

        Args:
            directory: of the data set.
            video: whether pictures go into videos.

        Raises:
            InputError: the directory holds something, or no step has been taken.
            OutputError: it cannot be written.
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
        assert isinstance(inner, TaskEnvironment), "of a task"
        names = {"action": inner.task.actions}
        self.episodes.append(LearningEpisode(self._task, columns, images, names))
