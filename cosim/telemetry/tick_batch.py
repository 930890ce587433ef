"""Ticks of a run as columns, and a snapshot, one row of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final, final
from warnings import warn

import numpy as np
from numpy.typing import NDArray

from cosim.base.column import listing_columns
from cosim.base.columns import TickRow, TickTable
from cosim.base.frames import IntArray, Pose, Wrench, read_only
from cosim.coupling.shape_figures import SubstepRecord
from cosim.devices.device_report import ActuationReport
from cosim.telemetry.camera_image import CameraImage
from cosim.telemetry.film_shapes import FilmShapes

if TYPE_CHECKING:  # batches are read without kernels
    from cosim.base.solid import LinkContact
    from cosim.soft.solve.branching import Branching, FilmOverlap, StabilityReport

_BY_ROW: Final = ("link_contacts", "branchings", "overlaps", "stability", "images", "substeps")
"""Fields of a batch that few ticks have, by row."""
_BY_ROW_ONLY: Final = (*_BY_ROW, "ends")
"""The same, with those that snapshots do not have."""


@final
@listing_columns
@dataclass(frozen=True, eq=False, repr=False)
class TickBatch(TickTable):
    """Ticks of one run, one row each, which are not changed any more; columns are attributes.

    Args:
        arrays: stored columns by name; `energy_J` is (n, 0) before the summary has observed the ticks, and in
            runs without a balance.
        film: shapes of the film.
        devices: n reports; None in a scenario without devices.
        link_contacts: contacts of the arm's links, by row; missing rows have none.
        branchings: of the soft robot's equilibria, by row; missing rows have none.
        overlaps: of its films, by row; missing rows have none, or were not checked.
        stability: of the soft robot, by row, at ends of phases.
        images: of cameras, by row; missing rows have none.
        substeps: of ticks that were taken in substeps, by row.
        ends: states of the soft side at ends of phases, by row, see `SoftRobot.end_state`.
    """

    arrays: Mapping[str, NDArray[Any]]
    film: FilmShapes
    devices: tuple[ActuationReport | None, ...]
    link_contacts: Mapping[int, tuple[LinkContact, ...]] = field(default_factory=dict)
    branchings: Mapping[int, tuple[Branching, ...]] = field(default_factory=dict)
    overlaps: Mapping[int, tuple[FilmOverlap, ...]] = field(default_factory=dict)
    stability: Mapping[int, StabilityReport] = field(default_factory=dict)
    images: Mapping[int, tuple[CameraImage, ...]] = field(default_factory=dict)
    substeps: Mapping[int, SubstepRecord] = field(default_factory=dict)
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
            shifted = zip(begins, batches, strict=False)
            return {a + row: value for a, each in shifted for row, value in getattr(each, name).items()}

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
        """Return some of the ticks, by their rows, in new arrays."""
        new = {row: k for k, row in enumerate(rows.tolist())}

        def by_row(values: Mapping[int, Any]) -> Any:
            return {new[row]: value for row, value in values.items() if row in new}

        return TickBatch(
            {name: array[rows] for name, array in self.arrays.items()},
            self.film.some(rows),
            tuple(self.devices[row] for row in rows.tolist()),
            **{name: by_row(getattr(self, name)) for name in _BY_ROW_ONLY},
        )

    def shown(self) -> TickBatch:
        """Return the same with read-only arrays, for observers; the run may share the arrays."""
        return replace(self, arrays={name: read_only(array) for name, array in self.arrays.items()})

    def changed(self, **columns: Any) -> TickBatch:
        """Return the same with other values of some columns, by name."""
        values = {name: np.array(value) for name, value in columns.items()}
        return replace(self, arrays={**self.arrays, **values})

    def snapshot(self, row: int) -> Snapshot:
        """Return one tick, in new arrays."""
        k = range(len(self))[row]
        arrays = {name: array[k : k + 1].copy() for name, array in self.arrays.items()}
        for array in arrays.values():
            array.setflags(write=False)
        film, rare = self.film.some(np.array([k])), vars(self)
        by_row = {name: {0: rare[name][k]} for name in _BY_ROW if k in rare[name]}
        return Snapshot(TickBatch(arrays, film, (self.devices[k],), **by_row))


@final
@dataclass(frozen=True, repr=False, eq=False)
class Snapshot(TickRow):
    """State at the end of one tick, with read-only arrays.

    Its columns are attributes, see `TickBatch`, such as `time_s`, a number, and `tip_position` (3,). `wrench`
    is a `Wrench`, `flange_twist` a `Twist`, and `tip_target` None without a target.

    Args:
        table: the tick as a batch.
    """

    table: TickBatch

    @property
    def world_from_flange(self) -> Pose:
        """Pose of the flange."""
        return Pose(self.flange_rotation, self.flange_position)

    @property
    def flange_wrench(self) -> Wrench:
        """Wrench of everything on the flange, at its origin, world axes."""
        return Wrench(self.flange_force, self.flange_torque)

    @property
    def devices(self) -> ActuationReport | None:
        """Report of pumps, winches and controllers; None in a scenario without."""
        return self.table.devices[0]

    @property
    def link_contacts(self) -> tuple[LinkContact, ...]:
        """Contacts of the arm's links, at ticks that check them."""
        return self.table.link_contacts.get(0, ())

    @property
    def branchings(self) -> tuple[Branching, ...]:
        """Unstable states of the soft robot in the tick."""
        return self.table.branchings.get(0, ())

    @property
    def overlaps(self) -> tuple[FilmOverlap, ...]:
        """Overlaps of its films, at ticks that check them."""
        return self.table.overlaps.get(0, ())

    @property
    def stability(self) -> StabilityReport | None:
        """Stability of the soft robot at the end of a phase; None if it is unknown."""
        return self.table.stability.get(0)

    @property
    def footing(self) -> StabilityReport | None:
        """The same as `stability`."""
        warn("Snapshot.footing: is Snapshot.stability now", DeprecationWarning, stacklevel=2)
        return self.stability

    @property
    def images(self) -> tuple[CameraImage, ...]:
        """Images of the cameras that take one at this tick."""
        return self.table.images.get(0, ())

    @property
    def ledger(self) -> Snapshot:
        """The snapshot: `snapshot.ledger.contacts` is `snapshot.contacts`."""
        warn("Snapshot.ledger: read its figures off the snapshot", DeprecationWarning, stacklevel=2)
        return self

    @property
    def film(self) -> Snapshot:
        """The snapshot: `snapshot.film.tip_position` is `snapshot.tip_position`."""
        warn("Snapshot.film: read its figures off the snapshot", DeprecationWarning, stacklevel=2)
        return self

    def kept(self) -> Snapshot:
        """Return the same to be saved: with the film's shape read, without images."""
        return Snapshot(replace(self.table, film=self.table.film.read(), images={}))

    def __repr__(self) -> str:
        """Return two lines: time and sizes, tip and loads."""
        tip = ", ".join(f"{1e3 * value:.1f}" for value in self.tip_position)
        pressures = ", ".join(f"{1e-3 * value:g}" for value in self.chamber_pressure_Pa)
        return (
            f"Snapshot of tick {self.tick}, {self.time_s:g} s, phase {self.phase}: "
            f"{len(self.joint_position)} joints, {len(self.body_position)} bodies, "
            f"{len(self.node_position)} nodes\n"
            f"tip at ({tip}) mm, sag {1e3 * self.sag_m:.1f} mm, {pressures} kPa, "
            f"{self.contacts} contacts, residual {self.residual_N:.1e} N"
        )
