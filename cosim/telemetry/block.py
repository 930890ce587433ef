"""Snapshots of some ticks in a row, read as arrays: together they cost a fraction of one by one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, quaternions_from_rotations
from cosim.telemetry.block_piece import BlockPiece, pieces_of
from cosim.telemetry.snapshot import LedgerEntry, Snapshot
from cosim.telemetry.tick_columns import TickColumns

if TYPE_CHECKING:
    from cosim.base.link_contact import LinkContact
    from cosim.coupling.soft_sides.shape_reader import ShapeFigures

READ_AT_ONCE: Final = 64
"""Snapshots that observers gather before they read them: more cost no less each, fine meshes are large."""
_ROWS_AT_ONCE: Final = 512
"""The same of rows, which are small."""

_OfColumns: TypeAlias = Callable[[TickColumns], Any]
_NONE: Final = np.zeros(0)
_NOWHERE: Final = np.full(3, np.nan)


def read_now(gathered: Sequence[Snapshot]) -> bool:
    """Whether what an observer has gathered, at least one, is enough for a block."""
    count = len(gathered)
    return count >= READ_AT_ONCE and (count >= _ROWS_AT_ONCE or gathered[-1].kept_row is None)


def _column(of_columns: _OfColumns, of_snapshots: Callable[[Sequence[Snapshot]], Any]) -> Any:
    """Return a property of `Block` that reads columns where there are some, else every snapshot.

    Args:
        of_columns: returns (n, ...), or the value that all rows have.
        of_snapshots: returns (k, ...) of k snapshots.
    """

    def of_piece(piece: BlockPiece) -> Any:
        if piece.columns is None:
            return of_snapshots(piece.snapshots)
        found = of_columns(piece.columns)
        return found[piece.rows] if isinstance(found, np.ndarray) else np.full(len(piece), found)

    return cached_property(lambda block: _joined([of_piece(piece) for piece in block.pieces]))


def _numbers(of_columns: _OfColumns, of_snapshot: Callable[[Snapshot], float]) -> cached_property[Array]:
    found: cached_property[Array] = _column(of_columns, lambda s: _each(s, of_snapshot, np.float64))
    return found


def _counts(of_columns: _OfColumns, of_snapshot: Callable[[Snapshot], int]) -> cached_property[IntArray]:
    found: cached_property[IntArray] = _column(of_columns, lambda s: _each(s, of_snapshot, np.int64))
    return found


def _flags(of_columns: _OfColumns, of_snapshot: Callable[[Snapshot], bool]) -> cached_property[Mask]:
    found: cached_property[Mask] = _column(of_columns, lambda s: _each(s, of_snapshot, np.bool_))
    return found


def _rows(of_columns: _OfColumns, of_snapshot: Callable[[Snapshot], Array]) -> cached_property[Array]:
    found: cached_property[Array] = _column(of_columns, lambda s: _stacked(s, of_snapshot))
    return found


def _each(snapshots: Sequence[Snapshot], read: Callable[[Snapshot], Any], kind: type) -> Any:
    return np.array([read(snapshot) for snapshot in snapshots], dtype=kind)


def _stacked(snapshots: Sequence[Snapshot], read: Callable[[Snapshot], Array]) -> Array:
    found = [read(snapshot) for snapshot in snapshots]
    return np.concatenate(found).reshape(len(found), *found[0].shape)  # in half the time of np.stack


def _of_contact(of_entry: Callable[[LedgerEntry], float]) -> cached_property[Array]:
    return _numbers(lambda c: 0.0, lambda s: of_entry(s.ledger))


def _no_cables(columns: TickColumns) -> Array:
    return np.zeros((len(columns), 0))


def _or_nowhere(target: Array | None) -> Array:
    return _NOWHERE if target is None else target


def _joined(parts: Sequence[Any]) -> Any:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


@final
class Block:
    """Some snapshots of one run; those that are rows of `TickColumns` are read off the columns.

    Every property is an array with one row per snapshot that nobody may write to; see `Snapshot` and
    `LedgerEntry`.

    Args:
        snapshots: at least one, in order.
    """

    def __init__(self, snapshots: Sequence[Snapshot]) -> None:
        self.snapshots = snapshots

    def __len__(self) -> int:
        return len(self.snapshots)

    def numbers(self, read: Callable[[Snapshot], float]) -> Array:
        """Return one number of each snapshot (k,)."""
        return np.asarray(_each(self.snapshots, read, np.float64))

    def rows(self, read: Callable[[Snapshot], Array]) -> Array:
        """Return one array (m,) of each snapshot, the same m in all: (k, m)."""
        return _stacked(self.snapshots, read)

    @cached_property
    def pieces(self) -> tuple[BlockPiece, ...]:
        """What is read in one way each."""
        return pieces_of(self.snapshots)

    tick = _counts(lambda c: c.tick, lambda s: s.tick)
    time_s = _numbers(lambda c: c.time_s, lambda s: s.time_s)
    phase = _counts(lambda c: c.phase, lambda s: s.phase)
    joint_position = _rows(lambda c: c.joint_position, lambda s: s.joint_position)
    joint_velocity = _rows(lambda c: c.joint_velocity, lambda s: s.joint_velocity)
    joint_torque = _rows(lambda c: c.joint_torque, lambda s: s.joint_torque)
    joint_target = _rows(lambda c: c.joint_target, lambda s: s.joint_target)
    body_position = _rows(lambda c: c.body_position, lambda s: s.body_position)
    body_quaternion = _rows(lambda c: c.body_quaternion, lambda s: s.body_quaternion)
    body_contact_force = _rows(lambda c: c.body_contact_force, lambda s: s.body_contact_force)
    pressure_Pa = _numbers(lambda c: c.chamber_pressure_Pa[:, 0], lambda s: s.pressure_Pa)
    chamber_pressure_Pa = _rows(lambda c: c.chamber_pressure_Pa, lambda s: s.chamber_pressure_Pa)
    cable_tension_N = _rows(lambda c: c.cable_tension_N, lambda s: s.cable_tension_N)
    cable_length_m = _rows(_no_cables, lambda s: _NONE if s.devices is None else s.devices.cable_length_m)
    cable_unstretched_m = _rows(_no_cables, lambda s: _NONE if s.devices is None else s.devices.unstretched_m)
    flange_position = _rows(lambda c: c.flange_position, lambda s: s.world_from_flange.translation)
    flange_rotation = _rows(lambda c: c.flange_rotation, lambda s: s.world_from_flange.rotation)
    flange_force = _rows(lambda c: c.wrench[:, :3], lambda s: s.ledger.wrench.force)
    flange_torque = _rows(lambda c: c.wrench[:, 3:], lambda s: s.ledger.wrench.torque)
    power_error_W = _numbers(lambda c: c.power_error_W, lambda s: s.ledger.power_error_W)
    power_error = _numbers(lambda c: c.power_error, lambda s: s.ledger.power_error)
    momentum_error = _numbers(lambda c: c.momentum_error, lambda s: s.ledger.momentum_error)
    residual_N = _numbers(lambda c: c.residual_N, lambda s: s.ledger.residual_N)
    slides = _counts(lambda c: 0, lambda s: s.ledger.slides)
    newton_iterations = _counts(lambda c: c.newton_iterations, lambda s: s.ledger.newton_iterations)
    stability_ratio = _numbers(lambda c: c.stability_ratio, lambda s: s.ledger.stability_ratio)
    contacts = _counts(lambda c: 0, lambda s: s.ledger.contacts)
    contact_force_N = _of_contact(lambda entry: entry.contact_force_N)
    contact_depth_m = _of_contact(lambda entry: entry.contact_depth_m)
    self_contacts = _counts(lambda c: 0, lambda s: s.ledger.self_contacts)
    self_contact_force_N = _of_contact(lambda entry: entry.self_contact_force_N)
    self_contact_depth_m = _of_contact(lambda entry: entry.self_contact_depth_m)
    interface_residual = _numbers(lambda c: 0.0, lambda s: s.ledger.interface_residual)
    iterated_trials = _counts(lambda c: 0, lambda s: s.ledger.trials if s.ledger.scheme == "iterated" else 0)
    tick_wall_s = _numbers(lambda c: c.tick_wall_s, lambda s: s.tick_wall_s)
    has_tip_target = _flags(lambda c: c.tip_target is not None, lambda s: s.tip_target is not None)
    tip_target = _rows(
        lambda c: np.broadcast_to(_or_nowhere(c.tip_target), (len(c), 3)), lambda s: _or_nowhere(s.tip_target)
    )

    @property
    def link_contacts(self) -> list[tuple[int, tuple[LinkContact, ...]]]:
        """Rows in which links of the arm touch something, and what they touch."""
        found, begin = [], 0
        for piece in self.pieces:
            found += [(begin + k, contacts) for k, contacts in piece.link_contacts]
            begin += len(piece)
        return found

    @cached_property
    def flange_quaternion(self) -> Array:
        """(k, 4), (w, x, y, z)."""
        return quaternions_from_rotations(self.flange_rotation)

    @cached_property
    def node_position(self) -> Array:
        """(k, nodes, 3) [m]."""
        return np.asarray(_joined([piece.node_position for piece in self.pieces]))

    @cached_property
    def tip_position(self) -> Array:
        """(k, 3) [m]."""
        return self._of_shapes(lambda f: f.tip_position, lambda s: s.tip_position)

    @cached_property
    def tip_direction(self) -> Array:
        """(k, 3)."""
        return self._of_shapes(lambda f: f.tip_direction, lambda s: s.tip_direction)

    @cached_property
    def bending_angle_rad(self) -> Array:
        """(k,), between the tip's direction and the flange's z axis."""
        axis, tip = self.flange_rotation[:, :, 2], self.tip_direction
        across = np.cross(axis, tip)
        return np.asarray(np.arctan2(np.sqrt((across * across).sum(axis=1)), (axis * tip).sum(axis=1)))

    @cached_property
    def chamber_volume_m3(self) -> Array:
        """(k, chambers)."""
        return self._of_shapes(lambda f: f.volumes_m3, lambda s: s.chamber_volume_m3)

    @cached_property
    def volume_m3(self) -> Array:
        """(k,), of all chambers."""
        return np.asarray(self.chamber_volume_m3.sum(axis=1))

    @cached_property
    def sag_m(self) -> Array:
        """(k,)."""
        origin, axis, found, begin = self.flange_position, self.flange_rotation[:, :, 2], [], 0
        for piece in self.pieces:
            end = begin + len(piece)
            if piece.figures is None:
                found.append(np.array([snapshot.sag_m for snapshot in piece.snapshots]))
            else:
                found.append(piece.figures.sag_m(origin[begin:end], axis[begin:end]))
            begin = end
        return np.asarray(_joined(found))

    def _of_shapes(
        self, of_figures: Callable[[ShapeFigures], Array], of_snapshot: Callable[[Snapshot], Array]
    ) -> Array:
        found = [
            _stacked(piece.snapshots, of_snapshot) if piece.figures is None else of_figures(piece.figures)
            for piece in self.pieces
        ]
        return np.asarray(_joined(found))
