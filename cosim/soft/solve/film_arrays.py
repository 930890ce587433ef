"""A film as kernels see it, and its gradient: what the elements of most bodies add, in one call.

The terms are added by the kernels that sum them one by one, called by their addresses: each is compiled once,
and that of beams for bodies with beams alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_calls import address_of, caller
from cosim.base.kernels import BLOCKS, INDEX_TABLE, INDICES, MATRIX, VECTOR, device_function
from cosim.soft.beams.node_turns import BeamArrays
from cosim.soft.beams.ring_kernels import REMEMBERED, add_beam_rings
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import PlainLoads
from cosim.soft.contact.obstacle_contact import add_contacts
from cosim.soft.contact.self_contact_pairs import add_pairs
from cosim.soft.elements.cable import Cable, add_segments
from cosim.soft.elements.element import Element
from cosim.soft.elements.hinge import Hinges, add_hinges
from cosim.soft.elements.mass_terms import add_gravity, add_inertia
from cosim.soft.elements.membrane import Membranes, add_membranes
from cosim.soft.elements.pressure import add_cap, add_pressure

_CALLED = (add_membranes, add_hinges, add_segments, add_pressure, add_cap, add_gravity, add_inertia)
_MEMBRANES, _HINGES, _SEGMENTS, _PRESSURE, _CAP, _GRAVITY, _INERTIA, _BEAMS = range(len(_CALLED) + 1)
_add_membranes, _add_hinges, _add_segments, _add_pressure, _add_cap, _add_gravity, _add_inertia = map(
    caller, _CALLED
)
_add_beam_rings, _add_contacts, _add_pairs = map(caller, (add_beam_rings, add_contacts, add_pairs))
_TAKEN: tuple[type, ...] = (Membranes, Hinges, Cable)
"""What the kernel knows besides rings of beams; a body with anything else is summed term by term."""


class FilmBeams(NamedTuple):
    """Rings of beams, group after group of equal ones; see `BeamArrays`.

    Args:
        groups: (g, 4), where the nodes of each begin, how many rings, nodes of a ring, first of its memory.
        rings: nodes of all rings.
        directors: their directors, 9 numbers each.
        lengths: [m], of their beams.
        rigidities: (g, 4).
    """

    groups: IntArray
    rings: IntArray
    directors: Array
    lengths: Array
    rigidities: Array


class FilmArrays(NamedTuple):
    """Films, hinges, cables, beams, chambers and masses of one body.

    Args:
        calls: (8,) addresses of the kernels.
        triangles: (m, 3), film after film.
        shape_gradients: (m, 3, 2), see `Membranes`.
        areas: (m,) [m^2].
        drawn: (groups, 5 LANES), see `in_lanes`.
        stiffness: (films, 3, 3) [N/m].
        laws: (films,), code of each film's law.
        fraction: (films,), compressive fraction.
        forces: (w, 2) [N/m], see `wrinkling_forces`; of plain films none.
        films: (films + 1, 3), where the triangles, groups and forces of each film begin.
        hinges: (h, 4).
        hinge_stiffness: (h,) [N m/rad].
        rest_angle: (h,) [rad].
        fold_barrier: (1,) [rad].
        angles: (2,), where the hinges' memory begins and ends.
        segments: (s, 2), of all cables.
        cable: (s,), of which each is.
        ratio: (s,), its tension over that at the cable's base end.
        beams: stiffeners.
        gas_triangles: (t, 3), chamber after chamber.
        rings: (r,), nodes of the caps, one after the other.
        caps: (caps + 1,), where each begins.
        chambers: (chambers + 1, 2), where the triangles and caps of each begin.
        mass: (n,) [kg].
        no_slots: (0, 0), and
        no_blocks: (0, 3, 3), and
        no_places: (0,), for no Hessian.
    """

    calls: IntArray
    triangles: IntArray
    shape_gradients: Array
    areas: Array
    drawn: Array
    stiffness: Array
    laws: IntArray
    fraction: Array
    forces: Array
    films: IntArray
    hinges: IntArray
    hinge_stiffness: Array
    rest_angle: Array
    fold_barrier: Array
    angles: IntArray
    segments: IntArray
    cable: IntArray
    ratio: Array
    beams: FilmBeams
    gas_triangles: IntArray
    rings: IntArray
    caps: IntArray
    chambers: IntArray
    mass: Array
    no_slots: IntArray
    no_blocks: Array
    no_places: IntArray


_FILM_BEAMS = types.NamedTuple((INDEX_TABLE, INDICES, VECTOR, VECTOR, MATRIX), FilmBeams)
FILM = types.NamedTuple(
    (
        INDICES, INDEX_TABLE, BLOCKS, VECTOR, MATRIX, BLOCKS, INDICES, VECTOR, MATRIX, INDEX_TABLE,
        INDEX_TABLE, VECTOR, VECTOR, VECTOR, INDICES, INDEX_TABLE, INDICES, VECTOR, _FILM_BEAMS, INDEX_TABLE,
        INDICES, INDICES, INDEX_TABLE, VECTOR, INDEX_TABLE, BLOCKS, INDICES,
    ),
    FilmArrays,
)  # fmt: skip


class StepBed(NamedTuple):
    """The elastic bed that inertia is in a step.

    Args:
        coefficient: (n,) [N/m].
        target: (n, 3) [m].
    """

    coefficient: Array
    target: Array


PLAIN_LOADS = types.NamedUniTuple(VECTOR, 3, PlainLoads)  # as numba has it where all fields are alike
BED = types.NamedTuple((VECTOR, MATRIX), StepBed)


def film_arrays(body: SoftBody) -> FilmArrays | None:
    """Return a body's arrays; None where it has more than the kernel knows, or loads without a potential."""
    known = all(isinstance(element, _TAKEN) or _beams_of(element) for element in body.elements)
    frictionless = all(cable.friction_coefficient == 0.0 for cable in body.cables)
    if not known or not frictionless or (body.caps and not body.closed):
        return None
    triangles, shapes, areas, drawn, stiffness, laws, fractions, forces = zip(
        *(film.arrays for film in body.membranes), strict=True
    )
    hinges, cables, bent = body.hinges, body.cables, len(body.hinges.coupled)
    angles = body.memory_places[body.elements.index(hinges)]
    gas, caps = zip(*body.enclosures, strict=True)
    rings = [ring for those in caps for ring in those]
    no_pairs, none, beams = np.zeros((0, 2), np.int64), np.zeros(0, np.int64), _film_beams(body)
    return FilmArrays(
        np.array([*map(address_of, _CALLED), address_of(add_beam_rings) if len(beams.groups) else 0]),
        np.concatenate(triangles), np.concatenate(shapes), np.concatenate(areas), np.concatenate(drawn),
        np.array(stiffness), np.array(laws), np.array(fractions), np.concatenate(forces),
        np.stack([_firsts(triangles), _firsts(drawn), _firsts(forces)], axis=1),
        hinges.coupled, hinges.stiffness[:bent], hinges.rest_angle[:bent],
        np.array([hinges.fold_barrier_rad]), np.array([angles.start, angles.start + bent]),
        np.concatenate([no_pairs, *(cable.segments for cable in cables)]),
        np.repeat(np.arange(len(cables)), [len(cable.segments) for cable in cables]),
        np.concatenate([np.zeros(0), *(cable.tension_ratio(body.positions) for cable in cables)]),
        beams, np.concatenate(gas), np.concatenate([none, *rings]), _firsts(rings),
        np.stack([_firsts(gas), _firsts(caps)], axis=1), body.node_mass,
        np.zeros((0, 0), np.int64), np.zeros((0, 3, 3)), none,
    )  # fmt: skip


def _beams_of(element: Element) -> BeamArrays | None:
    """Return an element's beams; None where it has none. Its class is known to bodies with beams alone."""
    arrays = getattr(element, "arrays", None)
    return arrays if isinstance(arrays, BeamArrays) else None


def _film_beams(body: SoftBody) -> FilmBeams:
    pairs = zip(map(_beams_of, body.elements), body.memory_places, strict=True)
    found = [(beams, place.start) for beams, place in pairs if beams is not None]
    firsts = _firsts([np.ravel(beams.rings) for beams, _ in found]).tolist()
    groups = [(at, *beams.rings.shape, first) for at, (beams, first) in zip(firsts, found, strict=False)]
    rings = [np.ravel(beams.rings) for beams, _ in found]
    return FilmBeams(
        np.array(groups, np.int64).reshape(-1, 4), np.concatenate([np.zeros(0, np.int64), *rings]),
        np.concatenate([np.zeros(0), *(np.ravel(beams.directors) for beams, _ in found)]),
        np.concatenate([np.zeros(0), *(np.ravel(beams.lengths) for beams, _ in found)]),
        np.array([beams.rigidities for beams, _ in found]).reshape(-1, 4),
    )  # fmt: skip


def _firsts(parts: Sequence[Any]) -> IntArray:
    """Return where each of some lists begins if they follow each other, and where the last one ends."""
    return np.array([0, *accumulate(len(part) for part in parts)], dtype=np.int64)


@device_function
def film_gradient(film, loads, touching, bed, x, memory, pull, tracked, gradient):  # type: ignore[no-untyped-def]
    """Fill the gradient (n, 3) [N] of a film in a step and what its elements track; return the potential [J].

    Terms come in the order in which `SoftSystem.evaluate` adds them.

    Args:
        film: see `FilmArrays`.
        loads: see `PlainLoads`.
        touching: see `Touching`.
        bed: see `StepBed`.
        x: (n, 3) [m].
        memory: (values,), see `Instant`.
        pull: (s,), scratch.
        tracked: (values,), see `Instant`.
        gradient: (n, 3), filled.
    """
    for i in range(gradient.shape[0]):
        for r in range(3):
            gradient[i, r] = 0.0
    energy = 0.0
    for k in range(film.laws.shape[0]):
        a, b = film.films[k], film.films[k + 1]
        energy += _add_membranes(
            film.calls[_MEMBRANES],
            (
                x, film.triangles[a[0] : b[0]], film.shape_gradients[a[0] : b[0]], film.areas[a[0] : b[0]],
                film.drawn[a[1] : b[1]], film.stiffness[k], film.laws[k], film.fraction[k],
                film.forces[a[2] : b[2]], film.no_slots, gradient, film.no_blocks,
            ),
        )  # fmt: skip
    first, end = film.angles[0], film.angles[1]
    energy += _add_hinges(
        film.calls[_HINGES],
        (
            x, film.hinges, film.hinge_stiffness, film.rest_angle, film.fold_barrier[0], memory[first:end],
            film.no_slots, gradient, film.no_blocks, tracked[first:end],
        ),
    )  # fmt: skip
    for s in range(film.ratio.shape[0]):
        pull[s] = loads.tension[film.cable[s]] * film.ratio[s]
    segments = x, film.segments, pull, film.no_slots, gradient, film.no_blocks
    energy += _add_segments(film.calls[_SEGMENTS], segments)
    energy += _add_beams(film, x, memory, tracked, gradient)
    energy += _add_gas(film, loads.pressure, x, gradient)
    energy += _add_gravity(film.calls[_GRAVITY], (x, film.mass, loads.gravity, gradient))
    planes = touching.planes
    if planes.call != 0:
        contacts = x, planes.planes, planes.widths, gradient, film.no_blocks, planes.own, planes.pressing
        energy += _add_contacts(planes.call, contacts)
    inertia = x, bed.coefficient, bed.target, film.no_places, gradient, film.no_blocks
    energy += _add_inertia(film.calls[_INERTIA], inertia)
    if touching.call != 0:
        energy += _add_pairs(touching.call, (x, touching.pairs, film.no_slots, gradient, film.no_blocks))
    return energy


@device_function
def _add_beams(film, x, memory, tracked, gradient):  # type: ignore[no-untyped-def]
    """Add the gradient of all rings of beams; return their energy [J]."""
    energy = 0.0
    for k in range(film.beams.groups.shape[0]):
        begin, rings, nodes, first = film.beams.groups[k]
        end, last = begin + rings * nodes, first + REMEMBERED * rings * nodes
        beams = BeamArrays(
            film.beams.rings[begin:end].reshape((rings, nodes)),
            film.beams.directors[9 * begin : 9 * end].reshape((rings, nodes, 3, 3)),
            film.beams.lengths[begin:end].reshape((rings, nodes)),
            film.beams.rigidities[k],
        )
        own, new, no_hessian = memory[first:last], tracked[first:last], (gradient, film.no_blocks)
        energy += _add_beam_rings(film.calls[_BEAMS], (x, beams, own, True, film.no_slots, *no_hessian, new))
    return energy


@device_function
def _add_gas(film, pressure, x, gradient):  # type: ignore[no-untyped-def]
    """Add the gradient of -p V of all chambers; return that potential [J]."""
    energy = 0.0
    for k in range(film.chambers.shape[0] - 1):
        a, b = film.chambers[k], film.chambers[k + 1]
        triangles, given = film.gas_triangles[a[0] : b[0]], pressure[k]
        filled = x, triangles, given, film.no_slots, gradient, film.no_blocks
        volume = _add_pressure(film.calls[_PRESSURE], filled)
        for cap in range(a[1], b[1]):
            ring = film.rings[film.caps[cap] : film.caps[cap + 1]]
            volume += _add_cap(film.calls[_CAP], (x, ring, given, film.no_places, gradient, film.no_blocks))
        energy += -given * volume
    return energy
