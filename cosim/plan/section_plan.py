"""Whether a plan's motion of the flange stays within the range of a section model, before anything runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import ConvergenceError
from cosim.plan.decision import SECTION_RANGE, Decision
from cosim.plan.plan import PhasePlan, Plan, start_equilibrium
from cosim.plan.ramp import progress
from cosim.plan.robot_command import CommandRamp, loads_of
from cosim.soft.body.loads import Loads

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm

_SAMPLES = 41  # of a phase
_SLOW = 0.1  # share of gravity below which an acceleration bends no arm out of its range
_SWING = 2.0  # an arm that is accelerated suddenly swings twice as far as it would rest


def section_range(arm: Arm, plan: Plan, make_soft: Callable[[], SoftSide]) -> Decision:
    """Return whether the soft arm bears what each phase's largest acceleration of the flange asks.

    Gravity is replaced by g - 2 a where the flange's acceleration a is largest, and the equilibrium is
    followed there: as far as an arm swings that is accelerated suddenly. How long a lasts is not in this.

    Args:
        arm: kinematics.
        plan: of the run.
        make_soft: makes a soft side at its start.
    """
    for planned in plan.phases:
        found = _largest_acceleration(arm, planned, float(np.linalg.norm(plan.gravity)))
        if found is None:
            continue
        fraction, pose, acceleration = found
        loads = loads_of(CommandRamp(planned.begin, planned.end).at(fraction), plan.gravity)
        failure = _failure(make_soft(), pose, loads, acceleration)
        if failure is not None:
            size = float(np.linalg.norm(acceleration))
            reason = (
                f"phase '{planned.phase.name}' accelerates the flange by up to {size:.3g} m/s^2; at twice "
                f"that, as far as an arm swings: {failure}; a longer duration_s, or fidelity = 'lumped'"
            )
            return Decision(SECTION_RANGE, False, reason, f"phase.{planned.phase.name}.duration_s")
    return Decision(SECTION_RANGE, True, "the arm bears twice each phase's largest acceleration", "fidelity")


def _largest_acceleration(arm: Arm, planned: PhasePlan, gravity: float) -> tuple[float, Pose, Array] | None:
    """Return share of the ramp, pose of the flange and its acceleration (3,) [m/s^2] where that is largest.

    None where it is small, or a step, which has none.
    """
    phase, path = planned.phase, planned.joints
    if path.spline is None or phase.ramp == "step":
        return None
    times = np.linspace(0.0, phase.duration_s, _SAMPLES)
    fractions = [progress(phase.ramp, t, phase.duration_s) for t in times]
    poses = [arm.forward(path.at(fraction).position) for fraction in fractions]
    x = np.array([pose.translation for pose in poses])
    second = np.diff(x, n=2, axis=0) / (times[1] - times[0]) ** 2
    worst = int(np.argmax(np.linalg.norm(second, axis=1)))
    if float(np.linalg.norm(second[worst])) < _SLOW * gravity:
        return None
    return fractions[worst + 1].value, poses[worst + 1], second[worst]


def _failure(soft: SoftSide, pose: Pose, loads: Loads, acceleration: Array) -> str | None:
    """Return why there is no rest under an acceleration (3,) [m/s^2] of the flange; None where there is."""
    try:
        here = start_equilibrium(soft, pose, loads)
    except ConvergenceError:
        return None  # the static plan has its own word on that
    x, y, z = (np.array(loads.gravity) - _SWING * acceleration).tolist()
    try:
        soft.follow(here, pose, replace(loads, gravity=(x, y, z)))
    except ConvergenceError as error:
        return str(error)
    return None
