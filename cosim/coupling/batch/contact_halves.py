"""What contact with the scene is in a tick of a row: what `ContactExchange` does, in kernels."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernels import address_of, device_function, handing_on_views
from cosim.base.numba_insides import caller
from cosim.coupling.batch.contact_rows import AGE, ASKS, NEAR, POINTS, REMEMBERED, TOUCHES
from cosim.coupling.contact.contact_arrays import MemoryRows, NearPoints, Ties
from cosim.coupling.contact.contact_kernels import conclude, describe
from cosim.coupling.contact.film_search import find_near
from cosim.coupling.schemes.momentum_balance import LEVER_M, SMALLEST_N
from cosim.soft.contact.obstacle_contact import PlaneRows, TouchedPlanes

_CALLED = (find_near, describe, conclude)
_FIND, _DESCRIBE, _CONCLUDE = range(len(_CALLED))
_find_near, _describe, _conclude = map(caller, _CALLED)


def contact_calls() -> IntArray:
    """Return the addresses (3,) of the kernels of contact in a tick."""
    return np.array([address_of(called) for called in _CALLED])


@device_function
def momentum_error_of_bodies(applied, centers, loaded, handed):  # type: ignore[no-untyped-def]
    """Return how far what acts on touched bodies is from what was handed over, see `momentum_balance`."""
    largest = 0.0
    for r in range(3):
        i, m = (r + 1) % 3, (r + 2) % 3
        force, torque = 0.0, 0.0
        for b in range(loaded.shape[0]):
            if loaded[b]:
                load, center = applied[b], centers[b]
                force += load[r]
                torque += load[3 + r] + (center[i] * load[m] - center[m] * load[i])
        largest = max(largest, abs(handed[r] - force), abs(handed[3 + r] - torque) / LEVER_M)
    return largest / max(handed[6], SMALLEST_N)


@device_function
def _is_free_of_contact(counts, loaded, weighed):  # type: ignore[no-untyped-def]
    """Return whether nothing is left of contacts of ticks before."""
    if counts[REMEMBERED] > 0:
        return False
    left = 0
    for b in range(loaded.shape[0]):
        left += loaded[b]
    for f in range(weighed.shape[0]):
        left += weighed[f]
    return left == 0


@handing_on_views
def touched_planes(touched, count):  # type: ignore[no-untyped-def]
    """Return the first of some contacts."""
    p = touched.planes
    planes = PlaneRows(
        p.nodes[:count], p.weights[:count], p.slots[:count], p.normal[:count], p.offset[:count],
        p.stiffness[:count], p.friction[:count], p.anchor[:count], p.body[:count],
    )  # fmt: skip
    return TouchedPlanes(touched.call, planes, touched.widths, touched.own[:count], touched.pressing[:count])


@handing_on_views
def _first_ties(ties, count):  # type: ignore[no-untyped-def]
    return Ties(ties.shape[:count], ties.key[:count], ties.carrier[:count], ties.triangle[:count])


@device_function
def _hold_features(listed, first_key, counts, memory, held):  # type: ignore[no-untyped-def]
    """Fill which triangle has held each listed feature back until now."""
    for f in range(listed.shape[0]):
        held[f] = -1
    for e in range(counts[REMEMBERED]):
        if memory.triangle[e] >= 0:
            at = np.searchsorted(listed, memory.key[e] - first_key)
            if at < listed.shape[0] and listed[at] == memory.key[e] - first_key:
                held[at] = memory.triangle[e]


@device_function
def find_touched(contact, x, low, high, active, reach):  # type: ignore[no-untyped-def]
    """Fill what the film may touch in a step; return how much, -1 where the search is not for a row.

    Args:
        contact: filled.
        x: (n, 3) [m], before the step.
        low: (3,) [m], smallest coordinates of the film.
        high: (3,) [m], largest ones.
        active: (a,) shapes that may be near it.
        reach: bound on the distance [m].
    """
    numbers, search, points, features = contact.numbers, contact.search, 0, 0
    if active.shape[0] > 0:
        if not contact.there:
            return -1
        first_key = contact.shapes.body.shape[0] * search.surface.nodes.shape[0]
        _hold_features(search.lists.features, first_key, contact.counts, contact.memory, search.held)
        asked = x, low, high, active, reach, numbers.behind, search
        points, features = _find_near(contact.calls[_FIND], asked)
    count = points + features
    contact.counts[NEAR], contact.counts[POINTS], contact.counts[TOUCHES] = active.shape[0] > 0, points, count
    if count <= 0:
        free = _is_free_of_contact(contact.counts, contact.loaded, contact.weighed)
        return 0 if count == 0 and free else -1
    n, m, past = search.near, contact.counts[REMEMBERED], contact.memory
    near = NearPoints(
        n.point[:points], n.shape[:points], n.distance[:points], n.normal[:points], n.feature[:features],
        n.owner[:features], n.place[:features], n.triangle[:features], n.weight[:features],
        n.film_distance[:features], n.film_normal[:features],
    )  # fmt: skip
    before = MemoryRows(
        past.key[:m], past.normal_force[:m], past.offset[:m], past.place[:m], past.triangle[:m]
    )
    given = x, search.places, near, search.surface, contact.shapes, before
    stiffness = numbers.per_area, numbers.of_feature
    planes = touched_planes(contact.touched, count).planes
    _describe(contact.calls[_DESCRIBE], (*given, *stiffness, planes, _first_ties(contact.ties, count)))
    return count


@device_function
def _remember(memory, kept, pressing):  # type: ignore[no-untyped-def]
    """Take the contacts that press for those of the last tick."""
    for e in range(pressing):
        memory.key[e], memory.normal_force[e] = kept.key[e], kept.normal_force[e]
        memory.triangle[e] = kept.triangle[e]
        for r in range(3):
            memory.offset[e, r], memory.place[e, r] = kept.offset[e, r], kept.place[e, r]


@device_function
def _load_bodies(end, applied, centers, loaded):  # type: ignore[no-untyped-def]
    """Let the contacts' loads act on bodies, see `Bodies.apply`."""
    for b in range(loaded.shape[0]):
        if not (end.acting[b] or loaded[b]):
            continue
        loaded[b] = end.acting[b]
        load, center = end.loads[b], centers[b]
        for r in range(3):
            i, m = (r + 1) % 3, (r + 2) % 3
            applied[b, r] = load[r]
            # MuJoCo takes torques about the centre of mass
            applied[b, 3 + r] = load[3 + r] - (center[i] * load[m] - center[m] * load[i])


@device_function
def _asks_for_weighing(counts, numbers, held, loaded, free, touching, weighed):  # type: ignore[no-untyped-def]
    """Return whether `BodyMass` has to look at the bodies after a tick."""
    counts[AGE] += 1
    if counts[AGE] >= numbers.renewed_after:
        return True
    for f in range(free.shape[0]):
        body, before = free[f], touching[f]
        if (loaded[body] and before == 0.0) or (not loaded[body] and weighed[f]):
            return True
        if held[body] > numbers.renewed_above * before:
            return True
    return False


@device_function
def settle_touched(contact, count, x, ticks, k):  # type: ignore[no-untyped-def]
    """Take in the end of a step with contacts: what `ContactExchange.settle` does."""
    planes, widths = touched_planes(contact.touched, count).planes, contact.touched.widths
    ends = contact.counts[POINTS], contact.shapes, widths[0], widths[1], contact.kept, contact.end
    pressing = _conclude(contact.calls[_CONCLUDE], (x, planes, _first_ties(contact.ties, count), *ends))
    contact.counts[REMEMBERED] = pressing
    _remember(contact.memory, contact.kept, pressing)
    _load_bodies(contact.end, contact.applied, contact.centers, contact.loaded)
    for r in range(6):
        contact.handed[r] = contact.end.film[r]
    contact.handed[6] = contact.end.figures[0]
    ticks.contacts[k] = pressing
    for r in range(2):
        ticks.contact[k, r] = contact.end.figures[r]
    for b in range(contact.loaded.shape[0]):
        for r in range(3):
            ticks.body_force[k, b, r] = contact.end.loads[b, r]
    bodies = contact.loaded, contact.free, contact.touching, contact.weighed
    contact.counts[ASKS] = _asks_for_weighing(contact.counts, contact.numbers, contact.end.held, *bodies)
