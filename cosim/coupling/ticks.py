"""What ticks are asked for and what they leave, as arrays of documented shapes: a row for each tick."""

from __future__ import annotations

from operator import itemgetter
from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.reduced.sections.assembly import FIGURES


class Servos(NamedTuple):
    """What the servos are asked for in n ticks.

    Args:
        position: (n, joints) [rad].
        velocity: (n, joints) [rad/s].
        torque: (n, joints) [N m], feedforward without payload.
        by_payload: (n, joints, 10), its derivative by the payload's `inertial_parameters`; of none: zero.
    """

    position: Matrix
    velocity: Matrix
    torque: Matrix
    by_payload: Blocks

    @classmethod
    def knowing_no_payload(cls, position: Array, velocity: Array, torque: Array) -> Servos:
        """Return (n, joints) each with a feedforward that is as it is, whatever hangs on the flange."""
        return cls(position, velocity, torque, np.zeros((*position.shape, 10)))

    def some(self, first: int, end: int) -> Servos:
        """Return what is asked for in some of the ticks."""
        return Servos._make(map(itemgetter(slice(first, end)), self))


class CarriedInertia(NamedTuple):
    """What the joints carry meanwhile.

    Args:
        inertia: (joints, joints) [kg m^2], algorithmic mass; (0, 0) for none.
        weights: (k,) of the last accelerations, see `algorithmic_mass.riding_along`.
        past: (k, joints) [rad/s^2], those of the ticks before the last one; kept up to date.
    """

    inertia: Matrix
    weights: Vector
    past: Matrix


class Ticks(NamedTuple):
    """What n ticks leave; of some there is one row more, the first of which is there before.

    Args:
        figures: (n + 1, FIGURES), of the soft side: wrench on the flange, centre and inertia of its mass.
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
        self_contact: (n, 3), points of films on films, sum of their normal forces [N], depth of the deepest
            [m].
        work: (n, 3) [J], of contacts with the scene on the film, of those between films on these, and lost at
            eyelets that know their direction.
    """

    figures: Matrix
    origin: Matrix
    axes: Blocks
    twist: Matrix
    handed: Matrix
    joints: Matrix
    joint_speed: Matrix
    servo_torque: Matrix
    places: Blocks
    quaternions: Blocks
    power: Matrix
    momentum_error: Vector
    residual: Vector
    iterations: Indices
    contacts: Indices
    contact: Matrix
    body_force: Blocks
    self_contact: Matrix
    work: Matrix

    @classmethod
    def room(cls, n: int, joints: int, bodies: int) -> Ticks:
        """Return room for n ticks, in which nothing is touched unless that is filled."""
        return cls(
            np.zeros((n + 1, FIGURES)), np.zeros((n + 1, 3)), np.zeros((n + 1, 3, 3)), np.zeros((n, 6)),
            np.zeros((n + 1, 7)), np.zeros((n, joints)), np.zeros((n, joints)), np.zeros((n, joints)),
            np.zeros((n, bodies, 3)), np.zeros((n, bodies, 4)), np.zeros((n, 3)), np.zeros(n), np.zeros(n),
            np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros((n, 3)), np.zeros((n, bodies, 3)),
            np.zeros((n, 3)), np.zeros((n, 3)),
        )  # fmt: skip

    def from_on(self, first: int) -> Ticks:
        """Return the rows of a tick and all after it."""
        return Ticks._make(map(itemgetter(slice(first, None)), self))

    def flange(self, row: int) -> Pose:
        """Return the flange's pose before a tick."""
        return Pose.owning(self.axes[row].copy(), self.origin[row].copy())
