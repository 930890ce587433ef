"""What the kernels of contact are given and fill, as arrays of documented shapes; how far bodies are ahead.

How far bodies will be ahead of where MuJoCo has them, by its own steps. A tick of one step: the accelerations
under the loads that act, with all that touches and holds bodies now. A tick of several: these steps
themselves, in a second state of the scene, so contacts that come about within the tick count, and servos
continue at the speed that they were asked for last.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector, nothing_of
from cosim.base.kernels import copy, device_function, kernel, small_vector
from cosim.base.numba_insides import call_native
from cosim.rigid.distance.shapes import ShapeBounds
from cosim.rigid.scene.bodies import (
    ACCELERATE,
    CONSTRAIN,
    REBEGIN,
    REFACTORISE,
    REFINISH,
    VELOCITIES,
    Bodies,
    Foresight,
)
from cosim.soft.contact.obstacle_contact import TouchedPlanes

AHEAD_TICKS: Final = 2.0
"""How many ticks' way of the fastest node a film looks ahead."""
REMEMBERED, TOUCHES, POINTS, AGE, ASKS, LEFT, MET = range(7)
"""Places in `ContactArrays.counts`: contacts remembered, contacts in the last tick, how many of these are of
the film's points, ticks of contact since bodies were weighed, whether heavy ones are to be, whether a tick in
which nothing is touched has something to end, ticks that touched bodies which gave way since these were
weighed."""

AGREED_M: Final = 2e-6
"""How far bodies may go from where the film has met them; the next tick answers it, and more than that."""
TURN_LEVER_M: Final = 0.02
"""Lever at which angles count as ways."""
UNKNOWN: Final = 1e30
"""Of `ContactArrays.gives`: such bodies kernels leave to `LightBodies`."""


class Leads(NamedTuple):
    """How far bodies are ahead: the film meets them where they will be at the end of the next step.

    Seen from the flange, so what it carries is met where it is.

    Args:
        spin: (bodies, 6), angular then linear [1/s, m/s], each at its tree's centre of mass; MuJoCo's.
        tree: (bodies, 3) [m], these centres of all trees, and
        root: (bodies,), where in them each body's is.
        mass: (bodies, 3) [m], centres of mass; MuJoCo's.
        flange: body that goes with it.
        ahead: (bodies,), 1 for those that are met ahead; -1 for those that are met where they will be in the
            middle of the steps in which the load acts, a tick late.
        foresight: by which they are.
        lead: (bodies, 6), by what they are ahead: translation at the world's origin [m], then turn [rad].
    """

    spin: Matrix
    tree: Matrix
    root: Indices
    mass: Matrix
    flange: int
    ahead: Indices
    foresight: Foresight
    lead: Matrix


class BodyLoads(NamedTuple):
    """What acts on the bodies that the film touches.

    Args:
        applied: (bodies, 6), MuJoCo's loads on them.
        centers: (bodies, 3) [m], of their masses, where the film meets them.
        loaded: (bodies,), 1 for those that bear a load of contact.
        pressing: (bodies,) [N], sum of the normal forces of the film that make up that load.
        handed: (8,), film's load on all bodies about the world's origin, its size [N], and the sum of the
            normal forces that are part of it [N].
        leads: how far they are ahead.
    """

    applied: Matrix
    centers: Matrix
    loaded: Indices
    pressing: Vector
    handed: Vector
    leads: Leads


def leads_of(bodies: Bodies) -> Leads:
    """Return how far the bodies of a scene are ahead: not at all."""
    count = bodies.count
    return Leads(
        bodies.spins, bodies.tree_centers, bodies.roots, bodies.mass_centers, bodies.flange,
        np.zeros(count, np.int64), bodies.foresight, np.zeros((count, 6)),
    )  # fmt: skip


@device_function
def fill_speed(leads: Any, body: int, out: Vector) -> None:
    """Fill out (6,) with a body's velocity at the world's origin, then its angular velocity."""
    fill_velocity(leads.spin, leads.tree, leads.root, body, out)


@device_function
def fill_velocity(spins: Matrix, trees: Matrix, root: Indices, body: int, out: Vector) -> None:
    """Fill out (6,), see `fill_speed`, from MuJoCo's velocities, see `Leads`."""
    spin, place = spins[body], trees[root[body]]
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        out[r] = spin[3 + r] - (spin[s] * place[q] - spin[q] * place[s])
        out[3 + r] = spin[r]


@device_function
def led(lead: Vector, place: Vector, r: int) -> float:
    """Return component r of a lead at a place."""
    s, q = (r + 1) % 3, (r + 2) % 3
    return lead[r] + lead[3 + s] * place[q] - lead[3 + q] * place[s]


@device_function
def see_hit(contact: Any, e: int) -> None:
    """Take note of a contact that presses, if the step resolves its hit less than those before."""
    figures, body, speed = contact.end.figures, contact.touched.planes.body[e], contact.ties.approach[e]
    way = contact.resolved[body]
    if speed > 0.0 and (figures[5] < 0.0 or speed * figures[4] > figures[3] * way):
        figures[3], figures[4], figures[5] = speed, way, body


@device_function
def add_load(part: float, force: Vector, place: Vector, loads: Vector) -> None:
    """Add part of a force at a place and its torque about the world's origin."""
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        loads[r] += part * force[r]
        loads[3 + r] += part * (place[s] * force[q] - place[q] * force[s])


class NearPoints(NamedTuple):
    """Contact points of the film near shapes, then features near triangles of the film.

    Args:
        point: (k,) of the film.
        shape: (k,).
        distance: (k,) [m].
        normal: (k, 3), out of the shape.
        feature: (f,) index among all features of the scene.
        owner: (f,) its shape.
        place: (f, 3) [m], world.
        triangle: (f,) of the film.
        weight: (f, 3), of the nearest point of the triangle.
        film_distance: (f,) [m].
        film_normal: (f, 3), out of the film.
    """

    point: Indices
    shape: Indices
    distance: Vector
    normal: Matrix
    feature: Indices
    owner: Indices
    place: Matrix
    triangle: Indices
    weight: Matrix
    film_distance: Vector
    film_normal: Matrix

    @classmethod
    def room(cls, points: int, features: int) -> NearPoints:
        """Return room for so many."""
        of_points = _no_indices(points), _no_indices(points), np.zeros(points), np.zeros((points, 3))
        owned = _no_indices(features), _no_indices(features), np.zeros((features, 3)), _no_indices(features)
        rest = np.zeros((features, 3)), np.zeros(features), np.zeros((features, 3))
        return cls(*of_points, *owned, *rest)

    def first(self, points: int, features: int) -> NearPoints:
        """Return the first of them."""
        return NearPoints(*(part[:points] for part in self[:4]), *(part[:features] for part in self[4:]))  # type: ignore[arg-type]


class SurfaceRows(NamedTuple):
    """The fields of `ContactSurface`."""

    nodes: IndexTable
    weights: Matrix
    slots: IndexTable
    area: Vector
    triangles: IndexTable
    triangle_slots: IndexTable


class ShapeRows(NamedTuple):
    """Poses, coefficients of friction and bodies of shapes: fields of `ContactQuery`."""

    position: Matrix
    rotation: Blocks
    friction: Vector
    body: Indices


class MemoryRows(NamedTuple):
    """The fields of `ContactMemory`."""

    key: Indices
    normal_force: Vector
    offset: Matrix
    place: Matrix
    triangle: Indices
    face: Indices

    @classmethod
    def room(cls, count: int) -> MemoryRows:
        """Return room for so many."""
        return cls(
            _no_indices(count), np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3)),
            _no_indices(count), _no_indices(count),
        )  # fmt: skip


class Ties(NamedTuple):
    """What contacts are tied to.

    Args:
        shape: (k,) that is touched.
        key: (k,) names the pair of contact point and shape; first points of the film, then features.
        carrier: (k, 3) [m], world: the shape's origin; of a feature: where it is.
        triangle: (k,) of the film, that a feature is near; -1 for points of the film.
        approach: (k,) [m/s], at which body and film came on to each other before the step.
    """

    shape: Indices
    key: Indices
    carrier: Matrix
    triangle: Indices
    approach: Vector

    @classmethod
    def room(cls, count: int) -> Ties:
        """Return room for so many."""
        of_shapes = _no_indices(count), _no_indices(count), np.zeros((count, 3)), _no_indices(count)
        return cls(*of_shapes, np.zeros(count))


class Glue(NamedTuple):
    """Points of the film that are glued to a body, with springs; they are the last contacts of every tick.

    Args:
        point: (k,) of the film.
        place: (k, 3) [m], body frame, where each is tied.
        body: (1,).
        stiffness: [N/m], of each.
        position: (bodies, 3) [m], world, and
        axes: (bodies, 9), of the bodies; MuJoCo's.
    """

    point: Indices
    place: Matrix
    body: Indices
    stiffness: float
    position: Matrix
    axes: Matrix


class EndRows(NamedTuple):
    """What is left of contacts at the end of a tick.

    Args:
        point: (k, 3) [m], where they are.
        slack_friction: (k,) [N], by which they rub from now on.
        loads: (bodies, 6), force [N] and torque about the world's origin [N m] on each body, world axes.
        acting: (bodies,), 1 where any acts.
        held: (bodies,) [N/m], trace of the stiffness of a body's contacts, stick springs slack.
        pressing: (bodies,) [N], sum of the normal forces on each body.
        film: (8,), the loads as the film's nodes bear them, summed over all bodies, their size [N], and the
            sum of the normal forces [N].
        figures: (6,), sum of the normal forces [N]; depth of the deepest that presses [m]; work on the film
            in the tick [J]; of the hit that the step resolves least: speed [m/s], the way that a step may
            take of it [m], and the body, -1 for no hit.
        own: (k, 3) [N], force of each on its body.
        force: (nodes, 3) [N], of all on the film.
    """

    point: Matrix
    slack_friction: Vector
    loads: Matrix
    acting: Indices
    held: Vector
    pressing: Vector
    film: Vector
    figures: Vector
    own: Matrix
    force: Matrix

    @classmethod
    def room(cls, count: int, bodies: int, force: Array) -> EndRows:
        """Return room for so many, with the force on the film as it is."""
        of_bodies = np.zeros((bodies, 6)), _no_indices(bodies), np.zeros(bodies), np.zeros(bodies)
        rest = np.zeros(8), np.zeros(6), np.zeros((count, 3)), force
        return cls(np.zeros((count, 3)), np.zeros(count), *of_bodies, *rest)


class ListRows(NamedTuple):
    """What was near when the lists were made.

    Args:
        row: (g,) of each shape in the arrays that follow; -1 for one that was too far.
        local: (s, n, 3) [m], the nodes then, in the frames of s shapes.
        reach_m: distance to which the lists hold.
        behind_m: the same for features behind the film.
        spans: (s, 2), and
        listed: (k,), see `PointLists`: points of the film, for each of the s shapes.
        features: (f,) that were near a triangle.
        first: (f + 1,), and
        triangles: (t,), see `TriangleLists`: of the film, for each of these.
    """

    row: Indices
    local: Blocks
    reach_m: float
    behind_m: float
    spans: IndexTable
    listed: Indices
    features: Indices
    first: Indices
    triangles: Indices


class Search(NamedTuple):
    """What a search is given, and what it fills; scratch is as long as the lists.

    Args:
        bounds: of the shapes.
        owner: (features,) shape of each feature.
        feature: (features, 3) [m], shape frame.
        surface: of the film.
        lists: that may be valid.
        near: filled from the beginning.
        held: (f,) the triangle that has held each listed feature back until now; -2 less the one that it has
            brushed; -1 for none.
        places: (p, 3) [m], of the film's points; those that no shape is near may be anywhere.
        spans: (s, 2).
        around: (f, 3) [m], where listed features are.
        found: (f,), which of them are near.
        out: (k, 4), distance and normal.
        box: (2, 3) [m], outside of which no feature counts.
        calls: (4,), see `search_calls`.
    """

    bounds: ShapeBounds
    owner: Indices
    feature: Matrix
    surface: SurfaceRows
    lists: ListRows
    near: NearPoints
    held: Indices
    places: Matrix
    spans: IndexTable
    around: Matrix
    found: Indices
    out: Matrix
    box: Matrix
    calls: Indices


class ContactNumbers(NamedTuple):
    """Numbers of contact.

    Args:
        behind: how far behind the film a feature counts [m].
        per_area: stiffness of a point [N/m^3].
        of_feature: stiffness of a feature [N/m].
        renewed_above: growth of the contacts' stiffness with which bodies are to be weighed.
        renewed_after: ticks of contact after which they are.
    """

    behind: float
    per_area: float
    of_feature: float
    renewed_above: float
    renewed_after: int


class ContactArrays(NamedTuple):
    """What a film may touch and has touched; arrays are filled from their beginnings.

    Args:
        search: for what is near.
        shapes: their poses, and what they are of.
        numbers: of contact.
        memory: of the last tick.
        kept: of the tick in progress.
        touched: contacts.
        ties: theirs.
        glue: what is glued.
        end: of the tick.
        bodies: that bear it.
        movable: (f,) bodies that can be touched, and that loads can move.
        heavy: (f,), 1 for those that are met where they are, see `LightBodies`.
        touching: (f,) [N/m], stiffness of their contacts when they were weighed.
        gives: (bodies, 2) [1/N, 1/(N m)], by how much a body goes from where the film has met it for a
            change of its load in a tick, over what may be; `UNKNOWN` where that is not known.
        yields: (bodies, 6, 6), share of the way that it would go, at its centre of mass, by which the film
            follows it there, see `LightBodies`.
        past: (bodies, 12), loads on bodies one tick before those that act, and two; zero where none acted.
        assumed: (bodies, 6), loads on bodies with which the film meets them, see `foresee`.
        met: (bodies, 18), scratch: how much further each goes at other loads than it was met; its load and
            lead before a look at these.
        speed: (2,) [m/s], of the film's fastest node before the step, and of the fastest body that loads can
            move, seen from the flange.
        resolved: (bodies,) [m], way of a body in a step with which that resolves a hit; infinite for bodies
            that no load moves.
        counts: (7,).
        calls: of the kernels that these call.
    """

    search: Search
    shapes: ShapeRows
    numbers: ContactNumbers
    memory: MemoryRows
    kept: MemoryRows
    touched: TouchedPlanes
    ties: Ties
    glue: Glue
    end: EndRows
    bodies: BodyLoads
    movable: Indices
    heavy: Indices
    touching: Vector
    gives: Matrix
    yields: Blocks
    past: Matrix
    assumed: Matrix
    met: Matrix
    speed: Vector
    resolved: Vector
    counts: Indices
    calls: Indices


def no_contact() -> ContactArrays:
    """Return what represents a scene in which nothing can be touched."""
    nothing: ContactArrays = nothing_of(ContactArrays)
    return nothing._replace(counts=np.zeros(7, np.int64))


def _no_indices(count: int) -> IntArray:
    return np.zeros(count, np.int64)


@device_function
def fill_leads(leads: Any, h: float) -> None:
    """Fill by how much bodies are ahead at the velocities that they have."""
    now, flange, steps = small_vector(6), small_vector(6), leads.foresight.ahead.pace[0]
    fill_speed(leads, leads.flange, flange)
    for b in range(leads.ahead.shape[0]):
        lead = leads.lead[b]
        lead[:] = 0.0
        if leads.ahead[b] != 0:
            fill_speed(leads, b, now)
            way = h if leads.ahead[b] > 0 else h * (steps - 1) / (2 * steps)
            for r in range(6):
                lead[r] = way * (now[r] - flange[r])


@device_function
def _begin_ahead(steps: Indices, ahead: Any) -> None:
    """Bring the second state up to its positions, with what the joints carry."""
    call_native(steps[REBEGIN], ahead.sides[0], ahead.sides[1])
    carried, some = ahead.carried, 0.0
    for i in range(carried.shape[0]):
        for j in range(i + 1):
            ahead.mass[ahead.mass_places[i, j]] += carried[i, j]
            some = max(some, abs(carried[i, j]))
    if some > 0.0:
        call_native(steps[REFACTORISE], ahead.sides[0], ahead.sides[1])


@device_function
def _take_ahead(leads: Any) -> None:
    """Fill by how much bodies are ahead after a tick of several steps."""
    steps, ahead, h = leads.foresight.steps, leads.foresight.ahead, leads.foresight.ahead.step_s
    here, there = ahead.here, ahead.there
    copy(here.position, there.position)
    copy(here.speed, there.speed)
    copy(here.warm, there.warm)
    copy(here.torque, there.torque)
    copy(here.applied, there.applied)
    copy(here.control, there.control)
    now, flange = small_vector(6), small_vector(6)
    for b in range(leads.ahead.shape[0]):
        if leads.ahead[b] > 0:
            leads.lead[b, :] = 0.0
    for _ in range(ahead.pace[0]):
        _begin_ahead(steps, ahead)
        for j in range(0, there.control.shape[0], 3):
            there.control[j] += h * there.control[j + 1]
        call_native(steps[REFINISH], ahead.sides[0], ahead.sides[1])
        call_native(steps[VELOCITIES], ahead.sides[0], ahead.sides[1])
        fill_velocity(ahead.spin, ahead.tree, leads.root, leads.flange, flange)
        for b in range(leads.ahead.shape[0]):
            if leads.ahead[b] > 0:
                fill_velocity(ahead.spin, ahead.tree, leads.root, b, now)
                for r in range(6):
                    leads.lead[b, r] += h * (now[r] - flange[r])


@kernel
def foresee(leads: Leads, h: float) -> None:
    """Fill by how much bodies are ahead at the end of MuJoCo's next step, under the loads that act now.

    Args:
        leads: filled.
        h: length of the step [s].
    """
    sight = leads.foresight
    if sight.ahead.pace[0] > 1:
        _take_ahead(leads)
        return
    sides, speed, kept = sight.sides, sight.speed, sight.kept
    for j in range(speed.shape[0]):
        kept[0, j], kept[1, j] = speed[j], sight.acceleration[j]
    call_native(sight.steps[ACCELERATE], sides[0], sides[1])
    call_native(sight.steps[CONSTRAIN], sides[0], sides[1])
    for j in range(speed.shape[0]):
        # damping is implicit in MuJoCo's step; joints count as if each were alone
        inertia = sight.mass[sight.diagonal[j]]
        speed[j] += h * sight.acceleration[j] * inertia / (inertia + h * sight.damping[j])
    call_native(sight.steps[VELOCITIES], sides[0], sides[1])
    fill_leads(leads, h)
    for j in range(speed.shape[0]):
        speed[j], sight.acceleration[j] = kept[0, j], kept[1, j]
    call_native(sight.steps[VELOCITIES], sides[0], sides[1])


@device_function
def approach_of(contact: Any, e: int, velocity: Matrix, body: Vector) -> float:
    """Return how fast contact e's point and body come on to each other [m/s], and apart below 0."""
    planes, speed = contact.touched.planes, 0.0
    for r in range(3):
        own = led(body, planes.anchor[e], r)
        for a in range(3):
            own -= planes.weights[e, a] * velocity[planes.nodes[e, a], r]
        speed += planes.normal[e, r] * own
    return speed


@device_function
def place_of(wanted: int, ascending: Indices) -> int:
    """Return where a number is in an ascending list, -1 if it is not; numpy's takes 0.5 s to compile."""
    low, high = 0, ascending.shape[0]
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low if low < ascending.shape[0] and ascending[low] == wanted else -1
