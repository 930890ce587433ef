"""How stiffly a stack that is inflated resists being tilted."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from cosim.base.frames import Array, Pose, cross, rotation_from_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Clamp
from cosim.verification.support.open_specimen import OpenSpecimen

ANGLE_RAD: Final = math.radians(1.0)


def tilt_stiffness(sample: OpenSpecimen) -> float:
    """Return the moment over angle [N m/rad] of the upper ring, turned about x at the place it has.

    Raises:
        ConvergenceError: no equilibrium was found.
    """
    body, here = sample.body, sample.here
    assert here is not None
    x = here.state.positions
    clamp = Clamp.of_base(body).extended(body.tip, x, Pose())
    solver = EquilibriumSolver(
        NewtonSolver(SoftSystem(body), clamp.mask(body.nodes)), clamp, sample.solver.options
    )
    centre, state = x[body.tip].mean(axis=0), here.state
    loads = sample.loads(here.loads.pressures(1)[0], x)
    moments = []
    for angle in (0.0, 0.5 * ANGLE_RAD, ANGLE_RAD):
        turn = rotation_from_vector(np.array([angle, 0.0, 0.0]))
        turned = x.copy()
        turned[body.tip] = centre + (x[body.tip] - centre) @ turn.T
        solver.clamp = Clamp.of_base(body).extended(body.tip, turned, Pose())
        state = solver.solve(state, Pose(), loads).state
        moments.append(_moment(solver.solver.system, body, state.positions, centre))
    return float(moments[-1] - moments[0]) / ANGLE_RAD


def _moment(system: SoftSystem, body: SoftBody, positions: Array, centre: Array) -> float:
    """Return the moment [N m] about x that holds the upper ring, the caps' pressure taken off."""
    arm = positions[body.tip] - centre
    return float(cross(arm, system.gradient[body.tip])[:, 0].sum())
