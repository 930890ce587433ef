"""Where rigid bodies are, by name."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import final

from cosim.base.frames import Array, Pose, rotations_from_quaternions


@final
class BodyPoses(Mapping[str, Pose]):
    """World from each of some rigid bodies, by name; a pose is made when it is asked for.

    Args:
        names: (bodies,).
        positions: (bodies, 3) [m].
        quaternions: (bodies, 4), (w, x, y, z); nobody writes to either.
    """

    def __init__(self, names: tuple[str, ...], positions: Array, quaternions: Array) -> None:
        self._names, self._positions, self._quaternions = names, positions, quaternions

    def __getitem__(self, name: str) -> Pose:
        if name not in self._names:
            raise KeyError(f"there is no rigid body '{name}'; there are: {', '.join(self._names)}")
        k = self._names.index(name)
        (rotation,) = rotations_from_quaternions(self._quaternions[k : k + 1])
        return Pose(rotation, self._positions[k])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        """Return what a dictionary of the poses would."""
        return repr(dict(self))
