"""What the kernel of many ticks is given and what it leaves, as arrays of documented shapes."""

from __future__ import annotations

from typing import NamedTuple

from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDICES, MATRIX, VECTOR
from cosim.coupling.batch.added_inertia import AddedInertiaRow
from cosim.reduced.sections.section_strains import CUBE

_MOTIONS = types.Array(types.float64, 5, "C")


class Commands(NamedTuple):
    """What is asked for in each of n ticks.

    Args:
        position: (n, joints) [rad].
        velocity: (n, joints) [rad/s].
        torque: (n, joints) [N m], feedforward without payload.
        by_payload: (n, joints, 10), its derivative by the payload's `inertial_parameters`; of none: zero.
        pressure: (n,) [Pa].
        first: (n,), first of the spline's functions that are not zero at that pressure.
        weights: (n, TERMS), their values.
        tension: (n, k) [N], of all cable segments.
    """

    position: Array
    velocity: Array
    torque: Array
    by_payload: Array
    pressure: Array
    first: IntArray
    weights: Array
    tension: Array

    def rows(self, first: int, end: int) -> Commands:
        """Return what is asked for in some of the ticks."""
        return Commands(*(array[first:end] for array in self))  # type: ignore[arg-type]


class Ticks(NamedTuple):
    """What n ticks leave; of some there is one row more, the first of which is there before.

    Args:
        figures: (n + 1, FIGURES), of the soft side.
        origin: (n + 1, 3) [m], of the flange.
        axes: (n + 1, 3, 3), world from flange.
        twist: (n, 6), of the flange's origin, linear then angular, world axes.
        handed: (n + 1, 7), the wrench about the world's origin, and its size [N].
        joints: (n, joints) [rad].
        joint_speed: (n, joints) [rad/s].
        servo_torque: (n, joints) [N m].
        places: (n, bodies, 3) [m].
        quaternions: (n, bodies, 4).
        power: (n, 3) [W], received by the rigid side, taken in by the soft one, and the size of such a power.
        momentum_error: (n,), see `LedgerEntry`.
        residual: (n,) [N].
        iterations: (n,).
        contacts: (n,), points that press.
        contact: (n, 3), sum of their normal forces [N], depth of the deepest [m], contact ratio.
        body_force: (n, bodies, 3) [N], of the soft robot on each body, world axes.
    """

    figures: Array
    origin: Array
    axes: Array
    twist: Array
    handed: Array
    joints: Array
    joint_speed: Array
    servo_torque: Array
    places: Array
    quaternions: Array
    power: Array
    momentum_error: Array
    residual: Array
    iterations: IntArray
    contacts: IntArray
    contact: Array
    body_force: Array

    def from_on(self, first: int) -> Ticks:
        """Return the rows of a tick and all after it."""
        return Ticks(*(array[first:] for array in self))  # type: ignore[arg-type]


class ChainMotion(NamedTuple):
    """How a chain moves in n ticks.

    Args:
        motion: (n + 2, 2, f, 4, 3), from the step before the last one on.
        gradient: (n, f, 6).
    """

    motion: Array
    gradient: Array

    def from_on(self, first: int) -> ChainMotion:
        """Return the rows of a tick and all after it."""
        return ChainMotion(self.motion[first:], self.gradient[first:])


CARRIED = types.NamedTuple((MATRIX, VECTOR, MATRIX), AddedInertiaRow)
COMMANDS = types.NamedTuple((MATRIX, MATRIX, MATRIX, BLOCKS, VECTOR, INDICES, MATRIX, MATRIX), Commands)
TICKS = types.NamedTuple(
    (
        MATRIX, MATRIX, CUBE, MATRIX, MATRIX, MATRIX, MATRIX, MATRIX, CUBE, CUBE, MATRIX,
        VECTOR, VECTOR, INDICES, INDICES, MATRIX, CUBE,
    ),
    Ticks,
)  # fmt: skip
CHAIN_MOTION = types.NamedTuple((_MOTIONS, CUBE), ChainMotion)
