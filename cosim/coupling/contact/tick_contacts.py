"""What contact with the scene adds to a tick of a film or of a chain in a kernel, around its soft step."""

from __future__ import annotations

from typing import Any

from cosim.base.kernels import Matrix, copy_rows, device_function
from cosim.base.numba_insides import caller
from cosim.coupling.contact.contact_arrays import ASKS, LEFT, MET, REMEMBERED, UNKNOWN, ContactArrays
from cosim.coupling.contact.contact_kernels import SETTLE_TOUCHED, settle_touched

_settle_touched = caller(settle_touched)


@device_function
def may_give_way(contact: ContactArrays, found: int) -> int:
    """Return 1 if a body is near that may give way, 2 if how it does is not known of one that is loaded."""
    bodies, body, near = contact.bodies, contact.touched.planes.body, 0
    for e in range(found):
        b = body[e]
        if bodies.leads.ahead[b] > 0:
            unknown = contact.gives[b, 0] == UNKNOWN or contact.counts[MET] >= contact.numbers.renewed_after
            near = max(near, 2 if bodies.loaded[b] and unknown else 1)
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
    if found == 0 and not contact.counts[LEFT]:
        return False
    _settle_touched(contact.calls[SETTLE_TOUCHED], (at, *moved))
    ticks.contacts[k] = contact.counts[REMEMBERED]
    ticks.contact[k, 0], ticks.contact[k, 1] = contact.end.figures[0], contact.end.figures[1]
    ticks.work[k, 0] = contact.end.figures[2]
    copy_rows(contact.end.loads, ticks.body_force[k])
    return contact.counts[ASKS] != 0
