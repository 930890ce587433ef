"""The kernels of a tick's contacts: what is near, what may be touched, and what was at the tick's end.

Bodies that give way are met where they will be, see `LightBodies`.
"""

import math
from typing import Any, Final

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import (
    address_of,
    device_function,
    handing_on_views,
    kernel,
    record_at,
    small_matrix,
    small_vector,
)
from cosim.base.numba_insides import caller
from cosim.coupling.contact import contact_arrays, search_kernels
from cosim.coupling.contact.contact_arrays import (
    ContactArrays,
    approach_of,
    fill_leads,
    fill_speed,
    foresee,
    led,
    place_of,
)
from cosim.rigid.distance.shapes import ShapePoses, fill_near_box
from cosim.soft.contact.contact_law import GLUED, shorten, span, touch
from cosim.soft.contact.obstacle_contact import PlaneRows, TouchedPlanes


@kernel
def fastest_touched(at: int, x: Matrix, velocity: Matrix) -> float:
    """Return how fast [m/s] the film comes on to bodies that can move, or loaded ones move on the flange.

    Args:
        at: address of the `ContactArrays`.
        x: (n, 3) [m], after a step.
        velocity: (n, 3) [m/s], then.
    """
    contact = record_at(at, ContactArrays)
    leads, planes, most = contact.bodies.leads, contact.touched.planes, 0.0
    flange, body, point, own = small_vector(6), small_vector(6), small_vector(3), small_vector(3)
    fill_speed(leads, leads.flange, flange)
    for f in range(contact.movable.shape[0]):
        b = contact.movable[f]
        fill_speed(leads, b, body)
        for e in range(contact.counts[contact_arrays.TOUCHES]):
            if planes.body[e] != b:
                continue
            for r in range(3):
                point[r] = own[r] = 0.0
                for a in range(3):
                    weight, node = planes.weights[e, a], planes.nodes[e, a]
                    point[r] += weight * x[node, r]
                    own[r] += weight * velocity[node, r]
            approach, square = 0.0, 0.0
            for r in range(3):
                speed = led(body, point, r)
                approach -= planes.normal[e, r] * (own[r] - speed)
                square += (speed - led(flange, point, r)) ** 2
            most = max(most, approach, math.sqrt(square) if contact.bodies.loaded[b] else 0.0)
    return most


EXACTLY: Final = 0.25
"""Share of what bodies may be off that the film's own residual may make."""
_CALLED = (search_kernels.find_near, span, fill_near_box, foresee)
_FIND, _SPAN, _NEAR, _FORESEE, FIND_TOUCHED, SETTLE_TOUCHED, MEET_TOUCHED, FASTEST, FOLLOW_TOUCHED = range(
    len(_CALLED) + 5
)
_find_near, _span, _fill_near_box, _foresee = map(caller, _CALLED)


def contact_calls() -> IntArray:
    """Return the addresses (9,) of the kernels of contact, for one another and for who takes a whole tick."""
    taken = *_CALLED, find_touched, settle_touched, meet_touched, fastest_touched, follow_touched
    return np.array([address_of(called) for called in taken])


@device_function
def _take_point(contact: Any, e: int) -> float:
    """Fill contact e from a point of the film; return its distance."""
    search, shapes, planes, ties = contact.search, contact.shapes, contact.touched.planes, contact.ties
    near, surface = search.near, search.surface
    p, g = near.point[e], near.shape[e]
    for r in range(3):
        planes.nodes[e, r], planes.weights[e, r] = surface.nodes[p, r], surface.weights[p, r]
        planes.normal[e, r], planes.anchor[e, r] = near.normal[e, r], search.places[p, r]
        ties.carrier[e, r] = shapes.position[g, r]
    for k in range(6):
        planes.slots[e, k] = surface.slots[p, k]
    planes.stiffness[e] = contact.numbers.per_area * surface.area[p]
    ties.shape[e], ties.key[e], ties.triangle[e] = g, g * surface.nodes.shape[0] + p, -1
    return near.distance[e]


@device_function
def _take_feature(contact: Any, x: Matrix, e: int, first_key: int) -> float:
    """Fill contact e from a feature near the film; return its distance."""
    near, surface = contact.search.near, contact.search.surface
    planes, ties, f = contact.touched.planes, contact.ties, e - contact.counts[contact_arrays.POINTS]
    t = near.triangle[f]
    for k in range(6):
        planes.slots[e, k] = surface.triangle_slots[t, k]
    for r in range(3):
        planes.nodes[e, r], planes.weights[e, r] = surface.triangles[t, r], near.weight[f, r]
        planes.normal[e, r], ties.carrier[e, r] = -near.film_normal[f, r], near.place[f, r]
        planes.anchor[e, r] = 0.0
        for a in range(3):
            planes.anchor[e, r] += near.weight[f, a] * x[surface.triangles[t, a], r]
    planes.stiffness[e] = contact.numbers.of_feature
    ties.shape[e], ties.key[e], ties.triangle[e] = near.owner[f], first_key + near.feature[f], t
    return near.film_distance[f]


@device_function
def _take_glued(contact: Any, e: int, k: int) -> None:
    """Fill contact e from glued point k, whose anchor goes with its body."""
    planes, ties, glue, surface = contact.touched.planes, contact.ties, contact.glue, contact.search.surface
    p, b, place = glue.point[k], glue.body[0], small_vector(3)
    for r in range(3):
        planes.nodes[e, r], planes.weights[e, r] = surface.nodes[p, r], surface.weights[p, r]
        planes.normal[e, r], ties.carrier[e, r] = 0.0, 0.0
        place[r] = glue.position[b, r]
        for s in range(3):
            place[r] += glue.axes[b, 3 * r + s] * glue.place[k, s]
    for r in range(3):
        planes.anchor[e, r] = place[r] + led(contact.bodies.leads.lead[b], place, r)
    for r in range(6):
        planes.slots[e, r] = surface.slots[p, r]
    planes.offset[e], planes.stiffness[e], planes.friction[e] = 0.0, glue.stiffness, GLUED
    planes.body[e], ties.shape[e], ties.key[e], ties.triangle[e] = b, -1, -1, -1


@device_function
def _describe(contact: Any, x: Matrix, velocity: Matrix) -> None:
    """Fill tangent planes and what they are tied to, from nodes (n, 3) [m] and their velocities.

    What pressed in the last tick keeps its normal force, and its anchor, which rides on the shape.
    """
    shapes, memory, planes, ties = contact.shapes, contact.memory, contact.touched.planes, contact.ties
    points, remembered = contact.counts[contact_arrays.POINTS], contact.counts[contact_arrays.REMEMBERED]
    first_key = shapes.body.shape[0] * contact.search.surface.nodes.shape[0]
    glued = contact.counts[contact_arrays.TOUCHES] - contact.glue.point.shape[0]
    moving, of = small_vector(6), -1
    for e in range(contact.counts[contact_arrays.TOUCHES]):
        ties.approach[e] = 0.0
        if e >= glued:
            _take_glued(contact, e, e - glued)
            continue
        distance = _take_point(contact, e) if e < points else _take_feature(contact, x, e, first_key)
        g, height = ties.shape[e], 0.0
        for r in range(3):
            height += planes.normal[e, r] * planes.anchor[e, r]
        planes.offset[e], planes.friction[e], planes.body[e] = height - distance, 0.0, shapes.body[g]
        if contact.resolved[shapes.body[g]] < np.inf:
            if of != shapes.body[g]:
                of = shapes.body[g]
                fill_speed(contact.bodies.leads, of, moving)
            ties.approach[e] = approach_of(contact, e, velocity, moving)
        found = np.searchsorted(memory.key[:remembered], ties.key[e])
        if found == remembered or memory.key[found] != ties.key[e]:
            continue
        planes.friction[e] = shapes.friction[g] * memory.normal_force[found]
        for r in range(3):
            turned = 0.0
            for s in range(3):
                turned += shapes.rotation[g, r, s] * memory.offset[found, s]
            # a feature has moved under the film, whose point there is another one than before: the stretch
            # goes on from where it was
            moved = ties.carrier[e, r] - memory.place[found, r]
            planes.anchor[e, r] = turned + (ties.carrier[e, r] if e < points else planes.anchor[e, r] + moved)


@handing_on_views
def touched_planes(touched: TouchedPlanes, count: int) -> TouchedPlanes:
    """Return the first of some contacts."""
    p = touched.planes
    planes = PlaneRows(
        p.nodes[:count], p.weights[:count], p.slots[:count], p.normal[:count], p.offset[:count],
        p.stiffness[:count], p.friction[:count], p.anchor[:count], p.body[:count],
    )  # fmt: skip
    return TouchedPlanes(touched.call, planes, touched.widths, touched.own[:count], touched.pressing[:count])


@device_function
def _read_poses(bounds: Any, body: Indices, leads: Any, centers: Matrix) -> None:
    """Take the shapes' present poses and centres of mass over from MuJoCo, and bring them ahead."""
    for b in range(leads.ahead.shape[0]):
        for r in range(3):
            centers[b, r] = leads.mass[b, r] + led(leads.lead[b], leads.mass[b], r)
    for g in range(bounds.geoms.shape[0]):
        place, lead, axes = bounds.places[bounds.geoms[g]], leads.lead[body[g]], bounds.rotation[g]
        for r in range(3):
            bounds.position[g, r] = place[r] + led(lead, place, r)
            for c in range(3):
                axes[r, c] = bounds.axes[bounds.geoms[g], 3 * r + c]
        x, y, z = lead[3], lead[4], lead[5]  # by which they have turned
        angle = math.sqrt(x * x + y * y + z * z)
        if not leads.ahead[body[g]] or angle < 1e-12:
            continue
        square = angle * angle
        sine, fall = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        for c in range(3):
            p, q, s = axes[0, c], axes[1, c], axes[2, c]
            along = x * p + y * q + z * s
            axes[0, c] += sine * (y * s - z * q) + fall * (x * along - square * p)
            axes[1, c] += sine * (z * p - x * s) + fall * (y * along - square * q)
            axes[2, c] += sine * (x * q - y * p) + fall * (z * along - square * s)


@device_function
def _assume(contact: Any) -> None:
    """Fill the loads with which the film meets bodies: those that act, and as they have changed.

    Of the last change, that share continues by which the change before it would have continued best.
    """
    bodies, past, assumed = contact.bodies, contact.past, contact.assumed
    for b in range(bodies.loaded.shape[0]):
        for first in range(0, 6, 3):
            along = square = 0.0
            for r in range(first, first + 3):
                before = past[b, r] - past[b, 6 + r]
                along += (bodies.applied[b, r] - past[b, r]) * before
                square += before * before
            share = min(max(along / square, 0.0), 1.0) if bodies.loaded[b] and square > 0.0 else 0.0
            for r in range(first, first + 3):
                assumed[b, r] = bodies.applied[b, r] + share * (bodies.applied[b, r] - past[b, r])


@device_function
def _look_ahead(contact: Any, loads: Matrix, h: float) -> None:
    """Fill how far bodies are ahead under loads (bodies, 6) on those that are met there."""
    bodies, met = contact.bodies, contact.met
    for b in range(bodies.loaded.shape[0]):
        for r in range(6):
            met[b, 6 + r] = bodies.applied[b, r]
            if bodies.leads.ahead[b] > 0:
                bodies.applied[b, r] = loads[b, r]
    _foresee(contact.calls[_FORESEE], (bodies.leads, h))
    for b in range(bodies.loaded.shape[0]):
        for r in range(6):
            bodies.applied[b, r] = met[b, 6 + r]


@device_function
def _fastest_body(contact: Any) -> float:
    """Return the largest speed [m/s] of a body that loads can move, seen from the flange."""
    leads, most, flange, body = contact.bodies.leads, 0.0, small_vector(6), small_vector(6)
    fill_speed(leads, leads.flange, flange)
    for f in range(contact.movable.shape[0]):
        b, square = contact.movable[f], 0.0
        fill_speed(leads, b, body)
        for r in range(3):
            square += (led(body, leads.mass[b], r) - led(flange, leads.mass[b], r)) ** 2
        most = max(most, square)
    return math.sqrt(most)


@device_function
def _find_pairs(contact: Any, x: Matrix, velocity: Matrix, rest: float, ahead: float) -> tuple[int, int]:
    """Find what is near; return how many points of the film and features, -1 for lists that are not valid."""
    bounds, search, bodies, memory = contact.search.bounds, contact.search, contact.bodies, contact.memory
    body, listed, held, met = contact.shapes.body, search.lists.features, search.held, 0
    fill_leads(bodies.leads, ahead / contact_arrays.AHEAD_TICKS)
    _read_poses(bounds, body, bodies.leads, bodies.centers)
    low, high, fastest = small_vector(3), small_vector(3), small_vector(1)
    _span(contact.calls[_SPAN], (x, velocity, low, high, fastest))
    # a body that comes on is met a tick before it is there, so its hit finds ticks in pieces
    contact.speed[0], contact.speed[1] = math.sqrt(fastest[0]), _fastest_body(contact)
    reach = rest + ahead * contact.speed[0] + ahead / contact_arrays.AHEAD_TICKS * contact.speed[1]
    poses = ShapePoses(bounds.position, bounds.rotation)
    near = _fill_near_box(contact.calls[_NEAR], (bounds.shapes, poses, low, high, reach, bounds.near))
    for k in range(near + (contact.glue.point.shape[0] > 0)):
        b = body[bounds.near[k]] if k < near else contact.glue.body[0]
        if ahead > 0.0 and bodies.leads.ahead[b] > 0:
            met += 1
    _assume(contact)
    if met > 0:
        _look_ahead(contact, contact.assumed, ahead / contact_arrays.AHEAD_TICKS)
        _read_poses(bounds, body, bodies.leads, bodies.centers)
        near = _fill_near_box(contact.calls[_NEAR], (bounds.shapes, poses, low, high, reach, bounds.near))
    if near == 0:
        return 0, 0
    for f in range(listed.shape[0]):  # which triangle has held it back until now
        held[f] = -1
    for e in range(contact.counts[contact_arrays.REMEMBERED]):
        if memory.face[e] >= 0:
            feature = memory.key[e] - body.shape[0] * search.surface.nodes.shape[0]
            at = place_of(feature, listed)
            if at >= 0:
                held[at] = memory.triangle[e] if memory.triangle[e] >= 0 else -2 - memory.face[e]
    asked = x, low, high, bounds.near[:near], reach, contact.numbers.behind, search
    return _find_near(contact.calls[_FIND], asked)


@kernel
def find_touched(at: int, x: Matrix, velocity: Matrix, rest: float, ahead: float) -> int:
    """Fill what the film may touch in a step; return how much, -1 for lists that are not valid.

    Args:
        at: address of the `ContactArrays`, which are filled.
        x: (n, 3) [m], before the step.
        velocity: (n, 3) [m/s], then.
        rest: how far a film at rest looks [m].
        ahead: the time [s] for whose way of the fastest node it looks further.
    """
    contact = record_at(at, ContactArrays)
    counts = contact.counts
    counts[contact_arrays.ASKS] = 0
    glued = contact.glue.point.shape[0]
    if contact.search.bounds.geoms.shape[0] + glued == 0:
        return 0
    points, features = _find_pairs(contact, x, velocity, rest, ahead)
    if points < 0:
        return -1
    touches = points + features + glued
    counts[contact_arrays.POINTS], counts[contact_arrays.TOUCHES] = points, touches
    if touches == 0:
        counts[contact_arrays.REMEMBERED] = 0
        return 0
    _describe(contact, x, velocity)
    return touches


@device_function
def _remember(contact: Any, e: int, kept: int, push: float, stretch: Vector) -> None:
    """Fill row `kept` of the memory from contact e, whose anchor is a stretch behind its point."""
    ties, memory, rotation, point = contact.ties, contact.kept, contact.shapes.rotation, contact.end.point
    g = ties.shape[e]
    memory.key[kept], memory.normal_force[kept], memory.triangle[kept] = ties.key[e], push, ties.triangle[e]
    memory.face[kept] = ties.triangle[e]
    for r in range(3):
        memory.place[kept, r], memory.offset[kept, r] = ties.carrier[e, r], 0.0
        for s in range(3):
            behind = point[e, s] - ties.carrier[e, s] if e < contact.counts[contact_arrays.POINTS] else 0.0
            memory.offset[kept, r] += rotation[g, s, r] * (behind - stretch[s])


@device_function
def _conclude(contact: Any, x: Matrix) -> int:
    """Fill what is left of contacts; return how many press."""
    planes, ties, end, kept = contact.touched.planes, contact.ties, contact.end, 0
    width, stick = contact.touched.widths[0], contact.touched.widths[1]
    own, tangent, stretch = small_vector(3), small_matrix(3, 3), small_vector(3)
    end.figures[0], end.figures[1], size = 0.0, -np.inf, 0.0
    end.figures[3], end.figures[4], end.figures[5] = 0.0, 0.0, -1.0
    end.loads[:], end.acting[:], end.held[:], end.pressing[:], end.film[:] = 0.0, 0, 0.0, 0.0, 0.0
    for e in range(contact.counts[contact_arrays.TOUCHES]):
        point, n, b, distance = end.point[e], planes.normal[e], planes.body[e], -planes.offset[e]
        for r in range(3):
            point[r] = 0.0
            for a in range(3):
                point[r] += planes.weights[e, a] * x[planes.nodes[e, a], r]
            distance += n[r] * point[r]
        friction, anchor = planes.friction[e], planes.anchor[e]
        _, push = touch(
            point, n, planes.offset[e], planes.stiffness[e], friction, anchor, width, stick, own, tangent
        )
        for r in range(3):
            end.own[e, r] = own[r]
        if friction == GLUED:
            end.slack_friction[e] = friction
            end.held[b] += 3.0 * planes.stiffness[e]
            size += abs(own[0]) + abs(own[1]) + abs(own[2])
        else:
            slack = contact.shapes.friction[ties.shape[e]] * push
            end.slack_friction[e] = slack
            pressing = planes.stiffness[e] * min(max((0.5 * width - distance) / width, 0.0), 1.0)
            end.held[b] += pressing + 4.0 * slack / stick
        # a point that has just come off may still rub: friction is bounded by the last tick's normal force
        if own[0] != 0.0 or own[1] != 0.0 or own[2] != 0.0:
            end.acting[b] = 1
            contact_arrays.add_load(1.0, own, point, end.loads[b])
            for a in range(3):
                contact_arrays.add_load(planes.weights[e, a], own, x[planes.nodes[e, a]], end.film)
        if push > 0.0:
            end.figures[0] += push
            end.pressing[b] += push
            end.figures[1] = max(end.figures[1], -distance)
            contact_arrays.see_hit(contact, e)
            for r in range(3):
                stretch[r] = point[r] - anchor[r]
            shorten(stretch, n, stick)
            _remember(contact, e, kept, push, stretch)
            if -distance < 0.5 * width:  # the law's transition: what only brushes an edge may slip off it
                contact.kept.triangle[kept] = -1
            kept += 1
    if kept == 0:
        end.figures[1] = 0.0
    end.film[6], end.film[7] = end.figures[0] + size, end.figures[0]
    return kept


@device_function
def _bear(bodies: Any, load: Vector, b: int) -> None:
    """Let a load (6,) about the world's origin act on a body; MuJoCo takes torques about its centre."""
    applied, center = bodies.applied[b], bodies.centers[b]
    for r in range(3):
        i, m = (r + 1) % 3, (r + 2) % 3
        applied[r] = load[r]
        applied[3 + r] = load[3 + r] - (center[i] * load[m] - center[m] * load[i])


@device_function
def _changed(contact: Any, b: int, first: int) -> float:
    """Return how far the force (first 0) or torque (3) on a body, about its centre, is from that assumed."""
    load, center, square = contact.end.loads[b], contact.bodies.centers[b], 0.0
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        about = center[s] * load[q] - center[q] * load[s] if first else 0.0
        square += (load[first + r] - about - contact.assumed[b, first + r]) ** 2
    return math.sqrt(square)


@device_function
def _away(contact: Any, h: float) -> float:
    """Return how far [m] bodies go from where the film has met them under the loads at the end of a step."""
    end, bodies, met, away = contact.end, contact.bodies, contact.met, 0.0
    for b in range(bodies.loaded.shape[0]):
        for r in range(6):
            met[b, 6 + r], met[b, 12 + r] = bodies.applied[b, r], bodies.leads.lead[b, r]
        if bodies.leads.ahead[b] > 0 and (end.acting[b] or bodies.loaded[b]):
            _bear(bodies, end.loads[b], b)
    _foresee(contact.calls[_FORESEE], (bodies.leads, h))
    for b in range(bodies.loaded.shape[0]):
        for r in range(6):
            bodies.applied[b, r] = met[b, 6 + r]
            met[b, r], bodies.leads.lead[b, r] = bodies.leads.lead[b, r] - met[b, 12 + r], met[b, 12 + r]
        if bodies.leads.ahead[b] > 0:
            for r in range(3):
                turned = contact_arrays.TURN_LEVER_M * abs(met[b, 3 + r])
                away = max(away, abs(led(met[b], bodies.centers[b], r)), turned)
    return away


@kernel
def meet_touched(at: int, x: Matrix, tolerance: float, h: float, again: bool) -> float:
    """Return how far bodies go from where a step that ends at x (n, 3) [m] has met them, under its loads.

    Where free ones would, held ones do; otherwise MuJoCo's next step is looked at.

    Args:
        at: address of the `ContactArrays`, whose end is filled.
        x: of the film's nodes.
        tolerance: of the film's forces [N].
        h: length of MuJoCo's step [s].
        again: whether the film has followed them in this step.

    Returns:
        The distance over what may be: at most 1 where that is agreed, infinite where it is not known.
    """
    contact = record_at(at, ContactArrays)
    end, bodies, touched, most = contact.end, contact.bodies, 0, 0.0
    _conclude(contact, x)
    for b in range(bodies.loaded.shape[0]):
        if bodies.leads.ahead[b] <= 0 or not (end.acting[b] or bodies.loaded[b]):
            continue
        force, torque = _changed(contact, b, 0), _changed(contact, b, 3)
        gives = contact.gives[b]
        if gives[0] * tolerance > EXACTLY and force + torque > 0.0:  # as where it is not known
            return np.inf
        most = max(most, gives[0] * force, gives[1] * torque)
        touched = max(touched, end.acting[b])
    if again or not most <= 1.0:
        most = _away(contact, h) / contact_arrays.AGREED_M
    if most <= 1.0:
        contact.counts[contact_arrays.MET] += touched
    return most


@device_function
def _yield(contact: Any, b: int) -> None:
    """Let a body be met a share of the way further that it would go, see `_away`."""
    met, share, center, way = contact.met[b], contact.yields[b], contact.bodies.centers[b], small_vector(6)
    for r in range(3):
        way[r], way[3 + r] = led(met, center, r), met[3 + r]
    for r in range(6):
        met[r] = 0.0
        for c in range(6):
            met[r] += share[r, c] * way[c]
    for r in range(3):  # back to the world's origin; the centre itself goes by the way there
        way[r] = met[r]
    for r in range(3):
        i, m = (r + 1) % 3, (r + 2) % 3
        met[r] -= met[3 + i] * center[m] - met[3 + m] * center[i]
    for r in range(3):
        center[r] += way[r]
    for r in range(6):
        contact.bodies.leads.lead[b, r] += met[r]


@kernel
def follow_touched(at: int, x: Matrix) -> None:
    """Let contacts follow bodies from where the film has met them, see `meet_touched`, by Newton's method.

    Args:
        at: address of the `ContactArrays`.
        x: (n, 3) [m], of the film's nodes before the step.
    """
    contact = record_at(at, ContactArrays)
    planes, ties, bodies, point = contact.touched.planes, contact.ties, contact.bodies, small_vector(3)
    for b in range(bodies.loaded.shape[0]):
        if bodies.leads.ahead[b] > 0:
            _yield(contact, b)
    for e in range(contact.counts[contact_arrays.TOUCHES]):
        b = planes.body[e]
        if bodies.leads.ahead[b] <= 0:
            continue
        for r in range(3):
            point[r] = 0.0
            for a in range(3):
                point[r] += planes.weights[e, a] * x[planes.nodes[e, a], r]
        for r in range(3):
            shift = led(contact.met[b], point, r)
            planes.offset[e] += planes.normal[e, r] * shift
            planes.anchor[e, r] += shift
            ties.carrier[e, r] += shift


@device_function
def _load_bodies(end: Any, bodies: Any, past: Matrix) -> None:
    """Let the contacts' loads act on bodies, see `Bodies.apply`."""
    for b in range(bodies.loaded.shape[0]):
        if end.acting[b] or bodies.loaded[b]:
            for r in range(6):
                past[b, 6 + r] = past[b, r] if bodies.loaded[b] else 0.0
                past[b, r] = bodies.applied[b, r] if bodies.loaded[b] else 0.0
            bodies.loaded[b], bodies.pressing[b] = end.acting[b], end.pressing[b]
            _bear(bodies, end.loads[b], b)
    for r in range(8):
        bodies.handed[r] = end.film[r]


@device_function
def _work(contact: Any, before: Matrix, x: Matrix) -> float:
    """Return the contacts' work on the film in a tick, by the mean of forces at its ends; keep the last."""
    planes, force, work = contact.touched.planes, contact.end.force, 0.0
    for i in range(force.shape[0]):
        for r in range(3):
            work += 0.5 * force[i, r] * (x[i, r] - before[i, r])
            force[i, r] = 0.0
    for e in range(contact.counts[contact_arrays.TOUCHES]):
        for a in range(3):
            i = planes.nodes[e, a]
            for r in range(3):
                share = planes.weights[e, a] * contact.end.own[e, r]
                force[i, r] -= share
                work -= 0.5 * share * (x[i, r] - before[i, r])
    return work


@kernel
def settle_touched(at: int, before: Matrix, x: Matrix) -> None:
    """Take in the end of a step from before to x (n, 3) [m]: remember what presses, and load the bodies.

    Args:
        at: address of the `ContactArrays`.
        before: of the film's nodes at the beginning.
        x: the same at the end.
    """
    contact = record_at(at, ContactArrays)
    counts, end, memory, kept, pressing = contact.counts, contact.end, contact.memory, contact.kept, 0
    if counts[contact_arrays.TOUCHES] > 0:
        pressing = _conclude(contact, x)
        counts[contact_arrays.AGE] += 1
    else:
        end.figures[:], end.loads[:], end.acting[:], end.held[:], end.film[:] = 0.0, 0.0, 0, 0.0, 0.0
        end.figures[5], end.pressing[:] = -1.0, 0.0
    end.figures[2] = _work(contact, before, x)
    counts[contact_arrays.REMEMBERED] = pressing
    for e in range(pressing):  # they are those of the last tick from now on
        memory.key[e], memory.normal_force[e] = kept.key[e], kept.normal_force[e]
        memory.triangle[e], memory.face[e] = kept.triangle[e], kept.face[e]
        for r in range(3):
            memory.offset[e, r], memory.place[e, r] = kept.offset[e, r], kept.place[e, r]
    loaded = contact.bodies.loaded
    _load_bodies(end, contact.bodies, contact.past)
    counts[contact_arrays.LEFT], counts[contact_arrays.ASKS] = counts[contact_arrays.TOUCHES] > 0, 0
    for f in range(contact.movable.shape[0]):
        body, held = contact.movable[f], contact.numbers.renewed_above * contact.touching[f]
        old = counts[contact_arrays.AGE] >= contact.numbers.renewed_after or end.held[body] > held
        if contact.heavy[f] and (not loaded[body] or old):  # `LightBodies` has to weigh it
            counts[contact_arrays.ASKS] = 1


_settle_touched = caller(settle_touched)


@device_function
def may_give_way(contact: ContactArrays, found: int) -> int:
    """Return 1 if a body is near that may give way, 2 if how it does is not known of one that is loaded."""
    bodies, body, near = contact.bodies, contact.touched.planes.body, 0
    for e in range(found):
        b = body[e]
        if bodies.leads.ahead[b] > 0:
            near = max(near, 2 if bodies.loaded[b] and contact.gives[b, 0] == contact_arrays.UNKNOWN else 1)
    return near


@device_function
def conclude_touch(
    contact: ContactArrays, at: int, found: int, moved: tuple[Matrix, Matrix], ticks: Any, k: int
) -> bool:
    """Take in the end of a step that might touch, or has let go; return if bodies are to be weighed.

    Args:
        contact: with the scene.
        at: its address.
        found: how much the step might touch.
        moved: (n, 3) [m], nodes before and after the step.
        ticks: filled.
        k: the tick.
    """
    if found == 0 and not contact.counts[contact_arrays.LEFT]:
        return False
    _settle_touched(contact.calls[SETTLE_TOUCHED], (at, *moved))
    ticks.contacts[k] = contact.counts[contact_arrays.REMEMBERED]
    ticks.contact[k, 1], ticks.work[k, 0] = contact.end.figures[1], contact.end.figures[2]
    for r in range(3):
        ticks.hit[k, r] = contact.end.figures[3 + r]
    return (
        contact.counts[contact_arrays.ASKS] != 0
        or contact.counts[contact_arrays.MET] >= contact.numbers.renewed_after
    )
