"""What many ticks show of themselves, as columns: written by what takes them in one go."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, Twist, Wrench
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.telemetry.film_shape import FilmShape

if TYPE_CHECKING:  # who only looks at snapshots needs no kernels
    from cosim.base.link_contact import LinkContact
    from cosim.coupling.soft_sides.shape_reader import ShapeRows


@final
@dataclass(frozen=True, eq=False)
class TickColumns:
    """What n ticks in a row show, one row each; nothing writes to the arrays any more.

    They are ticks of a staggered exchange without contacts and devices. See `Snapshot` and `LedgerEntry`, in
    which one row is read.

    Args:
        tick: (n,), each one more than the one before.
        time_s: (n,).
        phase: of all.
        joint_position: (n, joints) [rad].
        joint_velocity: (n, joints) [rad/s].
        joint_torque: (n, joints) [N m].
        joint_target: (n, joints) [rad].
        body_position: (n, bodies, 3) [m], world.
        body_quaternion: (n, bodies, 4), (w, x, y, z), world from body.
        shapes: of the film.
        flange_position: (n, 3) [m], world.
        flange_rotation: (n, 3, 3), world from flange.
        flange_twist: (n, 6), linear [m/s] and angular [rad/s], world axes.
        cable_tension_N: (n, cables).
        chamber_pressure_Pa: (n, chambers), gauge.
        wrench: (n, 6), force [N] and torque [N m] on the flange, at its origin, world axes.
        rigid_power_W: (n,).
        soft_power_W: (n,).
        power_size_W: (n,).
        residual_N: (n,).
        momentum_error: (n,).
        newton_iterations: (n,).
        stability_ratio: (n,).
        algorithmic_mass: (n,).
        tip_target: (3,) [m] or None, of all.
        tick_wall_s: wall time of each, their mean [s].
        link_contacts: of the arm's links, by row; rows left out have none.
    """

    tick: IntArray
    time_s: Array
    phase: int
    joint_position: Array
    joint_velocity: Array
    joint_torque: Array
    joint_target: Array
    body_position: Array
    body_quaternion: Array
    shapes: ShapeRows
    flange_position: Array
    flange_rotation: Array
    flange_twist: Array
    cable_tension_N: Array
    chamber_pressure_Pa: Array
    wrench: Array
    rigid_power_W: Array
    soft_power_W: Array
    power_size_W: Array
    residual_N: Array
    momentum_error: Array
    newton_iterations: IntArray
    stability_ratio: Array
    algorithmic_mass: Mask
    tip_target: Array | None
    tick_wall_s: float
    link_contacts: Mapping[int, tuple[LinkContact, ...]]

    def __len__(self) -> int:
        return len(self.tick)

    @cached_property
    def clock(self) -> tuple[tuple[int, float], ...]:
        """Tick and time [s] of each row."""
        return tuple(zip(self.tick.tolist(), self.time_s.tolist(), strict=True))

    def all_rows(self, value: float) -> Array:
        """Return (n,) with one value, not to be written to."""
        return np.broadcast_to(np.float64(value), (len(self),))

    @property
    def body_contact_force(self) -> Array:
        """(n, bodies, 3), see `Snapshot`: nothing is touched."""
        return np.broadcast_to(np.zeros(3), self.body_position.shape)

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

    def flange(self, row: int) -> Pose:
        """Return world_from_flange of a row."""
        return Pose.owning(self.flange_rotation[row].copy(), self.flange_position[row].copy())

    def twist(self, row: int) -> Twist:
        """Return the flange's twist in a row."""
        return Twist.owning(self.flange_twist[row, :3].copy(), self.flange_twist[row, 3:].copy())

    def film(self, row: int) -> FilmShape:
        """Return the film's shape of a row."""
        return FilmShape(self.shapes.reader, self.shapes.shape(row), self.flange(row))

    def ledger(self, row: int) -> LedgerEntry:
        """Return what the interface exchanged in a row."""
        return LedgerEntry(
            wrench=Wrench.owning(self.wrench[row, :3].copy(), self.wrench[row, 3:].copy()),
            rigid_power_W=float(self.rigid_power_W[row]),
            soft_power_W=float(self.soft_power_W[row]),
            residual_N=float(self.residual_N[row]),
            newton_iterations=int(self.newton_iterations[row]),
            stability_ratio=float(self.stability_ratio[row]),
            algorithmic_mass=bool(self.algorithmic_mass[row]),
            power_size_W=float(self.power_size_W[row]),
            momentum_error=float(self.momentum_error[row]),
        )


FROM_ROW: Final[dict[str, Callable[[TickColumns, int], Any]]] = {
    "joint_position": lambda c, k: c.joint_position[k].copy(),
    "joint_velocity": lambda c, k: c.joint_velocity[k].copy(),
    "joint_torque": lambda c, k: c.joint_torque[k].copy(),
    "joint_target": lambda c, k: c.joint_target[k].copy(),
    "body_position": lambda c, k: c.body_position[k].copy(),
    "body_quaternion": lambda c, k: c.body_quaternion[k].copy(),
    "body_contact_force": lambda c, k: c.body_contact_force[k].copy(),
    "world_from_flange": TickColumns.flange,
    "flange_twist": TickColumns.twist,
    "pressure_Pa": lambda c, k: float(c.chamber_pressure_Pa[k, 0]),
    "chamber_pressure_Pa": lambda c, k: c.chamber_pressure_Pa[k].copy(),
    "cable_tension_N": lambda c, k: c.cable_tension_N[k].copy(),
    "tip_target": lambda c, k: c.tip_target,
    "ledger": TickColumns.ledger,
    "tick_wall_s": lambda c, k: c.tick_wall_s,
    "link_contacts": lambda c, k: c.link_contacts.get(k, ()),
    "kept_shape": TickColumns.film,
}
"""What a `Snapshot` of a row takes from it when first asked; arrays are its own, so it keeps no others."""
