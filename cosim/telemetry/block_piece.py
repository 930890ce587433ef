"""The part of a block that is read in one way: rows of one array, or one snapshot after the other."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import groupby
from typing import TYPE_CHECKING, Any, final

import numpy as np

from cosim.base.frames import Array
from cosim.telemetry.snapshot import Snapshot
from cosim.telemetry.tick_columns import TickColumns

if TYPE_CHECKING:
    from cosim.base.link_contact import LinkContact
    from cosim.coupling.soft_sides.shape_reader import Rows, ShapeFigures, ShapeReader


@final
class BlockPiece:
    """Some snapshots of a block, one after the other, all of the same `TickColumns` or none of any.

    Args:
        snapshots: at least one, in order.
        columns: whose rows they are; None where each was made by itself.
    """

    def __init__(self, snapshots: Sequence[Snapshot], columns: TickColumns | None) -> None:
        self.snapshots, self.columns = snapshots, columns

    def __len__(self) -> int:
        return len(self.snapshots)

    @cached_property
    def rows(self) -> Rows:
        """Rows of the columns that they are: a slice where none is left out."""
        found = [snapshot.kept_row[1] for snapshot in self.snapshots if snapshot.kept_row is not None]
        if found[-1] - found[0] == len(found) - 1:
            return slice(found[0], found[-1] + 1)
        return np.array(found, dtype=np.int64)

    @property
    def link_contacts(self) -> list[tuple[int, tuple[LinkContact, ...]]]:
        """Snapshots in which links of the arm touch something, by their place, and what they touch."""
        if self.columns is not None and not self.columns.link_contacts:
            return []
        return [(k, s.link_contacts) for k, s in enumerate(self.snapshots) if s.link_contacts]

    @cached_property
    def figures(self) -> ShapeFigures | None:
        """What is read off the film's shapes; None for snapshots of different runs, or made by hand."""
        if self.columns is not None:
            return self.columns.shapes.figures(self.rows)
        return None if self._kept is None else self._kept[0].figures(self._kept[1])

    @cached_property
    def node_position(self) -> Array:
        """(k, n, 3) [m]."""
        if self.columns is not None:
            return self.columns.shapes.films(self.rows)
        if self._kept is not None:
            return self._kept[0].films(self._kept[1])
        return np.stack([snapshot.node_position for snapshot in self.snapshots])

    @cached_property
    def _kept(self) -> tuple[ShapeReader, list[Any]] | None:
        """Shapes that are still to be read, and what reads all of them."""
        kept = [snapshot.kept_shape for snapshot in self.snapshots]
        readers = {None if shape is None else shape.reader for shape in kept}
        reader = readers.pop()
        if readers or reader is None:
            return None
        return reader, [shape.shape for shape in kept if shape is not None]


def pieces_of(snapshots: Sequence[Snapshot]) -> tuple[BlockPiece, ...]:
    """Return the pieces of a block, in order."""
    parted = groupby(snapshots, key=lambda s: None if s.kept_row is None else s.kept_row[0])
    return tuple(BlockPiece(list(group), columns) for columns, group in parted)
