"""The answer of film and contacts to small motions of a touched body, against repeated steps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.base.frames import Array
from cosim.coupling.contact.levers import Levers, rigid_motions
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.solve.step_scheme import Integrator, StepAccuracy
from tests.coupling.pads import Grasp

TICK_S, NUDGE_m = 1e-3, 1e-7
CLOSELY = StepAccuracy(1e-9)


def loads_after(grasp: Grasp, planes: ContactPlanes, motion: Array) -> Array:
    """Return what a step to given planes answers on the cube (6,); arms are those of `motion`."""
    soft = grasp.soft
    soft.advance_accurately(grasp.flange, replace(grasp.loads, contact=planes), TICK_S, CLOSELY)
    return np.asarray(-np.einsum("kri,kr->i", motion, planes.at(soft.state.positions).force))


@pytest.mark.parametrize("integrator", ["implicit_euler", "bdf2"])
def test_the_stiffness_is_what_repeated_steps_show(integrator: Integrator) -> None:
    grasp = Grasp(0.01, TICK_S, light=False, integrator=integrator)
    for _ in range(10):
        grasp.tick()
    soft, exchange, before = grasp.soft, grasp.exchange, grasp.soft.state
    planes = exchange.find(before, TICK_S)
    assert planes is not None
    center = grasp.cube_position
    loads_after(grasp, planes, rigid_motions(np.zeros((len(planes.nodes), 3)), center))
    x = soft.state.positions
    motion = rigid_motions(planes.at(x).point, center)
    levers = Levers.of(planes, np.unique(planes.body), center[None], x)
    stiffness = levers.stiffness(planes, planes.at(x).tangent, soft, TICK_S)
    found = np.empty((6, 6))
    for j in range(6):
        sides = []
        for nudge in (NUDGE_m, -NUDGE_m):
            soft.restore(before)
            moved = nudge * motion[:, :, j]
            along = np.einsum("kr,kr->k", planes.normal, moved)
            moved_on = planes.changed(offset=planes.offset + along, anchor=planes.anchor + moved)
            sides.append(loads_after(grasp, moved_on, motion))
        found[:, j] = (sides[0] - sides[1]) / (2.0 * NUDGE_m)
    # the step is solved to 1e-9 N; inertia weighed by another scheme would be off by more than the force
    for rows in (slice(0, 3), slice(3, 6)):
        for columns in (slice(0, 3), slice(3, 6)):
            there = found[rows, columns]
            assert -stiffness[rows, columns] == pytest.approx(there, abs=1e-3 * np.abs(there).max())
    assert stiffness == pytest.approx(stiffness.T, abs=1e-9 * np.abs(stiffness).max())
