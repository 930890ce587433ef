"""The arm of a scenario and the scene around it, both engines checked against each other.

Whether MuJoCo and Pinocchio have the same arm: both are asked at random angles before anything runs.

Rigid objects of a scenario, and the palm of a soft robot, as the rigid side wants them.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, Final, final

import numpy as np

from cosim.base import arm_file, solid
from cosim.base.frames import Array, Mask, Pose
from cosim.base.kept_parts import KeptParts, name_of, stamps
from cosim.build.arms import cell_of, motion_of, placed_arm
from cosim.config.schema.objects import ObjectTable, SolidTable, mesh_path
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import ContactTable
from cosim.config.schema.soft_robot import PalmTable
from cosim.config.several_arms import of_arm
from cosim.config.toml.rules import Faults, errors_at
from cosim.coupling.soft_sides.soft_side import MassProperties
from cosim.errors import InputError, ScenarioError, SceneError
from cosim.kinematics.arm import Arm, Payload
from cosim.plan import asked_motion, clearance, motion, planning
from cosim.plan.arm_limits import PathClearances, PlannedArm
from cosim.plan.joint_planner import led_joints, nearest_start, plan_joints
from cosim.plan.plan import Plan
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import Geometry, Joint, PairFriction, SceneDescription, SceneObject
from cosim.rigid.scene.arms import SceneOfArms
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody

STATES: Final = 100
POSE_BOUND: Final = 1e-9
"""Of the flange's place [m] and of its turn, as a difference of rotation matrices."""

RELATIVE_BOUND: Final = 1e-6
"""Of the mass matrix and of the torques that hold the weight."""


def check_engines_agree(scene: RigidScene, arm: Arm, armature: Array, payload: Payload | None = None) -> None:
    """Check limits, then flange pose, mass matrix and gravity torque at random angles.

    M_ij may differ by 1e-6 sqrt(M_ii M_jj), torques by 1e-6 of the largest. What one link weighs more is felt
    by all joints before it, so the last joint that feels a difference is named.

    Args:
        scene: with the arm, MuJoCo's.
        arm: Pinocchio's.
        armature: (joints,) [kg m^2], as the arm's file has it.
        payload: what the scene has mounted on the flange.

    Raises:
        InputError: they differ; the message names a joint.
    """
    _check_limits(scene, arm)
    rng = np.random.default_rng(0)
    for _ in range(STATES):
        q = rng.uniform(*arm.drawn_from)
        here, pose = scene.dynamics.at(q), arm.forward(q)
        away = float(np.abs(here.flange.translation - pose.translation).max())
        turned = float(np.abs(here.flange.rotation - pose.rotation).max())
        if max(away, turned) > POSE_BOUND:
            places = np.abs(here.places - arm.joint_places(q)).max(axis=1) > POSE_BOUND
            _refuse(arm, places, f"the flange {1e3 * away:.3g} mm and {turned:.3g} apart", first=True)
        mass = arm.mass_matrix(q, payload) + np.diag(armature)
        scale = np.sqrt(np.diag(mass))
        excess = np.diag(np.abs(here.mass_matrix - mass) / np.outer(scale, scale))
        if (np.abs(here.mass_matrix - mass) > RELATIVE_BOUND * np.outer(scale, scale)).any():
            what = f"the mass matrix {excess.max():.3g} of its size apart"
            _refuse(arm, excess > RELATIVE_BOUND, what)
        torque = arm.gravity_torque(q, payload)
        apart = np.abs(here.gravity_torque - torque)
        if (bound := RELATIVE_BOUND * np.abs(torque).max()) < apart.max() > POSE_BOUND:
            _refuse(arm, apart > bound, f"the torque against gravity {apart.max():.3g} N m apart")


def _check_limits(scene: RigidScene, arm: Arm) -> None:
    lower, upper = scene.dynamics.limits
    effort = np.where(arm.effort_limit > 0.0, arm.effort_limit, np.inf)
    pairs = {
        "lower limits": (lower, arm.lower),
        "upper limits": (upper, arm.upper),
        "torque limits": (scene.effort_limit, effort),
    }
    for what, (one, other) in pairs.items():
        differs = ~np.isclose(one, other, rtol=RELATIVE_BOUND, atol=POSE_BOUND)
        if differs.any():
            k = int(np.argmax(differs))
            _refuse(arm, differs, f"{what} {one[k]:g} and {other[k]:g}", first=True)


def _refuse(arm: Arm, differs: Mask, what: str, *, first: bool = False) -> None:
    found = np.flatnonzero(differs)
    joint = arm.joint_names[int(found[0 if first else -1]) if len(found) else -1]
    raise InputError(
        f"arm {arm.name!r}: MuJoCo and Pinocchio read joint {joint!r}, or its links, differently: {what}"
    )


PALM_NAME = "palm"
_OF_A_SOLID = ("shape", "size_m", "position_m", "quaternion", "convex")


def rigid_object(entry: ObjectTable) -> SceneObject:
    """Return a scenario's object for the rigid scene."""
    with errors_at(f"object.{entry.name}"):
        return SceneObject(
            name=entry.name,
            mass_kg=entry.mass_kg or 0.0,
            rgba=entry.rgba,
            friction=entry.friction,
            parts=tuple(_object_geometry(part, entry) for part in entry.parts),
            joint=_joint(entry),
            inertia=entry.inertia_kg_m2,
            center_of_mass_m=entry.center_of_mass_m or (0.0, 0.0, 0.0),
            spin_friction_m=_spin_friction(entry),
            **_solid(entry),
        )


def pair_friction(contact: ContactTable) -> PairFriction:
    """Return how coefficients of friction make that of a pair."""
    pairs = tuple((*pair.between, pair.friction) for pair in contact.pairs)
    return PairFriction(contact.pair_friction, contact.film_friction, pairs)


def _spin_friction(entry: ObjectTable) -> tuple[float, float] | None:
    torsional, rolling = entry.torsional_friction_m, entry.rolling_friction_m
    return None if torsional is None and rolling is None else (torsional or 0.0, rolling or 0.0)


def _joint(entry: ObjectTable) -> Joint | None:
    if (hinge := entry.hinge) is not None:
        return Joint(
            "hinge", hinge.axis, hinge.anchor_m, hinge.parent, hinge.range_rad,
            hinge.damping_Nms, hinge.stiffness_Nm, hinge.friction_Nm,
        )  # fmt: skip
    if (slide := entry.slide) is not None:
        return Joint(
            "slide", slide.axis, entry.position_m, slide.parent, slide.range_m,
            slide.damping_Ns_m, slide.stiffness_N_m, slide.friction_N,
        )  # fmt: skip
    return None


def _object_geometry(part: SolidTable, entry: ObjectTable) -> Geometry:
    return Geometry(
        rgba=entry.rgba if part.rgba is None else part.rgba,
        friction=entry.friction if part.friction is None else part.friction,
        relative_density=part.relative_density,
        **_solid(part),
    )


def _solid(entry: ObjectTable | SolidTable) -> dict[str, Any]:
    """Return what a solid and the object that it is part of say of their shape alike."""
    mesh = None if entry.file is None else solid.read_mesh(mesh_path(entry.file)).scaled(entry.scale)
    return {"mesh": mesh} | {name: getattr(entry, name) for name in _OF_A_SOLID}


_THROWN_M: Final = 2.5e-5
"""How far a film may bring a free object within a step. A film that is hit answers as a wave, within some
tenths of a millisecond: 100 g that take steps of 1 ms lose too much as they bounce, and 0.5 ms suffice."""
_PRESS_N: Final = 8.0  # what the fingers of a gripper press with
_MOST_SUBSTEPS: Final = 4
"""With 8, rolls of 50 g end alike; one of 20 g came loose as a unit snapped."""


def rigid_substeps(scenario: Scenario) -> int:
    """Return how many steps MuJoCo takes in a tick: F h^2 / m of the lightest free object is 25 um in one.

    One where the film touches nothing that it may throw, and in the iterated exchange, which solves for one
    step of either side. One with wires too: their many contacts make such steps dear.
    """
    free = [entry.mass_kg for entry in scenario.objects if entry.mass_kg and not (entry.hinge or entry.slide)]
    touched = (
        scenario.mode == "dynamic" and scenario.contact.enabled and scenario.coupling.scheme != "iterated"
    )
    if not touched or scenario.wires or not free:
        return 1
    longest = math.sqrt(_THROWN_M * min(free) / _PRESS_N)
    return min(_MOST_SUBSTEPS, math.ceil(scenario.clock.tick_s / longest))


def palm_object(palm: PalmTable) -> SceneObject:
    """Return the plate in the flange frame."""
    return SceneObject(
        PALM_NAME, "cylinder", (palm.radius_m, palm.thickness_m), (0.0, 0.0, 0.5 * palm.thickness_m),
        mass_kg=palm.mass_kg, rgba=palm.rgba, friction=palm.friction,
        contact_time_s=palm.contact_time_s,
    )  # fmt: skip


def palm_mass(palm: PalmTable) -> MassProperties:
    """Return the plate's mass in the flange frame; I_x = I_y = m (3 r^2 + t^2) / 12, I_z = m r^2 / 2."""
    r, t = palm.radius_m, palm.thickness_m
    across, along = palm.mass_kg * (3.0 * r * r + t * t) / 12.0, 0.5 * palm.mass_kg * r * r
    return MassProperties(palm.mass_kg, np.array([0.0, 0.0, 0.5 * t]), np.diag([across, across, along]))


_FEWEST: Final = 4


@final
@dataclass(frozen=True)
class DescribedArm:
    """An arm of a scenario, ready for a scene to be compiled with it.

    Args:
        arm: Pinocchio's.
        name: of all that it was read from.
        driven: how the cell's joints move; None where it has none.
        description: of the scene with it.
    """

    arm: Arm
    name: str
    driven: motion.CellMotion | None
    description: SceneDescription

    @classmethod
    def of(cls, scenario: Scenario, kept: KeptParts, prefix: str = "") -> "DescribedArm":
        """Return the arm of a scenario.

        Args:
            scenario: checked, with an arm.
            kept: parts that may be used again.
            prefix: of its names, in a scene of several arms.

        Raises:
            ScenarioError: what is wrong with the arm and with the cell, by key.
        """
        gravity, palm = scenario.gravity_m_s2, scenario.soft_robot.palm
        faults, cell, driven = Faults(), None, None
        with faults, errors_at("robot"):
            file, name = _arm_file(scenario, kept)
            arm = Arm(file, gravity=gravity)
            _check_joints(scenario, arm)
        with faults:
            cell = None if scenario.scene is None else cell_of(scenario.scene)
            driven = motion_of(scenario, cell)
        faults.raise_all()
        description = SceneDescription(
            arm=file,
            tick_s=scenario.clock.tick_s,
            substeps=rigid_substeps(scenario),
            gravity=gravity,
            objects=tuple(rigid_object(entry) for entry in scenario.objects),
            wires=scenario.wires,
            cell=cell,
            mounted=() if palm is None else (palm_object(palm),),
            friction=pair_friction(scenario.contact),
            prefix=prefix,
        )
        return cls(arm, name, driven, description)

    def name_of(self, description: SceneDescription) -> str:
        """Return a name of all that a scene with this arm is made of."""
        others = [getattr(description, field.name) for field in fields(description) if field.name != "arm"]
        return name_of(self.name, others)


def compiled_scene(
    scenario: Scenario, kept: KeptParts, arm: DescribedArm, others: Sequence[DescribedArm] = ()
) -> CompiledScene:
    """Return the scene of an arm, and of others, compiled.

    Args:
        scenario: of the arm.
        kept: parts that may be used again.
        arm: described.
        others: further ones in the same scene.

    Raises:
        ScenarioError: an object or wire is wrong, by key.
    """
    together = [each.name_of(each.description) for each in (arm, *others)]
    descriptions = tuple(each.description for each in others)
    try:
        return kept.made("scene", name_of(*together), lambda: CompiledScene(arm.description, descriptions))
    except SceneError as error:
        raise ScenarioError(_body_key(scenario, error.body), str(error)) from error


def scene_of_arms(
    scenarios: Mapping[str, Scenario], kept: KeptParts
) -> tuple[dict[str, DescribedArm], SceneOfArms]:
    """Return several arms as described, and the one scene that they are in.

    Args:
        scenarios: of each arm, by its name.
        kept: parts that may be used again; it gets those that are made here.

    Raises:
        ScenarioError: drives move joints of the cell.
        InputError: as of `DescribedArm` and `compiled_scene`.
    """
    described = {name: DescribedArm.of(scenario, kept, f"{name}/") for name, scenario in scenarios.items()}
    if any(each.driven is not None for each in described.values()):
        raise ScenarioError(
            "scene.mjcf", "has joints, which drives move for one arm alone; let all stand still"
        )
    first, *others = described.values()
    compiled = compiled_scene(next(iter(scenarios.values())), kept, first, others)
    return described, SceneOfArms(tuple(each.description for each in described.values()), compiled)


def check_starts(shared: SceneOfArms, joints: Mapping[str, Array]) -> None:
    """Check that several arms can stand where they start, with the others where these start.

    Args:
        shared: the scene, in which they are put there.
        joints: (joints,) [rad], of each arm by its name.

    Raises:
        ScenarioError: a link is in something; the first arm of which that is so is named.
    """
    for scene, start in zip(shared.arms, joints.values(), strict=True):
        scene.set_joint_state(start)
    for (name, start), scene in zip(joints.items(), shared.arms, strict=True):
        with of_arm(name):
            clearance.check_stands(scene.links.at(start), "start.flange")


@final
class ArmParts:
    """An arm, in both engines, and the scene around it.

    Attributes: `arm`, Pinocchio's; `scene`, MuJoCo's, at its start; `mounted`, rigid mass on the flange
    besides the soft robot, None for none; `driven`, how the cell's joints move, None where it has none.

    Args:
        scenario: checked, with an arm.
        kept: parts that may be used again.
        described: the arm of that scenario, if it has been described already.
        scene: the scene with it, if it is one of several arms.

    Raises:
        ScenarioError: what is wrong with the arm and with the cell, or with an object, by key.
    """

    def __init__(
        self,
        scenario: Scenario,
        kept: KeptParts,
        described: DescribedArm | None = None,
        scene: RigidScene | None = None,
    ) -> None:
        self._scenario, self._kept = scenario, kept
        found = described or DescribedArm.of(scenario, kept)
        self.arm, self.driven, self._arm_name = found.arm, found.driven, found.name
        self._led = led_joints(self.arm, scenario.start, scenario.phases)
        self._geometry_name = found.name_of(_geometry(found.description))
        self.scene = (
            RigidScene(found.description, compiled_scene(scenario, kept, found)) if scene is None else scene
        )
        gravity, palm = scenario.gravity_m_s2, scenario.soft_robot.palm
        self.mounted = mounted = None if palm is None else palm_mass(palm)
        with errors_at("robot"):
            held = None if mounted is None else Payload(mounted.mass_kg, mounted.center, mounted.inertia)
            kept.made(
                "agreement", name_of(self._arm_name, gravity, palm),
                lambda: check_engines_agree(self.scene, self.arm, found.description.arm.armature, held),
            )  # fmt: skip

    def plan_joints(
        self, start: Pose, ways: list[planning.AnyWay], blame: Callable[[int], str]
    ) -> tuple[motion.JointPath, ...]:
        """Return the joint paths of all phases, see `cosim.plan.joint_planner.plan_joints`.

        An arm that would stand in something begins in another configuration. So does one with spare joints
        whose links come too near to something on the way, where the plan refuses that.
        """

        def planned(
            around: object = None, clear: Callable[[tuple[motion.JointPath, ...]], bool] | None = None
        ) -> tuple[motion.JointPath, ...]:
            return self._kept.made(
                "joint paths", name_of(self._arm_name, start, ways, self._led, around),
                lambda: plan_joints(self.arm, start, ways, blame, self._led, clear),
            )  # fmt: skip

        settings = self._scenario.plan
        if settings.collision == "refuse" and self.arm.has_spare_joints:
            clear = partial(clearance.keeps_clear, self.scene, settings.clearance_m)
            return planned((self._geometry_name, settings.clearance_m), clear)
        paths, stands = planned(), partial(clearance.stands_clear, self.scene)
        return paths if stands(paths) else planned(self._geometry_name, stands)

    def motion_name(self, plan: Plan) -> str:
        """Return a name of the arm, and of all that its motion along a plan consists of."""
        timed = [(p.phase.name, p.phase.duration_s, p.phase.settle_s, p.phase.ramp) for p in plan.phases]
        paths = [p.joints for p in plan.phases]
        curves = [None if path.spline is None else (path.spline.x, path.spline.c) for path in paths]
        return name_of(self._arm_name, timed, [path.first for path in paths], curves)

    def clearances(
        self, plan: Plan, body: SoftBody, body_name: str, *, film_touches: bool
    ) -> PathClearances | None:
        """Return how near to one another a plan brings things; see `path_clearances`.

        Args:
            plan: of the run.
            body: of the soft robot.
            body_name: of all that it is made of.
            film_touches: whether the run models what the soft robot touches.
        """
        settings = self._scenario.plan
        name = name_of(
            self.motion_name(plan), self._geometry_name, body_name, settings, self.driven, film_touches
        )
        return self._kept.made(
            "clearances", name,
            lambda: clearance.path_clearances(
                self.scene, plan, body, settings, self.driven, film_touches=film_touches
            ),
        )  # fmt: skip

    def asked(self, plan: Plan, payload: Payload, clearances: PathClearances | None) -> PlannedArm:
        """Return what a plan asks of the arm; see `planned_arm`.

        Args:
            plan: of the run.
            payload: the soft robot in its drawn shape, and what else is mounted.
            clearances: on that way.
        """
        arm, scene, dynamic = self.arm, self.scene, self._scenario.mode == "dynamic"
        gravity, tick_s = self._scenario.gravity_m_s2, scene.tick_s

        def made() -> PlannedArm:
            nearest = nearest_start(arm, plan.start, self._led[0])
            found = asked_motion.planned_arm(arm, scene, plan, payload, clearances, dynamic=dynamic)
            return replace(found, avoided=clearance.avoided_start(scene, plan.joints, nearest))

        name = name_of(
            self.motion_name(plan), self._geometry_name, gravity, tick_s, payload, clearances, dynamic
        )
        return self._kept.made("planned arm", name, made)


def _arm_file(scenario: Scenario, kept: KeptParts) -> tuple[arm_file.ArmFile, str]:
    """Return the arm of a scenario where it stands, and a name of all that it was read from."""
    name = name_of(scenario.robot, scenario.arm_base)

    def read() -> tuple[arm_file.ArmFile, object]:
        file = placed_arm(scenario.robot, scenario.arm_base)
        return file, stamps(file.files)

    file, seen = kept.made("arm file", name, read)
    if seen != stamps(file.files):
        kept.forget("arm file", name)
        file, seen = kept.made("arm file", name, read)
    return file, name_of(name, seen)


def _geometry(description: SceneDescription) -> SceneDescription:
    """Return a scene with what stands where and whether it moves, but not how heavy it is."""
    objects = tuple(
        replace(entry, mass_kg=1.0 if entry.mass_kg else 0.0, inertia=None) for entry in description.objects
    )
    return replace(description, objects=objects, tick_s=1.0, substeps=1, gravity=(0.0, 0.0, 0.0))


def _body_key(scenario: Scenario, body: str | None) -> str:
    """Return the key of an object or wire of the rigid scene; None: what every scene has."""
    if body is None:
        return "robot" if scenario.soft_robot.palm is None else "soft_robot.palm"
    return f"{'wire' if body in (wire.name for wire in scenario.wires) else 'object'}.{body}"


def _check_joints(scenario: Scenario, arm: Arm) -> None:
    """Check that an arm has as many joints as a scenario asks for.

    With less than 6 joints the flange follows places and directions of its z axis, and rolls as it comes.
    What depends on the roll before the plan is made cannot be asked for.

    Raises:
        ScenarioError: it has less than 4 joints, or does not follow rolls and is to reach a tip target.
    """
    if arm.joint_count < _FEWEST:
        raise ScenarioError(
            "robot",
            f"arm {arm.name!r} has {arm.joint_count} joints ({', '.join(arm.joint_names)}); at least "
            f"{_FEWEST} are needed for places and directions of the flange, 6 for its roll as well",
        )
    for phase in scenario.phases:
        if arm.free_roll and phase.tip_key is not None:
            raise ScenarioError(
                f"phase.{phase.name}.{phase.tip_key}",
                f"arm {arm.name!r} has {arm.joint_count} joints, so its flange rolls as it comes; tip "
                "targets and paths need an arm of 6 joints or more",
            )
