"""What n ticks leave, as arrays with a row for each, and the leaf that fills those of the rigid side."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, Indices, Matrix, Vector
from cosim.base.kernels import copy, copy_rows, kernel
from cosim.reduced.sections.assembly import FIGURES

if TYPE_CHECKING:
    from cosim.rigid.scene.coupled_scene import CoupledScene


class SceneRows(NamedTuple):
    """Views of where a scene is: MuJoCo's arrays, which stay where they are in memory.

    Args:
        joints: (joints,) [rad].
        joint_speed: (joints,) [rad/s].
        servo_torque: (joints,) [N m].
        origin: (3,) [m], of the flange.
        axes: (3, 3), world from flange.
        places: (bodies, 3) [m].
        quaternions: (bodies, 4), world from body.
        mounted: (6,), force [N] and torque [N m] of what is fixed next to the soft robot on the flange, at
            its origin, world axes: weight, inertia and contacts, mean over the last rigid step.
    """

    joints: Vector
    joint_speed: Vector
    servo_torque: Vector
    origin: Vector
    axes: Matrix
    places: Matrix
    quaternions: Matrix
    mounted: Vector

    @classmethod
    def of(cls, scene: CoupledScene) -> SceneRows:
        """Return those of a scene; they stay the same."""
        flange = scene.flange
        return cls(*scene.joint_rows, flange.origin, flange.axes, *scene.place_rows, scene.mounted)


class Ticks(NamedTuple):
    """What n ticks leave, at the end of each.

    Args:
        figures: (n, FIGURES), of the soft side: wrench on the flange, centre and inertia of its mass.
        origin: (n, 3) [m], of the flange.
        axes: (n, 3, 3), world from flange.
        twist: (n, 6), of the flange's origin, linear then angular, world axes.
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
        contact: (n, 3), sum of the normal forces that have acted on bodies, mean over the tick [N], depth of
            the deepest point [m], contact ratio.
        body_force: (n, bodies, 3) [N], mean over the tick of what has acted on each body, of the soft robot,
            world axes.
        self_contact: (n, 3), points of films on films, sum of their normal forces [N], depth of the deepest
            [m].
        work: (n, 4) [J], of contacts with the scene on the film, of those between films on these, lost at
            eyelets that know their direction, and of contacts with the film on bodies.
        hit: (n, 3), see `LedgerEntry`: speed [m/s], way that resolves it [m], body.
        mounted: (n, 6), of what is fixed next to the soft robot on the flange, see `CoupledScene`.
        touch: (n, bodies, 3), what touches each body: sum of the soft robot's normal forces on it that have
            acted in the tick [N]; of an object also its contacts with what is mounted on flanges, to which
            other arms' soft robots count as one, and with other rigid bodies; of the world also all
            contacts of what is mounted on the own flange with rigid bodies.
    """

    figures: Matrix
    origin: Matrix
    axes: Blocks
    twist: Matrix
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
    hit: Matrix
    mounted: Matrix
    touch: Blocks

    @classmethod
    def room(cls, n: int, joints: int, bodies: int) -> Ticks:
        """Return room for n ticks, in which nothing is touched unless that is filled."""
        return cls(
            np.zeros((n, FIGURES)), np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 6)),
            np.zeros((n, joints)), np.zeros((n, joints)), np.zeros((n, joints)), np.zeros((n, bodies, 3)),
            np.zeros((n, bodies, 4)), np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros(n, np.int64),
            np.zeros(n, np.int64), np.zeros((n, 3)), np.zeros((n, bodies, 3)), np.zeros((n, 3)),
            np.zeros((n, 4)), np.full((n, 3), (0.0, 0.0, -1.0)), np.zeros((n, 6)), np.zeros((n, bodies, 3)),
        )  # fmt: skip


@kernel
def log_rigid(k: int, rows: SceneRows, spin: Vector, ticks: Ticks) -> None:
    """Fill row k of ticks with where the rigid side is.

    Args:
        k: row.
        rows: of the scene.
        spin: (6,), of the flange: angular then linear velocity, at its origin, world axes.
        ticks: filled.
    """
    copy(rows.joints, ticks.joints[k])
    copy(rows.joint_speed, ticks.joint_speed[k])
    copy(rows.servo_torque, ticks.servo_torque[k])
    copy(rows.origin, ticks.origin[k])
    copy(rows.mounted, ticks.mounted[k])
    copy_rows(rows.axes, ticks.axes[k])
    copy_rows(rows.places, ticks.places[k])
    for b in range(rows.quaternions.shape[0]):
        copy(rows.quaternions[b], ticks.quaternions[k, b])
    for r in range(3):
        ticks.twist[k, r], ticks.twist[k, 3 + r] = spin[3 + r], spin[r]
