"""Many ticks as columns: together they are read at a fraction of what they cost one by one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.column import columns_of, listing_columns
from cosim.base.columns import TickColumns
from cosim.base.frames import Array, IntArray, Pose, Twist, Wrench, read_only
from cosim.coupling.schemes.ledger import LedgerEntry, TickPieces
from cosim.devices.device_report import ActuationReport
from cosim.telemetry.snapshot import CameraImage, FilmShapes, Snapshot

if TYPE_CHECKING:  # who only looks at batches needs no kernels
    from cosim.base.solid import LinkContact
    from cosim.coupling.ticks import TicksTaken
    from cosim.soft.solve.branching import Branching, FilmOverlap, Footing

_NOWHERE: Final = np.full(3, np.nan)
_BY_ROW: Final = ("link_contacts", "branchings", "overlaps", "footing", "images", "pieces")
"""What few ticks have: by the rows of those."""
_BY_ROW_ONLY: Final = (*_BY_ROW, "ends")
"""The same, with what no snapshot holds."""
_COLUMNS: Final = columns_of(TickColumns)
_OTHERS: Final = ("flange_twist", "tip_target", "wrench")
"""What snapshots hold otherwise."""
_OF_SNAPSHOT: Final = tuple(f.name for f in fields(Snapshot) if f.name in _COLUMNS and f.name not in _OTHERS)
_OF_LEDGER: Final = tuple(f.name for f in fields(LedgerEntry) if f.name not in _OTHERS)
_NUMBERS: Final = tuple(name for name in _OF_SNAPSHOT if len(_COLUMNS[name].axes) == 1)
_STACKED: Final = tuple(name for name in _OF_SNAPSHOT if name not in _NUMBERS)
"""Arrays of a snapshot, one row each in a batch."""


@final
@listing_columns
@dataclass(frozen=True, eq=False, repr=False)
class TickBatch(TickColumns):
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
    devices: Sequence[ActuationReport | None]
    link_contacts: Mapping[int, tuple[LinkContact, ...]] = field(default_factory=dict)
    branchings: Mapping[int, tuple[Branching, ...]] = field(default_factory=dict)
    overlaps: Mapping[int, tuple[FilmOverlap, ...]] = field(default_factory=dict)
    footing: Mapping[int, Footing] = field(default_factory=dict)
    images: Mapping[int, tuple[CameraImage, ...]] = field(default_factory=dict)
    pieces: Mapping[int, TickPieces] = field(default_factory=dict)
    ends: Mapping[int, Any] = field(default_factory=dict)

    @classmethod
    def of(cls, snapshots: Sequence[Snapshot]) -> TickBatch:
        """Return snapshots of one run as columns.

        Args:
            snapshots: at least one, in order.
        """

        def numbers(name: str, path: str) -> Any:
            return np.array(list(map(attrgetter(path), snapshots)), dtype=_COLUMNS[name].kind)

        def rows(path: str) -> Any:
            return _stacked(list(map(attrgetter(path), snapshots)))

        def by_row(name: str) -> Any:
            return {row: found for row, each in enumerate(snapshots) if (found := getattr(each, name))}

        targets = [snapshot.tip_target for snapshot in snapshots]
        arrays = {name: numbers(name, name) for name in _NUMBERS}
        arrays |= {name: rows(name) for name in _STACKED}
        arrays |= {name: numbers(name, f"ledger.{name}") for name in _OF_LEDGER}
        arrays |= {
            "flange_position": rows("world_from_flange.translation"),
            "flange_rotation": rows("world_from_flange.rotation"),
            "flange_twist": np.hstack([rows("flange_twist.linear"), rows("flange_twist.angular")]),
            "wrench": np.hstack([rows("ledger.wrench.force"), rows("ledger.wrench.torque")]),
            "tip_target": _stacked([_NOWHERE if target is None else target for target in targets]),
            "has_tip_target": np.array([target is not None for target in targets]),
            "energy_J": np.zeros((len(snapshots), 0)),
        }
        film = FilmShapes.of([snapshot.film for snapshot in snapshots])
        devices = [snapshot.devices for snapshot in snapshots]
        return cls(arrays, film, devices, **{name: by_row(name) for name in _BY_ROW})

    @classmethod
    def of_ticks(cls, taken: TicksTaken, arrays: Mapping[str, NDArray[Any]], **rest: Any) -> TickBatch:
        """Return ticks as columns.

        Args:
            taken: what they have left.
            arrays: the columns that this does not know.
            rest: what else the batch is made of.
        """
        return cls(
            {**taken.columns(), "energy_J": np.zeros((taken.done, 0)), **arrays}, pieces=taken.pieces, **rest
        )

    @classmethod
    def joined(cls, batches: Sequence[TickBatch]) -> TickBatch:
        """Return batches of one run as one, at least one batch, in order."""
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
            [report for batch in batches for report in batch.devices],
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
            [self.devices[row] for row in places],
            **{name: by_row(getattr(self, name)) for name in _BY_ROW_ONLY},
        )

    def shown(self) -> TickBatch:
        """Return the same for others to look at: nobody can write to its arrays, which the run may share."""
        return replace(self, arrays={name: read_only(array) for name, array in self.arrays.items()})

    def snapshot(self, row: int) -> Snapshot:
        """Return one tick, in its own arrays."""
        row = range(len(self))[row]
        held, rare = self.arrays, vars(self)
        flange = held["flange_rotation"][row].copy(), held["flange_position"][row].copy()
        wrench, twist = held["wrench"][row], held["flange_twist"][row]
        ledger = Wrench.owning(wrench[:3].copy(), wrench[3:].copy())
        return Snapshot(
            film=self.film[row],
            world_from_flange=Pose.owning(*flange),
            flange_twist=Twist.owning(twist[:3].copy(), twist[3:].copy()),
            tip_target=held["tip_target"][row].copy() if held["has_tip_target"][row] else None,
            ledger=LedgerEntry(ledger, **{name: held[name].item(row) for name in _OF_LEDGER}),
            devices=self.devices[row],
            **{name: rare[name][row] for name in _BY_ROW if row in rare[name]},
            **{name: held[name].item(row) for name in _NUMBERS},
            **{name: held[name][row].copy() for name in _STACKED},
        )


def _stacked(rows: Sequence[Array]) -> Array:
    return np.concatenate(rows).reshape(len(rows), *rows[0].shape)  # in half the time of np.stack
