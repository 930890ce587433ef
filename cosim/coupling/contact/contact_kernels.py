"""The two kernels of a tick's contacts: what may be touched in it, and what was at its end."""

from __future__ import annotations

import numpy as np
from numba import void

from cosim.base.kernels import INTEGER, MATRIX, REAL, device_function, kernel, small_matrix, small_vector
from cosim.coupling.contact.contact_arrays import END, MEMORY, NEAR, SHAPES, SURFACE, TIES
from cosim.soft.contact.contact_law import shorten, touch
from cosim.soft.contact.obstacle_contact import PLANES


@device_function
def _find_key(keys, key):  # type: ignore[no-untyped-def]
    """Return where a key is among ascending ones, -1 if it is not there."""
    at = np.searchsorted(keys, key)
    return at if at < keys.shape[0] and keys[at] == key else -1


@device_function
def _take_point(e, places, near, surface, shapes, per_area, planes, ties):  # type: ignore[no-untyped-def]
    """Fill contact e from a point of the film; return its distance."""
    p, g = near.point[e], near.shape[e]
    for r in range(3):
        planes.nodes[e, r], planes.weights[e, r] = surface.nodes[p, r], surface.weights[p, r]
        planes.normal[e, r], planes.anchor[e, r] = near.normal[e, r], places[p, r]
        ties.carrier[e, r] = shapes.position[g, r]
    for k in range(6):
        planes.slots[e, k] = surface.slots[p, k]
    planes.stiffness[e] = per_area * surface.area[p]
    ties.shape[e], ties.key[e], ties.triangle[e] = g, g * surface.nodes.shape[0] + p, -1
    return near.distance[e]


@device_function
def _take_feature(e, f, x, near, surface, stiffness, first_key, planes, ties):  # type: ignore[no-untyped-def]
    """Fill contact e from the f-th feature near the film; return its distance."""
    t = near.triangle[f]
    for k in range(6):
        planes.slots[e, k] = surface.triangle_slots[t, k]
    for r in range(3):
        planes.nodes[e, r], planes.weights[e, r] = surface.triangles[t, r], near.weight[f, r]
        planes.normal[e, r], ties.carrier[e, r] = -near.film_normal[f, r], near.place[f, r]
        planes.anchor[e, r] = 0.0
        for a in range(3):
            planes.anchor[e, r] += near.weight[f, a] * x[surface.triangles[t, a], r]
    planes.stiffness[e] = stiffness
    ties.shape[e], ties.key[e], ties.triangle[e] = near.owner[f], first_key + near.feature[f], t
    return near.film_distance[f]


@kernel(void(MATRIX, MATRIX, NEAR, SURFACE, SHAPES, MEMORY, REAL, REAL, PLANES, TIES))
def describe(x, places, near, surface, shapes, memory, per_area, of_feature, planes, ties):  # type: ignore[no-untyped-def]
    """Fill tangent planes and what they are tied to, from nodes and contact points (p, 3) [m].

    What pressed in the last tick keeps its normal force, and its anchor, which rides on the shape.
    """
    points = near.point.shape[0]
    first_key = shapes.body.shape[0] * surface.nodes.shape[0]
    for e in range(ties.key.shape[0]):
        if e < points:
            distance = _take_point(e, places, near, surface, shapes, per_area, planes, ties)
        else:
            distance = _take_feature(e, e - points, x, near, surface, of_feature, first_key, planes, ties)
        g, height = ties.shape[e], 0.0
        for r in range(3):
            height += planes.normal[e, r] * planes.anchor[e, r]
        planes.offset[e], planes.friction[e], planes.body[e] = height - distance, 0.0, shapes.body[g]
        found = _find_key(memory.key, ties.key[e])
        if found < 0:
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


@device_function
def _add_load(part, force, place, loads):  # type: ignore[no-untyped-def]
    """Add part of a force at a place and its torque about the world's origin."""
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        loads[r] += part * force[r]
        loads[3 + r] += part * (place[s] * force[q] - place[q] * force[s])


@device_function
def _remember(e, kept, push, point, stretch, shapes, ties, on_film, memory):  # type: ignore[no-untyped-def]
    """Fill row `kept` of the memory from contact e, whose anchor is a stretch behind its point."""
    g = ties.shape[e]
    memory.key[kept], memory.normal_force[kept], memory.triangle[kept] = ties.key[e], push, ties.triangle[e]
    for r in range(3):
        memory.place[kept, r], memory.offset[kept, r] = ties.carrier[e, r], 0.0
        for s in range(3):
            behind = point[s] - ties.carrier[e, s] if on_film else 0.0
            memory.offset[kept, r] += shapes.rotation[g, s, r] * (behind - stretch[s])


@kernel(INTEGER(MATRIX, PLANES, TIES, INTEGER, SHAPES, REAL, REAL, MEMORY, END))
def conclude(x, planes, ties, points, shapes, width, stick, memory, end):  # type: ignore[no-untyped-def]
    """Fill what is left of contacts, the first `points` of them of film points; return how many press."""
    own, tangent, stretch = small_vector(3), small_matrix(3, 3), small_vector(3)
    kept = 0
    end.figures[0], end.figures[1] = 0.0, -np.inf
    end.loads[:], end.acting[:], end.held[:], end.film[:] = 0.0, 0, 0.0, 0.0
    for e in range(ties.key.shape[0]):
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
        slack = shapes.friction[ties.shape[e]] * push
        end.slack_friction[e] = slack
        pressing = planes.stiffness[e] * min(max((0.5 * width - distance) / width, 0.0), 1.0)
        end.held[b] += pressing + 4.0 * slack / stick
        # a point that has just come off may still rub: friction is bounded by the last tick's normal force
        if own[0] != 0.0 or own[1] != 0.0 or own[2] != 0.0:
            end.acting[b] = 1
            _add_load(1.0, own, point, end.loads[b])
            for a in range(3):
                _add_load(planes.weights[e, a], own, x[planes.nodes[e, a]], end.film)
        if push > 0.0:
            end.figures[0] += push
            end.figures[1] = max(end.figures[1], -distance)
            for r in range(3):
                stretch[r] = point[r] - anchor[r]
            shorten(stretch, n, stick)
            _remember(e, kept, push, point, stretch, shapes, ties, e < points, memory)
            if -distance < 0.5 * width:  # the law's transition: what only brushes an edge may slip off it
                memory.triangle[kept] = -1
            kept += 1
    if kept == 0:
        end.figures[1] = 0.0
    return kept
