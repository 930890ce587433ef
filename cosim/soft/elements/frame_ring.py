"""Stiff frames around groups of nodes: a group keeps its drawn shape and moves almost like a rigid body.

A group is a ring, or the nodes on one plate. With its drawn positions X (m, 3) and P = 1 - Q Q^T, the columns
of Q a basis of constants and of coordinates in the plane (or space) of X, P x is how far the nodes deviate
from the closest affine image of X.
    energy = k |P x|^2 / 2 + sum over chords k (l - L)^2 / 2,   chords from each node i to node i + m // 3.
The first term resists warping, also out of the plane, and is zero in rigid motions; the chords resist the
other affine deformations, stretch and shear. As k grows the ring becomes rigid; the error falls with 1 / k.
"""

import math
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Matrix
from cosim.base.kernels import kernel, small_vector, zero_matrix
from cosim.errors import MeshError
from cosim.soft.elements.element import NODES, ROWS, Call, LeafElement, Remembered, writable
from cosim.soft.linear.pattern import add_block

_ORDERS_TRIED = 100


@kernel
def add_frames(
    x: Matrix,
    rings: IndexTable,
    projections: Blocks,
    lengths: Matrix,
    stiffness: float,
    slots: IndexTable,
    gradient: Matrix,
    blocks: Blocks,
) -> float:
    """Add all frames to gradient and, if slots is not empty, their Hessian to blocks.

    Returns the energy [J].
    """
    count = rings.shape[1]
    with_hessian = slots.shape[0] > 0
    block = zero_matrix(3, 3)
    u = small_vector(3)
    energy = 0.0
    for e in range(rings.shape[0]):
        for a in range(count):
            for r in range(3):
                deviation = 0.0
                for b in range(count):
                    deviation += projections[e, a, b] * x[rings[e, b], r]
                # P P = P: the gradient of |P x|^2 / 2 is P x itself
                gradient[rings[e, a], r] += stiffness * deviation
                energy += 0.5 * stiffness * deviation * deviation
        if with_hessian:
            block[:] = 0.0
            for a in range(count):
                for b in range(a + 1):
                    for r in range(3):
                        block[r, r] = stiffness * projections[e, a, b]
                    add_block(blocks, slots[e, a * (a + 1) // 2 + b], block)
        for a in range(count):
            b = (a + count // 3) % count
            length = 0.0
            for r in range(3):
                u[r] = x[rings[e, b], r] - x[rings[e, a], r]
                length += u[r] * u[r]
            length = math.sqrt(length)
            stretch = length - lengths[e, a]
            energy += 0.5 * stiffness * stretch * stretch
            for r in range(3):
                u[r] /= length
                gradient[rings[e, b], r] += stiffness * stretch * u[r]
                gradient[rings[e, a], r] -= stiffness * stretch * u[r]
            if with_hessian:
                across = stiffness * stretch / length
                for r in range(3):
                    for c in range(3):
                        block[r, c] = (stiffness - across) * u[r] * u[c]
                    block[r, r] += across
                high, low = max(a, b), min(a, b)
                add_block(blocks, slots[e, a * (a + 1) // 2 + a], block)
                add_block(blocks, slots[e, b * (b + 1) // 2 + b], block)
                for r in range(3):
                    for c in range(3):
                        block[r, c] = -block[r, c]
                add_block(blocks, slots[e, high * (high + 1) // 2 + low], block)
    return energy


@final
@dataclass(frozen=True)
class FrameRings(LeafElement):
    """Stiff frames of one body; all rings have the same number of nodes.

    Args:
        rings: (f, m) nodes, in order around each ring.
        projections: (f, m, m), P.
        lengths: (f, m) [m], lengths of the chords without loads.
        stiffness_N_m: k.
        leads_on: whether it joins films that nothing else joins, as a plate does.
    """

    label: ClassVar[str] = "frames"

    rings: Annotated[IntArray, NODES]
    projections: Annotated[Array, ROWS]
    lengths: Annotated[Array, ROWS]
    stiffness_N_m: float
    leads_on: bool = False

    @classmethod
    def from_shape(
        cls, positions: Array, rings: IntArray, stiffness_N_m: float, ratio: float = 1.0
    ) -> "FrameRings":
        """Return frames that are stress free where each ring is the given one, scaled about its centre.

        Args:
            positions: (n, 3) [m], drawn shape.
            rings: (f, m) nodes, in order around each ring.
            stiffness_N_m: k.
            ratio: scale; P x is the same for a ring of any size, chords have ratio times their drawn lengths.

        Raises:
            MeshError: a ring has fewer than 3 nodes, lies on a line or is a parallelogram of 4 nodes (its
                chords are its edges, which let it shear); k is not positive.
        """
        rings = np.array(rings, dtype=np.int64, order="C")
        if rings.ndim != 2 or rings.shape[1] < 3:
            raise MeshError(
                f"frame rings have shape {rings.shape}; (rings, nodes), at least 3 nodes, is needed"
            )
        if not 0.0 < stiffness_N_m < np.inf:
            raise MeshError(f"frame stiffness is {stiffness_N_m} N/m; it must be positive")
        if rings.size and (rings.min() < 0 or rings.max() >= len(positions)):
            raise MeshError(
                f"frames refer to node {int(rings.max())}; there are nodes 0 to {len(positions) - 1}"
            )
        drawn = positions[rings]
        projections = np.array([_projection(ring, e) for e, ring in enumerate(drawn)])
        projections = projections.reshape(len(rings), rings.shape[1], rings.shape[1])
        chords = np.roll(drawn, -(rings.shape[1] // 3), axis=1) - drawn
        return cls(rings, projections, ratio * np.linalg.norm(chords, axis=2), stiffness_N_m)

    def drawn_lengths(self, positions: Array) -> Array:
        """Return the lengths (f, m) [m] of the chords in a shape (n, 3) [m]."""
        point = positions[self.rings]
        return np.asarray(np.linalg.norm(np.roll(point, -(point.shape[1] // 3), axis=1) - point, axis=2))

    @classmethod
    def plate(cls, positions: Array, nodes: IntArray, stiffness_N_m: float) -> "FrameRings":
        """Return one frame of nodes that sit on a plate, in any order.

        The order determines the chords; of several orders, the one that resists every strain most is used.

        Args:
            positions: (n, 3) [m], drawn shape.
            nodes: (m,) on the plate.
            stiffness_N_m: k.

        Raises:
            MeshError: see `from_shape`.
        """
        random = np.random.default_rng(0)
        orders = [nodes, *(random.permutation(nodes) for _ in range(_ORDERS_TRIED))]

        def weakest(order: IntArray) -> float:
            strains = _strain_of_chords(positions[order])
            return float(np.linalg.svd(strains, compute_uv=False).min())

        frame = cls.from_shape(positions, max(orders, key=weakest)[None], stiffness_N_m)
        return replace(frame, leads_on=True)

    def call(
        self, memory: Remembered, slots: IntArray, gradient: Array, blocks: Array, *, moving: bool
    ) -> Call:
        rings = writable(self.rings), writable(self.projections), writable(self.lengths)
        return Call(add_frames, (*rings, self.stiffness_N_m, slots, gradient, blocks))


def _projection(ring: Array, number: int) -> Array:
    """Return P (m, m) of one ring's drawn positions (m, 3)."""
    centred = ring - ring.mean(axis=0)
    directions, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    if sizes[1] < 1e-6 * sizes[0] or sizes[0] == 0.0:
        raise MeshError(f"frame ring {number} lies on a line; a frame needs a plane")
    wide = sizes > 1e-6 * sizes[0]
    spread = directions[:, wide] * sizes[wide]
    if np.linalg.matrix_rank(_strain_of_chords(spread), tol=1e-6 * sizes[0]) < math.comb(wide.sum() + 1, 2):
        raise MeshError(f"frame ring {number} can shear along its chords; add nodes to it")
    # a drawn ring that is not flat has a third coordinate to keep
    basis = np.column_stack([np.full(len(ring), len(ring) ** -0.5), directions[:, wide]])
    return np.asarray(np.eye(len(ring)) - basis @ basis.T)


def _strain_of_chords(points: Array) -> Array:
    """Return the stretch (m, strains) [m] of each chord of points (m, d) by each affine strain."""
    chord = np.roll(points, -(len(points) // 3), axis=0) - points
    first, second = np.triu_indices(points.shape[1])
    length = np.linalg.norm(chord, axis=1)
    return np.asarray(chord[:, first] * chord[:, second] / length[:, None])
