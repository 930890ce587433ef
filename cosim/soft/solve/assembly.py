"""Assembly: potential, gradient and Hessian of a soft body at given positions."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import RoutedCables
from cosim.soft.elements.element import Element, Instant, Sums, Term
from cosim.soft.elements.gas_pressure import GasElements
from cosim.soft.elements.mass_terms import Inertia, Weight
from cosim.soft.linear.low_rank import LowRank
from cosim.soft.linear.pattern import BlockPattern, PatternWidening

_NO_SLOTS = np.zeros(0, np.int64)


@final
class SoftSystem:
    """Workspace in which one body's potential and derivatives are assembled.

    After `evaluate`: `gradient` (n, 3) [N], `blocks` (pattern.blocks, 3, 3) [N/m], `memory` (values,) of the
    elements as they track it, `gas` (volume and pressure of each chamber), `low_rank` (dense parts of the
    Hessian, such as of sealed gas). `tangent_pattern` and `tangent_blocks` are the sparse Hessian: the body's
    own, or a wider one where films touch one another. They are overwritten by the next call. `serving` is the
    pattern to go on from where films touch, which a solver sets to that of its last factorisation.
    """

    def __init__(self, body: SoftBody) -> None:
        self.body = body
        rings = [ring[None, :] for ring in body.caps]
        self.pattern = BlockPattern.from_elements(
            body.nodes, [*(element.coupled for element in body.elements), *rings]
        )
        self.gradient = np.zeros((body.nodes, 3))
        self.blocks = np.zeros((self.pattern.blocks, 3, 3))
        self.tangent_pattern, self.tangent_blocks = self.pattern, self.blocks
        self.serving, self._widening = self.pattern, PatternWidening(self.pattern)
        self.memory = body.first_memory()
        self._dense: list[LowRank] = []
        diagonal = np.flatnonzero(self.pattern.row == self.pattern.column)
        self._sums = sums = Sums(
            self.gradient, self.blocks, diagonal, self.pattern.slots, self._add_dense, self._widened
        )
        self.gas = GasElements(body.enclosures, self.conservative, sums)
        elements = _bound_elements(body, sums)
        self._terms = (*elements, (self.gas, None), (Weight(body.node_mass, sums), None))
        found = [term for term, _ in elements if isinstance(term, RoutedCables)]
        self._cables = found[0] if found else RoutedCables((), sums)
        self._advancing = _advancing(body)
        places = zip(body.elements, body.memory_places, strict=True)
        self._freshened = [(each, own) for each, own in places if type(each).fresh is not Element.fresh]
        self.low_rank: LowRank | None = None

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
        """Nodes (m,) that elements tie together across the mesh."""
        far = [element.coupled for element in self.body.elements if element.far]
        return np.unique(np.concatenate([_NO_SLOTS, *(np.ravel(nodes) for nodes in far)]))

    def segment_tension(self, positions: Array, loads: Loads) -> Array:
        """Return what losses at a given shape make of the loads in every cable segment (segments,).

        The tension [N]; of a cable whose length is commanded a weight, see `RoutedCables`.
        """
        return self._cables.segment_tension(positions, loads)

    def advanced(self, positions: Array, memory: Array) -> Array:
        """Return what the elements remember (values,) once a step has ended.

        Args:
            positions: (n, 3) [m], at its end.
            memory: (values,), as they tracked it there.
        """
        if not self._advancing:
            return memory
        result = memory.copy()
        for element, own in self._advancing:
            result[own] = element.advanced(positions, memory[own])
        return result

    @property
    def freshens(self) -> bool:
        """Whether some element looks at something anew as a static solution begins."""
        return bool(self._freshened)

    def fresh(self, memory: Array) -> Array:
        """Return what elements remember (values,) as a static solution begins, see `Element.fresh`."""
        result = memory.copy()
        for element, own in self._freshened:
            result[own] = element.fresh(memory[own])
        return result

    def evaluate(
        self,
        positions: Array,
        loads: Loads,
        segment_tension: Array,
        memory: Array,
        *,
        inertia: Inertia | None = None,
        hessian: bool = True,
    ) -> float:
        """Assemble potential, gradient and (unless told not to) Hessian.

        Args:
            positions: (n, 3) [m], world, C-contiguous.
            loads: pressure, tension, gravity, nodal forces.
            segment_tension: (segments,), from `segment_tension`.
            memory: (values,), what the elements remember of the last accepted state; hinge angles are
                unwrapped against it.
            inertia: of an implicit step; None in statics.
            hessian: whether to fill `blocks`.

        Returns:
            The potential [J]; infinite where a sealed gas has no volume.
        """
        self.gradient[:] = 0.0
        if hessian:
            self.blocks[:] = 0.0
            self.tangent_pattern, self.tangent_blocks = self.pattern, self.blocks
        self._dense.clear()
        self.memory[:] = memory
        step_s, closely = (math.inf, False) if inertia is None else (inertia.step_s, inertia.closely)
        at, energy = Instant(memory, self.memory, step_s, segment_tension, loads, closely), 0.0
        for term, own in self._terms:
            energy += term.add(positions, at if own is None else at.part(own), hessian)
        # touching films widen the tangent, in which all else is by then
        for potential in (*loads.potentials, inertia, loads.self_contact):
            if potential is not None:
                energy += potential.add(positions, self._sums, hessian)
        self.low_rank = LowRank.joined(self._dense) if self._dense else None
        return energy

    def take_own_tangent(self, rows: slice) -> None:
        """Let the body's own pattern be the tangent's, with no dense part; clear the blocks of some nodes."""
        first, last = np.searchsorted(self.pattern.row, [rows.start, rows.stop])
        self.blocks[first:last] = 0.0
        self.tangent_pattern, self.tangent_blocks, self.low_rank = self.pattern, self.blocks, None

    def _widened(self, nodes: IntArray) -> tuple[Array, IntArray]:
        coupled, slots = self._widening.places(nodes, self.serving)
        self.tangent_pattern, self.tangent_blocks = coupled.pattern, coupled.blocks(self.blocks)
        return self.tangent_blocks, slots

    def _add_dense(self, vectors: Array, coefficients: Array) -> None:
        self._dense.append(LowRank(vectors, coefficients))


def _bound_elements(body: SoftBody, sums: Sums) -> list[tuple[Term, slice | None]]:
    """Return a body's elements as terms, each with the place of its memory; None where no other has one."""
    found: list[tuple[Term, slice]] = []
    left = list(body.memory_places)  # elements stand kind by kind
    for kind in body.kinds:
        alike = body.of_kind(kind)
        places, left = left[: len(alike)], left[len(alike) :]
        terms = kind.bound(alike, sums)
        if len(terms) < len(alike):  # one for all
            places = [slice(places[0].start, places[-1].stop)]
        found += zip(terms, places, strict=True)
    remembering = sum(own.stop > own.start for _, own in found)
    return [(term, own if remembering > 1 and own.stop > own.start else None) for term, own in found]


def _advancing(body: SoftBody) -> list[tuple[Element, slice]]:
    """Return the elements that remember something else of a step's end than they track, with its place."""
    pairs = zip(body.elements, body.memory_places, strict=True)
    return [(element, own) for element, own in pairs if element.remembers_steps]
