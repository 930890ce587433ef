"""Stiffeners with a section: closed rings of beams whose nodes are nodes of the film.

The film knows positions alone, a beam also how its ends are turned. The turns are unknowns of the ring alone
(loads and film hold no node against turning), so they are taken where they are in balance:
    energy(x) = min over the turns R of the sum of all beams' energies(x, R),   see `node_turns`,
    gradient  = derivative by x at these turns,
    hessian   = E_xx - E_xR E_RR^-1 E_Rx,
a full matrix over the ring. A node turns as one, so that corners of the drawn shape are built in, and a
straight side of one beam or of eight has the same stiffness between its ends (`beam_lanes`): the energy is
that of a continuous ring, whatever the refinement. Without loads the ring has its drawn shape.
What is remembered are the turns of the last accepted state, quaternions in axes of the ring, from which the
next ones are sought, and a factor of E_RR with which.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, ClassVar, final

import numpy as np

from cosim.base.frames import Array, IntArray, cross
from cosim.errors import MeshError
from cosim.soft.beams.node_turns import BAND, BeamArrays
from cosim.soft.beams.rectangular_section import RectangularSection
from cosim.soft.beams.ring_kernels import add_beam_rings, peak_strains, ring_axes
from cosim.soft.elements.element import NODES, ROWS, STILL, DirectElement, Instant


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
        count, nodes = self.rings.shape
        return np.tile(np.append(np.tile([1.0, 0.0, 0.0, 0.0], nodes), np.zeros(3 * BAND * nodes)), count)

    def fresh(self, memory: Array) -> Array:
        """Return memory (m,) without factors: the turns' tangents are looked at anew."""
        rows = memory.reshape(len(self.rings), -1).copy()
        rows[:, 4 * self.rings.shape[1] :] = 0.0
        return rows.ravel()

    @cached_property
    def arrays(self) -> BeamArrays:
        """The beams as the kernels know them."""
        return BeamArrays(self.rings, self.directors, self.lengths, self.section.rigidities)

    def add(
        self, positions: Array, slots: IntArray, gradient: Array, blocks: Array, at: Instant = STILL
    ) -> float:
        memory = at.memory if len(at.memory) else self.first_memory(positions)
        tracked = at.tracked if len(at.tracked) else np.empty_like(memory)
        moving = at.step_s < np.inf and not at.closely
        energy: float = add_beam_rings(
            positions, self.arrays, memory, moving, slots, gradient, blocks, tracked
        )
        return energy

    def peak_strains(self, positions: Array, memory: Array) -> Array:
        """Return the largest strain (f, m) of each beam's fibres.

        Args:
            positions: (n, 3) [m].
            memory: (values,), from which the turns are sought.
        """
        size = self.section.width_m, self.section.height_m
        return np.asarray(peak_strains(positions, self.arrays, *size, memory))
