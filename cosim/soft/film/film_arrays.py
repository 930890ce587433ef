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
    ratio: Array
    beams: FilmBeams
    gas_triangles: IntArray
    rings: IntArray
    caps: IntArray
    chambers: IntArray
    mass: Array
    parts: IntArray
    no_slots: FilmSlots
    no_blocks: Array


_FILM_BEAMS = types.NamedTuple((INDEX_TABLE, INDICES, VECTOR, VECTOR, MATRIX), FilmBeams)
SLOTS = types.NamedTuple((*(4 * [INDEX_TABLE]), *(4 * [INDICES])), FilmSlots)
FILM = types.NamedTuple(
    (
        INDICES, INDEX_TABLE, BLOCKS, VECTOR, MATRIX, BLOCKS, INDICES, VECTOR, MATRIX, INDEX_TABLE,
        INDEX_TABLE, VECTOR, VECTOR, VECTOR, INDICES, INDEX_TABLE, INDICES, VECTOR, _FILM_BEAMS, INDEX_TABLE,
        INDICES, INDICES, INDEX_TABLE, VECTOR, INDEX_TABLE, SLOTS, BLOCKS,
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
