"""Shapes of the arrays by which kernels know a film, and of what its terms add to.

Bodies side by side that nothing couples, such as the fingers of a gripper, are parts: of each, all that is
listed follows in one stretch.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from numba import types

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import BLOCKS, BOOLEAN, INDEX_TABLE, INDICES, MATRIX, VECTOR

NODES, FILMS, HINGES, SEGMENTS, BEAMS, CHAMBERS = range(6)
"""What columns of `FilmArrays.parts` are."""
PART_COLUMNS: Final = 6


class FilmBeams(NamedTuple):
    """Rings of beams, group after group of equal ones; see `BeamArrays`.

    Args:
        groups: (g, 5), where the nodes of each begin, how many rings, nodes of a ring, first of its memory,
            first of its slots.
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


class FilmSlots(NamedTuple):
    """Where pairs of nodes are in the tangent's blocks, see `BlockPattern.slots`; empty for no Hessian.

    Args:
        triangles: (m, 6).
        hinges: (h, 10).
        segments: (s, 3).
        gas: (t, 6), of `gas_triangles`.
        caps: of ring after ring.
        first_of_cap: (caps + 1,), where those of each begin.
        beams: of ring after ring.
        diagonal: (n,).
    """

    triangles: IntArray
    hinges: IntArray
    segments: IntArray
    gas: IntArray
    caps: IntArray
    first_of_cap: IntArray
    beams: IntArray
    diagonal: IntArray


class FilmArrays(NamedTuple):
    """Films, hinges, cables, beams, chambers and masses of one body.

    Args:
        calls: (9,) addresses of the kernels.
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
        routes: (cables + 1,), where the segments of each cable begin.
        beams: stiffeners.
        gas_triangles: (t, 3), chamber after chamber.
        rings: (r,), nodes of the caps, one after the other.
        caps: (caps + 1,), where each begins.
        chambers: (chambers + 1, 2), where the triangles and caps of each begin.
        open: (caps,), 1 for those that carry no pressure, 0 for the others.
        mass: (n,) [kg].
        parts: (parts + 1, 6), of bodies that nothing couples: where nodes, films, hinges, segments, groups of
            beams and chambers of each begin.
        no_slots: for no Hessian.
        no_blocks: (0, 3, 3), for none.
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
    routes: IntArray
    beams: FilmBeams
    gas_triangles: IntArray
    rings: IntArray
    caps: IntArray
    chambers: IntArray
    open: IntArray
    mass: Array
    parts: IntArray
    no_slots: FilmSlots
    no_blocks: Array


_FILM_BEAMS = types.NamedTuple((INDEX_TABLE, INDICES, VECTOR, VECTOR, MATRIX), FilmBeams)
SLOTS = types.NamedTuple((*(4 * [INDEX_TABLE]), *(4 * [INDICES])), FilmSlots)
FILM = types.NamedTuple(
    (
        INDICES, INDEX_TABLE, BLOCKS, VECTOR, MATRIX, BLOCKS, INDICES, VECTOR, MATRIX, INDEX_TABLE,
        INDEX_TABLE, VECTOR, VECTOR, VECTOR, INDICES, INDEX_TABLE, INDICES, INDICES, _FILM_BEAMS, INDEX_TABLE,
        INDICES, INDICES, INDEX_TABLE, INDICES, VECTOR, INDEX_TABLE, SLOTS, BLOCKS,
    ),
    FilmArrays,
)  # fmt: skip


class StepBed(NamedTuple):
    """The elastic bed that inertia is in a step.

    Args:
        coefficient: (n,) [N/m].
        target: (n, 3) [m].
        closely: whether the step is solved closely, see `Inertia`.
    """

    coefficient: Array
    target: Array
    closely: bool


BED = types.NamedTuple((VECTOR, MATRIX, BOOLEAN), StepBed)


class FilmLoads(NamedTuple):
    """What acts on a film besides pressures, tensions and gravity, and what of that is dense in the tangent.

    Args:
        share: (s,), tension of each segment over that at its cable's base end, or, of a cable whose length is
            commanded, its weight (see `cable_length`); losses as they were where a solution began.
        length: (cables,) [m], the commanded ones, NaN where a tension is; empty where all are tensions.
        spring: (cables,) [N/m], k m of those.
        gas: (chambers, 4), of what is sealed in each: absolute pressure [Pa], volume [m^3], exponent, ambient
            pressure; zero where the pressure is given; empty where it is in all.
        force: (n, 3) [N], on the nodes; empty for none.
        found: (chambers, 2), filled with gauge pressure [Pa] and volume [m^3] of each.
        vectors: (cables + chambers, n, 3), filled with what a Hessian has of dense terms.
        coefficients: (cables + chambers,), of these; 0 for none.
    """

    share: Array
    length: Array
    spring: Array
    gas: Array
    force: Array
    found: Array
    vectors: Array
    coefficients: Array


FILM_LOADS = types.NamedTuple((VECTOR, VECTOR, VECTOR, MATRIX, MATRIX, MATRIX, BLOCKS, VECTOR), FilmLoads)


class FilmPoint(NamedTuple):
    """A shape, and what the terms of a film fill in there.

    Args:
        x: (n, 3) [m].
        memory: (values,), what elements remember of the last accepted state, see `Instant`.
        tracked: (values,), filled with what they make of it.
        gradient: (n, 3) [N], filled.
        blocks: (b, 3, 3) [N/m], added to; empty for no Hessian.
        pull: (s,) [N], scratch.
    """

    x: Array
    memory: Array
    tracked: Array
    gradient: Array
    blocks: Array
    pull: Array


FILM_POINT = types.NamedTuple((MATRIX, VECTOR, VECTOR, MATRIX, BLOCKS, VECTOR), FilmPoint)
