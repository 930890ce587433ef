"""Arrays that leaves of contact between film and scene take: what is near, and loads on bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.rigid.scene.bodies import Bodies


class BodyLoads(NamedTuple):
    """What acts on the bodies that the film touches.

    Args:
        applied: (bodies, 6), MuJoCo's loads on them.
        centers: (bodies, 3) [m], of their masses, where the film meets them.
        loaded: (bodies,), 1 for those that bear a load of contact.
        pressing: (bodies,) [N], sum of the normal forces of the film that make up that load.
        transferred: (8,), film's load on all bodies about the world's origin, its size [N], and the sum of the
            normal forces that are part of it [N].
    """

    applied: Matrix
    centers: Matrix
    loaded: Indices
    pressing: Vector
    transferred: Vector

    @classmethod
    def of(cls, bodies: Bodies, *, ahead: bool) -> BodyLoads:
        """Return those on the bodies of a scene; ahead: whether the film meets some where they will be."""
        centers = bodies.mass_centers.copy() if ahead else bodies.mass_centers
        return cls(bodies.applied, centers, bodies.bearing, np.zeros(bodies.count), np.zeros(8))


class SurfaceArrays(NamedTuple):
    """Where a film can be touched, see `ContactSurface`, and how stiff each of its points is (p,) [N/m]."""

    nodes: IndexTable
    weights: Matrix
    slots: IndexTable
    stiffness: Vector
    triangles: IndexTable
    triangle_slots: IndexTable


class ShapeArrays(NamedTuple):
    """Poses, coefficients of friction and bodies of shapes: fields of `ContactQuery`."""

    position: Matrix
    rotation: Blocks
    friction: Vector
    body: Indices


class NearFeatures(NamedTuple):
    """Corners of shapes, and points of their edges, near triangles of the film.

    Args:
        feature: (f,) index among all features of the scene.
        owner: (f,) its shape.
        place: (f, 3) [m], world.
        triangle: (f,) of the film.
        weight: (f, 3), of the nearest point of the triangle.
        found: (f, 4), distance [m] from the film, and normal out of it.
    """

    feature: Indices
    owner: Indices
    place: Matrix
    triangle: Indices
    weight: Matrix
    found: Matrix


class Glue(NamedTuple):
    """Points of the film that are glued to a body, with springs; they are the last contacts of every tick.

    Args:
        point: (k,) of the film.
        place: (k, 3) [m], body frame, where each is tied.
        body: (1,).
        stiffness: [N/m], of each.
        position: (bodies, 3) [m], world, and
        axes: (bodies, 9), of the bodies; MuJoCo's.
    """

    point: Indices
    place: Matrix
    body: Indices
    stiffness: float
    position: Matrix
    axes: Matrix


class ContactLoads(NamedTuple):
    """Loads of contacts on bodies at the end of a step.

    Args:
        loads: (bodies, 6), force [N] and torque about the world's origin [N m] on each body, world axes.
        acting: (bodies,), 1 where any acts.
        held: (bodies,) [N/m], trace of the stiffness of a body's contacts, stick springs slack.
        pressing: (bodies,) [N], sum of the normal forces on each body.
        film: (8,), the loads as the film's nodes bear them, summed over all bodies, their size [N], and the
            sum of the normal forces [N].
        figures: (5,), sum of the normal forces [N]; depth of the deepest that presses [m]; of the hit that
            the step resolves least: speed [m/s], the way that a step may take of it [m], and the body, -1 for
            no hit.
    """

    loads: Matrix
    acting: Indices
    held: Vector
    pressing: Vector
    film: Vector
    figures: Vector

    @classmethod
    def room(cls, bodies: int) -> ContactLoads:
        """Return what represents no contact."""
        acting, held = np.zeros(bodies, np.int64), np.zeros(bodies)
        figures = np.array([0.0, 0.0, 0.0, 0.0, -1.0])
        return cls(np.zeros((bodies, 6)), acting, held, np.zeros(bodies), np.zeros(8), figures)

    def clear(self) -> None:
        """Let there be no contact."""
        for part in self[:-1]:
            part.fill(0)
        self.figures[:] = 0.0, 0.0, 0.0, 0.0, -1.0
