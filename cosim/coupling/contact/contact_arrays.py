"""Array arguments of the kernels for contact between film and scene: surfaces, near features, loads."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector


class BodyLoads(NamedTuple):
    """Contact loads that act on bodies in MuJoCo's next step.

    Args:
        applied: (bodies, 6), MuJoCo's loads on bodies.
        centers: (bodies, 3) [m], centres of mass, predicted where contacts are computed for predicted poses.
        loaded: (bodies,), 1 for bodies with a contact load.
        normal_force: (bodies,) [N], sum of the film's normal forces on each body.
        transferred: (8,), the film's load on all bodies about the world's origin, the size of its forces [N],
            and the sum of its normal forces [N].
    """

    applied: Matrix
    centers: Matrix
    loaded: Indices
    normal_force: Vector
    transferred: Vector


class SurfaceArrays(NamedTuple):
    """Points and triangles of a film, see `ContactSurface`, and the stiffness (p,) [N/m] of each point."""

    nodes: IndexTable
    weights: Matrix
    slots: IndexTable
    stiffness: Vector
    triangles: IndexTable
    triangle_slots: IndexTable


class ShapeArrays(NamedTuple):
    """Poses, friction coefficients and bodies of the scene's shapes: fields of `ContactQuery`."""

    position: Matrix
    rotation: Blocks
    friction: Vector
    body: Indices


class NearFeatures(NamedTuple):
    """Corners of shapes, and points of their edges, near triangles of the film.

    Args:
        feature: (f,) index among all features of the scene.
        owner: (f,) its shape.
        position: (f, 3) [m], world.
        triangle: (f,) of the film.
        weight: (f, 3), barycentric weights of the nearest point of the triangle.
        gap: (f, 4), distance [m] from the film, and the film's outward normal.
    """

    feature: Indices
    owner: Indices
    position: Matrix
    triangle: Indices
    weight: Matrix
    gap: Matrix


class Glue(NamedTuple):
    """Points of the film that are glued to a body by springs; they are the last contacts of every tick.

    Args:
        point: (k,) of the film.
        anchor: (k, 3) [m], body frame, where each spring is tied.
        body: (1,).
        stiffness: [N/m], of each.
        position: (bodies, 3) [m], world, and
        axes: (bodies, 9), of the bodies; MuJoCo's.
    """

    point: Indices
    anchor: Matrix
    body: Indices
    stiffness: float
    position: Matrix
    axes: Matrix


class ContactLoads(NamedTuple):
    """Loads of contacts on bodies at the end of a step.

    Args:
        loads: (bodies, 6), force [N] and torque about the world's origin [N m] on each body, world axes.
        touched: (bodies,), 1 for bodies with a contact load.
        stiffness_trace: (bodies,) [N/m], trace of the stiffness of a body's contacts, stick springs slack.
        normal_force: (bodies,) [N], sum of the normal forces on each body.
        film: (8,), the loads summed over the film's nodes, the size of their forces [N], and the sum of the
            normal forces [N].
        figures: (5,), sum of the normal forces [N]; largest depth [m]; of the hit that the step resolves
            worst: its speed [m/s], the motion per step that would resolve it [m], and its body, -1 for none.
    """

    loads: Matrix
    touched: Indices
    stiffness_trace: Vector
    normal_force: Vector
    film: Vector
    figures: Vector

    @classmethod
    def none(cls, bodies: int) -> ContactLoads:
        """Return the loads of no contact."""
        touched, stiffness_trace = np.zeros(bodies, np.int64), np.zeros(bodies)
        figures = np.array([0.0, 0.0, 0.0, 0.0, -1.0])
        return cls(np.zeros((bodies, 6)), touched, stiffness_trace, np.zeros(bodies), np.zeros(8), figures)

    def clear(self) -> None:
        """Overwrite with the loads of no contact."""
        for array in self[:-1]:
            array.fill(0)
        self.figures[:] = 0.0, 0.0, 0.0, 0.0, -1.0
