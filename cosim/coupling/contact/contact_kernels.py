"""Leaves of a tick's contacts with the scene: what may be touched, what was at its end, what bodies bear.

Bodies that give way are met where they will be, see `LightBodies`.
"""

import math

import numpy as np

from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector
from cosim.coupling.contact.contact_arrays import (
    BodyLoads,
    ContactLoads,
    Glue,
    NearFeatures,
    ShapeArrays,
    SurfaceArrays,
)
from cosim.coupling.contact.contact_report import ContactMemory
from cosim.rigid.distance.shapes import GeomPoses, ShapePoses
from cosim.rigid.distance.signed_distance import HitRows
from cosim.rigid.scene.body_motion import BodyMotions, fill_speed, led
from cosim.soft.contact.contact_law import GLUED, depth_of, resting_stiffness, shorten
from cosim.soft.contact.obstacle_contact import ContactPlanes, evaluate_again

EXACTLY = 0.25  # share of what bodies may be off that the film's own residual may make


@kernel
def place_shapes(
    geoms: GeomPoses, mass_center: Matrix, lead: Matrix, poses: ShapePoses, centers: Matrix
) -> None:
    """Take the shapes' present poses and centres of mass over from MuJoCo, and bring them ahead.

    Args:
        geoms: MuJoCo's poses.
        mass_center: (bodies, 3) [m], MuJoCo's.
        lead: (bodies, 6), see `PosePrediction`.
        poses: of the shapes, filled.
        centers: (bodies, 3) [m], filled.
    """
    for b in range(centers.shape[0]):
        for r in range(3):
            centers[b, r] = mass_center[b, r] + led(lead[b], mass_center[b], r)
    for g in range(geoms.geoms.shape[0]):
        geom = geoms.geoms[g]
        place, moved, axes = geoms.places[geom], lead[geoms.body[g]], poses.rotation[g]
        for r in range(3):
            poses.position[g, r] = place[r] + led(moved, place, r)
            for c in range(3):
                axes[r, c] = geoms.axes[geom, 3 * r + c]
        x, y, z = moved[3], moved[4], moved[5]  # by which they have turned
        angle = math.sqrt(x * x + y * y + z * z)
        if angle < 1e-12:
            continue
        square = angle * angle
        sine, fall = math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
        for c in range(3):
            p, q, s = axes[0, c], axes[1, c], axes[2, c]
            along = x * p + y * q + z * s
            axes[0, c] += sine * (y * s - z * q) + fall * (x * along - square * p)
            axes[1, c] += sine * (z * p - x * s) + fall * (y * along - square * q)
            axes[2, c] += sine * (x * q - y * p) + fall * (z * along - square * s)


@kernel
def fastest_body(motions: BodyMotions, movable: Indices) -> float:
    """Return the largest speed [m/s] of a body that loads can move, seen from the flange.

    Args:
        motions: of all bodies.
        movable: (f,) bodies.
    """
    most, flange, body = 0.0, small_vector(6), small_vector(6)
    fill_speed(motions, motions.flange, flange)
    for f in range(movable.shape[0]):
        b, square = movable[f], 0.0
        fill_speed(motions, b, body)
        for r in range(3):
            square += (led(body, motions.mass_center[b], r) - led(flange, motions.mass_center[b], r)) ** 2
        most = max(most, square)
    return math.sqrt(most)


@kernel
def assume(loads: BodyLoads, past: Matrix, assumed: Matrix) -> None:
    """Fill the loads with which the film meets bodies: those that act, and as they have changed.

    Of the last change, that share continues by which the change before it would have continued best.

    Args:
        loads: that act.
        past: (bodies, 12), loads one tick before those that act, and two; zero where none acted.
        assumed: (bodies, 6), filled.
    """
    for b in range(loads.loaded.shape[0]):
        for first in range(0, 6, 3):
            along = square = 0.0
            for r in range(first, first + 3):
                before = past[b, r] - past[b, 6 + r]
                along += (loads.applied[b, r] - past[b, r]) * before
                square += before * before
            share = min(max(along / square, 0.0), 1.0) if loads.loaded[b] and square > 0.0 else 0.0
            for r in range(first, first + 3):
                assumed[b, r] = loads.applied[b, r] + share * (loads.applied[b, r] - past[b, r])


@device_function
def _place_of(wanted: int, ascending: Indices) -> int:
    """Return where a number is in an ascending list, -1 if it is not; numpy's takes 0.5 s to compile."""
    low, high = 0, ascending.shape[0]
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low if low < ascending.shape[0] and ascending[low] == wanted else -1


@kernel
def fill_held(memory: ContactMemory, listed: Indices, first_key: int, held: Indices) -> None:
    """Fill which triangle has held back each listed feature until now.

    Args:
        memory: of the contacts that pressed.
        listed: (f,) features, ascending.
        first_key: of features.
        held: (f,), filled with it; -2 less the one that it has brushed; -1 for none.
    """
    for f in range(listed.shape[0]):
        held[f] = -1
    for e in range(memory.key.shape[0]):
        if memory.face[e] >= 0:
            place = _place_of(memory.key[e] - first_key, listed)
            if place >= 0:
                held[place] = memory.triangle[e] if memory.triangle[e] >= 0 else -2 - memory.face[e]


@kernel
def describe_points(
    hits: HitRows, places: Matrix, surface: SurfaceArrays, shapes: ShapeArrays, contacts: ContactPlanes
) -> None:
    """Fill the first contacts from points of the film near shapes.

    Args:
        hits: (k,) such points.
        places: (p, 3) [m], of all points.
        surface: of the film.
        shapes: of the scene.
        contacts: filled.
    """
    for e in range(hits.point.shape[0]):
        p, g, height = hits.point[e], hits.shape[e], 0.0
        for r in range(3):
            contacts.nodes[e, r], contacts.weights[e, r] = surface.nodes[p, r], surface.weights[p, r]
            contacts.normal[e, r], contacts.anchor[e, r] = hits.found[e, 1 + r], places[p, r]
            contacts.carrier[e, r] = shapes.position[g, r]
            height += contacts.normal[e, r] * places[p, r]
        for k in range(6):
            contacts.slots[e, k] = surface.slots[p, k]
        contacts.offset[e], contacts.body[e] = height - hits.found[e, 0], shapes.body[g]
        contacts.stiffness[e], contacts.friction[e] = surface.stiffness[p], 0.0
        contacts.shape[e], contacts.key[e], contacts.triangle[e] = g, g * surface.nodes.shape[0] + p, -1


@kernel
def describe_features(
    x: Matrix,
    near: NearFeatures,
    surface: SurfaceArrays,
    shapes: ShapeArrays,
    begin: int,
    contacts: ContactPlanes,
) -> None:
    """Fill contacts from features near the film, but for their stiffness.

    Args:
        x: (n, 3) [m], of the nodes.
        near: (f,) such features.
        surface: of the film.
        shapes: of the scene.
        begin: the first of these contacts.
        contacts: filled.
    """
    first_key = shapes.body.shape[0] * surface.nodes.shape[0]
    for f in range(near.feature.shape[0]):
        e, t, height = begin + f, near.triangle[f], 0.0
        for k in range(6):
            contacts.slots[e, k] = surface.triangle_slots[t, k]
        for r in range(3):
            contacts.nodes[e, r], contacts.weights[e, r] = surface.triangles[t, r], near.weight[f, r]
            contacts.normal[e, r], contacts.carrier[e, r] = -near.found[f, 1 + r], near.place[f, r]
            contacts.anchor[e, r] = 0.0
            for a in range(3):
                contacts.anchor[e, r] += near.weight[f, a] * x[surface.triangles[t, a], r]
            height += contacts.normal[e, r] * contacts.anchor[e, r]
        contacts.offset[e], contacts.body[e] = height - near.found[f, 0], shapes.body[near.owner[f]]
        contacts.friction[e] = 0.0
        contacts.shape[e], contacts.key[e], contacts.triangle[e] = (
            near.owner[f],
            first_key + near.feature[f],
            t,
        )


@kernel
def describe_glue(glue: Glue, surface: SurfaceArrays, lead: Matrix, contacts: ContactPlanes) -> None:
    """Fill the last contacts from glued points, whose anchors go with their body.

    Args:
        glue: (k,) points.
        surface: of the film.
        lead: (bodies, 6), see `PosePrediction`.
        contacts: filled.
    """
    place = small_vector(3)
    for k in range(glue.point.shape[0]):
        p, b, e = glue.point[k], glue.body[0], contacts.body.shape[0] - glue.point.shape[0] + k
        for r in range(3):
            contacts.nodes[e, r], contacts.weights[e, r] = surface.nodes[p, r], surface.weights[p, r]
            contacts.normal[e, r] = 0.0
            place[r] = glue.position[b, r]
            for s in range(3):
                place[r] += glue.axes[b, 3 * r + s] * glue.place[k, s]
        for r in range(3):
            contacts.anchor[e, r] = place[r] + led(lead[b], place, r)
        for r in range(6):
            contacts.slots[e, r] = surface.slots[p, r]
        contacts.offset[e], contacts.stiffness[e], contacts.friction[e] = 0.0, glue.stiffness, GLUED
        contacts.body[e] = b


@kernel
def fill_approach(contacts: ContactPlanes, velocity: Matrix, resolved: Vector, motions: BodyMotions) -> None:
    """Fill how fast point and body of each contact come on to each other before a step.

    Args:
        contacts: filled.
        velocity: (n, 3) [m/s], of the nodes.
        resolved: (bodies,) [m], infinite for bodies that no load moves: of these it stays zero.
        motions: of all bodies.
    """
    body, of = small_vector(6), -1
    for e in range(contacts.body.shape[0]):
        if contacts.shape[e] < 0 or not resolved[contacts.body[e]] < np.inf:
            continue
        if of != contacts.body[e]:
            of = contacts.body[e]
            fill_speed(motions, of, body)
        speed = 0.0
        for r in range(3):
            own = led(body, contacts.anchor[e], r)
            for a in range(3):
                own -= contacts.weights[e, a] * velocity[contacts.nodes[e, a], r]
            speed += contacts.normal[e, r] * own
        contacts.approach[e] = speed


@kernel
def recall(memory: ContactMemory, shapes: ShapeArrays, contacts: ContactPlanes) -> None:
    """Give contacts that pressed in the last tick their normal force, and anchor, which rides on its shape.

    Args:
        memory: of that tick.
        shapes: of the scene.
        contacts: filled.
    """
    for e in range(contacts.body.shape[0]):
        found = _place_of(contacts.key[e], memory.key) if contacts.shape[e] >= 0 else -1
        if found < 0:
            continue
        g = contacts.shape[e]
        contacts.friction[e] = shapes.friction[g] * memory.normal_force[found]
        for r in range(3):
            turned = 0.0
            for s in range(3):
                turned += shapes.rotation[g, r, s] * memory.offset[found, s]
            # a feature has moved under the film, whose point there is another one than before: the stretch
            # continues from where it was
            moved = contacts.carrier[e, r] - memory.place[found, r]
            before = contacts.carrier[e, r] if contacts.triangle[e] < 0 else contacts.anchor[e, r] + moved
            contacts.anchor[e, r] = turned + before


@device_function
def _add_load(part: float, force: Vector, place: Vector, loads: Vector) -> None:
    """Add part of a force at a place and its torque about the world's origin."""
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        loads[r] += part * force[r]
        loads[3 + r] += part * (place[s] * force[q] - place[q] * force[s])


@kernel
def conclude(x: Matrix, contacts: ContactPlanes, friction: Vector, bodies: ContactLoads) -> int:
    """Fill the loads of contacts on bodies at the end of a step.

    Args:
        x: (n, 3) [m], of the nodes then.
        contacts: of the step.
        friction: (g,), coefficients of the shapes.
        bodies: filled, but for the hit.

    Returns:
        Of how many contacts the law had to be evaluated, as the step's solution has not done it at its end.
    """
    evaluated, pressing, size, deepest = 0, 0, 0.0, 0.0
    bodies.loads[:], bodies.acting[:], bodies.held[:], bodies.pressing[:] = 0.0, 0, 0.0, 0.0
    bodies.film[:], bodies.figures[:4], bodies.figures[4] = 0.0, 0.0, -1.0
    for e in range(contacts.body.shape[0]):
        evaluated += evaluate_again(x, contacts, e)
        own, b, distance = contacts.gradient[e], contacts.body[e], contacts.distance[e]
        slack, push = contacts.friction[e], contacts.normal_force[e]
        if slack == GLUED:
            size += abs(own[0]) + abs(own[1]) + abs(own[2])
        else:
            slack = friction[contacts.shape[e]] * push
        bodies.held[b] += resting_stiffness(distance, contacts.stiffness[e], slack, contacts.widths)
        # a point that has just come off may still rub: friction is bounded by the last tick's normal force
        if own[0] != 0.0 or own[1] != 0.0 or own[2] != 0.0:
            bodies.acting[b] = 1
            _add_load(1.0, own, contacts.point[e], bodies.loads[b])
            for a in range(3):
                _add_load(contacts.weights[e, a], own, x[contacts.nodes[e, a]], bodies.film)
        if push > 0.0:
            bodies.figures[0] += push
            bodies.pressing[b] += push
            deepest = -distance if pressing == 0 else max(deepest, -distance)
            pressing += 1
    bodies.figures[1] = deepest
    bodies.film[6], bodies.film[7] = bodies.figures[0] + size, bodies.figures[0]
    return evaluated


@kernel
def see_hits(contacts: ContactPlanes, resolved: Vector, figures: Vector) -> None:
    """Take note of the contact that presses whose hit the step resolves least.

    Args:
        contacts: at the end of the step.
        resolved: (bodies,) [m], way of a body in a step with which that resolves a hit.
        figures: see `ContactLoads`; the hit is filled.
    """
    for e in range(contacts.body.shape[0]):
        body, speed = contacts.body[e], contacts.approach[e]
        if contacts.normal_force[e] > 0.0 and speed > 0.0:
            way = resolved[body]
            if figures[4] < 0.0 or speed * figures[3] > figures[2] * way:
                figures[2], figures[3], figures[4] = speed, way, body


@kernel
def remember(contacts: ContactPlanes, shapes: ShapeArrays, memory: ContactMemory) -> None:
    """Fill what the next tick knows of the contacts that press.

    Args:
        contacts: at the end of the step.
        shapes: of the scene.
        memory: with as many rows as contacts press, filled.
    """
    stretch, kept, width = small_vector(3), 0, contacts.widths[0]
    for e in range(contacts.body.shape[0]):
        if not contacts.normal_force[e] > 0.0:
            continue
        point, g = contacts.point[e], contacts.shape[e]
        for r in range(3):
            stretch[r] = point[r] - contacts.anchor[e, r]
        shorten(stretch, contacts.normal[e], contacts.widths[1])
        memory.key[kept], memory.normal_force[kept] = contacts.key[e], contacts.normal_force[e]
        memory.triangle[kept] = memory.face[kept] = contacts.triangle[e]
        if depth_of(contacts.distance[e], width) < width:  # what only brushes an edge may slip off it
            memory.triangle[kept] = -1
        for r in range(3):
            memory.place[kept, r], memory.offset[kept, r] = contacts.carrier[e, r], 0.0
            for s in range(3):
                behind = point[s] - contacts.carrier[e, s] if contacts.triangle[e] < 0 else 0.0
                memory.offset[kept, r] += shapes.rotation[g, s, r] * (behind - stretch[s])
        kept += 1


@kernel
def add_work(contacts: ContactPlanes, before: Matrix, x: Matrix, force: Matrix) -> float:
    """Return the contacts' work on the film in a step [J], by the mean of forces at its ends; keep the last.

    Args:
        contacts: at its end.
        before: (n, 3) [m], nodes at its beginning.
        x: (n, 3) [m], nodes at its end.
        force: (n, 3) [N], on the film at its beginning; overwritten with that at its end.
    """
    work = 0.0
    for i in range(force.shape[0]):
        for r in range(3):
            work += 0.5 * force[i, r] * (x[i, r] - before[i, r])
            force[i, r] = 0.0
    for e in range(contacts.body.shape[0]):
        for a in range(3):
            i = contacts.nodes[e, a]
            for r in range(3):
                share = contacts.weights[e, a] * contacts.gradient[e, r]
                force[i, r] -= share
                work -= 0.5 * share * (x[i, r] - before[i, r])
    return work


@device_function
def _about_center(load: Vector, center: Vector, r: int) -> float:
    """Return component r of a load (6,) about a centre, given about the world's origin."""
    if r < 3:
        return load[r]
    i, m = (r + 1) % 3, (r + 2) % 3
    return load[r] - (center[i] * load[m] - center[m] * load[i])


@kernel
def load_bodies(ends: ContactLoads, loads: BodyLoads, past: Matrix) -> None:
    """Let the contacts' loads act on bodies, see `Bodies.apply`.

    Args:
        ends: of the step.
        loads: filled.
        past: (bodies, 12), see `assume`; moved on.
    """
    for b in range(loads.loaded.shape[0]):
        if ends.acting[b] or loads.loaded[b]:
            for r in range(6):
                past[b, 6 + r] = past[b, r] if loads.loaded[b] else 0.0
                past[b, r] = loads.applied[b, r] if loads.loaded[b] else 0.0
            loads.loaded[b], loads.pressing[b] = ends.acting[b], ends.pressing[b]
            for r in range(6):
                loads.applied[b, r] = _about_center(ends.loads[b], loads.centers[b], r)
    for r in range(8):
        loads.transferred[r] = ends.film[r]


@kernel
def fill_borne(ends: ContactLoads, loads: BodyLoads, borne: Matrix) -> None:
    """Fill what bodies will bear (bodies, 6) about their centres, as `load_bodies` would have it.

    Args:
        ends: of the step.
        loads: that act now.
        borne: filled.
    """
    for b in range(loads.loaded.shape[0]):
        touched = ends.acting[b] or loads.loaded[b]
        for r in range(6):
            borne[b, r] = (
                _about_center(ends.loads[b], loads.centers[b], r) if touched else loads.applied[b, r]
            )


@kernel
def disagreement(
    ends: ContactLoads, loads: BodyLoads, assumed: Matrix, ahead: Indices, gives: Matrix, tolerance: float
) -> float:
    """Return how far free bodies go from where a step has met them, over what they may; infinite: not known.

    Args:
        ends: of the step.
        loads: that act.
        assumed: (bodies, 6), loads with which they were met.
        ahead: (bodies,), 1 for those that were met where they will be.
        gives: (bodies, 2) [1/N, 1/(N m)], by how much a body goes from where the film has met it for a change
            of its load in a tick, over what may be.
        tolerance: of the film's forces [N].
    """
    most = 0.0
    for b in range(loads.loaded.shape[0]):
        if ahead[b] <= 0 or not (ends.acting[b] or loads.loaded[b]):
            continue
        force = torque = 0.0
        for r in range(3):
            force += (ends.loads[b, r] - assumed[b, r]) ** 2
            torque += (_about_center(ends.loads[b], loads.centers[b], 3 + r) - assumed[b, 3 + r]) ** 2
        force, torque = math.sqrt(force), math.sqrt(torque)
        if gives[b, 0] * tolerance > EXACTLY and force + torque > 0.0:  # as where it is not known
            return np.inf
        most = max(most, gives[b, 0] * force, gives[b, 1] * torque)
    return most


@kernel
def farthest_led(lead: Matrix, before: Matrix, centers: Matrix, ahead: Indices, lever: float) -> float:
    """Return how far [m] a body is at most from where it was met.

    Args:
        lead: (bodies, 6), see `PosePrediction`.
        before: (bodies, 6), with which they were.
        centers: (bodies, 3) [m], of their masses.
        ahead: (bodies,), 1 for those that count.
        lever: at which angles count as ways [m].
    """
    away, way = 0.0, small_vector(6)
    for b in range(ahead.shape[0]):
        if ahead[b] > 0:
            for r in range(6):
                way[r] = lead[b, r] - before[b, r]
            for r in range(3):
                away = max(away, abs(led(way, centers[b], r)), lever * abs(way[3 + r]))
    return away


@kernel
def fastest_touched(
    planes: ContactPlanes,
    motions: BodyMotions,
    movable: Indices,
    loaded: Indices,
    x: Matrix,
    velocity: Matrix,
) -> float:
    """Return how fast [m/s] the film comes on to bodies that can move, or loaded ones move on the flange.

    Args:
        planes: of the last step.
        motions: of all bodies.
        movable: (f,) bodies that can.
        loaded: (bodies,), 1 for those that bear a load of contact.
        x: (n, 3) [m], after a step.
        velocity: (n, 3) [m/s], then.
    """
    flange, body, point, own, most = small_vector(6), small_vector(6), small_vector(3), small_vector(3), 0.0
    fill_speed(motions, motions.flange, flange)
    for f in range(movable.shape[0]):
        b = movable[f]
        fill_speed(motions, b, body)
        for e in range(planes.body.shape[0]):
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
            most = max(most, approach, math.sqrt(square) if loaded[b] else 0.0)
    return most
