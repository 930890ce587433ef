"""Stiffeners with a section: closed rings of beams whose nodes are nodes of the film.

The film knows positions alone, a beam also how its ends are turned. The turns are unknowns of the ring alone
(loads and film hold no node against turning), so they are taken where they are in balance:
    energy(x) = min over the turns R of the sum of all beams' energies(x, R),   see `node_turns`,
    gradient  = derivative by x at these turns,
    hessian   = E_xx - E_xR E_RR^-1 E_Rx,
a full matrix over the ring. A node turns as one, so that corners of the drawn shape are built in, and a
straight side of one beam or of eight has the same stiffness between its ends (`beam_measures`): the energy is
that of a continuous ring, whatever the refinement. Without loads the ring has its drawn shape.
What is remembered are the turns of the last accepted state, quaternions in axes of the ring, from which the
next ones are sought.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar, final

import numpy as np

from cosim.base.frames import Array, IntArray, cross
from cosim.base.kernels import BLOCKS, INDEX_TABLE, MATRIX, REAL, VECTOR, add_block, device_function, kernel
from cosim.errors import MeshError
from cosim.soft.beams.band_cholesky import forward_rows, place_in_band
from cosim.soft.beams.beam_work import beam_work
from cosim.soft.beams.node_turns import (
    BEAM_ARRAYS,
    BeamArrays,
    balance_turns,
    fill_axes,
    place_ring,
    ring_work,
)
from cosim.soft.beams.rectangular_section import RectangularSection
from cosim.soft.elements.element import NODES, ROWS, STILL, DirectElement, Instant


@device_function
def _read_turns(memory, f, w):  # type: ignore[no-untyped-def]
    """Fill the turns that ring f remembers, 4 numbers a node."""
    count = w.turns.shape[0]
    for i in range(count):
        for r in range(4):
            w.turns[i, r] = memory[4 * (f * count + i) + r]


@device_function
def _fill_matrix(w, beam, mixed, matrix):  # type: ignore[no-untyped-def]
    """Fill matrix (3 m, 3 m) = E_xx - E_xR E_RR^-1 E_Rx in axes of the ring; mixed (3 m, 3 m) is scratch."""
    count = w.turns.shape[0]
    matrix[:] = 0.0
    mixed[:] = 0.0
    for e in range(count):
        h, ends = beam.hessian[e], (e, (e + 1) % count)
        for a in range(2):
            for b in range(2):
                sign = 1.0 if a == b else -1.0
                for r in range(3):
                    for c in range(3):
                        matrix[3 * ends[a] + r, 3 * ends[b] + c] += sign * h[r, c]
                sign = 1.0 if b == 1 else -1.0
                row = 3 * place_in_band(ends[a], count)
                for r in range(3):
                    for c in range(3):
                        mixed[row + r, 3 * ends[b] + c] += sign * h[3 + 3 * a + r, c]
    forward_rows(w.factor, mixed)
    for k in range(3 * count):
        for i in range(3 * count):
            for j in range(i + 1):
                matrix[i, j] -= mixed[k, i] * mixed[k, j]


@device_function
def _add_matrix(w, slots, matrix, blocks):  # type: ignore[no-untyped-def]
    """Add the lower triangle of a matrix in axes of the ring to blocks in those of the world."""
    axes, count = w.axes, w.turns.shape[0]
    block, half = np.empty((3, 3)), np.empty((3, 3))
    for a in range(count):
        for b in range(a + 1):
            for r in range(3):
                for c in range(3):
                    half[r, c] = 0.0
                    for k in range(3):
                        i, j = 3 * a + k, 3 * b + c
                        half[r, c] += axes[r, k] * (matrix[i, j] if i >= j else matrix[j, i])
            for r in range(3):
                for c in range(3):
                    block[r, c] = half[r, 0] * axes[c, 0] + half[r, 1] * axes[c, 1] + half[r, 2] * axes[c, 2]
            add_block(blocks, slots[a * (a + 1) // 2 + b], block)


@kernel(REAL(MATRIX, BEAM_ARRAYS, VECTOR, INDEX_TABLE, MATRIX, BLOCKS, VECTOR))
def add_beam_rings(x, beams, memory, slots, gradient, blocks, tracked):  # type: ignore[no-untyped-def]
    """Add all rings to gradient and, if slots is not empty, their Hessian to blocks.

    The search for the turns begins at those in memory (4 f m,); they are written to tracked (4 f m,).
    Returns the energy [J]; infinity where no turns in balance are found.
    """
    count, with_hessian = beams.rings.shape[1], slots.shape[0] > 0
    w, b, energy = ring_work(count), beam_work(count), 0.0
    size = 3 * count if with_hessian else 0
    mixed, matrix = np.empty((size, size)), np.empty((size, size))
    for f in range(beams.rings.shape[0]):
        place_ring(x, beams.rings[f], w)
        _read_turns(memory, f, w)
        energy += balance_turns(beams, f, w, b, with_hessian)
        if not energy < np.inf:
            return np.inf
        for i in range(count):
            for r in range(3):
                for c in range(3):
                    force = w.axes[r, c] * b.gradient[i, c]
                    gradient[beams.rings[f, i], r] -= force
                    gradient[beams.rings[f, (i + 1) % count], r] += force
            for r in range(4):
                tracked[4 * (f * count + i) + r] = w.turns[i, r]
        if with_hessian:
            _fill_matrix(w, b, mixed, matrix)
            _add_matrix(w, slots[f], matrix, blocks)
    return energy


@kernel(MATRIX(MATRIX, BEAM_ARRAYS, REAL, REAL, VECTOR))
def peak_strains(x, beams, width, height, memory):  # type: ignore[no-untyped-def]
    """Return the largest strain (f, m) of each beam's fibres, at its ends; NaN where no balance is found."""
    count = beams.rings.shape[1]
    w, b, found = ring_work(count), beam_work(count), np.empty(beams.rings.shape)
    for f in range(beams.rings.shape[0]):
        place_ring(x, beams.rings[f], w)
        _read_turns(memory, f, w)
        balanced = balance_turns(beams, f, w, b, False) < np.inf
        for e in range(count):
            bent = 0.0
            for a in range(2):
                in_plane = width * abs(2.0 * b.turn[e, a, 0] + b.turn[e, 1 - a, 0])
                across = height * abs(2.0 * b.turn[e, a, 1] + b.turn[e, 1 - a, 1])
                bent = max(bent, (in_plane + across) / beams.lengths[f, e])
            found[f, e] = abs(b.strain[e]) + bent if balanced else np.nan
    return found


@kernel(BLOCKS(MATRIX, INDEX_TABLE))
def ring_axes(x, rings):  # type: ignore[no-untyped-def]
    """Return the axes (f, 3, 3) of all rings, as columns."""
    axes = np.empty((rings.shape[0], 3, 3))
    for f in range(rings.shape[0]):
        fill_axes(x, rings[f], axes[f])
    return axes


@final
@dataclass(frozen=True)
class BeamRings(DirectElement):
    """Stiffeners of one body; all rings have the same number of nodes.

    Args:
        rings: (f, m) nodes, in order around each ring.
        directors: (f, m, 3, 3), of the beam from each node to the next: along it, in the ring's plane, across
            it; in axes of the ring.
        lengths: (f, m) [m], drawn.
        section: of all beams.
    """

    label: ClassVar[str] = "beams"

    rings: Annotated[IntArray, NODES]
    directors: Annotated[Array, ROWS]
    lengths: Annotated[Array, ROWS]
    section: RectangularSection

    @classmethod
    def from_shape(cls, positions: Array, rings: IntArray, section: RectangularSection) -> BeamRings:
        """Return stiffeners that are stress free in the given shape.

        Args:
            positions: (n, 3) [m], drawn shape.
            rings: (f, m) nodes, in order around each ring.
            section: of all beams.

        Raises:
            MeshError: a ring has fewer than 3 nodes, lies on a line, or has two nodes in one place.
        """
        rings = np.array(rings, dtype=np.int64, order="C")
        if rings.ndim != 2 or rings.shape[1] < 3:
            raise MeshError(
                f"rings of beams have shape {rings.shape}; (rings, nodes), at least 3 nodes, is needed"
            )
        if rings.size and (rings.min() < 0 or rings.max() >= len(positions)):
            raise MeshError(
                f"beams refer to node {int(rings.max())}; there are nodes 0 to {len(positions) - 1}"
            )
        drawn = np.array(positions, dtype=np.float64, order="C")
        point, following = drawn[rings], drawn[np.roll(rings, -1, axis=1)]
        lengths = np.linalg.norm(following - point, axis=2)
        centred = point - point.mean(axis=1, keepdims=True)
        normal = cross(centred, np.roll(centred, -1, axis=1)).sum(axis=1, keepdims=True)
        axes = ring_axes(drawn, rings)
        for number in range(len(rings)):
            if not lengths[number].min() > 1e-9 * lengths[number].max():
                raise MeshError(f"ring of beams {number} has two neighbouring nodes in one place")
            if not np.linalg.norm(normal[number]) > 1e-9 * lengths[number].sum() ** 2:
                raise MeshError(f"ring of beams {number} lies on a line; it needs a plane")
            if not np.isfinite(axes[number]).all():
                raise MeshError(f"ring of beams {number} has nodes 0, m // 3 and 2 m // 3 on a line")
        along = (following - point) / lengths[:, :, None]
        across = normal - (normal * along).sum(axis=2, keepdims=True) * along
        across /= np.linalg.norm(across, axis=2, keepdims=True)
        directors = np.stack([along, cross(across, along), across], axis=2)
        return cls(rings, np.ascontiguousarray(directors @ axes[:, None]), lengths, section)

    def first_memory(self, positions: Array) -> Array:
        return np.tile([1.0, 0.0, 0.0, 0.0], self.rings.size)

    @property
    def arrays(self) -> BeamArrays:
        """The beams as the kernels know them."""
        return BeamArrays(self.rings, self.directors, self.lengths, self.section.rigidities)

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        memory = at.memory if len(at.memory) else self.first_memory(positions)
        tracked = at.tracked if len(at.tracked) else np.empty_like(memory)
        energy: float = add_beam_rings(positions, self.arrays, memory, slots, gradient, blocks, tracked)
        return energy

    def peak_strains(self, positions: Array, memory: Array) -> Array:
        """Return the largest strain (f, m) of each beam's fibres.

        Args:
            positions: (n, 3) [m].
            memory: (4 f m,), from which the turns are sought.
        """
        size = self.section.width_m, self.section.height_m
        return np.asarray(peak_strains(positions, self.arrays, *size, memory))
