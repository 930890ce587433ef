"""Assembly: potential, gradient and Hessian of a soft body at given positions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import add_segments
from cosim.soft.elements.cable_length import pull, segment_weight
from cosim.soft.elements.hinge import add_hinges
from cosim.soft.elements.mass_terms import add_gravity, add_inertia
from cosim.soft.geometry.surface import dihedral_angle
from cosim.soft.linear.low_rank import LowRank
from cosim.soft.linear.pattern import BlockPattern
from cosim.soft.solve.gas_pressure import GasElements

_NO_TABLE = np.zeros((0, 0), np.int64)
_NO_SLOTS = np.zeros(0, np.int64)


@final
@dataclass(frozen=True)
class Inertia:
    """Inertia of an implicit step as an elastic bed: coefficient c, target y.

    energy = sum c |x - y|^2 / 2, gradient = c (x - y), Hessian = c 1.

    Args:
        coefficient: (n,) [N/m], mass over the squared step, plus damping.
        target: (n, 3) [m], where free flight would take each node.
    """

    coefficient: Array
    target: Array


@final
class SoftSystem:
    """Workspace in which one body's potential and derivatives are assembled.

    After `evaluate`: `gradient` (n, 3) [N], `blocks` (pattern.blocks, 3, 3) [N/m], `angles` (h,) [rad]
    `gas` (volume and pressure of each chamber), `low_rank` (dense parts of the Hessian, such as of sealed
    gas). `tangent_pattern` and `tangent_blocks` are the sparse Hessian: the body's own, or a wider one where
    films touch one another. They are overwritten by the next call.
    """

    def __init__(self, body: SoftBody) -> None:
        self.body = body
        self._segments = np.concatenate(
            [np.zeros((0, 2), np.int64), *(cable.segments for cable in body.cables)], axis=0
        )
        triangles, springs = body.membranes.triangles, body.hinges
        # springs without stiffness and barrier do nothing, whatever their angles
        self._bends = bool(springs.stiffness.any()) or springs.fold_barrier_rad > 0.0
        hinges = springs.nodes if self._bends else springs.nodes[:0]
        cap_elements = [ring[None, :] for ring in body.caps]
        self._frames = [*body.plates] if body.frames is None else [body.frames, *body.plates]
        frames = [frame.rings for frame in self._frames]
        self.pattern = BlockPattern.from_elements(
            body.nodes, [triangles, hinges, self._segments, *cap_elements, *frames]
        )
        self._frame_slots = [self.pattern.slots(rings) for rings in frames]
        self._triangle_slots = self.pattern.slots(triangles)
        self._hinge_slots = self.pattern.slots(hinges)
        self._segment_slots = self.pattern.slots(self._segments)
        self._diagonal = np.flatnonzero(self.pattern.row == self.pattern.column)
        self.gradient = np.zeros((body.nodes, 3))
        self.blocks = np.zeros((self.pattern.blocks, 3, 3))
        self.tangent_pattern, self.tangent_blocks = self.pattern, self.blocks
        self.angles = dihedral_angle(body.positions, body.hinges.nodes)
        self.gas = GasElements(body, self.pattern)
        self.low_rank: LowRank | None = None
        self._dense: list[LowRank] = []

    @property
    def conservative(self) -> bool:
        """Whether all loads have a potential."""
        return self.body.closed or not self.body.caps

    @property
    def volume(self) -> float:
        """Volume [m^3] of all chambers together."""
        return sum(self.gas.volumes)

    @property
    def pressure_Pa(self) -> float:
        """Gauge pressure in the first chamber."""
        return self.gas.pressures[0]

    @property
    def open_cap_stiffness(self) -> list[tuple[IntArray, Array]]:
        """What missing caps add to the stiffness, by ring."""
        return self.gas.open_cap_stiffness

    @property
    def eyelets(self) -> IntArray:
        """Nodes (m,) that cables tie together across the mesh."""
        return np.unique(self._segments)

    def segment_tension(self, positions: Array, loads: Loads) -> Array:
        """Return what losses at a given shape make of the loads in every cable segment (segments,).

        The tension [N]; of a cable whose length is commanded the weight w_i (see `cable_length`).
        """
        lengths = loads.cable_length_m or (None,) * len(self.body.cables)
        parts = [
            tension * cable.tension_ratio(positions) if length is None else segment_weight(cable, positions)
            for cable, tension, length in zip(self.body.cables, loads.cable_tension_N, lengths, strict=True)
        ]
        return np.concatenate([np.zeros(0), *parts])

    def evaluate(
        self,
        positions: Array,
        loads: Loads,
        segment_tension: Array,
        reference_angles: Array,
        *,
        inertia: Inertia | None = None,
        hessian: bool = True,
    ) -> float:
        """Assemble potential, gradient and (unless told not to) Hessian.

        Args:
            positions: (n, 3) [m], world, C-contiguous.
            loads: pressure, tension, gravity, nodal forces.
            segment_tension: (segments,), from `segment_tension`.
            reference_angles: (h,) [rad] at the last accepted state; angles are unwrapped against them.
            inertia: of an implicit step; None in statics.
            hessian: whether to fill `blocks`.

        Returns:
            The potential [J]; infinite where a sealed gas has no volume.
        """
        body, x = self.body, positions
        self.gradient[:] = 0.0
        if hessian:
            self.blocks[:] = 0.0
        table = (lambda slots: slots) if hessian else (lambda _slots: _NO_TABLE)
        hinges = body.hinges
        energy: float = body.membranes.add(x, table(self._triangle_slots), self.gradient, self.blocks)
        if self._bends:
            energy += add_hinges(
                x, hinges.nodes, hinges.stiffness, hinges.rest_angle, hinges.fold_barrier_rad,
                reference_angles, table(self._hinge_slots), self.gradient, self.blocks, self.angles,
            )  # fmt: skip
        self._dense = []
        if segment_tension.any():  # slack cables add nothing
            tension, rest = self._pulls(x, loads, segment_tension)
            energy += rest + add_segments(
                x, self._segments, tension, table(self._segment_slots), self.gradient, self.blocks
            )
        for frame, slots in zip(self._frames, self._frame_slots, strict=True):
            energy += frame.add(x, table(slots), self.gradient, self.blocks)
        energy += self._add_gas(x, loads, hessian)
        self.low_rank = LowRank.joined(self._dense) if self._dense else None
        energy += add_gravity(x, body.node_mass, np.array(loads.gravity), self.gradient)
        if loads.nodal_force is not None:
            self.gradient -= loads.nodal_force
            energy -= float(np.einsum("nr,nr->", loads.nodal_force, x))
        if loads.contact is not None:
            energy += loads.contact.add(x, self.gradient, self.blocks, hessian=hessian)
        if loads.extra is not None:
            energy += loads.extra.add(x, self.gradient, self.blocks, hessian=hessian)
        if inertia is not None:
            diagonal = self._diagonal if hessian else _NO_SLOTS
            energy += add_inertia(
                x, inertia.coefficient, inertia.target, diagonal, self.gradient, self.blocks
            )
        return energy + self._add_self_contact(x, loads, hessian)

    def _add_self_contact(self, x: Array, loads: Loads, hessian: bool) -> float:
        """Add the contacts between films to the gradient and, with all there is, to the wider tangent."""
        pairs = loads.self_contact
        if hessian:
            self.tangent_pattern, self.tangent_blocks = self.pattern, self.blocks
        if pairs is None:
            return 0.0
        if hessian:
            self.tangent_pattern = pairs.coupled.pattern
            self.tangent_blocks = pairs.coupled.blocks(self.blocks)
        return pairs.add(x, self.gradient, self.tangent_blocks, hessian=hessian)

    def _pulls(self, x: Array, loads: Loads, given: Array) -> tuple[Array, float]:
        """Return the tension of all segments (segments,) [N], and the energy beyond sum T_i L_i [J]."""
        if not loads.cable_length_m:
            return given, 0.0
        tension, energy, first = given.copy(), 0.0, 0
        for cable, length in zip(self.body.cables, loads.cable_length_m, strict=True):
            own = slice(first, first + len(cable.nodes) - 1)
            if length is not None:
                tension[own], rest, dense = pull(cable, x, given[own], length)
                energy += rest
                self._dense.append(dense)
            first = own.stop
        return tension, energy

    def _add_gas(self, x: Array, loads: Loads, hessian: bool) -> float:
        energy = self.gas.add(x, loads, self.gradient, self.blocks, hessian=hessian)
        self._dense += [] if self.gas.low_rank is None else [self.gas.low_rank]
        return energy
