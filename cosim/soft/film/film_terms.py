"""What the elements of most bodies add, in one call: potential, gradient and tangent of one part of a film.

The terms are added by the kernels that sum them one by one, called by their addresses: each is compiled once,
and that of beams for bodies with beams alone.
"""

from __future__ import annotations

from numba import types

from cosim.base.kernels import BLOCKS, INTEGER, MATRIX, REAL, VECTOR, address_of, device_function, kernel
from cosim.base.numba_insides import caller
from cosim.soft.beams.node_turns import BeamArrays
from cosim.soft.beams.ring_kernels import REMEMBERED, add_beam_rings
from cosim.soft.body.loads import TOUCHING, PlainLoads
from cosim.soft.contact.obstacle_contact import add_contacts
from cosim.soft.contact.self_contact_pairs import add_pairs
from cosim.soft.elements.cable import add_segments
from cosim.soft.elements.hinge import add_hinges
from cosim.soft.elements.mass_terms import add_gravity, add_inertia
from cosim.soft.elements.membrane import add_membranes
from cosim.soft.elements.pressure import add_cap, add_pressure
from cosim.soft.film.film_arrays import BEAMS, BED, CHAMBERS, FILM, FILMS, HINGES, NODES, SEGMENTS, SLOTS

_CALLED = (add_membranes, add_hinges, add_segments, add_pressure, add_cap, add_gravity, add_inertia)
_MEMBRANES, _HINGES, _SEGMENTS, _PRESSURE, _CAP, _GRAVITY, _INERTIA, _BEAMS = range(len(_CALLED) + 1)
_add_membranes, _add_hinges, _add_segments, _add_pressure, _add_cap, _add_gravity, _add_inertia = map(
    caller, _CALLED
)
_add_beam_rings, _add_contacts, _add_pairs = map(caller, (add_beam_rings, add_contacts, add_pairs))

PLAIN_LOADS = types.NamedUniTuple(VECTOR, 3, PlainLoads)  # as numba has it where all fields are alike


def term_calls(*, beams: bool) -> list[int]:
    """Return the addresses (8,) of the kernels of the terms; of a body without beams none of theirs."""
    return [*map(address_of, _CALLED), address_of(add_beam_rings) if beams else 0]


@kernel(
    REAL(
        FILM, SLOTS, PLAIN_LOADS, TOUCHING, BED, INTEGER, MATRIX, VECTOR, VECTOR, VECTOR, MATRIX, BLOCKS
    )
)  # fmt: skip
def film_terms(  # type: ignore[no-untyped-def]
    film, slots, loads, touching, bed, part, x, memory, pull, tracked, gradient, blocks
):
    """Fill a part's rows of the gradient (n, 3) [N] of a film in a step; return its potential [J].

    Fills as well what its elements track, and adds to the blocks if slots are not empty. Terms come in the
    order in which `SoftSystem.evaluate` adds them.

    Args:
        film: see `FilmArrays`.
        slots: see `FilmSlots`.
        loads: see `PlainLoads`.
        touching: see `Touching`; films touch one another in a film of one part only.
        bed: see `StepBed`.
        part: its number.
        x: (n, 3) [m].
        memory: (values,), see `Instant`.
        pull: (s,), scratch.
        tracked: (values,), see `Instant`.
        gradient: (n, 3), filled.
        blocks: (b, 3, 3) [N/m].
    """
    a, b = film.parts[part], film.parts[part + 1]
    begin, end = a[NODES], b[NODES]
    for i in range(begin, end):
        for r in range(3):
            gradient[i, r] = 0.0
    energy = 0.0
    for k in range(a[FILMS], b[FILMS]):
        energy += _add_film(film, slots, k, x, gradient, blocks)
    energy += _add_bends(film, slots, a[HINGES], b[HINGES], x, memory, tracked, gradient, blocks)
    first, last = a[SEGMENTS], b[SEGMENTS]
    for s in range(first, last):
        pull[s] = loads.tension[film.cable[s]] * film.ratio[s]
    segments = x, film.segments[first:last], pull[first:last], slots.segments[first:last], gradient, blocks
    energy += _add_segments(film.calls[_SEGMENTS], segments)
    groups, moving = (a[BEAMS], b[BEAMS]), not bed.closely
    energy += _add_beams(film, slots, groups, moving, x, memory, tracked, gradient, blocks)
    energy += _add_gas(film, slots, a[CHAMBERS], b[CHAMBERS], loads.pressure, x, gradient, blocks)
    own, mass = gradient[begin:end], film.mass[begin:end]
    energy += _add_gravity(film.calls[_GRAVITY], (x[begin:end], mass, loads.gravity, own))
    planes = touching.planes
    if planes.call != 0:
        contacts = x, planes.planes, planes.widths, begin, end, gradient, blocks, planes.own, planes.pressing
        energy += _add_contacts(planes.call, contacts)
    inertia = x[begin:end], bed.coefficient[begin:end], bed.target[begin:end], slots.diagonal[begin:end]
    energy += _add_inertia(film.calls[_INERTIA], (*inertia, own, blocks))
    if touching.call != 0:
        energy += _add_pairs(touching.call, (x, touching.pairs, film.no_slots.triangles, gradient, blocks))
    return energy


@device_function
def _add_film(film, slots, k, x, gradient, blocks):  # type: ignore[no-untyped-def]
    """Add the triangles of film k; return their energy [J]."""
    a, b = film.films[k], film.films[k + 1]
    return _add_membranes(
        film.calls[_MEMBRANES],
        (
            x, film.triangles[a[0] : b[0]], film.shape_gradients[a[0] : b[0]], film.areas[a[0] : b[0]],
            film.drawn[a[1] : b[1]], film.stiffness[k], film.laws[k], film.fraction[k],
            film.forces[a[2] : b[2]], slots.triangles[a[0] : b[0]], gradient, blocks,
        ),
    )  # fmt: skip


@device_function
def _add_bends(film, slots, first, last, x, memory, tracked, gradient, blocks):  # type: ignore[no-untyped-def]
    """Add some of the hinges; return their energy [J]."""
    begin, end = film.angles[0] + first, film.angles[0] + last
    return _add_hinges(
        film.calls[_HINGES],
        (
            x, film.hinges[first:last], film.hinge_stiffness[first:last], film.rest_angle[first:last],
            film.fold_barrier[0], memory[begin:end], slots.hinges[first:last], gradient, blocks,
            tracked[begin:end],
        ),
    )  # fmt: skip


@device_function
def _add_beams(film, slots, groups, moving, x, memory, tracked, gradient, blocks):  # type: ignore[no-untyped-def]
    """Add some groups of rings of beams; return their energy [J]."""
    energy = 0.0
    for k in range(groups[0], groups[1]):
        begin, rings, nodes, first, slot = film.beams.groups[k]
        end, last = begin + rings * nodes, first + REMEMBERED * rings * nodes
        beams = BeamArrays(
            film.beams.rings[begin:end].reshape((rings, nodes)),
            film.beams.directors[9 * begin : 9 * end].reshape((rings, nodes, 3, 3)),
            film.beams.lengths[begin:end].reshape((rings, nodes)),
            film.beams.rigidities[k],
        )
        pairs, differentiated = nodes * (nodes + 1) // 2, rings if slots.diagonal.shape[0] > 0 else 0
        own = slots.beams[slot : slot + differentiated * pairs].reshape((differentiated, pairs))
        places = memory[first:last], moving, own, gradient, blocks, tracked[first:last]
        energy += _add_beam_rings(film.calls[_BEAMS], (x, beams, *places))
    return energy


@device_function
def _add_gas(film, slots, first, last, pressure, x, gradient, blocks):  # type: ignore[no-untyped-def]
    """Add -p V of some chambers; return that potential [J]."""
    energy = 0.0
    for k in range(first, last):
        a, b = film.chambers[k], film.chambers[k + 1]
        triangles, given = film.gas_triangles[a[0] : b[0]], pressure[k]
        filled = x, triangles, given, slots.gas[a[0] : b[0]], gradient, blocks
        volume = _add_pressure(film.calls[_PRESSURE], filled)
        for cap in range(a[1], b[1]):
            ring = film.rings[film.caps[cap] : film.caps[cap + 1]]
            own = slots.caps[slots.first_of_cap[cap] : slots.first_of_cap[cap + 1]]
            volume += _add_cap(film.calls[_CAP], (x, ring, given, own, gradient, blocks))
        energy += -given * volume
    return energy
