"""How far bodies will be ahead of where MuJoCo has them, by its own steps.

A tick of one step: the accelerations under the loads that act, with all that touches and holds bodies now. A
tick of several: these steps themselves, in a second state of the scene, so contacts that come about within
the tick count, and servos continue at the speed that they were asked for last.
"""

from typing import Any

from cosim.base.kernel_types import Indices
from cosim.base.kernels import copy, device_function, kernel, small_vector
from cosim.base.numba_insides import call_native
from cosim.coupling.contact.contact_arrays import Leads, fill_speed, fill_velocity
from cosim.rigid.scene.bodies import ACCELERATE, CONSTRAIN, REBEGIN, REFACTORISE, REFINISH, VELOCITIES


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
