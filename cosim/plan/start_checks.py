"""Checks of an arm at the start of a run: its links do not penetrate other bodies, and its joints bear its
weight and payload.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.base.solid import LinkContact
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.errors import ScenarioError
from cosim.plan.joint_path import JointPath
from cosim.plan.planning import JointPlanner
from cosim.plan.tip_paths import AnyFlangeMotion
from cosim.soft.body.body import SoftBody

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm, Payload
    from cosim.rigid.scene.scene import RigidScene

_STANDS_IN_M = 1e-3  # depth up to which an overlap counts as touching
_SAME_rad = 1e-3  # difference of joint angles within one configuration


def drawn_payload(body: SoftBody, mounted: MassProperties | None) -> Payload:
    """Return a soft robot in its drawn shape, with other mounted mass (flange frame), as a rigid payload."""
    from cosim.kinematics.arm import Payload  # imported here so that no arm means no Pinocchio

    mass = MassProperties.of(body.node_mass, body.positions)
    if mounted is not None:
        mass = mass.joined(mounted)
    return Payload(mass.mass_kg, mass.center, mass.inertia)


def checked_start(plan_joints: JointPlanner, arm: Arm, scene: RigidScene, payload: Payload) -> JointPlanner:
    """Return a planner of joint paths that also checks the start, see `check_start`.

    Args:
        plan_joints: returns the joint paths.
        arm: of Pinocchio.
        scene: at its start.
        payload: see `planned_arm`.
    """

    def plan(start: Pose, ways: list[AnyFlangeMotion], blame: Callable[[int], str]) -> tuple[JointPath, ...]:
        paths = plan_joints(start, ways, blame)
        check_start(arm, scene, payload, paths[0].first, blame(-1))
        return paths

    return plan


def check_start(arm: Arm, scene: RigidScene, payload: Payload, joints: Array, key: str) -> None:
    """Check an arm at the start of a run.

    Args:
        arm: of Pinocchio.
        scene: at its start.
        payload: see `planned_arm`.
        joints: (joints,) [rad].
        key: of the scenario, for messages.

    Raises:
        ScenarioError: a link penetrates a body, or a joint needs more than its torque limit.
    """
    check_no_overlap(touched_by_links(scene, joints), key)
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
    """Return the contacts of an arm's links at joint angles (joints,) [rad], without those with other arms.

    The start of other arms is known only after all have been planned.
    """
    return [one for one in scene.links.at(joints) if not one.other.startswith(scene.other_arms)]


def is_clear_at_start(scene: RigidScene, paths: Sequence[JointPath]) -> bool:
    """Return whether no link penetrates a body at the start of joint paths; see `check_no_overlap`."""
    return not _overlaps(touched_by_links(scene, paths[0].first))


def avoided_start(scene: RigidScene, begins: Array, nearest: Array) -> str:
    """Return the overlaps at the start configuration nearest to home, as text; empty if the arm starts there.

    Args:
        scene: with the arm.
        begins: (joints,) [rad].
        nearest: (joints,) [rad], the configuration nearest to the arm's home.
    """
    if np.abs(begins - nearest).max() <= _SAME_rad:
        return ""
    return _overlaps(touched_by_links(scene, nearest))


def _overlaps(contacts: Sequence[LinkContact]) -> str:
    """Return text that lists overlaps of links with bodies; empty without any."""
    deep = [contact for contact in contacts if contact.depth_m > _STANDS_IN_M]
    return ", ".join(f"{c.link} {1e3 * c.depth_m:.0f} mm deep in {c.other}" for c in deep)


def check_no_overlap(contacts: Sequence[LinkContact], key: str) -> None:
    """Check that no link of an arm penetrates a body at the start.

    Args:
        contacts: of the links.
        key: of the scenario, for messages.

    Raises:
        ScenarioError: a link does.
    """
    if where := _overlaps(contacts):
        raise ScenarioError(
            key, f"the arm overlaps something: {where}; move the flange, the base of an arm or the objects"
        )


def check_base(scene: RigidScene, body: SoftBody, flange: Pose, depth_m: float) -> None:
    """Check that the base of a soft robot is not inside a fixed body.

    Args:
        scene: at its start.
        body: on the flange.
        flange: pose at the start, world from flange.
        depth_m: largest allowed depth.

    Raises:
        ScenarioError: a held node is deeper; contact would tear at the film next to it.
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
