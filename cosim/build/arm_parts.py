"""Builds the arm of a scenario in both engines, Pinocchio and MuJoCo, with the scene around it, and plans its
joint paths.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Final, final

from cosim.base import arm_file
from cosim.base.frames import Array, Pose
from cosim.base.kept_parts import KeptParts, name_of, stamps
from cosim.build.arms import cell_of, motion_of, placed_arm
from cosim.build.engine_agreement import check_engines_agree
from cosim.build.scene_objects import pair_friction, palm_mass, palm_object, rigid_object, rigid_substeps
from cosim.config.schema.scenario import Scenario
from cosim.config.several_arms import of_arm
from cosim.config.toml.rules import Faults, errors_at
from cosim.errors import ScenarioError, SceneError
from cosim.kinematics.arm import Arm, Payload
from cosim.plan import cell_motion, joint_path, path_clearance, required_motion, start_checks, tip_paths
from cosim.plan.arm_limits import PathClearances, PlannedArm
from cosim.plan.joint_planner import nearest_start, plan_joints, prescribed_joints
from cosim.plan.plan import Plan
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.arms import SceneOfArms
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.body import SoftBody

_FEWEST: Final = 4


@final
@dataclass(frozen=True)
class DescribedArm:
    """An arm of a scenario, and the description of the scene that MuJoCo compiles.

    Args:
        arm: of Pinocchio.
        name: cache name of the files and tables that it was read from.
        driven: motion of the cell's joints; None without such joints.
        description: of the scene with the arm.
    """

    arm: Arm
    name: str
    driven: cell_motion.CellMotion | None
    description: SceneDescription

    @classmethod
    def of(cls, scenario: Scenario, kept: KeptParts, prefix: str = "") -> "DescribedArm":
        """Return the arm of a scenario.

        Args:
            scenario: checked, with an arm.
            kept: cache of parts.
            prefix: of its names, in a scene of several arms.

        Raises:
            ScenarioError: the arm or the cell is wrong; with all faults by key.
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
        """Return a cache name of a scene with this arm."""
        others = [getattr(description, field.name) for field in fields(description) if field.name != "arm"]
        return name_of(self.name, others)


def compiled_scene(
    scenario: Scenario, kept: KeptParts, arm: DescribedArm, others: Sequence[DescribedArm] = ()
) -> CompiledScene:
    """Return the compiled scene of one or several arms.

    Args:
        scenario: of the first arm.
        kept: cache of parts.
        arm: the first arm.
        others: further arms in the same scene.

    Raises:
        ScenarioError: MuJoCo refuses an object or wire; the message names its key.
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
    """Return several arms and the scene that they share.

    Args:
        scenarios: of each arm, by its name.
        kept: cache of parts; gets those that are built here.

    Raises:
        ScenarioError: the cell has joints that phases drive.
        InputError: see `DescribedArm` and `compiled_scene`.
    """
    described = {name: DescribedArm.of(scenario, kept, f"{name}/") for name, scenario in scenarios.items()}
    if any(each.driven is not None for each in described.values()):
        raise ScenarioError(
            "scene.mjcf", "has joints, which phases drive only with one arm; use a cell without joints"
        )
    first, *others = described.values()
    compiled = compiled_scene(next(iter(scenarios.values())), kept, first, others)
    return described, SceneOfArms(tuple(each.description for each in described.values()), compiled)


def check_starts(shared: SceneOfArms, joints: Mapping[str, Array]) -> None:
    """Check that no arm penetrates another body or arm at the start.

    Args:
        shared: the scene; it is set to the start.
        joints: (joints,) [rad], of each arm by its name.

    Raises:
        ScenarioError: a link penetrates something; the message names the first such arm.
    """
    for scene, start in zip(shared.arms, joints.values(), strict=True):
        scene.set_joint_state(start)
    for (name, start), scene in zip(joints.items(), shared.arms, strict=True):
        with of_arm(name):
            start_checks.check_no_overlap(scene.links.at(start), "start.flange")


@final
@dataclass(frozen=True)
class _KeptClearances:
    """Clearances along a plan, as the cache holds them; None where they are not looked at."""

    clearances: PathClearances | None


@final
class ArmParts:
    """An arm, in both engines, and the scene around it.

    Attributes: `arm`, of Pinocchio; `scene`, of MuJoCo, at its start; `mounted`, rigid mass on the flange
    in addition to the soft robot, None for none; `driven`, motion of the cell's joints, None without.

    Args:
        scenario: checked, with an arm.
        kept: cache of parts.
        described: the arm of that scenario; None: it is read here.
        scene: the scene of several arms; None: the arm's scene is compiled here.

    Raises:
        ScenarioError: the arm, the cell or an object is wrong; with all faults by key.
    """

    def __init__(
        self,
        scenario: Scenario,
        kept: KeptParts,
        described: DescribedArm | None = None,
        scene: RigidScene | None = None,
    ) -> None:
        self._scenario, self._kept = scenario, kept
        one = described or DescribedArm.of(scenario, kept)
        self.arm, self.driven, self._arm_name = one.arm, one.driven, one.name
        self._led = prescribed_joints(self.arm, scenario.start, scenario.phases)
        self._geometry_name = one.name_of(_geometry(one.description))
        self.scene = (
            RigidScene(one.description, compiled_scene(scenario, kept, one)) if scene is None else scene
        )
        gravity, palm = scenario.gravity_m_s2, scenario.soft_robot.palm
        self.mounted = mounted = None if palm is None else palm_mass(palm)
        with errors_at("robot"):
            held = None if mounted is None else Payload(mounted.mass_kg, mounted.center, mounted.inertia)
            kept.made(
                "agreement", name_of(self._arm_name, gravity, palm),
                lambda: check_engines_agree(self.scene, self.arm, one.description.arm.armature, held),
            )  # fmt: skip

    def plan_joints(
        self, start: Pose, ways: list[tip_paths.AnyFlangeMotion], blame: Callable[[int], str]
    ) -> tuple[joint_path.JointPath, ...]:
        """Return the joint paths of all phases, see `cosim.plan.joint_planner.plan_joints`.

        If the arm would penetrate something at the start, another configuration is tried. With
        plan.collision = "refuse" an arm with redundant joints also tries others to keep its clearance.
        """

        def planned(
            around: object = None, clear: Callable[[tuple[joint_path.JointPath, ...]], bool] | None = None
        ) -> tuple[joint_path.JointPath, ...]:
            return self._kept.made(
                "joint paths", name_of(self._arm_name, start, ways, self._led, around),
                lambda: plan_joints(self.arm, start, ways, blame, self._led, clear),
            )  # fmt: skip

        settings = self._scenario.plan
        if settings.collision == "refuse" and self.arm.has_spare_joints:
            clear = partial(path_clearance.keeps_clear, self.scene, settings.clearance_m)
            return planned((self._geometry_name, settings.clearance_m), clear)
        paths, stands = planned(), partial(start_checks.is_clear_at_start, self.scene)
        return paths if stands(paths) else planned(self._geometry_name, stands)

    def motion_name(self, plan: Plan) -> str:
        """Return a cache name of the arm's motion along a plan."""
        timed = [(p.phase.name, p.phase.duration_s, p.phase.settle_s, p.phase.ramp) for p in plan.phases]
        paths = [p.joints for p in plan.phases]
        curves = [None if path.spline is None else (path.spline.x, path.spline.c) for path in paths]
        return name_of(self._arm_name, timed, [path.first for path in paths], curves)

    def clearances(
        self, plan: Plan, body: SoftBody, body_name: str, *, film_touches: bool, lasting: bool
    ) -> PathClearances | None:
        """Return the clearances along a plan; see `path_clearances`.

        Args:
            plan: of the run.
            body: of the soft robot.
            body_name: its cache name.
            film_touches: whether the run models the soft robot's contact.
            lasting: whether `body_name` is valid in other processes too.
        """
        settings = self._scenario.plan
        name = name_of(
            self.motion_name(plan), self._geometry_name, body_name, settings, self.driven, film_touches
        )

        def found() -> _KeptClearances:
            return _KeptClearances(
                path_clearance.path_clearances(
                    self.scene, plan, body, settings, self.driven, film_touches=film_touches
                )
            )

        if lasting:
            return self._kept.lasting("clearances", name, _KeptClearances, found).clearances
        return self._kept.made("clearances", name, found).clearances

    def asked(self, plan: Plan, payload: Payload, clearances: PathClearances | None) -> PlannedArm:
        """Return the planned motion of the arm with its loads; see `planned_arm`.

        Args:
            plan: of the run.
            payload: the soft robot in its drawn shape, and other mounted mass.
            clearances: along the plan.
        """
        arm, scene, dynamic = self.arm, self.scene, self._scenario.mode == "dynamic"
        gravity, tick_s = self._scenario.gravity_m_s2, scene.tick_s

        def made() -> PlannedArm:
            nearest = nearest_start(arm, plan.start, self._led[0])
            found = required_motion.planned_arm(arm, scene, plan, payload, clearances, dynamic=dynamic)
            return replace(found, avoided=start_checks.avoided_start(scene, plan.joints, nearest))

        name = name_of(
            self.motion_name(plan), self._geometry_name, gravity, tick_s, payload, clearances, dynamic
        )
        return self._kept.made("planned arm", name, made)


def _arm_file(scenario: Scenario, kept: KeptParts) -> tuple[arm_file.ArmFile, str]:
    """Return the arm of a scenario at its base, and a cache name of the files that it was read from."""
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
    """Return a scene without what does not affect clearances: masses, time steps, gravity."""
    objects = tuple(
        replace(entry, mass_kg=1.0 if entry.mass_kg else 0.0, inertia=None) for entry in description.objects
    )
    return replace(description, objects=objects, tick_s=1.0, substeps=1, gravity=(0.0, 0.0, 0.0))


def _body_key(scenario: Scenario, body: str | None) -> str:
    """Return the key of an object or wire of the rigid scene; for None that of the arm or palm."""
    if body is None:
        return "robot" if scenario.soft_robot.palm is None else "soft_robot.palm"
    return f"{'wire' if body in (wire.name for wire in scenario.wires) else 'object'}.{body}"


def _check_joints(scenario: Scenario, arm: Arm) -> None:
    """Check that an arm has enough joints for a scenario.

    With fewer than 6 joints the flange follows positions and directions of its z axis, and its roll is free.
    A tip target depends on the roll, so it needs 6 joints.

    Raises:
        ScenarioError: the arm has fewer than 4 joints, or fewer than 6 and a phase has a tip target.
    """
    if arm.joint_count < _FEWEST:
        raise ScenarioError(
            "robot",
            f"arm {arm.name!r} has {arm.joint_count} joints ({', '.join(arm.joint_names)}); at least "
            f"{_FEWEST} are needed for positions and directions of the flange, 6 for its roll as well",
        )
    for phase in scenario.phases:
        if arm.free_roll and phase.tip_key is not None:
            raise ScenarioError(
                f"phase.{phase.name}.{phase.tip_key}",
                f"arm {arm.name!r} has {arm.joint_count} joints, so the roll of its flange is free; tip "
                "targets and paths need an arm of 6 joints or more",
            )
