"""A film as kernels see it, and its gradient: what the elements of most bodies add, in one call."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from typing import Any, NamedTuple

import numpy as np
from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, INDEX_TABLE, INDICES, MATRIX, VECTOR, device_function
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import PlainLoads
from cosim.soft.elements.cable import Cable, add_segments
from cosim.soft.elements.hinge import Hinges
from cosim.soft.elements.hinge_gradient import add_hinge_gradients
from cosim.soft.elements.mass_terms import add_gravity, add_inertia
from cosim.soft.elements.membrane import Membranes
from cosim.soft.elements.membrane_gradient import add_membrane_gradients
from cosim.soft.elements.pressure import add_cap, add_pressure

_TAKEN: tuple[type, ...] = (Membranes, Hinges, Cable)
"""What the kernel knows; a body with anything else is summed term by term."""


class FilmArrays(NamedTuple):
    """Films, hinges, cables, chambers and masses of one body.

    Args:
        triangles: (m, 3), film after film.
        drawn: (groups, 5 LANES), see `in_lanes`.
        stiffness: (films, 3, 3) [N/m].
        forces: (w, 2) [N/m], see `wrinkling_forces`; of plain films none.
        films: (films + 1, 3), where the triangles, groups and forces of each film begin.
        hinges: (h, 4).
        hinge_stiffness: (h,) [N m/rad].
        rest_angle: (h,) [rad].
        fold_barrier: (1,) [rad].
        segments: (s, 2), of all cables.
        cable: (s,), of which each is.
        ratio: (s,), its tension over that at the cable's base end.
        gas_triangles: (t, 3), chamber after chamber.
        rings: (r,), nodes of the caps, one after the other.
        caps: (caps + 1,), where each begins.
        chambers: (chambers + 1, 2), where the triangles and caps of each begin.
        mass: (n,) [kg].
        no_slots: (0, 0), and
        no_blocks: (0, 3, 3), and
        no_places: (0,), for no Hessian.
    """

    triangles: IntArray
    drawn: Array
    stiffness: Array
    forces: Array
    films: IntArray
    hinges: IntArray
    hinge_stiffness: Array
    rest_angle: Array
    fold_barrier: Array
    segments: IntArray
    cable: IntArray
    ratio: Array
    gas_triangles: IntArray
    rings: IntArray
    caps: IntArray
    chambers: IntArray
    mass: Array
    no_slots: IntArray
    no_blocks: Array
    no_places: IntArray


FILM = types.NamedTuple(
    (
        INDEX_TABLE, MATRIX, BLOCKS, MATRIX, INDEX_TABLE, INDEX_TABLE, VECTOR, VECTOR, VECTOR, INDEX_TABLE,
        INDICES, VECTOR, INDEX_TABLE, INDICES, INDICES, INDEX_TABLE, VECTOR, INDEX_TABLE, BLOCKS, INDICES,
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


PLAIN_LOADS = types.NamedTuple((VECTOR, VECTOR, VECTOR), PlainLoads)
BED = types.NamedTuple((VECTOR, MATRIX), StepBed)


def film_arrays(body: SoftBody) -> FilmArrays | None:
    """Return a body's arrays; None where it has more than the kernel knows, or loads without a potential."""
    films = [film.gradient_arrays for film in body.membranes]
    known = all(isinstance(element, _TAKEN) for element in body.elements)
    frictionless = all(cable.friction_coefficient == 0.0 for cable in body.cables)
    if not known or not frictionless or (body.caps and not body.closed):
        return None
    parts = [film for film in films if film is not None]
    if len(parts) < len(films):
        return None
    triangles, drawn, stiffness, forces = zip(*parts, strict=True)
    hinges, cables, bent = body.hinges, body.cables, len(body.hinges.coupled)
    gas, caps = zip(*body.enclosures, strict=True)
    rings = [ring for those in caps for ring in those]
    no_pairs, none = np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
    return FilmArrays(
        np.concatenate(triangles), np.concatenate(drawn), np.array(stiffness), np.concatenate(forces),
        np.stack([_firsts(triangles), _firsts(drawn), _firsts(forces)], axis=1),
        hinges.coupled, hinges.stiffness[:bent], hinges.rest_angle[:bent],
        np.array([hinges.fold_barrier_rad]),
        np.concatenate([no_pairs, *(cable.segments for cable in cables)]),
        np.repeat(np.arange(len(cables)), [len(cable.segments) for cable in cables]),
        np.concatenate([np.zeros(0), *(cable.tension_ratio(body.positions) for cable in cables)]),
        np.concatenate(gas), np.concatenate([none, *rings]), _firsts(rings),
        np.stack([_firsts(gas), _firsts(caps)], axis=1), body.node_mass,
        np.zeros((0, 0), np.int64), np.zeros((0, 3, 3)), none,
    )  # fmt: skip


def _firsts(parts: Sequence[Any]) -> IntArray:
    """Return where each of some lists begins if they follow each other, and where the last one ends."""
    return np.array([0, *accumulate(len(part) for part in parts)], dtype=np.int64)


@device_function
def film_gradient(film, loads, bed, x, reference, pull, angles, gradient):  # type: ignore[no-untyped-def]
    """Fill the gradient (n, 3) [N] of a film's potential in a step, and its hinges' angles; return it [J].

    Terms come in the order in which `SoftSystem.evaluate` adds them.

    Args:
        film: see `FilmArrays`.
        loads: see `PlainLoads`.
        bed: see `StepBed`.
        x: (n, 3) [m].
        reference: (h,) [rad], against which angles are unwrapped.
        pull: (s,), scratch.
        angles: (h,) [rad], filled.
        gradient: (n, 3), filled.
    """
    gradient[:] = 0.0
    energy = 0.0
    for k in range(film.films.shape[0] - 1):
        a, b = film.films[k], film.films[k + 1]
        energy += add_membrane_gradients(
            x, film.triangles[a[0] : b[0]], film.drawn[a[1] : b[1]], film.stiffness[k],
            film.forces[a[2] : b[2]], gradient,
        )  # fmt: skip
    energy += add_hinge_gradients(
        x, film.hinges, film.hinge_stiffness, film.rest_angle, film.fold_barrier[0], reference, gradient,
        angles,
    )  # fmt: skip
    for s in range(film.ratio.shape[0]):
        pull[s] = loads.tension[film.cable[s]] * film.ratio[s]
    energy += add_segments(x, film.segments, pull, film.no_slots, gradient, film.no_blocks)
    energy += _add_gas(film, loads.pressure, x, gradient)
    energy += add_gravity(x, film.mass, loads.gravity, gradient)
    energy += add_inertia(x, bed.coefficient, bed.target, film.no_places, gradient, film.no_blocks)
    return energy


@device_function
def _add_gas(film, pressure, x, gradient):  # type: ignore[no-untyped-def]
    """Add the gradient of -p V of all chambers; return that potential [J]."""
    energy = 0.0
    for k in range(film.chambers.shape[0] - 1):
        a, b = film.chambers[k], film.chambers[k + 1]
        triangles, given = film.gas_triangles[a[0] : b[0]], pressure[k]
        volume = add_pressure(x, triangles, given, film.no_slots, gradient, film.no_blocks)
        for cap in range(a[1], b[1]):
            ring = film.rings[film.caps[cap] : film.caps[cap + 1]]
            volume += add_cap(x, ring, given, film.no_places, gradient, film.no_blocks)
        energy += -given * volume
    return energy
