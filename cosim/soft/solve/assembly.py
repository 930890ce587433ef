"""Assembly: potential, gradient and Hessian of a soft body at given positions.

What kernels know of a body is packed into arrays, and summed in one call (`film_terms`); all else follows,
term by term.
"""

from collections.abc import Sequence
from functools import cached_property
from itertools import accumulate, pairwise
from typing import Any, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import RecordStore
from cosim.errors import InputError
from cosim.soft.beams.ring_kernels import REMEMBERED, BeamArrays
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements import frame_ring, hinge, membrane, pressure
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.element import Element, Instant, Sums, Term
from cosim.soft.elements.eyelets import COLUMNS, RATIO, SHARE, eyelet_laws, eyelet_loss, frozen_losses
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.film import step_arrays, strain_rates
from cosim.soft.film.film_terms import FilmActing, film_terms, term_calls
from cosim.soft.linear.linear_solver import LowRank
from cosim.soft.linear.pattern import BlockPattern, PatternWidening, ranges_apart

_NO_SLOTS = np.zeros(0, np.int64)
_NO_MEMORY = np.zeros(0)
_NO_BED = step_arrays.StepBed(np.zeros(0), np.zeros((0, 3)), False, 0)


@final
class SoftSystem:
    """Workspace in which one body's potential and derivatives are assembled.

    After `evaluate`: `gradient` (n, 3) [N], `blocks` (pattern.blocks, 3, 3) [N/m], `memory` (values,) of the
    elements as they track it, `volume` and `pressure_Pa` of the gas, `low_rank` (dense parts of the Hessian,
    such as of sealed gas). `tangent_pattern` and `tangent_blocks` are the sparse Hessian: the body's
    own, or a wider one where films touch one another. They are overwritten by the next call. `serving` is the
    pattern to continue from where films touch, which a solver sets to that of its last factorisation.
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
        self.serving, self.widening = self.pattern, PatternWidening(self.pattern)
        self.memory = body.first_memory()
        diagonal = np.flatnonzero(self.pattern.row == self.pattern.column)
        self._sums = Sums(self.gradient, self.blocks, diagonal, self.pattern.slots, self._widened)
        self.gas = pressure.GasChambers(body.enclosures)
        self._further = _bound_elements(body, self._sums)
        self._advancing = _advancing(body)
        places = zip(body.elements, body.memory_places, strict=True)
        self._freshened = [(each, own) for each, own in places if type(each).fresh is not Element.fresh]
        self._acting: tuple[tuple[object, ...], FilmActing] | None = None
        self.low_rank: LowRank | None = None
        self._stores = RecordStore(step_arrays.FilmArrays), RecordStore(step_arrays.FilmArrays)

    @cached_property
    def film(self) -> step_arrays.FilmArrays:
        """What kernels know of the body, in parts that nothing couples."""
        return film_arrays(self.body, ranges_apart(self.pattern))

    @cached_property
    def whole_film(self) -> step_arrays.FilmArrays:
        """The same as one part."""
        return self.film._replace(parts=np.ascontiguousarray(self.film.parts[[0, -1]]))

    @cached_property
    def at(self) -> int:
        """Address at which kernels read `film`."""
        return self._stores[0].address(self.film)

    @cached_property
    def whole_at(self) -> int:
        """The same of `whole_film`."""
        return self._stores[1].address(self.whole_film)

    @cached_property
    def slots(self) -> step_arrays.FilmSlots:
        """Where the terms of the film are in the body's own pattern."""
        return film_slots(self.film, self.pattern)

    @cached_property
    def _pull(self) -> Array:
        return np.empty(len(self.film.segments))

    @property
    def complete(self) -> bool:
        """Whether the film is all that the body is made of."""
        return not self._further

    @property
    def conservative(self) -> bool:
        """Whether all loads have a potential."""
        return self.body.closed or not self.body.caps

    @property
    def volume(self) -> float:
        """Volume [m^3] of all chambers together, where `evaluate` was called last."""
        return float(self._found[:, 1].sum())

    @property
    def pressure_Pa(self) -> float:
        """Gauge pressure in the first chamber there."""
        return float(self._found[0, 0])

    @property
    def _found(self) -> Array:
        assert self._acting is not None, "evaluate() comes before"
        return self._acting[1].more.found

    def open_cap_stiffness(self, positions: Array) -> list[tuple[IntArray, Array]]:
        """Return what missing caps add to the stiffness at positions (n, 3) [m], by ring."""
        return [] if self.conservative else self.gas.open_cap_stiffness(positions, self._found[:, 0])

    def add_open_caps(self, positions: Array) -> None:
        """Add the symmetric part of what missing caps do at positions (n, 3) [m] to the tangent in store."""
        for ring, part in self.open_cap_stiffness(positions):
            count, slots = len(ring), self.tangent_pattern.slots(ring[None])[0]
            whole = (0.5 * (part + part.T)).reshape(count, 3, count, 3).swapaxes(1, 2)
            pairs = whole[np.tril_indices(count)]
            turned = slots < 0
            pairs[turned] = pairs[turned].swapaxes(1, 2)
            np.add.at(self.tangent_blocks, np.where(turned, -1 - slots, slots), pairs)

    @property
    def eyelets(self) -> IntArray:
        """Nodes (m,) that elements tie together across the mesh."""
        far = [element.coupled for element in self.body.elements if element.far]
        return np.unique(np.concatenate([_NO_SLOTS, *(np.ravel(nodes) for nodes in far)]))

    def segment_share(self, positions: Array, loads: Loads, memory: Array | None = None) -> Array:
        """Return what losses at a given shape make of cables in every segment (segments, COLUMNS).

        Args:
            positions: (n, 3) [m].
            loads: that act.
            memory: (values,), of the last accepted state; as of cables that are pulled taut unless given.
        """
        body = self.body
        before = body.first_memory() if memory is None and self.slides else memory
        pulls = loads.cable_tension_N, loads.cable_length_m, loads.cable_stiffening
        return frozen_losses(
            self.film.eyelets, body.cables, positions, _NO_MEMORY if before is None else before, pulls
        )

    @cached_property
    def slides(self) -> bool:
        """Whether some cable remembers which way it has slid."""
        return any(cable.remembers for cable in self.body.cables)

    def unslid(self, memory: Array, accepted: Array) -> Array:
        """Return memory (values,) tracked by a solution, with eyelets as in the accepted state before it."""
        if not self.slides:
            return memory
        places = self.film.eyelets.places
        result, places = memory.copy(), places[places >= 0]
        result[places] = accepted[places]
        return result

    def lost_at_eyelets(self, positions: Array, before: Array, after: Array) -> float:
        """Return the work lost at eyelets [J] from one accepted state to the next.

        Args:
            positions: (n, 3) [m], at the end.
            before: (values,), what elements remember at the beginning.
            after: the same at the end.
        """
        return eyelet_loss(positions, self.film.eyelets, before, after) if self.slides else 0.0

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
        """Whether some element looks at something again as a static solution begins."""
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
        share: Array,
        memory: Array,
        *,
        inertia: Inertia | None = None,
        hessian: bool = True,
    ) -> float:
        """Assemble potential, gradient and (unless told not to) Hessian.

        Args:
            positions: (n, 3) [m], world, C-contiguous.
            loads: pressure, tension, gravity, nodal forces.
            share: (segments, COLUMNS), from `segment_share`.
            memory: (values,), what the elements remember of the last accepted state; hinge angles are
                unwrapped against it.
            inertia: of an implicit step; None in statics.
            hessian: whether to fill `blocks`.

        Returns:
            The potential [J]; infinite where a sealed gas has no volume.
        """
        film, acting = self.whole_film, self.acting(loads, share, inertia)
        blocks, slots, films = film.no_blocks, film.no_slots, loads.self_contact
        if hessian:
            self.blocks[:] = 0.0
            self.tangent_pattern, self.tangent_blocks = self.pattern, self.blocks
            blocks, slots = self.blocks, self.slots
            if films is not None:  # touching films widen the tangent, in which all else is by then
                acting = acting._replace(touching=acting.touching._replace(call=0))
        self.memory[:] = memory
        point = step_arrays.FilmPoint(positions, memory, self.memory, self.gradient, blocks, self._pull)
        energy: float = film_terms(self.whole_at, slots, acting, 0, point)
        if not self.complete or loads.extra is not None:
            energy += self._add_further(positions, loads, memory, inertia, hessian=hessian)
        if hessian and films is not None:
            energy += films.add(positions, self._sums, hessian)
        if hessian:
            self.low_rank = LowRank.acting(acting.more.vectors, acting.more.coefficients)
        return energy

    def act_as(self, other: "SoftSystem") -> None:
        """Take over what acts on another film, of as many chambers and with the same cables."""
        self._acting = other._acting

    def acting(self, loads: Loads, share: Array, inertia: Inertia | None) -> FilmActing:
        """Return what acts on the film as kernels take it; the same arrays for the same objects."""
        key = loads, share, inertia
        last = self._acting
        if last is None or not all(one is other for one, other in zip(last[0], key, strict=True)):
            more, plain = film_loads(self.body, loads, share), loads.arrays(self.gas.count)
            found = FilmActing(plain, more, loads.touching, _bed_of(inertia))
            last = self._acting = key, found
        return last[1]

    def _add_further(
        self, positions: Array, loads: Loads, memory: Array, inertia: Inertia | None, *, hessian: bool
    ) -> float:
        """Add what kernels do not know; return its energy [J]."""
        step_s, closely = (np.inf, False) if inertia is None else (inertia.step_s, inertia.closely)
        at, energy = Instant(memory, self.memory, step_s, loads, closely), 0.0
        for term, own in self._further:
            energy += term.add(positions, at if own is None else at.part(own), hessian)
        extra = loads.extra
        return energy if extra is None else energy + extra.add(positions, self._sums, hessian)

    def take_own_tangent(self, rows: slice) -> None:
        """Let the body's own pattern be the tangent's, with no dense part; clear the blocks of some nodes."""
        first, last = np.searchsorted(self.pattern.row, [rows.start, rows.stop])
        self.blocks[first:last] = 0.0
        self.tangent_pattern, self.tangent_blocks, self.low_rank = self.pattern, self.blocks, None

    def _widened(self, nodes: IntArray) -> tuple[Array, BlockPattern]:
        coupled = self.widening.around(nodes, self.serving)
        self.tangent_pattern, self.tangent_blocks = coupled.pattern, coupled.blocks(self.blocks)
        return self.tangent_blocks, coupled.pattern


_TAKEN: Final[tuple[type, ...]] = (membrane.Membranes, hinge.Hinges, Cable, frame_ring.FrameRings)
"""What kernels know besides rings of beams; all else is summed after them, term by term."""


def is_packed(element: Element) -> bool:
    """Return whether an element is in the arrays of its body."""
    return isinstance(element, _TAKEN) or _beams_of(element) is not None


def film_arrays(body: SoftBody, apart: IntArray) -> step_arrays.FilmArrays:
    """Return the arrays of what kernels know of a body, see `is_packed`.

    Args:
        body: to be packed.
        apart: (k + 1,), where the nodes of its parts begin, see `ranges_apart`; what is not listed part by
            part is one.
    """
    triangles, shapes, areas, drawn, stiffness, laws, compression, forces, yarns = zip(
        *(film.arrays for film in body.membranes), strict=True
    )
    hinges, cables, bent = body.hinges, body.cables, len(body.hinges.coupled)
    angles = body.memory_places[body.elements.index(hinges)]
    places = zip(body.elements, body.memory_places, strict=True)
    routes = tuple(own for element, own in places if isinstance(element, Cable))
    gas, caps = zip(*body.enclosures, strict=True)
    rings = [ring for those in caps for ring in those]
    no_pairs, none = np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
    beams, frames = _film_beams(body, apart), _film_frames(body, apart)
    segments = np.concatenate([no_pairs, *(cable.segments for cable in cables)])
    listed = hinges.coupled[:, None], segments[:, None]  # row by row
    rows = triangles, *listed, _rings(beams), _rings(frames), gas
    return step_arrays.FilmArrays(
        np.array(term_calls()),
        np.concatenate(triangles), np.concatenate(shapes), np.concatenate(areas), np.concatenate(drawn),
        np.array(stiffness), np.array(laws), np.array(compression), np.concatenate(forces),
        np.array(yarns),
        np.stack([_firsts(triangles), _firsts(drawn), _firsts(forces)], axis=1),
        hinges.coupled, hinges.stiffness[:bent], hinges.rest_angle[:bent],
        np.array([hinges.fold_barrier_rad]), np.array([angles.start, angles.start + bent]), segments,
        np.repeat(np.arange(len(cables)), [len(cable.segments) for cable in cables]),
        eyelet_laws(cables, routes), beams, frames, np.concatenate(gas),
        np.concatenate([none, *rings]), _firsts(rings), np.stack([_firsts(gas), _firsts(caps)], axis=1),
        np.full(len(rings), not body.closed, np.int64), body.node_mass, _parts(rows, apart),
        _no_slots(len(rings)), np.zeros((0, 3, 3)),
    )  # fmt: skip


def film_slots(film: step_arrays.FilmArrays, pattern: BlockPattern) -> step_arrays.FilmSlots:
    """Return where pairs of a film's nodes are in a pattern."""
    rings = [film.rings[a:b] for a, b in zip(film.caps[:-1], film.caps[1:], strict=True)]
    caps, none = [pattern.slots(ring[None, :])[0] for ring in rings], np.zeros(0, np.int64)
    tied = [pattern.slots(nodes[None])[0] if len(nodes) else none for nodes in film.eyelets.tied]
    return step_arrays.FilmSlots(
        pattern.slots(film.triangles), pattern.slots(film.hinges), pattern.slots(film.segments),
        np.concatenate([none, *tied]), _firsts(tied), pattern.slots(film.gas_triangles),
        np.concatenate([none, *caps]), _firsts(caps),
        np.concatenate([none, *(pattern.slots(ring).ravel() for ring in _rings(film.beams))]),
        np.concatenate([none, *(pattern.slots(ring).ravel() for ring in _rings(film.frames))]),
        np.flatnonzero(pattern.row == pattern.column),
    )  # fmt: skip


def film_loads(body: SoftBody, loads: Loads, share: Array) -> step_arrays.FilmLoads:
    """Return what acts on a body besides what is plain, with room for what it adds to a tangent.

    Args:
        body: of which films.
        loads: that act.
        share: (segments, COLUMNS), see `segment_share`.
    """
    cables, chambers, rows = body.cables, len(body.gas_chambers), share.reshape(-1, COLUMNS)
    lengths, spring, gas = loads.cable_length_m, np.zeros(0), np.zeros((0, 4))
    if any(length is not None for length in lengths):
        firsts = _firsts([cable.segments for cable in cables])[:-1]
        # the first segment has w_1 = r_1 / m, so that m follows from it
        stiffness = np.array([c.stiffness_N_m for c in cables])
        spring = stiffness * rows[firsts, RATIO] / rows[firsts, SHARE]
    else:
        lengths = ()
    if any(loads.gas):
        sealed = loads.gases(chambers)
        if body.caps and not body.closed:
            raise InputError("a sealed gas needs a closed body; this one has open caps")
        nothing = (0.0, 0.0, 0.0, 0.0)
        gas = np.array([nothing if each is None else each.numbers for each in sealed])
    eyelets = rows.copy() if any(cable.remembers for cable in cables) else rows[:0]
    dense = len(lengths) + len(gas)
    force = np.zeros((0, 3)) if loads.nodal_force is None else np.array(loads.nodal_force, order="C")
    return step_arrays.FilmLoads(
        rows[:, SHARE].copy(), np.array([np.nan if length is None else length for length in lengths]), spring,
        gas, eyelets, force,
        np.array(loads.cable_stiffening or np.ones(len(lengths))),
        np.zeros((chambers, 2)), np.zeros((dense, body.nodes if dense else 0, 3)), np.zeros(dense),
    )  # fmt: skip


def _no_slots(caps: int) -> step_arrays.FilmSlots:
    table, none = np.zeros((0, 0), np.int64), np.zeros(0, np.int64)
    firsts, of_caps = np.zeros(1, np.int64), np.zeros(caps + 1, np.int64)
    return step_arrays.FilmSlots(table, table, table, none, firsts, table, none, of_caps, none, none, none)


def _parts(rows: Sequence[Sequence[IntArray] | IntArray], apart: IntArray) -> IntArray:
    """Return where nodes and each of some kinds of rows begin in each part; one part where they are mixed.

    Args:
        rows: nodes of each film, hinge, segment, group of beams, group of frames and chamber, kind by kind.
        apart: (k + 1,), where the nodes of parts begin.
    """
    columns, mixed = [apart], False
    for entries in rows:
        first, last = (np.searchsorted(apart, nodes, side="right") - 1 for nodes in _extremes(entries))
        mixed = mixed or bool((first != last).any() or (np.diff(first) < 0).any())
        column = np.searchsorted(first, np.arange(len(apart)))
        column[-1] = len(first)
        columns.append(column)
    table = np.stack(columns, axis=1)
    return np.ascontiguousarray(table[[0, -1]] if mixed else table)


def _extremes(entries: Sequence[IntArray] | IntArray) -> tuple[IntArray, IntArray]:
    """Return the lowest and the highest node of each of some entries; of none: 0."""
    if isinstance(entries, np.ndarray):
        return entries.min(axis=(1, 2)), entries.max(axis=(1, 2))
    found = [(np.min(nodes), np.max(nodes)) if np.size(nodes) else (0, 0) for nodes in entries]
    lowest, highest = np.array(found, np.int64).reshape(-1, 2).T
    return lowest, highest


def _beams_of(element: Element) -> BeamArrays | None:
    """Return an element's beams; None where it has none. Its class is known to bodies with beams alone."""
    arrays = getattr(element, "arrays", None)
    return arrays if isinstance(arrays, BeamArrays) else None


def _film_beams(body: SoftBody, apart: IntArray) -> step_arrays.FilmBeams:
    """Return the rings of beams of a body, those of each element part by part."""
    groups, found = list[tuple[int, int, int, int, int]](), list[BeamArrays]()
    begin, slot = 0, 0
    for element, place in zip(body.elements, body.memory_places, strict=True):
        beams = _beams_of(element)
        if beams is None:
            continue
        count, nodes = beams.rings.shape
        for a, b in _part_by_part(beams.rings, apart):
            groups.append((begin + a * nodes, b - a, nodes, place.start + REMEMBERED * a * nodes, slot))
            slot += (b - a) * nodes * (nodes + 1) // 2
            found.append(beams)
        begin += count * nodes
    whole = list({id(beams): beams for beams in found}.values())
    return step_arrays.FilmBeams(
        np.array(groups, np.int64).reshape(-1, 5),
        np.concatenate([np.zeros(0, np.int64), *(np.ravel(beams.rings) for beams in whole)]),
        np.concatenate([np.zeros(0), *(np.ravel(beams.directors) for beams in whole)]),
        np.concatenate([np.zeros(0), *(np.ravel(beams.lengths) for beams in whole)]),
        np.array([beams.rigidities for beams in found]).reshape(-1, 4),
    )


def _film_frames(body: SoftBody, apart: IntArray) -> step_arrays.FilmFrames:
    """Return the frames and plates of a body, those of each element part by part."""
    groups, found = list[tuple[int, int, int, int, int]](), list(body.of_kind(frame_ring.FrameRings))
    begin, first, slot = 0, 0, 0
    for frames in found:
        nodes = frames.rings.shape[1]
        for a, b in _part_by_part(frames.rings, apart):
            groups.append((begin + a * nodes, b - a, nodes, first + a * nodes * nodes, slot))
            slot += (b - a) * nodes * (nodes + 1) // 2
        begin, first = begin + frames.rings.size, first + frames.projections.size
    return step_arrays.FilmFrames(
        np.array(groups, np.int64).reshape(-1, 5),
        np.concatenate([np.zeros(0, np.int64), *(frames.rings.ravel() for frames in found)]),
        np.concatenate([np.zeros(0), *(frames.projections.ravel() for frames in found)]),
        np.concatenate([np.zeros(0), *(frames.lengths.ravel() for frames in found)]),
        np.array([each.stiffness_N_m for each in found for _ in _part_by_part(each.rings, apart)]),
    )


def _part_by_part(rings: IntArray, apart: IntArray) -> list[tuple[int, int]]:
    """Return where the rings (f, m) of each part begin and end, the nodes of parts beginning at `apart`."""
    part = np.searchsorted(apart, rings.min(axis=1), side="right")
    return list(pairwise([0, *(1 + np.flatnonzero(np.diff(part))).tolist(), len(rings)]))


def _rings(groups: step_arrays.FilmBeams | step_arrays.FilmFrames) -> list[IntArray]:
    """Return the nodes (f, m) of each group of rings."""
    return [
        groups.rings[begin : begin + count * nodes].reshape(count, nodes)
        for begin, count, nodes, *_ in groups.groups.tolist()
    ]


def _firsts(parts: Sequence[Any]) -> IntArray:
    """Return where each of some lists begins if they follow each other, and where the last one ends."""
    return np.array([0, *accumulate(len(part) for part in parts)], dtype=np.int64)


def _bed_of(inertia: Inertia | None) -> step_arrays.StepBed:
    if inertia is None:
        return _NO_BED
    closely = inertia.closely or inertia.step_s == np.inf
    return step_arrays.StepBed(inertia.coefficient, inertia.target, closely, inertia.rates)


def _bound_elements(body: SoftBody, sums: Sums) -> list[tuple[Term, slice | None]]:
    """Return the elements that the film lacks as terms, each with the place of its memory.

    None where no other element of the body has one.
    """
    found: list[tuple[Term, slice]] = []
    places = dict(zip(map(id, body.elements), body.memory_places, strict=True))
    for kind in body.kinds:
        alike = [
            element for element in body.of_kind(kind) if type(element) is kind and not is_packed(element)
        ]
        own = [places[id(element)] for element in alike]
        terms = kind.bound(alike, sums) if alike else ()
        if len(terms) < len(alike):  # one for all
            own = [slice(own[0].start, own[-1].stop)]
        found += zip(terms, own, strict=True)
    remembering = sum(place.stop > place.start for place in places.values())
    return [(term, own if remembering > 1 and own.stop > own.start else None) for term, own in found]


def _advancing(body: SoftBody) -> list[tuple[Element, slice]]:
    """Return the elements that remember something else of a step's end than they track, with its place."""
    pairs = zip(body.elements, body.memory_places, strict=True)
    return [(element, own) for element, own in pairs if element.remembers_steps]


@final
class FilmEnergies:
    """What a body's film holds and loses, at shapes that are given; made when it is first asked for.

    Another process makes its own.

    Args:
        body: the film.
        tick_s: [s], of the run.
    """

    def __init__(self, body: SoftBody, tick_s: float) -> None:
        self._body, self._tick_s = body, tick_s

    def __reduce__(self) -> tuple[Any, ...]:
        return FilmEnergies, (self._body, self._tick_s)

    @cached_property
    def _system(self) -> tuple[SoftSystem, Array]:
        system = SoftSystem(self._body)
        return system, system.fresh(self._body.first_memory())

    @cached_property
    def _rates(self) -> strain_rates.StrainRates | None:
        return strain_rates.StrainRates.of(self._body, self._system[0].film)

    def elastic(self, positions: Array) -> float:
        """Return the elastic energy [J] at positions (n, 3) [m]."""
        (system, memory), x = self._system, np.array(positions, order="C")
        loads = Loads((), (0.0,) * len(self._body.cables), (0.0, 0.0, 0.0))
        return system.evaluate(x, loads, system.segment_share(x, loads), memory, hessian=False)

    def resisted(self, positions: Array, two_steps: bool) -> float:
        """Return the power [W] that materials lose in a tick.

        Args:
            positions: (3, n, 3) [m] two ticks before its end, one before, and there.
            two_steps: whether its step looks back over both.
        """
        rates = self._rates
        if rates is None:
            return 0.0
        span = 2.0 * self._tick_s / 3.0 if two_steps else self._tick_s
        rates.begin(positions[1].copy(), positions[0].copy() if two_steps else None, span)
        return 2.0 * rates.potential(positions[2].copy()) / span
