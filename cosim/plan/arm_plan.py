"""Whether an arm can stand where a run begins: its links against the scene, its joints against its weight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.base.solid import LinkContact
from cosim.coupling.soft_sides.soft_side import MassProperties
from cosim.errors import ScenarioError
from cosim.plan.motion import JointPath
from cosim.plan.planning import AnyWay, JointPlanner
from cosim.soft.body.body import SoftBody

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.scene import RigidScene

_STANDS_IN_M = 1e-3  # an arm that stands no deeper than this touches
_SAME_rad = 1e-3  # joints of one configuration


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
