"""Result of a tick's contacts between film and scene: the report, and the memory for the next tick."""

from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import INDICES, MATRIX, VECTOR
from cosim.soft.contact.obstacle_contact import ContactPlanes


class ContactMemory(NamedTuple):
    """The contacts that pressed at the end of a tick.

    Args:
        key: (k,) ascending; identifies the pair of contact point and shape.
        normal_force: (k,) [N].
        offset: (k, 3) [m], shape frame: from the point that the shape carries to the anchor.
        position: (k, 3) [m], world, of features; not used for points of the film.
        triangle: (k,) of the film, that held a feature back; -1 for points of the film, and for features
            that it only brushed, no deeper than the law's transition.
        face: (k,) triangle of the film on which a feature pressed or brushed; -1 for points of the film.
    """

    key: Annotated[IntArray, ("k",), INDICES]
    normal_force: Annotated[Array, ("k",), VECTOR]
    offset: Annotated[Array, ("k", 3), MATRIX]
    position: Annotated[Array, ("k", 3), MATRIX]
    triangle: Annotated[IntArray, ("k",), INDICES]
    face: Annotated[IntArray, ("k",), INDICES]

    @classmethod
    def empty(cls, count: int) -> "ContactMemory":
        """Return an allocated memory of `count` contacts."""
        key, triangle, face = (np.zeros(count, np.int64) for _ in range(3))
        return cls(key, np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3)), triangle, face)


@final
@dataclass(frozen=True)
class ContactReport:
    """Loads, depth and work of the contacts of one tick.

    Args:
        bodies: (b,) touched bodies.
        force: (b, 3) [N] on each, world axes.
        torque: (b, 3) [N m] on each, about the world's origin.
        count: contact points that press.
        normal_force_N: sum over them.
        depth_m: of the deepest.
        work_J: on the film.
        hit_m_s: speed of the hit that the step resolves worst.
        hit_way_m: motion of its body per step for which the hit would be resolved.
        hit_body: its body; -1 for no hit.
    """

    bodies: Annotated[IntArray, ("b",)]
    force: Annotated[Array, ("b", 3)]
    torque: Annotated[Array, ("b", 3)]
    count: int
    normal_force_N: float
    depth_m: float
    work_J: float = 0.0
    hit_m_s: float = 0.0
    hit_way_m: float = 0.0
    hit_body: int = -1

    @classmethod
    def of(cls, planes: ContactPlanes) -> "ContactReport":
        """Return the report of contacts, with the law evaluated at the end of the tick."""
        # a point that has just separated may still have friction: its bound is the last tick's normal force
        acting = np.abs(planes.gradient).max(axis=1) > 0.0
        point, force = planes.point[acting], planes.gradient[acting]
        bodies, index = np.unique(planes.body[acting], return_inverse=True)
        total, torque = np.zeros((len(bodies), 3)), np.zeros((len(bodies), 3))
        np.add.at(total, index, force)
        np.add.at(torque, index, np.cross(point, force))
        return cls(bodies, total, torque, planes.pressing, float(planes.normal_force.sum()), planes.depth_m)

    def on_each(self, bodies: int) -> Array:
        """Return the force on each of the scene's bodies (bodies, 3) [N], world axes."""
        forces = np.zeros((bodies, 3))
        forces[self.bodies] = self.force
        return forces


NOTHING_TOUCHED: Final = ContactReport(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)), 0, 0.0, 0.0)
