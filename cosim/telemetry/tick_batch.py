"""Many ticks as columns: together they are read at a fraction of what they cost one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import (
    Array,
    IntArray,
    Mask,
    Pose,
    Twist,
    Wrench,
    quaternions_from_rotations,
    read_only,
)
from cosim.coupling.schemes.ledger import LedgerEntry, Scheme, TickPieces
from cosim.devices.device_report import ActuationReport
from cosim.telemetry.snapshot import CameraImage, FilmShapes, Snapshot

if TYPE_CHECKING:  # who only looks at batches needs no kernels
    from cosim.base.solid import LinkContact
    from cosim.coupling.ticks import TicksTaken
    from cosim.soft.solve.branching import Branching, FilmOverlap, Footing

_NONE: Final = np.zeros(0)
_NOWHERE: Final = np.full(3, np.nan)
_STACKED: Final = (
    "joint_position", "joint_velocity", "joint_torque", "joint_target", "body_position", "body_quaternion",
    "body_contact_force", "soft_center", "soft_inertia", "chamber_pressure_Pa", "cable_tension_N",
    "sensor_reading", "sensor_truth", "mounted_load", "body_touch",
)  # fmt: skip
"""Arrays of a snapshot, one row each in a batch."""
_BY_ROW: Final = ("link_contacts", "branchings", "overlaps", "footing", "images", "pieces")
"""What few ticks have: by the rows of those."""
_KINDS: Final[dict[Any, Any]] = {int: np.int64, float: np.float64, bool: np.bool_, Scheme: np.str_}
_OF_LEDGER: Final = {f.name: _KINDS[f.type] for f in fields(LedgerEntry) if f.name != "wrench"}
"""What a ledger says beside the wrench, and of which kind the columns are."""


@dataclass(frozen=True, eq=False, repr=False)
class RigidColumns:
    """When ticks were, and where the rigid side was: columns that a run's result has as well."""

    tick: IntArray
    time_s: Array
    phase: IntArray
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    joint_target: Array
    body_position: Array
    body_quaternion: Array
    body_contact_force: Array


@final
@dataclass(frozen=True, eq=False, repr=False)
class TickBatch(RigidColumns):
    """Ticks of one run, one row each, that nobody writes to any more; see `Snapshot` and `LedgerEntry`.

    Args:
        tick: (n,).
        time_s: (n,).
        phase: (n,) index into `RunInfo.phase_names`.
        joint_position: (n, joints) [rad].
        joint_velocity: (n, joints) [rad/s].
        joint_torque: (n, joints) [N m].
        joint_target: (n, joints) [rad].
        body_position: (n, bodies, 3) [m], world.
        body_quaternion: (n, bodies, 4), (w, x, y, z), world from body.
        body_contact_force: (n, bodies, 3) [N], of the soft robot on each body, mean over the tick, world
            axes. In a staggered tick that is the force found at the end of the one before.
        film: where it is.
        flange_position: (n, 3) [m], world.
        flange_rotation: (n, 3, 3), world from flange.
        flange_twist: (n, 6), linear [m/s] and angular [rad/s], of its origin, world axes.
        soft_center: (n, 3) [m], centre of mass of the soft robot, world.
        soft_inertia: (n, 3, 3) [kg m^2], about that, world axes.
        chamber_pressure_Pa: (n, chambers), gauge.
        cable_tension_N: (n, cables), at the base end.
        sensor_reading: (n, readings), of all sensors one after the other.
        sensor_truth: (n, readings), what they measure.
        tip_target: (n, 3) [m], world; what is free, or not given at all, is not a number.
        has_tip_target: (n,).
        wrench: (n, 6), force [N] and torque [N m] of the soft robot on the flange, at its origin, world axes.
        mounted_load: (n, 6), the same of what is fixed next to it, mean over the tick.
        body_touch: (n, bodies, 3), what touches each body: sum of the soft robot's normal forces on it that
            acted in the tick [N]; of an object also its contacts with what is mounted on flanges, to which
            other arms' soft robots count as one, and with other rigid bodies; of the world also all
            contacts of what is mounted on the own flange with rigid bodies.
        rigid_power_W: (n,), as all that follow down to `slides`; each is described in `LedgerEntry`.
        tick_wall_s: (n,), wall time.
        energy_J: (n, terms) [J], `TERMS` of the balance; (n, 0) before the summary has taken the ticks in,
            and of runs without a balance.
        devices: n; None where a scenario has none.
        link_contacts: of the arm's links, by row; rows left out have none.
        branchings: of the soft robot's states, by row; rows left out have none.
        overlaps: of its films, by row; rows left out have none, or were not looked at.
        footing: of the soft robot, by row, at ends of phases.
        images: of cameras, by row; rows left out have none.
        pieces: of ticks that were taken in pieces, by row.
    """

    film: FilmShapes
    flange_position: Array
    flange_rotation: Array
    flange_twist: Array
    soft_center: Array
    soft_inertia: Array
    chamber_pressure_Pa: Array
    cable_tension_N: Array
    sensor_reading: Array
    sensor_truth: Array
    tip_target: Array
    has_tip_target: Mask
    wrench: Array
    mounted_load: Array
    body_touch: Array
    rigid_power_W: Array
    soft_power_W: Array
    residual_N: Array
    newton_iterations: IntArray
    stability_ratio: Array
    algorithmic_mass: Mask
    contacts: IntArray
    contact_force_N: Array
    contact_depth_m: Array
    contact_ratio: Array
    self_contacts: IntArray
    self_contact_force_N: Array
    self_contact_depth_m: Array
    contact_work_J: Array
    self_contact_work_J: Array
    eyelets_J: Array
    bodies_work_J: Array
    hit_m_s: Array
    hit_way_m: Array
    hit_body: IntArray
    scheme: NDArray[np.str_]
    trials: IntArray
    interface_residual: Array
    power_size_W: Array
    momentum_error: Array
    slides: IntArray
    tick_wall_s: Array
    energy_J: Array
    devices: Sequence[ActuationReport | None]
    link_contacts: Mapping[int, tuple[LinkContact, ...]]
    branchings: Mapping[int, tuple[Branching, ...]]
    overlaps: Mapping[int, tuple[FilmOverlap, ...]]
    footing: Mapping[int, Footing]
    images: Mapping[int, tuple[CameraImage, ...]]
    pieces: Mapping[int, TickPieces]

    @classmethod
    def of(cls, snapshots: Sequence[Snapshot]) -> TickBatch:
        """Return snapshots of one run as columns.

        Args:
            snapshots: at least one, in order.
        """

        def column(name: str, kind: type) -> Any:
            return np.array(list(map(attrgetter(name), snapshots)), dtype=kind)

        def rows(name: str) -> Any:
            return _stacked(list(map(attrgetter(name), snapshots)))

        def by_row(name: str) -> Any:
            return {row: found for row, each in enumerate(snapshots) if (found := getattr(each, name))}

        targets = [snapshot.tip_target for snapshot in snapshots]
        return cls(
            tick=column("tick", np.int64),
            time_s=column("time_s", np.float64),
            phase=column("phase", np.int64),
            film=FilmShapes.of([snapshot.film for snapshot in snapshots]),
            flange_position=rows("world_from_flange.translation"),
            flange_rotation=rows("world_from_flange.rotation"),
            flange_twist=np.hstack([rows("flange_twist.linear"), rows("flange_twist.angular")]),
            tip_target=_stacked([_NOWHERE if target is None else target for target in targets]),
            has_tip_target=np.array([target is not None for target in targets]),
            wrench=np.hstack([rows("ledger.wrench.force"), rows("ledger.wrench.torque")]),
            tick_wall_s=column("tick_wall_s", np.float64),
            energy_J=np.zeros((len(snapshots), 0)),
            devices=[snapshot.devices for snapshot in snapshots],
            **{name: by_row(name) for name in _BY_ROW},
            **{name: rows(name) for name in _STACKED},
            **{name: column(f"ledger.{name}", kind) for name, kind in _OF_LEDGER.items()},
        )

    @classmethod
    def of_ticks(cls, taken: TicksTaken, **rest: Any) -> TickBatch:
        """Return ticks as columns.

        Args:
            taken: what they have left.
            rest: the columns that this does not know.
        """
        n, ticks = taken.done, taken.ticks
        center, inertia = taken.mass()
        return cls(
            joint_position=ticks.joints[:n],
            joint_velocity=ticks.joint_speed[:n],
            joint_torque=ticks.servo_torque[:n],
            body_position=ticks.places[:n],
            body_quaternion=ticks.quaternions[:n],
            body_contact_force=ticks.body_force[:n],
            flange_position=ticks.origin[:n],
            flange_rotation=ticks.axes[:n],
            flange_twist=ticks.twist[:n],
            soft_center=center,
            soft_inertia=inertia,
            chamber_pressure_Pa=taken.pressure_Pa[:n],
            wrench=taken.wrench,
            mounted_load=ticks.mounted[:n],
            body_touch=ticks.touch[:n],
            energy_J=np.zeros((n, 0)),
            pieces=taken.pieces,
            **taken.ledger(),
            **rest,
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

        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(batch, name) for batch in batches]) for name in _ARRAYS
        }
        return cls(
            film=FilmShapes.joined([batch.film for batch in batches]),
            devices=[report for batch in batches for report in batch.devices],
            **{name: by_row(name) for name in _BY_ROW},
            **arrays,
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

        return replace(
            self,
            film=self.film.some(rows),
            devices=[self.devices[row] for row in places],
            **{name: by_row(getattr(self, name)) for name in _BY_ROW},
            **{name: getattr(self, name)[rows] for name in _ARRAYS},
        )

    def shown(self) -> TickBatch:
        """Return the same for others to look at: nobody can write to its arrays, which the run may share."""
        return replace(self, **{name: read_only(getattr(self, name)) for name in _ARRAYS})

    def snapshot(self, row: int) -> Snapshot:
        """Return one tick, in its own arrays."""
        row = range(len(self))[row]
        wrench, twist = self.wrench[row], self.flange_twist[row]
        held = vars(self)
        of_ledger = {name: held[name].item(row) for name in _OF_LEDGER}
        return Snapshot(
            tick=self.tick.item(row),
            time_s=self.time_s.item(row),
            phase=self.phase.item(row),
            film=self.film[row],
            world_from_flange=Pose.owning(self.flange_rotation[row].copy(), self.flange_position[row].copy()),
            flange_twist=Twist.owning(twist[:3].copy(), twist[3:].copy()),
            tip_target=self.tip_target[row].copy() if self.has_tip_target[row] else None,
            ledger=LedgerEntry(Wrench.owning(wrench[:3].copy(), wrench[3:].copy()), **of_ledger),
            tick_wall_s=self.tick_wall_s.item(row),
            devices=self.devices[row],
            **{name: held[name][row] for name in _BY_ROW if row in held[name]},
            **{name: held[name][row].copy() for name in _STACKED},
        )

    @property
    def pressure_Pa(self) -> Array:
        """(n,), gauge, in the first chamber."""
        return self.chamber_pressure_Pa[:, 0]

    @property
    def flange_quaternion(self) -> Array:
        """(n, 4), (w, x, y, z), world from flange."""
        return quaternions_from_rotations(self.flange_rotation)

    @property
    def flange_force(self) -> Array:
        """(n, 3) [N], of all that hangs on the flange, world axes."""
        return self.wrench[:, :3] + self.mounted_load[:, :3]

    @property
    def flange_torque(self) -> Array:
        """(n, 3) [N m], about the flange's origin, world axes."""
        return self.wrench[:, 3:] + self.mounted_load[:, 3:]

    @property
    def palm_contacts(self) -> IntArray:
        """(n,), of what is mounted on the flange with rigid bodies."""
        return self.body_touch[:, :1, 1].sum(axis=1).astype(np.int64)

    @property
    def power_error_W(self) -> Array:
        """(n,), see `LedgerEntry`."""
        return self.rigid_power_W + self.soft_power_W

    @property
    def power_error(self) -> Array:
        """(n,), see `LedgerEntry`."""
        size = self.power_size_W
        moved = size > 0.0
        return np.where(moved, np.abs(self.power_error_W) / np.where(moved, size, 1.0), 0.0)

    @property
    def iterated_trials(self) -> IntArray:
        """(n,), how often ticks were taken that were repeated until the loads agreed; 0 for the others."""
        return np.where(self.scheme == "iterated", self.trials, 0)

    @property
    def node_position(self) -> Array:
        """(n, nodes, 3) [m], world."""
        return self.film.node_position()

    @property
    def tip_position(self) -> Array:
        """(n, 3) [m], world."""
        return self.film.figures.tip_position

    @property
    def tip_direction(self) -> Array:
        """(n, 3), world."""
        return self.film.figures.tip_direction

    @property
    def sag_m(self) -> Array:
        """(n,), see `Snapshot.sag_m`."""
        return self.film.figures.sag_m(self.flange_position, self.flange_rotation[:, :, 2])

    @property
    def chamber_volume_m3(self) -> Array:
        """(n, chambers)."""
        return self.film.figures.volumes_m3

    @property
    def volume_m3(self) -> Array:
        """(n,), of all chambers."""
        return np.asarray(self.chamber_volume_m3.sum(axis=1))

    @property
    def bending_angle_rad(self) -> Array:
        """(n,), between the tip's direction and the flange's z axis."""
        axis, tip = self.flange_rotation[:, :, 2], self.tip_direction
        across = np.cross(axis, tip)
        return np.asarray(np.arctan2(np.sqrt((across * across).sum(axis=1)), (axis * tip).sum(axis=1)))

    @property
    def cable_length_m(self) -> Array:
        """(n, cables), of the routes; (n, 0) in a scenario without devices."""
        return self._of_devices(lambda report: report.cable_length_m)

    @property
    def cable_unstretched_m(self) -> Array:
        """(n, cables), off the drum; (n, 0) in a scenario without devices."""
        return self._of_devices(lambda report: report.unstretched_m)

    def _of_devices(self, read: Callable[[ActuationReport], Array]) -> Array:
        return _stacked([_NONE if report is None else read(report) for report in self.devices])


def _stacked(rows: Sequence[Array]) -> Array:
    return np.concatenate(rows).reshape(len(rows), *rows[0].shape)  # in half the time of np.stack


_NO_ARRAYS: Final = ("film", "devices", *_BY_ROW)
_ARRAYS: Final = tuple(field.name for field in fields(TickBatch) if field.name not in _NO_ARRAYS)
