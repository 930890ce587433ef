"""Joint motion that a plan requires of an arm, and remedies if it exceeds the limits. A phase that takes s
times as long passes the same joint angles with speeds of 1 / s and accelerations of 1 / s^2. A torque tau = g
+ d + i, of weight, viscous friction and inertia, becomes g + d / s + i / s^2. Dry friction is part of g, as
it does not depend on the speed. A reference that jumps has no duration: it needs a smooth ramp, whose length
follows from the same rules.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.plan.arm_limits import ArmLimits, Extreme, PathClearances, PlannedArm
from cosim.plan.joint_path import JointReference
from cosim.plan.plan import PhasePlan, Plan
from cosim.plan.ramp import progress

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.scene import RigidScene

_FEWEST, _MOST, _PER_KNOT = 50, 1000, 2  # samples of a phase in which the arm moves
_INSIDE = 1e-9  # distance of the first sample from a phase's start, over its duration
_BETWEEN: Final = 1.02  # largest speed between samples over the largest speed at samples
_HALF: Final = 0.5  # of a limit: two smaller jumps at one instant stay within it


@final
@dataclass(frozen=True)
class RequiredMotion:
    """Joint motion that a plan requires, at n instants; at `jumps` the reference's speed or position jumps.

    Args:
        time_s: (n,), in order.
        phase: (n,) index.
        joints: n instants.
        jumps: (n,) bool; speed and acceleration are then those of a jump within a tick.
    """

    time_s: Array
    phase: IntArray
    joints: JointReference
    jumps: Mask


def planned_arm(
    arm: Arm,
    scene: RigidScene,
    plan: Plan,
    payload: Payload,
    clearances: PathClearances | None,
    *,
    dynamic: bool,
) -> PlannedArm:
    """Return the planned motion of an arm compared with its limits.

    Torques are those of the arm with a rigid payload, without jumps of the reference.

    Args:
        arm: of Pinocchio.
        scene: at its start.
        plan: of the run.
        payload: the soft robot in its drawn shape, and other mounted mass.
        clearances: along the motion; None: not checked.
        dynamic: whether the run is in time; if not, only positions and torques at rest are compared.
    """
    limits, names = ArmLimits.of(arm), tuple(planned.phase.name for planned in plan.phases)
    asked = required_motion(plan, scene.tick_s)
    q, v, a = asked.joints.position, asked.joints.velocity, asked.joints.acceleration
    moving, still = np.zeros_like(q), np.zeros(arm.joint_count)
    for k in range(len(q)):
        timed = dynamic and not asked.jumps[k]
        moving[k] = arm.inverse_dynamics(
            q[k], v[k] if timed else still, a[k] if timed else still, scene.armature, payload
        )
    values = {"position": q, "velocity": v, "acceleration": a, "torque": moving}
    asked_for = values if dynamic else {"position": q, "torque": moving}
    found = [limits.extreme(name, rows, asked.time_s, asked.phase) for name, rows in asked_for.items()]
    remedies = _Remedies(Dynamics(arm, limits, scene.armature, payload), plan, asked, scene.tick_s, dynamic)
    extremes = tuple(
        replace(each, remedy=remedies.of(each)) if each.beyond else each for each in found if each is not None
    )
    return PlannedArm(limits, extremes, clearances, names)


def required_motion(plan: Plan, tick_s: float) -> RequiredMotion:
    """Return the joint motion that a plan requires, at instants close enough to find the largest values.

    Args:
        plan: of a run.
        tick_s: within which a jump of the reference happens [s].
    """
    rows: list[tuple[Array, int, JointReference, bool]] = []
    began_s, here, speed = 0.0, plan.joints, np.zeros_like(plan.joints)
    for index, planned in enumerate(plan.phases):
        phase = planned.phase
        time_s, joints = _through(planned)
        first, last = joints.row(0), joints.row(-1)
        jump = JointReference(
            here, first.velocity + (first.position - here) / tick_s, (first.velocity - speed) / tick_s
        )
        rows.append((np.array([began_s]), index, jump, True))
        rows.append((began_s + time_s, index, joints, False))
        here, speed = planned.joints.last, last.velocity
        if phase.settle_s > 0.0:
            end_s = np.array([began_s + phase.duration_s])
            rows.append((end_s, index, JointReference(here, last.velocity, -speed / tick_s), True))
            speed = np.zeros_like(here)
        began_s += phase.duration_s + phase.settle_s
    return RequiredMotion(
        np.concatenate([time_s for time_s, _, _, _ in rows]),
        np.concatenate([np.full(len(time_s), index) for time_s, index, _, _ in rows]),
        JointReference(*(
            np.concatenate([np.atleast_2d(getattr(joints, name)) for _, _, joints, _ in rows])
            for name in ("position", "velocity", "acceleration")
        )),
        np.concatenate([np.full(len(time_s), jumps) for time_s, _, _, jumps in rows]),
    )  # fmt: skip


def _through(planned: PhasePlan) -> tuple[Array, JointReference]:
    """Return times (n,) within a phase, and the reference of the joints at these times."""
    phase, path = planned.phase, planned.joints
    count = 2
    if path.spline is not None:
        count = min(max(_FEWEST, _PER_KNOT * len(path.spline.x)), _MOST)
    time_s = phase.duration_s * np.clip(np.linspace(0.0, 1.0, count), _INSIDE, 1.0 - _INSIDE)
    return time_s, path.through([progress(phase.ramp, t, phase.duration_s) for t in time_s.tolist()])


@final
@dataclass(frozen=True)
class Dynamics:
    """Computes by which factor a motion must be slower for the limits of an arm.

    Args:
        arm: kinematics and inverse dynamics.
        limits: of it.
        armature: (joints,) [kg m^2].
        payload: see `planned_arm`.
    """

    arm: Arm
    limits: ArmLimits
    armature: Array
    payload: Payload

    def slower(self, quantity: str, asked: JointReference) -> float:
        """Return the factor on a motion's duration; infinite if weight alone is beyond a limit.

        Args:
            quantity: "velocity", "acceleration" or "torque".
            asked: n instants of it, without jumps.
        """
        if quantity == "torque":
            return max(map(self._for_torque, asked.position, asked.velocity, asked.acceleration), default=0.0)
        fraction = float((np.abs(getattr(asked, quantity)) / self.limits.bound(quantity)).max(initial=0.0))
        return fraction if quantity == "velocity" else math.sqrt(fraction)

    def _for_torque(self, position: Array, velocity: Array, acceleration: Array) -> float:
        """Return the largest root s of limit = g + d / s + i / s^2 of all joints."""
        torque = self.arm.inverse_dynamics(position, velocity, acceleration, self.armature, self.payload)
        weight, bound = self.arm.gravity_torque(position, self.payload), self.limits.torque
        weight = weight + self.arm.dry_friction(velocity)
        if (np.abs(weight) >= bound).any():
            return math.inf
        friction = self.arm.joint_damping * velocity
        inertia, roots = torque - weight - friction, np.zeros_like(weight)
        for way in (1.0, -1.0):  # at either bound
            room, linear = bound - way * weight, way * friction
            square = np.maximum(linear**2 + 4.0 * room * way * inertia, 0.0)
            roots = np.maximum(roots, (linear + np.sqrt(square)) / (2.0 * room))
        return float(roots.max(initial=0.0))


@final
@dataclass(frozen=True)
class _Remedies:
    """Finds changes of a plan that keep it within the limits.

    Args:
        dynamics: of the arm.
        plan: of the run.
        asked: by it.
        tick_s: within which a jump of the reference happens [s].
        dynamic: whether the motion takes time.
    """

    dynamics: Dynamics
    plan: Plan
    asked: RequiredMotion
    tick_s: float
    dynamic: bool

    def of(self, extreme: Extreme) -> str:
        """Return text, to follow that of a value beyond its limit, on the remedy; empty if unknown."""
        if extreme.quantity == "position" or not math.isfinite(extreme.excess):
            return ""
        asked, here = self.asked, self.asked.phase == extreme.phase
        if extreme.quantity != "torque" and (asked.jumps & here & (asked.time_s == extreme.time_s)).any():
            return self._smooth(extreme)
        within = np.flatnonzero(here & ~asked.jumps)
        times = math.inf
        if self.dynamic:
            times = self.dynamics.slower(extreme.quantity, asked.joints.some(within[0], within[-1] + 1))
        if not math.isfinite(times):
            return "; weight alone exceeds the bound: bring the flange closer in, or make the load lighter"
        return f"; {_longer(self.plan.phases[extreme.phase], math.ceil(10.0 * _BETWEEN * times) / 10.0)}"

    def _smooth(self, extreme: Extreme) -> str:
        """Return text on the phases that need a smooth ramp, so that the reference does not jump."""
        planned = self.plan.phases[extreme.phase]
        around = [planned]
        if extreme.phase and not self.plan.phases[extreme.phase - 1].phase.settle_s:
            around.insert(0, self.plan.phases[extreme.phase - 1])
        jumping = [each for each in around if self._jumps(each)] or [planned]
        return "; " + ", and ".join(map(self._with_ramp, jumping))

    def _jumps(self, planned: PhasePlan) -> bool:
        """Return whether a phase begins or ends with a jump of the reference."""
        if planned.joints.spline is None or planned.phase.ramp == "step":
            return planned.joints.spline is not None
        jump = np.abs(_through(planned)[1].velocity[[0, -1]]) / self.tick_s
        return bool((jump > _HALF * self.dynamics.limits.acceleration).any())

    def _with_ramp(self, planned: PhasePlan) -> str:
        """Return text on the smooth ramp that a phase needs, and its duration."""
        phase, rule = planned.phase, self.dynamics.slower
        if phase.flange_shake is not None:
            return f"put the shift of phase '{phase.name}' into a separate phase, with ramp = \"smooth\""
        asked = planned.joints.through([progress("smooth", t, 1.0) for t in np.linspace(0.0, 1.0, _FEWEST)])
        needs = [rule(name, asked) for name in ("velocity", "acceleration", "torque")]
        least_s = _BETWEEN * max(each for each in needs if math.isfinite(each))
        text = f"give phase '{phase.name}' ramp = \"smooth\""
        if phase.duration_s >= least_s:
            return text
        return f"{text} and a duration_s of at least {math.ceil(100.0 * least_s) / 100.0:g}"


def _longer(planned: PhasePlan, times: float) -> str:
    """Return text on how a phase takes `times` as long."""
    phase = planned.phase
    name = f"phase '{phase.name}'"
    if phase.tip_path is not None:
        return f"divide speed_m_s of the tip_path of {name} by {times:g}, and multiply its ramp_s by as much"
    text = f"give {name} at least {times:g} times its duration_s"
    if phase.flange_shake is None:
        return text
    return f"{text}, and divide frequency_Hz of its flange_shake by as much"
