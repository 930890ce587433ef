"""What the kernel of a film's step is given and what it leaves, as arrays of documented shapes.

Shapes of the arrays by which kernels know a film, and of what its terms add to.

Bodies side by side that nothing couples, such as the fingers of a gripper, are parts: of each, all that is
listed follows in one stretch.
"""

from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function
from cosim.soft.elements.element import EyeletLaws
from cosim.soft.linear import pattern, secant_pairs

NODES, FILMS, HINGES, SEGMENTS, BEAMS, FRAMES, CHAMBERS = range(7)
"""What columns of `FilmArrays.parts` are."""


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

    groups: IndexTable
    rings: Indices
    directors: Vector
    lengths: Vector
    rigidities: Matrix


class FilmFrames(NamedTuple):
    """Stiff frames and plates, group after group of equal ones; see `FrameRings`.

    Args:
        groups: (g, 5), where the nodes of each begin, how many rings, nodes of a ring, first of its
            projections, first of its slots.
        rings: nodes of all rings.
        projections: of all rings.
        lengths: [m], of their chords.
        stiffness: (g,) [N/m].
    """

    groups: IndexTable
    rings: Indices
    projections: Vector
    lengths: Vector
    stiffness: Vector


class FilmSlots(NamedTuple):
    """Where pairs of nodes are in the tangent's blocks, see `BlockPattern.slots`; empty for no Hessian.

    Args:
        triangles: (m, 6).
        hinges: (h, 10).
        segments: (s, 3).
        cables: of all eyelets of cables that remember, cable after cable.
        first_of_cable: (cables + 1,), where those of each begin.
        gas: (t, 6), of `gas_triangles`.
        caps: of ring after ring.
        first_of_cap: (caps + 1,), where those of each begin.
        beams: of ring after ring.
        frames: of ring after ring.
        diagonal: (n,).
    """

    triangles: IndexTable
    hinges: IndexTable
    segments: IndexTable
    cables: Indices
    first_of_cable: Indices
    gas: IndexTable
    caps: Indices
    first_of_cap: Indices
    beams: Indices
    frames: Indices
    diagonal: Indices


class FilmArrays(NamedTuple):
    """Films, hinges, cables, beams, chambers and masses of one body.

    Args:
        calls: (12,) addresses of the kernels.
        triangles: (m, 3), film after film.
        shape_gradients: (m, 3, 2), see `Membranes`.
        areas: (m,) [m^2].
        drawn: (groups, 5 LANES), see `in_lanes`.
        stiffness: (films, 3, 3) [N/m].
        laws: (films,), code of each film's law.
        compression: (films, 2), see `Film.compression`.
        forces: (w, 2) [N/m], see `wrinkling_forces`; of plain films none.
        yarns: (films, 2, 2), see `Film.yarns`.
        films: (films + 1, 3), where the triangles, groups and forces of each film begin.
        hinges: (h, 4).
        hinge_stiffness: (h,) [N m/rad].
        rest_angle: (h,) [rad].
        fold_barrier: (1,) [rad].
        angles: (2,), where the hinges' memory begins and ends.
        segments: (s, 2), of all cables.
        cable: (s,), of which each is.
        eyelets: of the cables.
        beams: stiffeners.
        frames: that keep their shape.
        gas_triangles: (t, 3), chamber after chamber.
        rings: (r,), nodes of the caps, one after the other.
        caps: (caps + 1,), where each begins.
        chambers: (chambers + 1, 2), where the triangles and caps of each begin.
        open: (caps,), 1 for those that carry no pressure, 0 for the others.
        mass: (n,) [kg].
        parts: (parts + 1, 7), of bodies that nothing couples: where nodes, films, hinges, segments, groups of
            beams, groups of frames and chambers of each begin.
        no_slots: for no Hessian.
        no_blocks: (0, 3, 3), for none.
    """

    calls: Indices
    triangles: IndexTable
    shape_gradients: Blocks
    areas: Vector
    drawn: Matrix
    stiffness: Blocks
    laws: Indices
    compression: Matrix
    forces: Matrix
    yarns: Blocks
    films: IndexTable
    hinges: IndexTable
    hinge_stiffness: Vector
    rest_angle: Vector
    fold_barrier: Vector
    angles: Indices
    segments: IndexTable
    cable: Indices
    eyelets: EyeletLaws
    beams: FilmBeams
    frames: FilmFrames
    gas_triangles: IndexTable
    rings: Indices
    caps: Indices
    chambers: IndexTable
    open: Indices
    mass: Vector
    parts: IndexTable
    no_slots: FilmSlots
    no_blocks: Blocks


class StepBed(NamedTuple):
    """The elastic bed that inertia is in a step.

    Args:
        coefficient: (n,) [N/m].
        target: (n, 3) [m].
        closely: whether the step is solved closely, see `Inertia`.
        rates: address of the step's `StepRates`, see `RecordStore`; 0 where no material resists rates.
    """

    coefficient: Vector
    target: Matrix
    closely: bool
    rates: int


class StepRates(NamedTuple):
    """How materials resist rates of strain in a step, see `rate_kernels`.

    Args:
        calls: (4,) addresses of kernels: that fill it as a step begins, that add what it resists with, and
            that add and fill its triangles.
        film_time: (films,) [s], tau of each film.
        hinge_time: (h,) [s], tau of each hinge.
        triangles: (groups, 9 LANES), strain that rates count from and resistance [N/m] of each triangle.
        hinge_stiffness: (h,) [N m/rad], tau k / s.
        hinge_angle: (h,) [rad], angle that rates count from.
    """

    calls: Indices
    film_time: Vector
    hinge_time: Vector
    triangles: Matrix
    hinge_stiffness: Vector
    hinge_angle: Vector


class FilmLoads(NamedTuple):
    """What acts on a film besides pressures, tensions and gravity, and what of that is dense in the tangent.

    Args:
        share: (s,), tension of each segment over that at its cable's base end, or, of a cable whose length is
            commanded, its weight (see `cable`); losses as they were where a solution began.
        length: (cables,) [m], the commanded ones, NaN where a tension is; empty where all are tensions.
        spring: (cables,) [N/m], k m of those.
        gas: (chambers, 4), of what is sealed in each: absolute pressure [Pa], volume [m^3], exponent, ambient
            pressure; zero where the pressure is given; empty where it is in all.
        eyelets: (s, COLUMNS), losses frozen as well; empty where no cable remembers, see `eyelets`.
        force: (n, 3) [N], on the nodes; empty for none.
        stiffening: (cables,), q of those of a commanded length in a step, see `cable`.
        found: (chambers, 2), filled with gauge pressure [Pa] and volume [m^3] of each.
        vectors: (cables + chambers, n, 3), filled with what a Hessian has of dense terms.
        coefficients: (cables + chambers,), of these; 0 for none.
    """

    share: Vector
    length: Vector
    spring: Vector
    gas: Matrix
    eyelets: Matrix
    force: Matrix
    stiffening: Vector
    found: Matrix
    vectors: Blocks
    coefficients: Vector


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

    x: Matrix
    memory: Vector
    tracked: Vector
    gradient: Matrix
    blocks: Blocks
    pull: Vector


(
    TO_DO, LEFT, TANGENTS, RESIDUAL, ENERGY, ASKS, TRIED, SEARCHES, TRIES, SHARE, SLOPE, PAIRS_KNOWN, AGAIN,
    MOVED, SWEEPS, RUN,
) = range(16)  # fmt: skip
"""What columns of `StepWork.parts` are."""
NOTHING, EVALUATION, TANGENT, SOLUTION, EVALUATED, SOLVED, STUCK, PATTERN, WIDENED = range(9)
"""What a part asks for: the potential where kernels do not know all terms, a step with a new tangent, one
with a kept factorisation of a kind that they do not know; what it is given; that no share of it serves; a
factorisation of another pattern, as other films touch one another; that it has got one, at once, so that the
tangent is still in the blocks."""
GOES_ON, BEGINS_STEP, BEGINS = range(3)
"""How a call begins: where the last one ended; a step in time; a solution where the end of the motion is."""


class StepNumbers(NamedTuple):
    """Numbers of a step; see `StepOptions`, `NewtonOptions` and `step_begin`.

    Args:
        two_steps: whether the step looks back over two.
        h: [s].
        span: s [s].
        factor: s / (1 + (alpha + beta) s) [s].
        share: alpha s, of the flange's motion in that of a node.
        fraction: of the gain in velocity that moves the nodes in free flight.
        tolerance: [N].
        start_tolerance: [N].
        reuse_rate: bound on a residual over the last one.
        reuse_below: [N], residual above which new tangents are made.
        step_max: [m].
        halvings: of a step along a new tangent, at most.
        potential: whether the loads have one.
        complete: whether kernels know all terms.
    """

    two_steps: bool
    h: float
    span: float
    factor: float
    share: float
    fraction: float
    tolerance: float
    start_tolerance: float
    reuse_rate: float
    reuse_below: float
    step_max: float
    halvings: int
    potential: bool
    complete: bool


class StepMotion(NamedTuple):
    """Where a step begins, and where it ends: `new_...` are filled.

    Args:
        x: (n, 3) [m].
        velocity: (n, 3) [m/s].
        earlier_x: one step earlier; of the first step: x.
        earlier_velocity: the same.
        memory: (values,), what the elements remember.
        flange: (4, 3), see `flange_axes`, at the end.
        new_x: (n, 3).
        new_velocity: (n, 3).
        new_memory: (values,).
    """

    x: Matrix
    velocity: Matrix
    earlier_x: Matrix
    earlier_velocity: Matrix
    memory: Vector
    flange: Matrix
    new_x: Matrix
    new_velocity: Matrix
    new_memory: Vector


class StepPlace(NamedTuple):
    """Where a call continues.

    Args:
        begins: BEGINS_STEP, BEGINS, or GOES_ON where the end of the motion, the gradient and `StepWork.parts`
            are.
        reuse_max: iterations of each part with a kept factorisation at most, in all calls of a step.
        tangents_max: new tangents of each part at most, in all calls of a step.
    """

    begins: int
    reuse_max: int
    tangents_max: int


class WideTangent(NamedTuple):
    """The tangent of films that touch one another.

    Args:
        call: address of the kernel that adds what pairs have in it.
        rows: its pattern.
        of_body: (b,), which of the body's own blocks each is, -1 for none.
        blocks: (b, 3, 3) [N/m].
        used: (b,), scratch.
    """

    call: int
    rows: pattern.PatternRows
    of_body: Indices
    blocks: Blocks
    used: Indices


class NewTangents(NamedTuple):
    """Where a kernel assembles new tangents.

    Args:
        slots: of the film's terms, see `FilmSlots`; empty where it makes none.
        blocks: (b, 3, 3) [N/m].
        first: (parts + 1,), where the blocks of each part begin.
        wide: where films touch one another; empty for a factorisation in the body's own pattern.
    """

    slots: FilmSlots
    blocks: Blocks
    first: Indices
    wide: WideTangent


class StepWork(NamedTuple):
    """Scratch of a step; `gradient` holds what its end has.

    Args:
        calls: (10,), see `step_calls`.
        gradient: (n, 3) [N].
        solution: (1, n, 3).
        served: (2, n, 3), the last point that is usable [m] and its gradient [N].
        pairs: of the steps with the kept factorisation.
        reference: (values,).
        pull: (segments,).
        parts: (parts, 16) of which each has: whether it is to be solved, iterations with a kept factorisation
            that are left, new tangents in the step, residual [N] and potential [J] where it is, what it asks
            for, the potential [J] where it tries to go; whether it searches along a new tangent's step, how
            often still, at what share of the step, and its slope [J]; pairs known, whether it tries once more
            from where it is, whether it has moved, sweeps over folds, iterations with the kept factorisation.
        film: address of the film's `FilmArrays`, for its terms.
        more: loads that are not plain.
        along: (n, 3) [m/s], see `follow_flange`; without damping zero.
    """

    calls: Indices
    gradient: Matrix
    solution: Blocks
    served: Blocks
    pairs: secant_pairs.SecantPairs
    reference: Vector
    pull: Vector
    parts: Matrix
    film: int
    more: FilmLoads
    along: Matrix


@device_function
def move(place: Matrix, share: float, change: Matrix, x: Matrix) -> None:
    """Fill x with a place to which a share of a change is added."""
    for i in range(x.shape[0]):
        for r in range(3):
            x[i, r] = place[i, r] + share * change[i, r]


def room_for_parts(count: int) -> Array:
    """Return room for what `StepWork` has of each of some parts."""
    return np.zeros((count, RUN + 1))
