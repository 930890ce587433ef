"""The arm of a scenario and the scene around it, with what is planned of the arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Final, final

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Pose
from cosim.base.kept_parts import KeptParts, name_of, stamps
from cosim.build.arms import placed_arm
from cosim.build.blame import blamed_on
from cosim.build.cells import cell_of, motion_of
from cosim.build.engines_agree import check_engines_agree
from cosim.build.parts.soft_model import SoftModel
from cosim.build.scene_objects import palm_mass, palm_object, rigid_object, rigid_wire
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.faults import Faults
from cosim.errors import ScenarioError, SceneError
from cosim.kinematics.arm import Arm, Payload
from cosim.plan.arm_limits import PathClearances, PlannedArm
from cosim.plan.arm_plan import planned_arm
from cosim.plan.joint_path import JointPath
from cosim.plan.joint_planner import plan_joints
from cosim.plan.path_clearances import path_clearances
from cosim.plan.paths.phase_motion import AnyWay
from cosim.plan.plan import Plan
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.scene.scene import RigidScene

_FEWEST: Final = 4


@final
class ArmParts:
    """An arm, in both engines, and the scene around it.

    Attributes: `arm`, Pinocchio's; `scene`, MuJoCo's, at its start; `mounted`, rigid mass on the flange
    besides the soft robot, None for none; `driven`, how the cell's joints move, None where it has none.

    Args:
        scenario: checked, with an arm.
        kept: parts that may serve again.

    Raises:
        ScenarioError: what is wrong with the arm and with the cell, or with an object, by key.
    """

    def __init__(self, scenario: Scenario, kept: KeptParts) -> None:
        self._scenario, self._kept = scenario, kept
        gravity, palm = scenario.gravity_m_s2, scenario.soft_robot.palm
        faults, cell, self.driven = Faults(), None, None
        with faults, blamed_on("robot"):
            file, self._arm_name = _arm_file(scenario, kept)
            self.arm = Arm(file, gravity=gravity)
            _check_joints(scenario, self.arm)
        with faults:
            cell = None if scenario.scene is None else cell_of(scenario.scene)
            self.driven = motion_of(scenario, cell)
        faults.tell()
        description = SceneDescription(
            arm=file,
            tick_s=scenario.clock.tick_s,
            gravity=gravity,
            objects=tuple(rigid_object(entry) for entry in scenario.objects),
            wires=tuple(rigid_wire(entry) for entry in scenario.wires),
            cell=cell,
            mounted=() if palm is None else (palm_object(palm),),
        )
        self._geometry_name = self._name(_geometry(description))
        try:
            self.scene = RigidScene(
                description,
                kept.made("scene", self._name(description), lambda: CompiledScene(description)),
            )
        except SceneError as error:
            raise ScenarioError(_body_key(scenario, error.body), str(error)) from error
        self.mounted = mounted = None if palm is None else palm_mass(palm)
        with blamed_on("robot"):
            held = None if mounted is None else Payload(mounted.mass_kg, mounted.center, mounted.inertia)
            kept.made(
                "agreement", name_of(self._arm_name, gravity, palm),
                lambda: check_engines_agree(self.scene, self.arm, file.armature, held),
            )  # fmt: skip

    def _name(self, description: SceneDescription) -> str:
        """Return a name of all that a scene is made of."""
        others = [getattr(description, field.name) for field in fields(description) if field.name != "arm"]
        return name_of(self._arm_name, others)

    def plan_joints(
        self, start: Pose, ways: list[AnyWay], blame: Callable[[int], str]
    ) -> tuple[JointPath, ...]:
        """Return the joint paths of all phases, see `cosim.plan.joint_planner.plan_joints`."""
        return self._kept.made(
            "joint paths", name_of(self._arm_name, start, ways),
            lambda: plan_joints(self.arm, start, ways, blame),
        )  # fmt: skip

    def motion_name(self, plan: Plan) -> str:
        """Return a name of the arm, and of all that its motion along a plan consists of."""
        timed = [(p.phase.name, p.phase.duration_s, p.phase.settle_s, p.phase.ramp) for p in plan.phases]
        paths = [p.joints for p in plan.phases]
        curves = [None if path.spline is None else (path.spline.x, path.spline.c) for path in paths]
        return name_of(self._arm_name, timed, [path.first for path in paths], curves)

    def clearances(self, plan: Plan, model: SoftModel, *, film_touches: bool) -> PathClearances | None:
        """Return how near to one another a plan brings things; see `path_clearances`.

        Args:
            plan: of the run.
            model: of the soft robot.
            film_touches: whether the run models what the soft robot touches.
        """
        settings = self._scenario.plan
        name = name_of(
            self.motion_name(plan), self._geometry_name, model.body_name, settings, self.driven, film_touches
        )
        return self._kept.made(
            "clearances", name,
            lambda: path_clearances(
                self.scene, plan, model.body, settings, self.driven, film_touches=film_touches
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
        return self._kept.made(
            "planned arm",
            name_of(self.motion_name(plan), gravity, tick_s, payload, clearances, dynamic),
            lambda: planned_arm(arm, scene, plan, payload, clearances, dynamic=dynamic),
        )


def _arm_file(scenario: Scenario, kept: KeptParts) -> tuple[ArmFile, str]:
    """Return the arm of a scenario where it stands, and a name of all that it was read from."""
    name = name_of(scenario.robot, scenario.arm_base)

    def read() -> tuple[ArmFile, object]:
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
    return replace(description, objects=objects, tick_s=1.0, gravity=(0.0, 0.0, 0.0))


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
