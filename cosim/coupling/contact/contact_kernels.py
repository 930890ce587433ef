"""Kernels of a tick's contacts between film and scene: contact planes before the step, loads after it.

Contacts with light bodies are computed for their predicted poses, see `LightBodies`.
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

EXACTLY = 0.25  # fraction of the bodies' position tolerance that the film's residual may cause


@kernel
def predict_poses(
    geoms: GeomPoses, mass_center: Matrix, lead: Matrix, poses: ShapePoses, centers: Matrix
) -> None:
    """Fill the shapes' poses and the bodies' centres of mass: MuJoCo's, moved by the predicted displacement.

    Args:
        geoms: MuJoCo's poses.
        mass_center: (bodies, 3) [m], MuJoCo's.
        lead: (bodies, 6), displacement, see `PosePrediction`.
        poses: of the shapes, filled.
        centers: (bodies, 3) [m], filled.
    """
    for b in range(centers.shape[0]):
        for r in range(3):
            centers[b, r] = mass_center[b, r] + led(lead[b], mass_center[b], r)
    for g in range(geoms.geoms.shape[0]):
        geom = geoms.geoms[g]
        position, displacement, axes = geoms.places[geom], lead[geoms.body[g]], poses.rotation[g]
        for r in range(3):
            poses.position[g, r] = position[r] + led(displacement, position, r)
            for c in range(3):
                axes[r, c] = geoms.axes[geom, 3 * r + c]
        x, y, z = displacement[3], displacement[4], displacement[5]  # rotation vector
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
    """Return the largest speed [m/s] of a body that loads can move, relative to the flange.

    Args:
        motions: of all bodies.
        movable: (f,) bodies.
    """
    largest_square, flange, body = 0.0, small_vector(6), small_vector(6)
    fill_speed(motions, motions.flange, flange)
    for f in range(movable.shape[0]):
        b, square = movable[f], 0.0
        fill_speed(motions, b, body)
        for r in range(3):
            square += (led(body, motions.mass_center[b], r) - led(flange, motions.mass_center[b], r)) ** 2
        largest_square = max(largest_square, square)
    return math.sqrt(largest_square)


@kernel
def extrapolate_loads(loads: BodyLoads, past: Matrix, assumed: Matrix) -> None:
    """Fill the loads for which bodies' poses are predicted: the present ones, extrapolated.

    The last change is repeated times a fraction: the best one to get that change from the change before it.

    Args:
        loads: that act.
        past: (bodies, 12), loads one tick and two ticks before the present ones; zero where none acted.
        assumed: (bodies, 6), filled.
    """
    for b in range(loads.loaded.shape[0]):
        for first in range(0, 6, 3):
            along = square = 0.0
            for r in range(first, first + 3):
                before = past[b, r] - past[b, 6 + r]
                along += (loads.applied[b, r] - past[b, r]) * before
                square += before * before
            fraction = min(max(along / square, 0.0), 1.0) if loads.loaded[b] and square > 0.0 else 0.0
            for r in range(first, first + 3):
                assumed[b, r] = loads.applied[b, r] + fraction * (loads.applied[b, r] - past[b, r])


@device_function
def _index_of(number: int, ascending: Indices) -> int:
    """Return the index of a number in an ascending list, -1 if absent; numpy's takes 0.5 s to compile."""
    low, high = 0, ascending.shape[0]
    while low < high:
        middle = (low + high) // 2
        if ascending[middle] < number:
            low = middle + 1
        else:
            high = middle
    return low if low < ascending.shape[0] and ascending[low] == number else -1


@kernel
def fill_holding_triangles(memory: ContactMemory, listed: Indices, first_key: int, holding: Indices) -> None:
    """Fill the triangle that has held back each listed feature in the last tick.

    Args:
        memory: of the contacts that pressed.
        listed: (f,) features, ascending.
        first_key: key of the first feature.
        holding: (f,), filled with the triangle t; -2 - t for one that the feature only brushed; -1 for none.
    """
    for f in range(listed.shape[0]):
        holding[f] = -1
    for e in range(memory.key.shape[0]):
        if memory.face[e] >= 0:
            index = _index_of(memory.key[e] - first_key, listed)
            if index >= 0:
                holding[index] = memory.triangle[e] if memory.triangle[e] >= 0 else -2 - memory.face[e]


@kernel
def describe_points(
    hits: HitRows, positions: Matrix, surface: SurfaceArrays, shapes: ShapeArrays, contacts: ContactPlanes
) -> None:
    """Fill the first contacts from points of the film near shapes.

    Args:
        hits: (k,) such points.
        positions: (p, 3) [m], of all points.
        surface: of the film.
        shapes: of the scene.
        contacts: filled.
    """
    for e in range(hits.point.shape[0]):
        p, g, height = hits.point[e], hits.shape[e], 0.0
        for r in range(3):
            contacts.nodes[e, r], contacts.weights[e, r] = surface.nodes[p, r], surface.weights[p, r]
            contacts.normal[e, r], contacts.anchor[e, r] = hits.found[e, 1 + r], positions[p, r]
            contacts.carrier[e, r] = shapes.position[g, r]
            height += contacts.normal[e, r] * positions[p, r]
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
    """Fill contacts from features near the film, without their stiffness.

    Args:
        x: (n, 3) [m], of the nodes.
        near: (f,) such features.
        surface: of the film.
        shapes: of the scene.
        begin: index of the first of these contacts.
        contacts: filled.
    """
    first_key = shapes.body.shape[0] * surface.nodes.shape[0]
    for f in range(near.feature.shape[0]):
        e, t, height = begin + f, near.triangle[f], 0.0
        for k in range(6):
            contacts.slots[e, k] = surface.triangle_slots[t, k]
        for r in range(3):
            contacts.nodes[e, r], contacts.weights[e, r] = surface.triangles[t, r], near.weight[f, r]
            contacts.normal[e, r], contacts.carrier[e, r] = -near.gap[f, 1 + r], near.position[f, r]
            contacts.anchor[e, r] = 0.0
            for a in range(3):
                contacts.anchor[e, r] += near.weight[f, a] * x[surface.triangles[t, a], r]
            height += contacts.normal[e, r] * contacts.anchor[e, r]
        contacts.offset[e], contacts.body[e] = height - near.gap[f, 0], shapes.body[near.owner[f]]
        contacts.friction[e] = 0.0
        contacts.shape[e], contacts.key[e], contacts.triangle[e] = (
            near.owner[f],
            first_key + near.feature[f],
            t,
        )


@kernel
def describe_glue(glue: Glue, surface: SurfaceArrays, lead: Matrix, contacts: ContactPlanes) -> None:
    """Fill the last contacts from glued points, whose anchors move with their body.

    Args:
        glue: (k,) points.
        surface: of the film.
        lead: (bodies, 6), displacement, see `PosePrediction`.
        contacts: filled.
    """
    anchor = small_vector(3)
    for k in range(glue.point.shape[0]):
        p, b, e = glue.point[k], glue.body[0], contacts.body.shape[0] - glue.point.shape[0] + k
        for r in range(3):
            contacts.nodes[e, r], contacts.weights[e, r] = surface.nodes[p, r], surface.weights[p, r]
            contacts.normal[e, r] = 0.0
            anchor[r] = glue.position[b, r]
            for s in range(3):
                anchor[r] += glue.axes[b, 3 * r + s] * glue.anchor[k, s]
        for r in range(3):
            contacts.anchor[e, r] = anchor[r] + led(lead[b], anchor, r)
        for r in range(6):
            contacts.slots[e, r] = surface.slots[p, r]
        contacts.offset[e], contacts.stiffness[e], contacts.friction[e] = 0.0, glue.stiffness, GLUED
        contacts.body[e] = b


@kernel
def fill_approach(contacts: ContactPlanes, velocity: Matrix, resolved: Vector, motions: BodyMotions) -> None:
    """Fill the speed of approach of each contact's point and body before a step.

    Args:
        contacts: filled.
        velocity: (n, 3) [m/s], of the nodes.
        resolved: (bodies,) [m], infinite for bodies that no load moves: their contacts keep zero.
        motions: of all bodies.
    """
    twist, body = small_vector(6), -1
    for e in range(contacts.body.shape[0]):
        if contacts.shape[e] < 0 or not resolved[contacts.body[e]] < np.inf:
            continue
        if body != contacts.body[e]:
            body = contacts.body[e]
            fill_speed(motions, body, twist)
        speed = 0.0
        for r in range(3):
            relative = led(twist, contacts.anchor[e], r)
            for a in range(3):
                relative -= contacts.weights[e, a] * velocity[contacts.nodes[e, a], r]
            speed += contacts.normal[e, r] * relative
        contacts.approach[e] = speed


@kernel
def restore_memory(memory: ContactMemory, shapes: ShapeArrays, contacts: ContactPlanes) -> None:
    """Restore normal force and anchor of contacts that pressed in the last tick; anchors move with the shape.

    Args:
        memory: of that tick.
        shapes: of the scene.
        contacts: filled.
    """
    for e in range(contacts.body.shape[0]):
        index = _index_of(contacts.key[e], memory.key) if contacts.shape[e] >= 0 else -1
        if index < 0:
            continue
        g = contacts.shape[e]
        contacts.friction[e] = shapes.friction[g] * memory.normal_force[index]
        for r in range(3):
            turned = 0.0
            for s in range(3):
                turned += shapes.rotation[g, r, s] * memory.offset[index, s]
            # a feature has moved under the film and touches another point of it: the stretch continues from
            # its last value
            feature_motion = contacts.carrier[e, r] - memory.position[index, r]
            before = (
                contacts.carrier[e, r] if contacts.triangle[e] < 0 else contacts.anchor[e, r] + feature_motion
            )
            contacts.anchor[e, r] = turned + before


@device_function
def _add_load(weight: float, force: Vector, point: Vector, loads: Vector) -> None:
    """Add weight times a force at a point, and its torque about the world's origin."""
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        loads[r] += weight * force[r]
        loads[3 + r] += weight * (point[s] * force[q] - point[q] * force[s])


@kernel
def sum_contact_loads(x: Matrix, contacts: ContactPlanes, friction: Vector, bodies: ContactLoads) -> int:
    """Fill the loads of contacts on bodies at the end of a step.

    Args:
        x: (n, 3) [m], of the nodes then.
        contacts: of the step.
        friction: (g,), coefficients of the shapes.
        bodies: filled, without the hit.

    Returns:
        Number of contacts whose law had to be evaluated here, as the solver did not do it at x.
    """
    evaluated, pressing, size, deepest = 0, 0, 0.0, 0.0
    bodies.loads[:], bodies.touched[:], bodies.stiffness_trace[:], bodies.normal_force[:] = 0.0, 0, 0.0, 0.0
    bodies.film[:], bodies.figures[:4], bodies.figures[4] = 0.0, 0.0, -1.0
    for e in range(contacts.body.shape[0]):
        evaluated += evaluate_again(x, contacts, e)
        force, b, distance = contacts.gradient[e], contacts.body[e], contacts.distance[e]
        slack, push = contacts.friction[e], contacts.normal_force[e]
        if slack == GLUED:
            size += abs(force[0]) + abs(force[1]) + abs(force[2])
        else:
            slack = friction[contacts.shape[e]] * push
        bodies.stiffness_trace[b] += resting_stiffness(
            distance, contacts.stiffness[e], slack, contacts.widths
        )
        # a point that has just separated may still have friction: its bound is the last tick's normal force
        if force[0] != 0.0 or force[1] != 0.0 or force[2] != 0.0:
            bodies.touched[b] = 1
            _add_load(1.0, force, contacts.point[e], bodies.loads[b])
            for a in range(3):
                _add_load(contacts.weights[e, a], force, x[contacts.nodes[e, a]], bodies.film)
        if push > 0.0:
            bodies.figures[0] += push
            bodies.normal_force[b] += push
            deepest = -distance if pressing == 0 else max(deepest, -distance)
            pressing += 1
    bodies.figures[1] = deepest
    bodies.film[6], bodies.film[7] = bodies.figures[0] + size, bodies.figures[0]
    return evaluated


@kernel
def find_worst_hit(contacts: ContactPlanes, resolved: Vector, figures: Vector) -> None:
    """Fill the hit that the step resolves worst, of the contacts that press.

    Args:
        contacts: at the end of the step.
        resolved: (bodies,) [m], largest motion of a body in a step for which its hits are resolved.
        figures: see `ContactLoads`; the hit is filled.
    """
    for e in range(contacts.body.shape[0]):
        body, speed = contacts.body[e], contacts.approach[e]
        if contacts.normal_force[e] > 0.0 and speed > 0.0:
            resolved_motion = resolved[body]
            if figures[4] < 0.0 or speed * figures[3] > figures[2] * resolved_motion:
                figures[2], figures[3], figures[4] = speed, resolved_motion, body


@kernel
def fill_memory(contacts: ContactPlanes, shapes: ShapeArrays, memory: ContactMemory) -> None:
    """Fill the memory of the contacts that press, for the next tick.

    Args:
        contacts: at the end of the step.
        shapes: of the scene.
        memory: with as many rows as contacts press, filled.
    """
    stretch, m, width = small_vector(3), 0, contacts.widths[0]
    for e in range(contacts.body.shape[0]):
        if not contacts.normal_force[e] > 0.0:
            continue
        point, g = contacts.point[e], contacts.shape[e]
        for r in range(3):
            stretch[r] = point[r] - contacts.anchor[e, r]
        shorten(stretch, contacts.normal[e], contacts.widths[1])
        memory.key[m], memory.normal_force[m] = contacts.key[e], contacts.normal_force[e]
        memory.triangle[m] = memory.face[m] = contacts.triangle[e]
        if depth_of(contacts.distance[e], width) < width:  # a feature that only brushes an edge may slip off
            memory.triangle[m] = -1
        for r in range(3):
            memory.position[m, r], memory.offset[m, r] = contacts.carrier[e, r], 0.0
            for s in range(3):
                behind = point[s] - contacts.carrier[e, s] if contacts.triangle[e] < 0 else 0.0
                memory.offset[m, r] += shapes.rotation[g, s, r] * (behind - stretch[s])
        m += 1


@kernel
def add_work(contacts: ContactPlanes, before: Matrix, x: Matrix, force: Matrix) -> float:
    """Return the contacts' work on the film in a step [J], by the mean of the forces at start and end.

    Args:
        contacts: at the end of the step.
        before: (n, 3) [m], nodes at the start.
        x: (n, 3) [m], nodes at the end.
        force: (n, 3) [N], contact forces on the film at the start; overwritten with those at the end.
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
                push = contacts.weights[e, a] * contacts.gradient[e, r]
                force[i, r] -= push
                work -= 0.5 * push * (x[i, r] - before[i, r])
    return work


@device_function
def _about_center(load: Vector, center: Vector, r: int) -> float:
    """Return component r, about a centre, of a load (6,) about the world's origin."""
    if r < 3:
        return load[r]
    i, m = (r + 1) % 3, (r + 2) % 3
    return load[r] - (center[i] * load[m] - center[m] * load[i])


@kernel
def load_bodies(ends: ContactLoads, loads: BodyLoads, past: Matrix) -> None:
    """Apply the contacts' loads to bodies, see `Bodies.apply`.

    Args:
        ends: loads of contacts at the end of the step.
        loads: filled.
        past: (bodies, 12), see `extrapolate_loads`; advanced by one tick.
    """
    for b in range(loads.loaded.shape[0]):
        if ends.touched[b] or loads.loaded[b]:
            for r in range(6):
                past[b, 6 + r] = past[b, r] if loads.loaded[b] else 0.0
                past[b, r] = loads.applied[b, r] if loads.loaded[b] else 0.0
            loads.loaded[b], loads.normal_force[b] = ends.touched[b], ends.normal_force[b]
            for r in range(6):
                loads.applied[b, r] = _about_center(ends.loads[b], loads.centers[b], r)
    for r in range(8):
        loads.transferred[r] = ends.film[r]


@kernel
def fill_next_loads(ends: ContactLoads, loads: BodyLoads, borne: Matrix) -> None:
    """Fill the loads that `load_bodies` would apply to bodies, about their centres.

    Args:
        ends: loads of contacts at the end of the step.
        loads: that act now.
        borne: (bodies, 6), filled.
    """
    for b in range(loads.loaded.shape[0]):
        touched = ends.touched[b] or loads.loaded[b]
        for r in range(6):
            borne[b, r] = (
                _about_center(ends.loads[b], loads.centers[b], r) if touched else loads.applied[b, r]
            )


@kernel
def mismatch(
    ends: ContactLoads,
    loads: BodyLoads,
    assumed: Matrix,
    ahead: Indices,
    compliance: Matrix,
    tolerance: float,
) -> float:
    """Return the largest error of a predicted pose of a free body, relative to its tolerance; inf if unknown.

    Args:
        ends: loads of contacts at the end of the step.
        loads: that act.
        assumed: (bodies, 6), loads for which the poses were predicted.
        ahead: (bodies,), 1 for bodies with a predicted pose.
        compliance: (bodies, 2) [1/N, 1/(N m)], change of a body's pose in a tick per change of its load,
            relative to the tolerance.
        tolerance: of the film's forces [N].
    """
    largest_error = 0.0
    for b in range(loads.loaded.shape[0]):
        if ahead[b] <= 0 or not (ends.touched[b] or loads.loaded[b]):
            continue
        force = torque = 0.0
        for r in range(3):
            force += (ends.loads[b, r] - assumed[b, r]) ** 2
            torque += (_about_center(ends.loads[b], loads.centers[b], 3 + r) - assumed[b, 3 + r]) ** 2
        force, torque = math.sqrt(force), math.sqrt(torque)
        if compliance[b, 0] * tolerance > EXACTLY and force + torque > 0.0:  # too inexact to decide
            return np.inf
        largest_error = max(largest_error, compliance[b, 0] * force, compliance[b, 1] * torque)
    return largest_error


@kernel
def largest_pose_error(lead: Matrix, before: Matrix, centers: Matrix, ahead: Indices, lever: float) -> float:
    """Return the largest distance [m] between two predicted poses of a body.

    Args:
        lead: (bodies, 6), displacements, see `PosePrediction`.
        before: (bodies, 6), displacements for which contacts were computed.
        centers: (bodies, 3) [m], of the masses.
        ahead: (bodies,), 1 for bodies with a predicted pose.
        lever: length by which angles are converted to distances [m].
    """
    largest, difference = 0.0, small_vector(6)
    for b in range(ahead.shape[0]):
        if ahead[b] > 0:
            for r in range(6):
                difference[r] = lead[b, r] - before[b, r]
            for r in range(3):
                turn = lever * abs(difference[3 + r])
                largest = max(largest, abs(led(difference, centers[b], r)), turn)
    return largest


@kernel
def fastest_touched(
    planes: ContactPlanes,
    motions: BodyMotions,
    movable: Indices,
    loaded: Indices,
    x: Matrix,
    velocity: Matrix,
) -> float:
    """Return the largest speed [m/s] at which the film approaches movable bodies.

    The speed of loaded bodies relative to the flange counts as well.

    Args:
        planes: of the last step.
        motions: of all bodies.
        movable: (f,) bodies that loads can move.
        loaded: (bodies,), 1 for bodies with a contact load.
        x: (n, 3) [m], after a step.
        velocity: (n, 3) [m/s], then.
    """
    flange, body, point, film = small_vector(6), small_vector(6), small_vector(3), small_vector(3)
    fastest = 0.0
    fill_speed(motions, motions.flange, flange)
    for f in range(movable.shape[0]):
        b = movable[f]
        fill_speed(motions, b, body)
        for e in range(planes.body.shape[0]):
            if planes.body[e] != b:
                continue
            for r in range(3):
                point[r] = film[r] = 0.0
                for a in range(3):
                    weight, node = planes.weights[e, a], planes.nodes[e, a]
                    point[r] += weight * x[node, r]
                    film[r] += weight * velocity[node, r]
            approach, square = 0.0, 0.0
            for r in range(3):
                speed = led(body, point, r)
                approach -= planes.normal[e, r] * (film[r] - speed)
                square += (speed - led(flange, point, r)) ** 2
            fastest = max(fastest, approach, math.sqrt(square) if loaded[b] else 0.0)
    return fastest
