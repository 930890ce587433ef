"""What the elements of most bodies add, in one call: potential, gradient and tangent of one part of a film.

The terms are added by the kernels that sum them one by one, called by their addresses: each is compiled once,
those of beams and of frames for bodies that have some.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, Matrix
from cosim.base.kernels import address_of, device_function, kernel, record_at
from cosim.base.numba_insides import caller
from cosim.soft.beams.ring_kernels import REMEMBERED, BeamArrays, add_beam_rings
from cosim.soft.body.loads import PlainLoads, Touching
from cosim.soft.contact.obstacle_contact import add_contacts
from cosim.soft.contact.self_contact_pairs import add_pairs
from cosim.soft.elements import eyelets, frame_ring, gas, mass_terms, membrane, pressure
from cosim.soft.elements.cable import add_segments, segment_length
from cosim.soft.elements.cable import onset as onset_of_tension
from cosim.soft.elements.element import Remembered
from cosim.soft.elements.hinge import HingeRows, add_hinges
from cosim.soft.film import rate_kernels, step_arrays
from cosim.soft.film.step_arrays import FilmArrays, FilmLoads, FilmPoint, FilmSlots, StepBed, StepRates

onset = device_function(onset_of_tension)
absolute_pressure = device_function(gas.absolute_pressure)
gas_potential = device_function(gas.gas_potential)

_CALLED = (
    membrane.add_membranes, add_hinges, add_segments, pressure.add_pressure, pressure.add_cap,
    pressure.add_cap_force, mass_terms.add_gravity, mass_terms.add_inertia, eyelets.pull_eyelets,
    eyelets.hold_eyelets,
)  # fmt: skip
(
    _MEMBRANES, _HINGES, _SEGMENTS, _PRESSURE, _CAP, _OPEN, _GRAVITY, _INERTIA, _EYELETS, _HELD, _BEAMS,
    _FRAMES,
) = range(len(_CALLED) + 2)  # fmt: skip
(
    _add_membranes, _add_hinges, _add_segments, _add_pressure, _add_cap, _add_cap_force, _add_gravity,
    _add_inertia, _pull_eyelets, _hold_eyelets,
) = map(caller, _CALLED)  # fmt: skip
_add_beam_rings, _add_frame_rings, _add_contacts, _add_pairs, _add_rates = map(
    caller, (add_beam_rings, frame_ring.add_frames, add_contacts, add_pairs, rate_kernels.add_rates)
)


class FilmActing(NamedTuple):
    """What acts on a film.

    Args:
        loads: that are plain.
        more: what else is given.
        touching: what may be touched; films touch one another in a film of one part only.
        bed: that inertia is; empty in statics.
    """

    loads: PlainLoads
    more: FilmLoads
    touching: Touching
    bed: StepBed


def term_calls() -> list[int]:
    """Return the places (12,) of the kernels of the terms."""
    return [address_of(called) for called in (*_CALLED, add_beam_rings, frame_ring.add_frames)]


@kernel
def film_terms(at: int, slots: FilmSlots, acting: FilmActing, part: int, point: FilmPoint) -> float:
    """Fill a part's rows of the gradient (n, 3) [N] of a film; return its potential [J].

    It is infinite where a sealed gas has no volume. Fills as well what its elements track, and adds to the
    blocks if slots are not empty.

    Args:
        at: address of the `FilmArrays`.
        slots: see `FilmSlots`.
        acting: see `FilmActing`.
        part: its number.
        point: see `FilmPoint`.
    """
    film = record_at(at, FilmArrays)
    a, b = film.parts[part], film.parts[part + 1]
    begin, end = a[step_arrays.NODES], b[step_arrays.NODES]
    x, gradient, blocks, bed = point.x, point.gradient, point.blocks, acting.bed
    for i in range(begin, end):
        for r in range(3):
            gradient[i, r] = 0.0
    moves = bed.coefficient.shape[0] > 0
    energy = _add_films(film, slots, part, point)
    energy += _add_cables(film, slots, a[step_arrays.SEGMENTS], b[step_arrays.SEGMENTS], acting, point)
    beams, frames = _add_rings(film, slots, part, moves and not bed.closely, point)
    energy = energy + beams + frames
    energy += _add_gas(film, slots, a[step_arrays.CHAMBERS], b[step_arrays.CHAMBERS], acting, point)
    if not energy < np.inf:
        return np.inf
    own, mass = gradient[begin:end], film.mass[begin:end]
    energy += _add_gravity(film.calls[_GRAVITY], (x[begin:end], mass, acting.loads.gravity, own))
    force, level = acting.more.force, 0.0
    for i in range(begin, end if force.shape[0] > 0 else begin):
        for r in range(3):
            gradient[i, r] -= force[i, r]
            level -= force[i, r] * x[i, r]
    energy += level
    planes = acting.touching.planes
    if planes.own.shape[0] > 0:
        contacts = x, planes.planes, planes.widths, begin, end, gradient, blocks, planes.own, planes.pressing
        energy += _add_contacts(planes.call, contacts)
    if moves:
        inertia = x[begin:end], bed.coefficient[begin:end], bed.target[begin:end], slots.diagonal[begin:end]
        energy += _add_inertia(film.calls[_INERTIA], (*inertia, own, blocks))
    if bed.rates != 0:
        rates = record_at(bed.rates, StepRates)
        energy += _add_rates(rates.calls[1], (film, slots, rates, part, point))
    if acting.touching.call != 0:
        energy += _add_pairs(acting.touching.call, (x, acting.touching.pairs, gradient))
    return energy


@device_function
def _add_films(film: Any, slots: Any, part: int, point: Any) -> float:
    """Add a part's triangles and hinges; return their energy [J]."""
    energy, triangles, fold = 0.0, slots.triangles, film.fold_barrier[0]
    for k in range(film.parts[part, step_arrays.FILMS], film.parts[part + 1, step_arrays.FILMS]):
        pairs = triangles[film.films[k, 0] : film.films[k + 1, 0]]
        added = point.x, rate_kernels.film_rows(film, k), pairs, point.gradient, point.blocks
        energy += _add_membranes(film.calls[_MEMBRANES], added)
    first, last = film.parts[part, step_arrays.HINGES], film.parts[part + 1, step_arrays.HINGES]
    begin, end = film.angles[0] + first, film.angles[0] + last
    own = film.hinges[first:last], film.hinge_stiffness[first:last], film.rest_angle[first:last]
    angles = Remembered(point.memory[begin:end], point.tracked[begin:end])
    bent = point.x, HingeRows(*own, fold), angles, slots.hinges[first:last], point.gradient, point.blocks
    return energy + _add_hinges(film.calls[_HINGES], bent)


@device_function
def _add_cables(film: Any, slots: Any, first: int, last: int, acting: FilmActing, point: Any) -> float:
    """Add segments, given tensions or commanded lengths; return their energy [J]."""
    loads, more, pull, energy = acting.loads, acting.more, point.pull, 0.0
    for s in range(first, last):
        pull[s] = loads.tension[film.cable[s]] * more.share[s]
    with_hessian, routes = slots.diagonal.shape[0] > 0, film.eyelets.routes
    for c in range(more.length.shape[0]):
        if first <= routes[c] < last and not math.isnan(more.length[c]):
            begin, end, weighted = routes[c], routes[c + 1], 0.0
            for s in range(begin, end):
                weighted += more.share[s] * segment_length(point.x, film.segments[s, 0], film.segments[s, 1])
            q = more.stiffening[c]
            level, force, slope = onset(q * (weighted - more.length[c]))
            for s in range(begin, end):
                pull[s] = more.spring[c] * force * more.share[s]
            if with_hessian:
                more.coefficients[c] = more.spring[c] * q * slope
                more.vectors[c, :, :] = 0.0
                if slope > 0.0:
                    weights = film.segments[begin:end], more.share[begin:end], film.no_slots.segments
                    added = point.x, *weights, more.vectors[c], film.no_blocks
                    _add_segments(film.calls[_SEGMENTS], added)
            energy += more.spring[c] * (level / q - force * weighted)  # less sum T_i L_i
    for c in range(routes.shape[0] - 1 if more.eyelets.shape[0] > 0 else 0):
        if first <= routes[c] < last and film.eyelets.places[routes[c]] >= 0:
            lost = point.x, film.eyelets, more.eyelets, c, point.tracked, pull
            energy += _pull_eyelets(film.calls[_EYELETS], lost)
            if with_hessian:
                own = slots.cables[slots.first_of_cable[c] : slots.first_of_cable[c + 1]]
                held = point.x, film.eyelets, more.eyelets, c, own, point.blocks
                _hold_eyelets(film.calls[_HELD], held)
    segments = film.segments[first:last], pull[first:last], slots.segments[first:last]
    filled = point.gradient, point.blocks
    return energy + _add_segments(film.calls[_SEGMENTS], (point.x, *segments, *filled))


@device_function
def _add_rings(film: Any, slots: Any, part: int, moving: bool, point: Any) -> tuple[float, float]:
    """Add a part's groups of rings of beams, and of frames; return the energies [J] of both."""
    energy, stiff, frames, differentiated = 0.0, 0.0, film.frames, slots.diagonal.shape[0] > 0
    for k in range(film.parts[part, step_arrays.BEAMS], film.parts[part + 1, step_arrays.BEAMS]):
        begin, rings, nodes, first, slot = film.beams.groups[k]
        end, last = begin + rings * nodes, first + REMEMBERED * rings * nodes
        beams = BeamArrays(
            film.beams.rings[begin:end].reshape((rings, nodes)),
            film.beams.directors[9 * begin : 9 * end].reshape((rings, nodes, 3, 3)),
            film.beams.lengths[begin:end].reshape((rings, nodes)), film.beams.rigidities[k], moving,
        )  # fmt: skip
        shape = rings if differentiated else 0, nodes * (nodes + 1) // 2
        own = slots.beams[slot : slot + shape[0] * shape[1]].reshape(shape)
        memory = Remembered(point.memory[first:last], point.tracked[first:last])
        added = point.x, beams, memory, own, point.gradient, point.blocks
        energy += _add_beam_rings(film.calls[_BEAMS], added)
    for k in range(film.parts[part, step_arrays.FRAMES], film.parts[part + 1, step_arrays.FRAMES]):
        begin, rings, nodes, first, slot = frames.groups[k]
        end, last = begin + rings * nodes, first + rings * nodes * nodes
        shape = rings if differentiated else 0, nodes * (nodes + 1) // 2
        own = slots.frames[slot : slot + shape[0] * shape[1]].reshape(shape)
        given = (
            point.x, frames.rings[begin:end].reshape((rings, nodes)),
            frames.projections[first:last].reshape((rings, nodes, nodes)),
            frames.lengths[begin:end].reshape((rings, nodes)), frames.stiffness[k],
        )  # fmt: skip
        stiff += _add_frame_rings(film.calls[_FRAMES], (*given, own, point.gradient, point.blocks))
    return energy, stiff


@device_function
def _add_gas(film: Any, slots: Any, first: int, last: int, acting: FilmActing, point: Any) -> float:
    """Add the gas of some chambers; return its potential [J], infinite where sealed gas has no volume."""
    energy, more = 0.0, acting.more
    for k in range(first, last):
        given, sealed = acting.loads.pressure[k], more.gas.shape[0] > 0 and more.gas[k, 0] > 0.0
        if sealed:
            row = more.coefficients.shape[0] - more.gas.shape[0] + k
            if slots.diagonal.shape[0] > 0:
                more.vectors[row, :, :] = 0.0
                volume = _press(film, slots, k, -1.0, (point.x, more.vectors[row], film.no_blocks))
            else:
                volume = _press(film, slots, k, 0.0, (point.x, point.gradient, film.no_blocks))
            given = absolute_pressure(more.gas[k, 0], more.gas[k, 1], more.gas[k, 2], volume)
            if slots.diagonal.shape[0] > 0:
                more.coefficients[row] = more.gas[k, 2] * given / volume
            given -= more.gas[k, 3]
            if not given < np.inf:
                return np.inf
        volume = _press(film, slots, k, given, (point.x, point.gradient, point.blocks))
        a, b = film.chambers[k], film.chambers[k + 1]
        for cap in range(a[1], b[1]):
            if film.open[cap]:
                ring = film.rings[film.caps[cap] : film.caps[cap + 1]]
                _add_cap_force(film.calls[_OPEN], (point.x, ring, given, point.gradient))
        more.found[k, 0], more.found[k, 1] = given, volume
        gas, held = more.gas, -given * volume
        energy += gas_potential(gas[k, 0], gas[k, 1], gas[k, 2], gas[k, 3], volume) if sealed else held
    return energy


@device_function
def _press(film: Any, slots: Any, k: int, given: float, into: tuple[Matrix, Matrix, Blocks]) -> float:
    """Add -p V of chamber k at a given pressure; return V [m^3].

    into: positions, gradient, and blocks if the Hessian is asked for.
    """
    x, gradient, blocks = into
    a, b, differentiated = film.chambers[k], film.chambers[k + 1], blocks.shape[0] > 0
    own = slots.gas[a[0] : b[0] if differentiated else a[0]]
    filled = x, film.gas_triangles[a[0] : b[0]], given, own, gradient, blocks
    volume = _add_pressure(film.calls[_PRESSURE], filled)
    for cap in range(a[1], b[1]):
        ring = film.rings[film.caps[cap] : film.caps[cap + 1]]
        begin, end = slots.first_of_cap[cap], slots.first_of_cap[cap + 1 if differentiated else cap]
        pairs = slots.caps[begin:end]
        volume += _add_cap(film.calls[_CAP], (x, ring, given, pairs, gradient, blocks))
    return volume
