"""What a plan asks of the arm, before anything runs: joints against their bounds, links against the scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.solid import LinkContact
from cosim.coupling.soft_sides.soft_side import MassProperties
from cosim.errors import ScenarioError
from cosim.plan.arm_limits import ArmLimits, PathClearances, PlannedArm
from cosim.plan.motion import JointPath, JointReference, progress
from cosim.plan.plan import PhasePlan, Plan
from cosim.plan.planning import AnyWay, JointPlanner
from cosim.soft.body.body import SoftBody

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.scene import RigidScene

_FEWEST, _MOST, _PER_KNOT = 50, 1000, 2  # samples of a phase in which the arm moves
_INSIDE = 1e-9  # share of a phase between its border and what counts as within
_STANDS_IN_M = 1e-3  # an arm that stands no deeper than this touches
_SAME_rad = 1e-3  # joints of one configuration


@final
@dataclass(frozen=True)
class AskedMotion:
    """What a plan asks of the joints at some instants; at `jumps` the reference's speed or place jumps.

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
    """Return what a plan asks of an arm.

    Torques are those of the arm with a rigid payload; jumps of the reference do not count in them.

    Args:
        arm: kinematics and inverse dynamics.
        scene: at its start.
        plan: of the run.
        payload: the soft robot in its drawn shape and what else is mounted.
        clearances: on that way; None where they are not looked at.
        dynamic: whether the motion takes time; positions and torques at rest otherwise.
    """
    limits, names = ArmLimits.of(arm), tuple(planned.phase.name for planned in plan.phases)
    asked = asked_motion(plan, scene.tick_s)
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
    return PlannedArm(limits, tuple(extreme for extreme in found if extreme is not None), clearances, names)


def asked_motion(plan: Plan, tick_s: float) -> AskedMotion:
    """Return what a plan asks of the joints, at instants close enough together to find the largest values.

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
    return AskedMotion(
        np.concatenate([time_s for time_s, _, _, _ in rows]),
        np.concatenate([np.full(len(time_s), index) for time_s, index, _, _ in rows]),
        JointReference(*(
            np.concatenate([np.atleast_2d(getattr(joints, name)) for _, _, joints, _ in rows])
            for name in ("position", "velocity", "acceleration")
        )),
        np.concatenate([np.full(len(time_s), jumps) for time_s, _, _, jumps in rows]),
    )  # fmt: skip


def _through(planned: PhasePlan) -> tuple[Array, JointReference]:
    """Return times (n,) within a phase, and what is asked for then."""
    phase, path = planned.phase, planned.joints
    count = 2
    if path.spline is not None:
        count = min(max(_FEWEST, _PER_KNOT * len(path.spline.x)), _MOST)
    time_s = phase.duration_s * np.clip(np.linspace(0.0, 1.0, count), _INSIDE, 1.0 - _INSIDE)
    return time_s, path.through([progress(phase.ramp, t, phase.duration_s) for t in time_s.tolist()])


def drawn_payload(body: SoftBody, mounted: MassProperties | None) -> Payload:
    """Return a soft robot in its drawn shape, and what else is mounted (flange frame), as a rigid payload."""
    from cosim.kinematics.arm import Payload  # here: a scene without an arm does not wait for Pinocchio

    mass = MassProperties.of(body.node_mass, body.positions)
    if mounted is not None:
        mass = mass.joined(mounted)
    return Payload(mass.mass_kg, mass.center, mass.inertia)


def checked_start(plan_joints: JointPlanner, arm: Arm, scene: RigidScene, payload: Payload) -> JointPlanner:
    """Return a planner that refuses a start at which the arm cannot stand.

    Args:
        plan_joints: finds the joint angles.
        arm: kinematics and inverse dynamics.
        scene: at its start.
        payload: see `planned_arm`.
    """

    def plan(start: Pose, ways: list[AnyWay], blame: Callable[[int], str]) -> tuple[JointPath, ...]:
        paths = plan_joints(start, ways, blame)
        check_start(arm, scene, payload, paths[0].first, blame(-1))
        return paths

    return plan


def check_start(arm: Arm, scene: RigidScene, payload: Payload, joints: Array, key: str) -> None:
    """Check that an arm can stand where it starts.

    Args:
        arm: kinematics and inverse dynamics.
        scene: at its start.
        payload: see `planned_arm`.
        joints: (joints,) [rad].
        key: to blame.

    Raises:
        ScenarioError: a link is in something, or a joint takes more torque than it can give.
    """
    check_stands(touched_by_links(scene, joints), key)
    torque, limit = arm.gravity_torque(joints, payload), arm.effort_limit
    beyond = [k for k in range(len(torque)) if abs(torque[k]) > limit[k] > 0.0]
    if beyond:
        needs = ", ".join(f"{arm.joint_names[k]} {abs(torque[k]):.0f} of {limit[k]:g} N m" for k in beyond)
        raise ScenarioError(
            key,
            f"the arm cannot hold itself and a payload of {payload.mass_kg:.3g} kg: {needs}; bring the "
            "flange closer in, or make the load lighter",
        )


def touched_by_links(scene: RigidScene, joints: Array) -> list[LinkContact]:
    """Return the contacts of an arm's links at joint angles (joints,), but those with other arms.

    Where other arms begin is known once all have been planned.
    """
    return [one for one in scene.links.at(joints) if not one.other.startswith(scene.other_arms)]


def stands_clear(scene: RigidScene, paths: Sequence[JointPath]) -> bool:
    """Return whether the links of an arm are in nothing where its joint paths begin; see `check_stands`."""
    return not _overlaps(touched_by_links(scene, paths[0].first))


def avoided_start(scene: RigidScene, begins: Array, nearest: Array) -> str:
    """Return in what links would be at the start nearest to home; empty for nothing, or if it begins there.

    Args:
        scene: with the arm.
        begins: (joints,) [rad].
        nearest: (joints,) [rad], the configuration nearest to the arm's home.
    """
    if np.abs(begins - nearest).max() <= _SAME_rad:
        return ""
    return _overlaps(touched_by_links(scene, nearest))


def _overlaps(contacts: Sequence[LinkContact]) -> str:
    """Return which links are in what, in words; empty if none is."""
    deep = [contact for contact in contacts if contact.depth_m > _STANDS_IN_M]
    return ", ".join(f"{c.link} {1e3 * c.depth_m:.0f} mm deep in {c.other}" for c in deep)


def check_stands(contacts: Sequence[LinkContact], key: str) -> None:
    """Check that links of an arm are in nothing, where it starts.

    Args:
        contacts: there.
        key: to blame.

    Raises:
        ScenarioError: a link is in something.
    """
    if where := _overlaps(contacts):
        raise ScenarioError(
            key, f"the arm overlaps something: {where}; move the flange, the base of an arm or the objects"
        )


def check_base(scene: RigidScene, body: SoftBody, flange: Pose, depth_m: float) -> None:
    """Check that the held end of a soft robot is not inside something that stands still.

    Args:
        scene: at its start.
        body: on the flange.
        flange: where it starts, world.
        depth_m: up to which it may be inside.

    Raises:
        ScenarioError: a held node is deeper; the film beside it could only be torn out of there.
    """
    query = scene.contact_query(fixed_only=True)
    hits = query.distances(flange.apply(body.positions[body.base]), -depth_m)
    if len(hits.distance):
        k = int(np.argmin(hits.distance))
        other = scene.body_names[int(query.body[hits.shape[k]])]
        raise ScenarioError(
            "start.flange",
            f"the soft robot's base stands {-1e3 * hits.distance[k]:.2f} mm deep in {other}; move the flange "
            "or the objects",
        )
