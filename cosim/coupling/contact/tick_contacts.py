"""What contact with the scene adds to a tick of a film or of a chain in a kernel, around its soft step.

Bodies that give way are met where they will be, see `LightBodies`. A film that has met them elsewhere may
follow: it meets them where its own load of that step takes them. That is repeated as long as it comes nearer
fast, as it does where something holds them, or they are heavy for the film.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernels import Matrix, address_of, copy_rows, device_function, kernel, record_at, small_vector
from cosim.base.numba_insides import caller
from cosim.coupling.contact.contact_arrays import (
    AGREED_M,
    ASKS,
    LEFT,
    MET,
    REMEMBERED,
    TOUCHES,
    TURN_LEVER_M,
    UNKNOWN,
    ContactArrays,
    led,
)
from cosim.coupling.contact.contact_kernels import (
    CALLED,
    FORESEE,
    bear,
    conclude,
    fastest_touched,
    find_touched,
    settle_touched,
)
from cosim.coupling.contact.foresight_kernels import foresee

FIND_TOUCHED, SETTLE_TOUCHED, MEET_TOUCHED, FASTEST, FOLLOW_TOUCHED = range(len(CALLED), len(CALLED) + 5)
"""Places of kernels in `ContactArrays.calls`."""
_EXACTLY: Final = 0.25  # share of what bodies may be off that the film's own residual may make
_foresee, _settle_touched = caller(foresee), caller(settle_touched)


def contact_calls() -> IntArray:
    """Return the addresses (9,) of the kernels of contact, for one another and for who takes a whole tick."""
    taken = *CALLED, find_touched, settle_touched, meet_touched, fastest_touched, follow_touched
    return np.array([address_of(called) for called in taken])


@device_function
def may_give_way(contact: ContactArrays, found: int) -> int:
    """Return 1 if a body is near that may give way, 2 if how it does is not known of one that is loaded."""
    bodies, body, near = contact.bodies, contact.touched.planes.body, 0
    for e in range(found):
        b = body[e]
        if bodies.leads.ahead[b] > 0:
            near = max(near, 2 if bodies.loaded[b] and contact.gives[b, 0] == UNKNOWN else 1)
    return near


@device_function
def _changed(contact: Any, b: int, first: int, again: bool) -> float:
    """Return by how much the force (first 0) or torque (3) on a body is another than it was met with."""
    load, center, square = contact.end.loads[b], contact.bodies.centers[b], 0.0
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        about = center[s] * load[q] - center[q] * load[s] if first else 0.0
        before = contact.met[b, 12 + first + r] if again else contact.bodies.applied[b, first + r]
        square += (load[first + r] - about - before) ** 2
    return math.sqrt(square)


@device_function
def _away(contact: Any, h: float) -> float:
    """Return how far [m] bodies go from where the film has met them under the loads at the end of a step."""
    end, bodies, met, away = contact.end, contact.bodies, contact.met, 0.0
    for b in range(bodies.loaded.shape[0]):
        for r in range(6):
            met[b, r], met[b, 6 + r] = bodies.applied[b, r], bodies.leads.lead[b, r]
        if bodies.leads.ahead[b] > 0 and (end.acting[b] or bodies.loaded[b]):
            bear(bodies, end.loads[b], b)
    _foresee(contact.calls[FORESEE], (bodies.leads, h))
    for b in range(bodies.loaded.shape[0]):
        for r in range(6):
            met[b, 12 + r], bodies.applied[b, r] = bodies.applied[b, r], met[b, r]
            met[b, r] = bodies.leads.lead[b, r] - met[b, 6 + r]
        if bodies.leads.ahead[b] > 0:
            for r in range(3):
                turned = TURN_LEVER_M * abs(met[b, 3 + r])
                away = max(away, abs(led(met[b], bodies.centers[b], r)), turned)
    return away


@kernel
def meet_touched(at: int, x: Matrix, tolerance: float, h: float, again: bool) -> float:
    """Return how far bodies go from where a step that ends at x (n, 3) [m] has met them, under its loads.

    Where free ones would not go too far, held ones do not; otherwise MuJoCo's next step is looked at.

    Args:
        at: address of the `ContactArrays`, whose end is filled.
        x: of the film's nodes.
        tolerance: of the film's forces [N].
        h: length of MuJoCo's step [s].
        again: whether the film has followed them in this tick.

    Returns:
        The distance over what may be, at most 1 if that is agreed; infinite where it is not known.
    """
    contact = record_at(at, ContactArrays)
    end, bodies, touched, most = contact.end, contact.bodies, 0, 0.0
    conclude(contact, x)
    for b in range(bodies.loaded.shape[0]):
        if bodies.leads.ahead[b] <= 0 or not (end.acting[b] or bodies.loaded[b]):
            continue
        force, torque = _changed(contact, b, 0, again), _changed(contact, b, 3, again)
        gives = contact.gives[b]
        if gives[0] * tolerance > _EXACTLY and force + torque > 0.0:  # as where it is not known
            return np.inf
        most = max(most, gives[0] * force, gives[1] * torque)
        touched = max(touched, end.acting[b])
    if not most <= 1.0:
        most = _away(contact, h) / AGREED_M
    if most <= 1.0:
        contact.counts[MET] += touched
    return most


@kernel
def follow_touched(at: int, x: Matrix) -> None:
    """Let contacts follow bodies to where they would go from where the film has met them, see `meet_touched`.

    Args:
        at: address of the `ContactArrays`.
        x: (n, 3) [m], of the film's nodes before the step.
    """
    contact = record_at(at, ContactArrays)
    planes, ties, bodies, point = contact.touched.planes, contact.ties, contact.bodies, small_vector(3)
    for e in range(contact.counts[TOUCHES]):
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
    for b in range(bodies.loaded.shape[0]):
        if bodies.leads.ahead[b] > 0:
            for r in range(3):
                point[r] = bodies.centers[b, r]
            for r in range(3):
                bodies.centers[b, r] += led(contact.met[b], point, r)


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
    if found == 0 and not contact.counts[LEFT]:
        return False
    _settle_touched(contact.calls[SETTLE_TOUCHED], (at, *moved))
    ticks.contacts[k] = contact.counts[REMEMBERED]
    ticks.contact[k, 0], ticks.contact[k, 1] = contact.end.figures[0], contact.end.figures[1]
    ticks.work[k, 0] = contact.end.figures[2]
    copy_rows(contact.end.loads, ticks.body_force[k])
    return contact.counts[ASKS] != 0 or contact.counts[MET] >= contact.numbers.renewed_after
