"""Snapshots of some ticks in a row, read as arrays: together they cost a fraction of one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.frames import Array, IntArray, quaternions_from_rotations
from cosim.scenario.snapshot import Snapshot

if TYPE_CHECKING:
    from cosim.coupling.shape_reader import ShapeFigures


READ_AT_ONCE: Final = 64
"""Snapshots that observers gather before they read them: more cost no less each, fine meshes are large."""


@final
class Block:
    """Some snapshots of one run.

    Args:
        snapshots: at least one, in order.
    """

    def __init__(self, snapshots: Sequence[Snapshot]) -> None:
        self.snapshots = snapshots

    def __len__(self) -> int:
        return len(self.snapshots)

    def numbers(self, read: Callable[[Snapshot], float]) -> Array:
        """Return one number of each snapshot (k,)."""
        return np.array([read(snapshot) for snapshot in self.snapshots], dtype=np.float64)

    def counts(self, read: Callable[[Snapshot], int]) -> IntArray:
        """Return one count of each snapshot (k,)."""
        return np.array([read(snapshot) for snapshot in self.snapshots], dtype=np.int64)

    def rows(self, read: Callable[[Snapshot], Array]) -> Array:
        """Return one array (m,) of each snapshot, the same m in all: (k, m)."""
        found = [read(snapshot) for snapshot in self.snapshots]
        return np.concatenate(found).reshape(len(found), len(found[0]))

    @cached_property
    def tip_position(self) -> Array:
        """(k, 3) [m]."""
        return self.rows(lambda s: s.tip_position) if self._figures is None else self._figures.tip_position

    @cached_property
    def tip_direction(self) -> Array:
        """(k, 3)."""
        return self.rows(lambda s: s.tip_direction) if self._figures is None else self._figures.tip_direction

    @cached_property
    def chamber_volume_m3(self) -> Array:
        """(k, chambers)."""
        if self._figures is None:
            return self.rows(lambda s: s.chamber_volume_m3)
        return self._figures.volumes_m3

    @cached_property
    def flange_position(self) -> Array:
        """(k, 3) [m]."""
        return self.rows(lambda s: s.world_from_flange.translation)

    @cached_property
    def flange_rotation(self) -> Array:
        """(k, 3, 3), world from flange."""
        return np.stack([snapshot.world_from_flange.rotation for snapshot in self.snapshots])

    @property
    def flange_quaternion(self) -> Array:
        """(k, 4), (w, x, y, z)."""
        return quaternions_from_rotations(self.flange_rotation)

    @cached_property
    def sag_m(self) -> Array:
        """(k,)."""
        figures = self._figures
        if figures is None:
            return self.numbers(lambda s: s.sag_m)
        return figures.sag_m(self.flange_position, self.flange_rotation[:, :, 2])

    @cached_property
    def _figures(self) -> ShapeFigures | None:
        kept = [snapshot.kept_shape for snapshot in self.snapshots]
        readers = {None if shape is None else shape.reader for shape in kept}
        reader = readers.pop()
        if readers or reader is None:
            return None  # of different runs, or made by hand
        return reader.figures([shape.shape for shape in kept if shape is not None])
