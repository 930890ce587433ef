"""CPU time of ticks of soft arms, moved by their flange: two motions."""

from __future__ import annotations

import time

import numpy as np

from cosim.base.frames import Pose, rotation_from_vector
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import StepOptions

STEP_S = 0.002
HANGING = Pose(np.diag([1.0, -1.0, -1.0]))

JERK_TICKS = 12
_SETTLE_TICKS = 20
_RAMP_Pa_s, _TURN_RAD, _TURN_S = 15e3, 0.8796, 2.5  # as the reference scenario inflates and turns


def jerk_times(body: SoftBody) -> list[float]:
    """Return the time [s] of each tick while the flange is jerked from rest and the pressure rises."""
    options = StepOptions(newton=NewtonOptions(reuse_max=6), damping_per_s=2.0)
    arm, times = SoftArm(body, HANGING, NewtonOptions(), options), []
    for k in range(1, JERK_TICKS + 1):
        swing = rotation_from_vector(np.array([0.0, 0.3 * np.sin(6.0 * k * STEP_S), 0.0]))
        times.append(_timed(arm, Pose(swing @ HANGING.rotation), 100.0 * k))
    return times


def motion_times(body: SoftBody, ticks: int) -> list[float]:
    """Return the time [s] of each tick as the flange begins to turn and the pressure to rise.

    Both at the reference scenario's rates and with its integrator, from the drawn shape, after a few ticks of
    rest. Ticks with buckles count as they come.
    """
    options = StepOptions(integrator="bdf2", newton=NewtonOptions(reuse_max=6), damping_per_s=2.0)
    arm, times = SoftArm(body, HANGING, NewtonOptions(), options), []
    for k in range(1, _SETTLE_TICKS + ticks + 1):
        since = max(0, k - _SETTLE_TICKS) * STEP_S
        angle = 0.5 * _TURN_RAD * (1.0 - np.cos(np.pi * since / _TURN_S))
        turn = rotation_from_vector(np.array([0.0, -angle, 0.0]))
        times.append(_timed(arm, Pose(turn @ HANGING.rotation), _RAMP_Pa_s * since))
    return times[_SETTLE_TICKS:]


def _timed(arm: SoftArm, flange: Pose, pressure_Pa: float) -> float:
    began = time.process_time()
    arm.advance(flange, Loads((pressure_Pa,), (0.0,) * len(arm.body.cables)), STEP_S)
    return time.process_time() - began
