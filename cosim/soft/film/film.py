"""A body of film: potential, gradient and tangent at given positions, as sums over its elements.

    potential(x) = sum of elements + gas + cables + weight + dead load + contact + inertia [J]

A compiled kernel adds each family of elements; terms of few numbers (gas, commanded lengths, eyelets) are
computed here.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple, final

import numpy as np

from cosim.base.compilation import compile_kernels
from cosim.base.frames import Array, IntArray
from cosim.base.kernels import unchecked, unchecked_for
from cosim.errors import InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import add_contacts
from cosim.soft.contact.self_contact_pairs import FilmPairs, add_pair_blocks, add_pairs
from cosim.soft.elements import eyelets, pressure
from cosim.soft.elements.cable import Cable, add_segments, onset, weighted_length
from cosim.soft.elements.element import (
    Call,
    Element,
    EyeletLaws,
    Instant,
    LeafElement,
    Remembered,
    Sums,
    Term,
    writable,
)
from cosim.soft.elements.gas import SealedGas
from cosim.soft.elements.mass_terms import add_gravity, add_inertia
from cosim.soft.film.inertia import Inertia
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.linear.linear_solver import LowRank, Tangent
from cosim.soft.linear.pattern import BlockPattern, PatternWidening

_NO_TABLE, _NO_SLOTS = np.zeros((0, 0), np.int64), np.zeros(0, np.int64)
_NO_BLOCKS, _NO_MEMORY = np.zeros((0, 3, 3)), np.zeros(0)


class _Chamber(NamedTuple):
    """Film and caps around one gas.

    Args:
        triangles: (t, 3).
        rings: of its caps.
        slots: (t, 6) of the triangles.
        ring_slots: of each cap.
    """

    triangles: IntArray
    rings: list[IntArray]
    slots: IntArray
    ring_slots: list[IntArray]


class _DenseTerm(NamedTuple):
    """A term c v v^T of a tangent.

    Args:
        coefficient: c.
        vector: (n, 3), v.
    """

    coefficient: float
    vector: Array


class _Winch(NamedTuple):
    """A cable whose length is commanded, see `cable`.

    Args:
        segments: slice of its segments among all.
        weights: (k,), w_i.
        spring: k m [N/m].
        length: L_0 or L_0' [m].
        stiffening: q.
    """

    segments: slice
    weights: Array
    spring: float
    length: float
    stiffening: float


@final
@dataclass
class FilmLoads:
    """Loads on a film in one solution, prepared for kernels.

    Args:
        loads: that act.
        losses: (segments, COLUMNS), frozen, see `FilmPotential.losses_at`.
        rows: the same, in which sticking eyelets are marked.
        inertia: of an implicit step; None in statics.
        pressures: commanded gauge pressure of each chamber [Pa].
        gases: sealed in each chamber, None for a commanded pressure; empty if no gas is sealed.
        pull: (segments,) [N], of the cables with commanded tension.
        winches: cables with commanded length.
        moving: whether it is an ordinary step in time.
        calls: kernel calls of the gradient.
    """

    loads: Loads
    losses: Array
    rows: Array
    inertia: Inertia | None
    pressures: tuple[float, ...]
    gases: tuple[SealedGas | None, ...]
    pull: Array
    winches: list[_Winch]
    moving: bool
    calls: list[Call]


@final
class FilmPotential:
    """Sums potential, gradient and tangent of one body.

    After `evaluate`: `gradient` (n, 3) [N], `memory` (values,), the elements' internal variables there, and
    `tangent` on request; the next call overwrites them. `before` (values,) is the memory of the last accepted
    state. `reusable_pattern` is the pattern of the last factorisation, which is reused with self-contact if
    it fits.

    Args:
        body: to sum.
    """

    def __init__(self, body: SoftBody) -> None:
        self.body, self.mass = body, writable(body.node_mass)
        rings = [ring[None, :] for ring in body.caps]
        coupled = [*(element.coupled for element in body.elements), *rings]
        self.pattern = BlockPattern.from_elements(body.nodes, coupled)
        self.reusable_pattern, self.widening = self.pattern, PatternWidening(self.pattern)
        self.gradient = np.zeros((body.nodes, 3))
        self.blocks = np.zeros((self.pattern.blocks, 3, 3))
        self.tangent = Tangent(self.pattern, self.blocks)
        self.before, self.memory = body.first_memory(), body.first_memory()
        self.gas = pressure.GasChambers(body.enclosures)
        self.pressures_Pa, self.volumes_m3 = np.zeros(self.gas.count), np.zeros(self.gas.count)
        self._memory_slices = list(zip(body.elements, body.memory_slices, strict=True))
        self._diagonal = np.flatnonzero(self.pattern.row == self.pattern.column)
        self._sums = Sums(self.gradient, self.blocks, self._diagonal, self.pattern.slots)
        self._further = _further(body, self._sums)
        self._advancing = [(element, own) for element, own in self._memory_slices if element.remembers_steps]
        self._freshened = [pair for pair in self._memory_slices if type(pair[0]).fresh is not Element.fresh]
        self._acting: FilmLoads | None = None
        self._prepare_cables()

    def _prepare_cables(self) -> None:
        cables = self.body.cables
        memory_slices = tuple(
            memory_slice for element, memory_slice in self._memory_slices if isinstance(element, Cable)
        )
        self.eyelets: EyeletLaws = eyelets.eyelet_laws(cables, memory_slices)
        """The eyelets of all cables."""
        self.routes = [slice(*pair) for pair in pairwise(self.eyelets.routes.tolist())]
        """Slice of each cable's segments among all."""
        self.slides = any(cable.remembers for cable in cables)
        """Whether some cable has a memory of its direction of sliding."""
        rubs = any(cable.friction_coefficient for cable in cables)
        self._losses_change = self.slides or rubs
        self._cable_of = np.repeat(np.arange(len(cables)), [len(cable.nodes) - 1 for cable in cables])
        self._pull = np.empty(len(self._cable_of))
        self._segment_slots = self.pattern.slots(self.eyelets.segments)
        self._eyelet_slots = [
            self.pattern.slots(nodes[None])[0] if len(nodes) else _NO_SLOTS for nodes in self.eyelets.tied
        ]

    @cached_property
    def _losses(self) -> Array:
        """(segments, COLUMNS), of cables with commanded tensions and losses that do not depend on shape."""
        pulls: eyelets.Pulls = (), (), ()
        return eyelets.frozen_losses(self.eyelets, self.body.cables, self.body.positions, _NO_MEMORY, pulls)

    @cached_property
    def _plain_chambers(self) -> list[_Chamber]:
        """The chambers for the gradient alone."""
        no_slots = _NO_TABLE, _NO_SLOTS
        return [
            _Chamber(np.ascontiguousarray(triangles), rings, no_slots[0], [no_slots[1]] * len(rings))
            for triangles, rings in self.body.enclosures
        ]

    @cached_property
    def _tangent_chambers(self) -> list[_Chamber]:
        """The chambers for the tangent as well."""
        slots = self.pattern.slots
        return [
            each._replace(slots=slots(each.triangles), ring_slots=[slots(r[None])[0] for r in each.rings])
            for each in self._plain_chambers
        ]

    @property
    def complete(self) -> bool:
        """Whether kernels exist for all elements of the body."""
        return not self._further

    @property
    def conservative(self) -> bool:
        """Whether all loads have a potential."""
        return self.body.closed or not self.body.caps

    @property
    def volume(self) -> float:
        """Volume [m^3] of all chambers at the last evaluation."""
        return float(self.volumes_m3.sum())

    @property
    def pressure_Pa(self) -> float:
        """Gauge pressure in the first chamber at the last evaluation."""
        return float(self.pressures_Pa[0])

    @property
    def tied(self) -> IntArray:
        """Nodes (m,) that elements couple across the mesh."""
        far = [element.coupled for element in self.body.elements if element.far]
        return np.unique(np.concatenate([_NO_SLOTS, *(np.ravel(nodes) for nodes in far)]))

    def open_cap_stiffness(self, positions: Array) -> list[tuple[IntArray, Array]]:
        """Return the stiffness terms of open caps at positions (n, 3) [m], by ring."""
        return [] if self.conservative else self.gas.open_cap_stiffness(positions, self.pressures_Pa)

    def add_open_caps(self, positions: Array) -> None:
        """Add the symmetric part of the terms of open caps at positions (n, 3) [m] to the tangent."""
        for ring, cap_terms in self.open_cap_stiffness(positions):
            count, slots = len(ring), self.tangent.pattern.slots(ring[None])[0]
            symmetric_blocks = (0.5 * (cap_terms + cap_terms.T)).reshape(count, 3, count, 3).swapaxes(1, 2)
            pairs = symmetric_blocks[np.tril_indices(count)]
            transposed = slots < 0
            pairs[transposed] = pairs[transposed].swapaxes(1, 2)
            np.add.at(self.tangent.blocks, np.where(transposed, -1 - slots, slots), pairs)

    def losses_at(self, positions: Array, loads: Loads, memory: Array | None = None) -> Array:
        """Return the losses along cables at a given shape (segments, COLUMNS), see `eyelets`.

        Args:
            positions: (n, 3) [m].
            loads: that act.
            memory: (values,), of the last accepted state; None for cables that have been pulled taut.
        """
        if not self._losses_change and not any(loads.cable_length_m):
            return self._losses
        before = self.body.first_memory() if memory is None and self.slides else memory
        pulls = loads.cable_tension_N, loads.cable_length_m, loads.cable_stiffening
        start_memory = _NO_MEMORY if before is None else before
        return eyelets.frozen_losses(self.eyelets, self.body.cables, positions, start_memory, pulls)

    def unslid(self, memory: Array, accepted: Array) -> Array:
        """Return the memory (values,) of a solution, with eyelets reset to the accepted state before it."""
        if not self.slides:
            return memory
        anchors = self.eyelets.places
        reset_memory, anchors = memory.copy(), anchors[anchors >= 0]
        reset_memory[anchors] = accepted[anchors]
        return reset_memory

    def lost_at_eyelets(self, positions: Array, before: Array, after: Array) -> float:
        """Return the work lost at eyelets [J] from one accepted state to the next.

        Args:
            positions: (n, 3) [m], at the end.
            before: (values,), memory at the start.
            after: memory at the end.
        """
        return eyelets.eyelet_loss(positions, self.eyelets, before, after) if self.slides else 0.0

    def advanced(self, positions: Array, memory: Array) -> Array:
        """Return the elements' memory (values,) after a step.

        Args:
            positions: (n, 3) [m], at its end.
            memory: (values,), of the last evaluation there.
        """
        if not self._advancing:
            return memory
        new_memory = memory.copy()
        for element, memory_slice in self._advancing:
            new_memory[memory_slice] = element.advanced(positions, memory[memory_slice])
        return new_memory

    @property
    def freshens(self) -> bool:
        """Whether some element resets internal variables at the start of a static solution."""
        return bool(self._freshened)

    def fresh(self, memory: Array) -> Array:
        """Return the memory (values,) at the start of a static solution, see `Element.fresh`."""
        new_memory = memory.copy()
        for element, memory_slice in self._freshened:
            new_memory[memory_slice] = element.fresh(memory[memory_slice])
        return new_memory

    def evaluate(
        self,
        positions: Array,
        loads: Loads,
        losses: Array,
        memory: Array,
        *,
        inertia: Inertia | None = None,
        hessian: bool = True,
    ) -> float:
        """Sum potential, gradient and, with `hessian`, the tangent.

        Args:
            positions: (n, 3) [m], world, C-contiguous.
            loads: pressure, tension, gravity, nodal forces.
            losses: (segments, COLUMNS), from `losses_at`.
            memory: (values,), of the last accepted state; hinge angles are unwrapped relative to it.
            inertia: of an implicit step; None in statics.
            hessian: whether to fill the tangent.

        Returns:
            The potential [J]; infinite if a sealed gas has no volume.
        """
        acting = self.acting(loads, losses, inertia)
        np.copyto(self.before, memory)
        return self.sum_tangent(positions, acting) if hessian else self.sum_gradient(positions, acting)

    def acting(self, loads: Loads, losses: Array, inertia: Inertia | None) -> FilmLoads:
        """Return the loads prepared for kernels; cached for the same arguments."""
        last = self._acting
        if last and last.loads is loads and last.losses is losses and last.inertia is inertia:
            return last
        self._acting = acting = self._prepare(loads, losses, inertia)
        return acting

    def sum_gradient(self, x: Array, acting: FilmLoads) -> float:
        """Fill gradient and memory at x (n, 3) [m]; return the potential [J]."""
        return self._sum(x, acting, acting.calls, None)

    def sum_tangent(self, x: Array, acting: FilmLoads) -> float:
        """Fill the tangent as well; return the potential [J]."""
        self.blocks.fill(0.0)
        dense: list[_DenseTerm] = []
        element_calls = self._moving_tangent_calls if acting.moving else self._still_tangent_calls
        simple = not (self.slides or acting.winches)
        load_calls = self._calls_of(acting.loads, acting.inertia, acting.pull, self.blocks, simple=simple)
        energy = self._sum(x, acting, [*element_calls, *load_calls], dense)
        low_rank, pairs = None, acting.loads.self_contact
        if dense:
            low_rank = LowRank(
                np.array([term.vector for term in dense]), np.array([term.coefficient for term in dense])
            )
        pattern, blocks = self.pattern, self.blocks
        if pairs is not None and len(pairs.acting):
            pattern, blocks = self._widened(x, pairs)
        self.tangent = Tangent(pattern, blocks, low_rank, self.open_cap_stiffness(x))
        return energy

    def _widened(self, x: Array, pairs: FilmPairs) -> tuple[BlockPattern, Array]:
        """Return the tangent's blocks with self-contact, which couples distant nodes."""
        wide = self.widening.around(pairs.near, self.reusable_pattern)
        pattern, blocks = wide.pattern, wide.blocks(self.blocks)
        add_pair_blocks(x, pairs.rows, pattern.rows, np.zeros(pattern.blocks, np.int64), blocks)
        return pattern, blocks

    def _sum(self, x: Array, acting: FilmLoads, calls: list[Call], dense: list[_DenseTerm] | None) -> float:
        """Add all terms; append dense terms of the tangent to `dense`, None for the gradient alone."""
        np.copyto(self.memory, self.before)
        self.gradient.fill(0.0)
        energy = 0.0
        for leaf, arguments in calls:
            energy += leaf(x, *arguments)
        if self.slides or acting.winches:
            energy += self._add_cables(x, acting, dense)
        for number in range(self.gas.count):
            energy += self._add_gas(number, x, acting, dense)
        if not energy < np.inf:
            return np.inf
        loads = acting.loads
        if loads.nodal_force is not None:
            self.gradient -= loads.nodal_force
            energy -= float(np.vdot(loads.nodal_force, x))
        if self._further or loads.extra is not None:
            energy += self._add_further(x, acting, hessian=dense is not None)
        return energy

    def _prepare(self, loads: Loads, losses: Array, inertia: Inertia | None) -> FilmLoads:
        rows, moving = losses.copy() if self.slides else losses, False
        tension = np.array(loads.cable_tension_N)
        pull = (
            tension[self._cable_of] * rows[:, eyelets.BASE_FRACTION] if len(tension) else np.zeros(len(rows))
        )
        winches = self._winches(loads, rows) if any(loads.cable_length_m) else []
        if inertia is not None:
            moving = inertia.step_s < np.inf and not inertia.closely
        element_calls = self._moving_calls if moving else self._still_calls
        simple = not (self.slides or winches)
        calls = [*element_calls, *self._calls_of(loads, inertia, pull, _NO_BLOCKS, simple=simple)]
        gases = loads.gases(self.gas.count) if any(loads.gas) else ()
        if gases and not self.conservative:
            raise InputError("a sealed gas needs a closed body; this one has open caps")
        pressures = loads.pressures(self.gas.count)
        return FilmLoads(
            loads, losses, rows, inertia, pressures, gases, pull, winches, moving, calls
        )  # fmt: skip

    def _calls_of(
        self, loads: Loads, inertia: Inertia | None, pull: Array, blocks: Array, *, simple: bool
    ) -> list[Call]:
        """Return the kernel calls of loads: cables, weight, inertia, contact.

        Args:
            loads: that act.
            inertia: of a step.
            pull: (segments,) [N].
            blocks: of the tangent; empty for the gradient alone.
            simple: whether `pull` is the tension of all segments in every shape.
        """
        gradient, with_tangent = self.gradient, len(blocks) > 0
        calls = [Call(unchecked(add_gravity), (self.mass, loads.gravity_vector, gradient))]
        if simple and len(pull):
            slots = self._segment_slots if with_tangent else _NO_TABLE
            calls.append(
                Call(unchecked(add_segments), (self.eyelets.segments, pull, slots, gradient, blocks))
            )
        if loads.contact is not None:
            calls.append(Call(unchecked(add_contacts), (loads.contact, gradient, blocks)))
        if inertia is not None:
            diagonal = self._diagonal if with_tangent else _NO_SLOTS
            arguments = inertia.coefficient, inertia.target, diagonal, gradient, blocks
            calls.append(Call(unchecked(add_inertia), arguments))
            if inertia.rates is not None:
                calls += self._rate_calls(inertia.rates, blocks)
        if loads.self_contact is not None:
            calls.append(Call(unchecked(add_pairs), (loads.self_contact.rows, gradient)))
        return calls

    def _rate_calls(self, rates: StrainRates, blocks: Array) -> list[Call]:
        angles = Remembered(self.before[rates.angles], self.memory[rates.angles])
        if len(blocks):
            slots = [self.pattern.slots(membranes.coupled) for membranes in self.body.membranes]
            return rates.calls(angles, slots, self.pattern.slots(rates.hinges), self.gradient, blocks)
        no_slots = [_NO_TABLE] * len(self.body.membranes)
        return rates.calls(angles, no_slots, _NO_TABLE, self.gradient, blocks)

    @cached_property
    def _still_calls(self) -> list[Call]:
        return self._element_calls(lambda _nodes: _NO_TABLE, _NO_BLOCKS, moving=False)

    @cached_property
    def _moving_calls(self) -> list[Call]:
        return self._element_calls(lambda _nodes: _NO_TABLE, _NO_BLOCKS, moving=True)

    @cached_property
    def _still_tangent_calls(self) -> list[Call]:
        return self._element_calls(self.pattern.slots, self.blocks, moving=False)

    @cached_property
    def _moving_tangent_calls(self) -> list[Call]:
        return self._element_calls(self.pattern.slots, self.blocks, moving=True)

    def _element_calls(
        self, slots: Callable[[IntArray], IntArray], blocks: Array, *, moving: bool
    ) -> list[Call]:
        element_calls = []
        for element, memory_slice in self._memory_slices:
            if isinstance(element, LeafElement):
                memory = Remembered(self.before[memory_slice], self.memory[memory_slice])
                element_calls.append(
                    element.call(memory, slots(element.coupled), self.gradient, blocks, moving=moving)
                )
        calls, x = [call for call in element_calls if call is not None], writable(self.body.positions)
        compile_kernels(call.leaf for call in calls)
        return [Call(unchecked_for(leaf, x, *arguments), arguments) for leaf, arguments in calls]

    def _winches(self, loads: Loads, rows: Array) -> list[_Winch]:
        winches, stiffening = [], loads.cable_stiffening or (1.0,) * len(self.routes)
        cable_rows = zip(self.routes, self.body.cables, loads.cable_length_m, stiffening, strict=True)
        for segments, cable, length, stiffening_of_cable in cable_rows:
            if length is not None:
                # the first segment has w_1 = r_1 / m, so that m follows from it
                mean = rows[segments.start, eyelets.RATIO] / rows[segments.start, eyelets.BASE_FRACTION]
                weights = np.ascontiguousarray(rows[segments, eyelets.BASE_FRACTION])
                winches.append(
                    _Winch(segments, weights, cable.stiffness_N_m * float(mean), length, stiffening_of_cable)
                )
        return winches

    def _add_cables(self, x: Array, acting: FilmLoads, dense: list[_DenseTerm] | None) -> float:
        """Add cables with commanded length or with memory of sliding; return their energy [J]."""
        pull, rows, energy, blocks = self._pull, acting.rows, 0.0, self.blocks
        np.copyto(pull, acting.pull)
        for winch in acting.winches:
            energy += self._wind(x, winch, pull, dense)
        for number, segments in enumerate(self.routes if self.slides else ()):
            if self.eyelets.places[segments.start] >= 0:
                energy += eyelets.pull_eyelets(x, self.eyelets, rows, number, self.memory, pull)
                if dense is not None:
                    eyelets.hold_eyelets(x, self.eyelets, rows, number, self._eyelet_slots[number], blocks)
        slots, blocks = (_NO_TABLE, _NO_BLOCKS) if dense is None else (self._segment_slots, blocks)
        return energy + add_segments(x, self.eyelets.segments, pull, slots, self.gradient, blocks)

    def _wind(self, x: Array, winch: _Winch, pull: Array, dense: list[_DenseTerm] | None) -> float:
        """Fill the tensions by a commanded length; return its energy less sum T_i L_i."""
        segments, q = self.eyelets.segments[winch.segments], winch.stiffening
        weighted = weighted_length(x, segments, winch.weights)
        level, force, slope = onset(q * (weighted - winch.length))
        np.multiply(winch.weights, winch.spring * force, out=pull[winch.segments])
        if dense is not None and slope > 0.0:
            vector = np.zeros_like(self.gradient)
            add_segments(x, segments, winch.weights, _NO_TABLE, vector, _NO_BLOCKS)
            dense.append(_DenseTerm(winch.spring * q * slope, vector))
        return winch.spring * (level / q - force * weighted)

    def _add_gas(self, number: int, x: Array, acting: FilmLoads, dense: list[_DenseTerm] | None) -> float:
        """Add the gas of a chamber; return its potential [J], infinite if sealed gas has no volume."""
        chamber, gauge_Pa = self._plain_chambers[number], acting.pressures[number]
        gas = acting.gases[number] if acting.gases else None
        if gas is not None:
            vector = np.zeros_like(self.gradient)
            volume = _press(chamber, x, -1.0, vector, _NO_BLOCKS)
            gauge_Pa = gas.gauge_pressure(volume)
            if not gauge_Pa < np.inf:
                return np.inf
            if dense is not None:
                dense.append(_DenseTerm(gas.exponent * (gauge_Pa + gas.ambient_Pa) / volume, vector))
        if dense is None:
            volume = _press(chamber, x, gauge_Pa, self.gradient, _NO_BLOCKS)
        else:
            volume = _press(self._tangent_chambers[number], x, gauge_Pa, self.gradient, self.blocks)
        if not self.body.closed:
            for ring in chamber.rings:
                pressure.add_cap_force(x, ring, gauge_Pa, self.gradient)
        self.pressures_Pa[number], self.volumes_m3[number] = gauge_Pa, volume
        return -gauge_Pa * volume if gas is None else gas.potential(volume)

    def _add_further(self, x: Array, acting: FilmLoads, *, hessian: bool) -> float:
        """Add elements without kernels, and extra potentials; return their energy [J]."""
        inertia, extra, energy = acting.inertia, acting.loads.extra, 0.0
        step_s, closely = (np.inf, False) if inertia is None else (inertia.step_s, inertia.closely)
        at = Instant(self.before, self.memory, step_s, acting.loads, closely)
        for term, memory_slice in self._further:
            energy += term.add(x, at if memory_slice is None else at.part(memory_slice), hessian)
        return energy if extra is None else energy + extra.add(x, self._sums, hessian)


def _press(chamber: _Chamber, x: Array, gauge_Pa: float, gradient: Array, blocks: Array) -> float:
    """Add -p V of a chamber at a gauge pressure; return V [m^3]."""
    volume = unchecked(pressure.add_pressure)(x, chamber.triangles, gauge_Pa, chamber.slots, gradient, blocks)
    for ring, slots in zip(chamber.rings, chamber.ring_slots, strict=True):
        volume += unchecked(pressure.add_cap)(x, ring, gauge_Pa, slots, gradient, blocks)
    return volume


def _further(body: SoftBody, sums: Sums) -> list[tuple[Term, slice | None]]:
    """Return the elements without kernels as terms, each with the slice of its memory.

    The slice is None if no other element of the body has memory.
    """
    terms_of_body: list[tuple[Term, slice]] = []
    slice_of = dict(zip(map(id, body.elements), body.memory_slices, strict=True))
    for kind in body.kinds:
        if issubclass(kind, (LeafElement, Cable)):
            continue
        alike = [element for element in body.of_kind(kind) if type(element) is kind]
        memory_slices = [slice_of[id(element)] for element in alike]
        terms: Sequence[Any] = kind.bound(alike, sums) if alike else ()
        if len(terms) < len(alike):  # one for all
            memory_slices = [slice(memory_slices[0].start, memory_slices[-1].stop)]
        terms_of_body += zip(terms, memory_slices, strict=True)
    remembering = sum(memory_slice.stop > memory_slice.start for memory_slice in slice_of.values())
    return [
        (term, memory_slices if remembering > 1 and memory_slices.stop > memory_slices.start else None)
        for term, memory_slices in terms_of_body
    ]
