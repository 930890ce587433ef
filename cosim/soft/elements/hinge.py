"""Rotational springs on the dihedral angle of interior edges, with an optional fold barrier.

Nodes (i, j, k, l): j-k is the edge, i and l its opposite corners. With u = x_i - x_j, e = x_k - x_j,
w = x_k - x_l, m = u x e, n = e x w the angle is
    theta = atan2(e/|e| . (m x n), m . n)  in [0, 2 pi),   theta = pi where the film is flat,
    energy = k (theta - theta0)^2 / 2  between theta1 and theta2 = 2 pi - theta1.
Beyond them the moment grows as k (theta1 - theta0) - (2 k theta1 / pi) tan(pi (theta1 - theta) / (2 theta1)).
There it would be infinite where the two films touch (theta = 0 or 2 pi), and nothing could be followed from a
shape with crossed films. So from x_c theta1 on, a closed fold, the moment goes on along its tangent, also
beyond theta = 0; the energy is finite and twice differentiable but for a kink of the tangent at x_c theta1.
Angles are unwrapped: of those that fit the shape, the one within pi of the last accepted state's is taken.
A fold that has closed by 0.003 rad too far reads -0.003, not 2 pi - 0.003; one that turns by more than pi at
once reads as one that has turned the other way.
Source: Liu and Paulino, Proc. R. Soc. A 473 (2017) 20170348, equations for theta and the barrier; the
second derivatives are written here in the orthonormal frames of the two triangles.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDEX_TABLE, MATRIX, REAL, VECTOR, kernel
from cosim.soft.elements.hinge_gradient import add_hinge_gradients
from cosim.soft.elements.hinge_hessian import add_hinge_hessians


@kernel(REAL(MATRIX, INDEX_TABLE, VECTOR, VECTOR, REAL, VECTOR, INDEX_TABLE, MATRIX, BLOCKS, VECTOR))
def add_hinges(x, hinges, stiffness, rest, theta1, reference, slots, force, blocks, angles):  # type: ignore[no-untyped-def]
    """Add all hinges' gradient to force and, if slots is not empty, their Hessian to blocks.

    The angle is unwrapped against `reference`, the angle at the last accepted state, and written to
    `angles`. Returns the energy [J].
    """
    if slots.shape[0] == 0:
        return add_hinge_gradients(x, hinges, stiffness, rest, theta1, reference, force, angles)
    return add_hinge_hessians(x, hinges, stiffness, rest, theta1, reference, slots, force, blocks, angles)


@final
@dataclass(frozen=True)
class Hinges:
    """All rotational springs of a body.

    Args:
        nodes: (h, 4) node indices i, j, k, l.
        stiffness: (h,) [N m/rad].
        rest_angle: (h,) [rad], stress-free angle.
        fold_barrier_rad: theta1, where the barrier begins; 0 for none.
    """

    nodes: IntArray
    stiffness: Array
    rest_angle: Array
    fold_barrier_rad: float
