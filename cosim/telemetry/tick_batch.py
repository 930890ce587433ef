"""Many ticks as columns: together they are read at a fraction of what they cost one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.column import listing_columns
from cosim.base.columns import TickTable
from cosim.base.frames import IntArray, read_only
from cosim.coupling.film_figures import TickPieces
from cosim.devices.device_report import ActuationReport
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.snapshot import CameraImage, Snapshot

if TYPE_CHECKING:  # who only looks at batches needs no kernels
    from cosim.base.solid import LinkContact
    from cosim.soft.solve.branching import Branching, FilmOverlap, Footing

_BY_ROW: Final = ("link_contacts", "branchings", "overlaps", "footing", "images", "pieces")
"""What few ticks have: by the rows of those."""
_BY_ROW_ONLY: Final = (*_BY_ROW, "ends")
"""The same, with what no snapshot holds."""


@final
@listing_columns
@dataclass(frozen=True, eq=False, repr=False)
class TickBatch(TickTable):
    """Ticks of one run, one row each, that nobody writes to any more; its columns are attributes.

    Args:
        arrays: columns that are stored, by name; `energy_J` is (n, 0) before the summary has taken the ticks
            in, and of runs without a balance.
        film: where it is.
        devices: n; None where a scenario has none.
        link_contacts: of the arm's links, by row; rows left out have none.
        branchings: of the soft robot's states, by row; rows left out have none.
        overlaps: of its films, by row; rows left out have none, or were not looked at.
        footing: of the soft robot, by row, at ends of phases.
        images: of cameras, by row; rows left out have none.
        pieces: of ticks that were taken in pieces, by row.
        ends: of phases, by row: states of the soft side, see `SoftSide.end_state`.
    """

    arrays: Mapping[str, NDArray[Any]]
    film: FilmShapes
    devices: tuple[ActuationReport | None, ...]
    link_contacts: Mapping[int, tuple[LinkContact, ...]] = field(default_factory=dict)
    branchings: Mapping[int, tuple[Branching, ...]] = field(default_factory=dict)
    overlaps: Mapping[int, tuple[FilmOverlap, ...]] = field(default_factory=dict)
    footing: Mapping[int, Footing] = field(default_factory=dict)
    images: Mapping[int, tuple[CameraImage, ...]] = field(default_factory=dict)
    pieces: Mapping[int, TickPieces] = field(default_factory=dict)
    ends: Mapping[int, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, snapshots: Sequence[Snapshot]) -> TickBatch:
        """Return snapshots as one batch, at least one, in order."""
        return cls.joined([snapshot.table for snapshot in snapshots])

    @classmethod
    def joined(cls, batches: Sequence[TickBatch]) -> TickBatch:
        """Return batches as one, at least one batch, in order."""
        if len(batches) == 1:
            return batches[0]
        begins = np.cumsum([0, *map(len, batches)]).tolist()

        def by_row(name: str) -> Any:
            placed = zip(begins, batches, strict=False)
            return {a + row: found for a, each in placed for row, found in getattr(each, name).items()}

        names = batches[0].arrays
        return cls(
            {name: np.concatenate([batch.arrays[name] for batch in batches]) for name in names},
            FilmShapes.joined([batch.film for batch in batches]),
            tuple(report for batch in batches for report in batch.devices),
            **{name: by_row(name) for name in _BY_ROW_ONLY},
        )

    def __len__(self) -> int:
        return len(self.tick)

    def __iter__(self) -> Iterator[Snapshot]:
        """Yield the ticks one by one."""
        return map(self.snapshot, range(len(self)))

    def some(self, rows: IntArray) -> TickBatch:
        """Return some of the ticks, by their rows, in their own arrays."""
        places = {row: place for place, row in enumerate(rows.tolist())}

        def by_row(given: Mapping[int, Any]) -> Any:
            return {places[row]: found for row, found in given.items() if row in places}

        return TickBatch(
            {name: array[rows] for name, array in self.arrays.items()},
            self.film.some(rows),
            tuple(self.devices[row] for row in places),
            **{name: by_row(getattr(self, name)) for name in _BY_ROW_ONLY},
        )

    def shown(self) -> TickBatch:
        """Return the same for others to look at: nobody can write to its arrays, which the run may share."""
        return replace(self, arrays={name: read_only(array) for name, array in self.arrays.items()})

    def changed(self, **columns: Any) -> TickBatch:
        """Return the same with other values of some columns, by name."""
        given = {name: np.array(value) for name, value in columns.items()}
        return replace(self, arrays={**self.arrays, **given})

    def snapshot(self, row: int) -> Snapshot:
        """Return one tick, in its own arrays."""
        k = range(len(self))[row]
        arrays = {name: array[k : k + 1].copy() for name, array in self.arrays.items()}
        for array in arrays.values():
            array.setflags(write=False)
        film, rare = self.film.some(np.array([k])), vars(self)
        by_row = {name: {0: rare[name][k]} for name in _BY_ROW if k in rare[name]}
        return Snapshot(TickBatch(arrays, film, (self.devices[k],), **by_row))
