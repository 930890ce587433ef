"""Rules that tie several values of a scenario together.

Rules on what a section model can show.

Rules on what a scenario's fidelity can show.

Bounds on how much a scenario may ask for: triangles, ticks, increments, solids, periods of a shake.

Rules on paths of the tip.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Final, Protocol

from cosim.base.resources import list_arms
from cosim.config.arms.arm_files import is_arm_path, unknown_arm
from cosim.config.rules.device_rules import check_devices, check_gas
from cosim.config.rules.scene_rules import check_cell, check_holding, check_objects, check_rings
from cosim.config.rules.soft_robot_rules import check_given_body, check_known, check_not_a_stack, check_source
from cosim.config.schema.phase import PhaseTable, TipPathTable, TipTargetTable
from cosim.config.schema.scenario import NO_ARM, AnySoftRobot, GivenBodyTable, Scenario
from cosim.config.schema.soft_robot import FIRST_RING, AttachmentTable, SoftRobotTable
from cosim.config.toml.keys import listing
from cosim.config.toml.parsing import check_registered
from cosim.config.toml.reading import Faults
from cosim.errors import InputError, ScenarioError


def check_section(scenario: Scenario, faults: Faults) -> None:
    """Check that nothing is asked of a section model that it leaves out.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        _check_robot(scenario.soft_robot, faults)
    with faults:
        if scenario.contact.self_contact:
            raise ScenarioError("contact.self_contact", "is not in a section model; use fidelity = 'lumped'")
    for phase in scenario.phases:
        with faults:
            _check_section_phase(phase, scenario.soft_robot, faults)


def _check_robot(robot: AnySoftRobot, faults: Faults) -> None:
    if isinstance(robot, GivenBodyTable):
        return  # is refused by itself
    with faults:
        if robot.copies:
            raise ScenarioError(
                "soft_robot.copies",
                "have no section model: fingers fold where they close, and a folded section has no "
                "equilibrium to condense (docs/section.md); use fidelity = 'lumped'",
            )
    with faults:
        if robot.attachments:
            raise ScenarioError(
                "soft_robot.attach",
                "has no section model: it is of one stack of units; use fidelity = 'lumped'",
            )
    if robot.base != (FIRST_RING,):
        raise ScenarioError(
            "soft_robot.base", f"is {list(robot.base)}; a section model needs ['{FIRST_RING}'] alone"
        )


def _check_section_phase(phase: PhaseTable, robot: AnySoftRobot, faults: Faults) -> None:
    path = f"phase.{phase.name}"
    with faults:
        if phase.supports:
            raise ScenarioError(f"{path}.support", "is not in a section model; use fidelity = 'lumped'")
    if isinstance(robot, GivenBodyTable) or robot.stack is None:
        return  # is refused by itself
    frames = robot.stack.frame_rings()
    for key in ("clamp", "release"):
        with faults:
            for ring in getattr(phase, key):
                if ring not in frames:
                    raise ScenarioError(
                        f"{path}.{key}", f"names '{ring}'; a section model holds outer rings and the tip only"
                    )


_REFINE_MAX: Final = 4


def check_fidelity(scenario: Scenario, faults: Faults) -> None:
    """Check that nothing is asked of a fidelity that it leaves out.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        _check_auto(scenario)
    with faults:
        robot = scenario.soft_robot
        refined = scenario.fidelity == "refined"
        if isinstance(robot, SoftRobotTable) and not robot.all_stacks:
            check_not_a_stack(robot.name, "not drawn as a stack of units alone", scenario)
        elif (
            refined
            and isinstance(robot, SoftRobotTable)
            and robot.stack
            and robot.stack.refine >= _REFINE_MAX
        ):
            raise ScenarioError(
                "fidelity",
                "'refined' is one refinement more than soft_robot.stack.refine, which is at its bound of "
                f"{_REFINE_MAX} already",
            )
    if scenario.fidelity == "section":
        check_section(scenario, faults)
    if scenario.fidelity == "rigid":
        _check_rigid(scenario, faults)


def _refined(robot: SoftRobotTable) -> int:
    return 0 if robot.stack is None else robot.stack.refine


def _check_rigid(scenario: Scenario, faults: Faults) -> None:
    with faults:
        if not scenario.model.closed:
            raise ScenarioError(
                "fidelity",
                "'rigid' needs model.closed = true: it leaves out how an open chamber's gas pushes",
            )
    for phase in scenario.phases:
        for key, field in (("release", "release"), ("support", "supports")):
            with faults:
                if getattr(phase, field):
                    raise ScenarioError(
                        f"phase.{phase.name}.{key}",
                        "cannot stand beside fidelity = 'rigid': every node is held",
                    )


def _check_auto(scenario: Scenario) -> None:
    requirement = scenario.auto
    if scenario.fidelity != "auto":
        if requirement is not None and requirement.chosen is None:
            raise ScenarioError("auto", f"goes with fidelity = 'auto'; the fidelity is '{scenario.fidelity}'")
        return
    if scenario.mode != "dynamic":
        raise ScenarioError("fidelity", f"'auto' chooses among dynamic runs; the mode is '{scenario.mode}'")
    if requirement is None or (
        requirement.budget,
        requirement.tolerance_m,
        requirement.force_tolerance_N,
    ) == (None, None, None):
        raise ScenarioError(
            "auto", "is missing a requirement; fidelity = 'auto' needs auto.budget (least real-time factor), "
            "auto.tolerance_m (of the tip) or auto.force_tolerance_N",
        )  # fmt: skip


MOST_TRIANGLES: Final = 200_000
MOST_TICKS: Final = 1_000_000_000
MOST_INCREMENTS: Final = 10_000_000
MOST_SOLIDS: Final = 2_000
MOST_SHAKE_PERIODS: Final = 1_000


def check_sizes(scenario: Scenario, faults: Faults) -> None:
    """Check that what a scenario asks for can be built within minutes and some gigabytes.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the bounds that are exceeded.
    """
    with faults:
        _check_triangles(scenario)
    with faults:
        solids = sum(max(1, bool(entry.shape) + len(entry.parts)) for entry in scenario.objects)
        if solids > MOST_SOLIDS:
            raise ScenarioError("object", f"makes {solids} solids in all; at most {MOST_SOLIDS} are allowed")
    with faults:
        segments = sum(wire.segments for wire in scenario.wires)
        if segments > MOST_SOLIDS:
            raise ScenarioError(
                "wire", f"makes {segments} segments in all; at most {MOST_SOLIDS} are allowed"
            )
    with faults:
        for phase in scenario.phases:
            with faults:
                _check_shake_size(phase)
    _check_length(scenario)


def triangle_count(robot: AnySoftRobot) -> int:
    """Return how many triangles the mesh of a soft robot has, with its copies and attachments."""
    if isinstance(robot, GivenBodyTable):
        return robot.triangles
    copies = 1 if robot.copies is None else robot.copies.count
    own = 0 if robot.stack is None else robot.stack.triangles  # mesh files have a bound of their own
    return copies * own + sum(triangle_count(part.robot) for part in robot.attachments)


def check_ends(scenario: Scenario) -> None:
    """Check that a scenario has phases, with which it ends.

    Raises:
        ScenarioError: it has none.
    """
    if scenario.endless:
        raise ScenarioError(
            "phase",
            "is missing: the scenario holds its start without end; give a [[phase]] with a duration_s, or "
            "step and command it with cosim.Simulation",
        )


def _check_triangles(scenario: Scenario) -> None:
    finer = scenario.fidelity == "refined"
    triangles = triangle_count(scenario.soft_robot) * (4 if finer else 1)
    if triangles > MOST_TRIANGLES:
        also = ", fidelity = 'refined'" if finer else ""
        raise ScenarioError(
            "soft_robot.stack",
            f"makes {triangles:,} triangles, copies and attachments counted; at most {MOST_TRIANGLES:,} are "
            f"allowed: take fewer units, sides, refine{also}",
        )


def _check_shake_size(phase: PhaseTable) -> None:
    if phase.flange_shake is None:
        return
    periods = phase.flange_shake.frequency_Hz * phase.duration_s
    if periods > MOST_SHAKE_PERIODS:
        raise ScenarioError(
            f"phase.{phase.name}.flange_shake.frequency_Hz",
            f"makes {periods:g} periods in one phase; at most {MOST_SHAKE_PERIODS} are allowed",
        )


def _check_length(scenario: Scenario) -> None:
    """Check ticks or increments, by the mode; the phase that makes most of them is named."""
    if scenario.endless:
        return
    quasistatic = scenario.mode == "quasistatic"
    tick_s = scenario.clock.tick_s
    counts = [p.increments if quasistatic else (p.duration_s + p.settle_s) / tick_s for p in scenario.phases]
    most, what = (MOST_INCREMENTS, "increments") if quasistatic else (MOST_TICKS, "ticks")
    if sum(counts) <= most:
        return
    phase = scenario.phases[max(range(len(counts)), key=counts.__getitem__)]
    key = "increments" if quasistatic else "duration_s" if phase.duration_s > phase.settle_s else "settle_s"
    raise ScenarioError(
        f"phase.{phase.name}.{key}", f"all phases make {sum(counts):.3g} {what}; at most {most:g} are allowed"
    )


_BESIDE: Final = ("flange", "flange_turn", "flange_shift_m", "flange_shake", "tip_target")
_SAME: Final = 1e-6  # of a duration


def check_tip_path(phase: PhaseTable, faults: Faults) -> None:
    """Check the path of a phase, if it has one, and that nothing stands beside it that it decides.

    Args:
        phase: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    path, key = phase.tip_path, f"phase.{phase.name}"
    if path is None:
        return
    for other in _BESIDE:
        with faults:
            if getattr(phase, other) is not None:
                raise ScenarioError(f"{key}.{other}", "cannot stand beside tip_path, which moves the flange")
    with faults:
        if phase.ramp != "linear":
            raise ScenarioError(
                f"{key}.ramp", f"is '{phase.ramp}'; a tip_path has ramps of its own (ramp_s): leave it out"
            )
    with faults:
        _check_course(phase, path, key)


def _check_course(phase: PhaseTable, path: TipPathTable, key: str) -> None:
    if path.file is not None:
        raise ScenarioError(f"{key}.tip_path.file", "is read where a scenario's file names it; give points_m")
    try:
        lasts_s = path.course().duration_s
    except InputError as error:
        raise ScenarioError(f"{key}.tip_path", str(error)) from error
    if not math.isclose(phase.duration_s, lasts_s, rel_tol=_SAME):
        raise ScenarioError(
            f"{key}.duration_s",
            f"is {phase.duration_s:g}, but the path takes {lasts_s:.6g} s at {path.speed_m_s:g} m/s; leave "
            "it out",
        )


LEAST_NODE_MASS_kg: Final = 1e-12
_NAMED: Final = {
    "object": "objects", "phase": "phases", "pump": "pumps", "winch": "winches", "controller": "controllers"
}  # fmt: skip
_MOVES = ("flange", "flange_turn", "flange_shift_m", "flange_shake")


class _Named(Protocol):
    @property
    def name(self) -> str: ...


def check_scenario(scenario: Scenario, faults: Faults) -> None:
    """Check what single values cannot show: names that must exist, lengths that must agree.

    Args:
        scenario: may hold UNKNOWN where it is wrong by itself; what needs that is not checked.
        faults: gets the rules that are broken.
    """
    with faults:
        _check_arm(scenario.robot)
    with faults:
        _check_endless(scenario)
    with faults:
        if isinstance(scenario.soft_robot, GivenBodyTable):
            check_given_body(scenario.soft_robot, scenario, faults)
        else:
            check_soft_robot(scenario.soft_robot, "soft_robot", faults)
    for key, field in _NAMED.items():
        with faults:
            _check_unique(getattr(scenario, field), key, faults)
    with faults:
        _check_unique(scenario.wires, "wire", faults, {entry.name for entry in scenario.objects})
    with faults:
        cables = scenario.soft_robot.cable_names()
        _check_tensions(scenario.start.cable_tension_N or None, cables, "start.cable_tension_N")
    with faults:
        check_objects(scenario, faults)
    with faults:
        for phase in scenario.phases:
            with faults:
                _check_phase(phase, scenario, f"phase.{phase.name}", faults)
    for check in (check_sizes, check_holding, check_cell, check_fidelity, check_gas, check_devices):
        with faults:
            check(scenario, faults)


def _check_arm(robot: str) -> None:
    if robot not in (*list_arms(), NO_ARM) and not is_arm_path(robot):
        raise ScenarioError("robot", unknown_arm(robot, (NO_ARM,)))


def _check_endless(scenario: Scenario) -> None:
    """Check that what holds its start until it is commanded can be stepped, and its model is given."""
    if scenario.endless and scenario.mode != "dynamic":
        raise ScenarioError(
            "mode",
            f"'{scenario.mode}' follows the increments of phases, and there is no [[phase]]; give one, or "
            "mode = 'dynamic', which cosim.Simulation steps and commands",
        )
    if scenario.endless and scenario.fidelity == "auto":
        raise ScenarioError(
            "fidelity", "'auto' is chosen by running the phases, and there is no [[phase]]; name a model"
        )


def check_soft_robot(robot: SoftRobotTable, path: str, faults: Faults) -> None:
    """Check a soft robot's geometry, clamped rings, cables and attachments.

    Args:
        robot: may hold UNKNOWN.
        path: of its table.
        faults: gets the rules that are broken.
    """
    with faults:
        check_source(robot, path, faults)
    for check in (_check_mass, _check_law, _check_stiffener):
        with faults:
            check(robot, path)
    with faults:
        check_known(robot, f"{path}.known", faults)
    with faults:
        check_rings(robot.base, robot, f"{path}.base")
    with faults:
        _check_unique(robot.cables, f"{path}.cable", faults)
    with faults:
        _check_elements(robot, f"{path}.element")
    with faults:
        _check_unique(robot.attachments, f"{path}.attach", faults)
    with faults:
        for entry in robot.attachments:
            with faults:
                _check_attachment(entry, robot, f"{path}.attach.{entry.name}", faults)


def _check_elements(robot: SoftRobotTable, path: str) -> None:
    for entry in robot.elements:
        check_registered(entry, path)


def _check_mass(robot: SoftRobotTable, path: str) -> None:
    size_m = 1.0 if robot.stack is None else robot.stack.unit_height_m  # of other films the mesh will tell
    film_mass = robot.film.density_kg_m3 * robot.film.thickness_m * size_m**2
    if robot.mass.node_mass_kg < LEAST_NODE_MASS_kg and film_mass < LEAST_NODE_MASS_kg:
        raise ScenarioError(
            f"{path}.mass.node_mass_kg",
            f"every node needs mass, {LEAST_NODE_MASS_kg:g} kg at least; give node_mass_kg or "
            "film.density_kg_m3",
        )


def _check_law(robot: SoftRobotTable, path: str) -> None:
    if robot.film.wrinkle_panel_m is not None and robot.film.law != "wrinkling":
        raise ScenarioError(
            f"{path}.film.wrinkle_panel_m", f"goes with law = 'wrinkling'; the law is '{robot.film.law}'"
        )


def _check_stiffener(robot: SoftRobotTable, path: str) -> None:
    stiffener = robot.stiffener
    for key in ("width_m", "height_m", "young_modulus_Pa"):
        given = getattr(stiffener, key) is not None
        if given is not (stiffener.kind == "beam"):
            has = "goes with" if given else "is missing; needed with"
            raise ScenarioError(
                f"{path}.stiffener.{key}", f"{has} kind = 'beam'; the kind is '{stiffener.kind}'"
            )


def _check_attachment(entry: AttachmentTable, robot: SoftRobotTable, path: str, faults: Faults) -> None:
    with faults:
        check_soft_robot(entry.robot, f"{path}.robot", faults)
    with faults:
        if robot.copies is not None:
            raise ScenarioError(path, "cannot stand beside copies, which have no single tip")
    with faults:
        if entry.robot.film != robot.film:
            raise ScenarioError(f"{path}.robot.film", f"differs from the film of '{robot.name}'; must not")
    barrier, own = entry.robot.hinge.fold_barrier_rad, robot.hinge.fold_barrier_rad
    if barrier != own:
        raise ScenarioError(
            f"{path}.robot.hinge.fold_barrier_rad",
            f"{barrier:g} differs from that of '{robot.name}', {own:g}; must not",
        )


def _check_phase(phase: PhaseTable, scenario: Scenario, path: str, faults: Faults) -> None:
    with faults:
        if phase.duration_s < scenario.clock.tick_s:
            raise ScenarioError(
                f"{path}.duration_s",
                f"{phase.duration_s:g} is shorter than a tick ({scenario.clock.tick_s:g} s)",
            )
    with faults:
        cables = scenario.soft_robot.cable_names()
        _check_tensions(phase.cable_tension_N, cables, f"{path}.cable_tension_N")
    with faults:
        moves = _moves(phase)
        if phase.flange is not None and len(moves) > 1:
            raise ScenarioError(
                f"{path}.{moves[1]}", "cannot stand beside flange, which already gives the pose"
            )
    with faults:
        if phase.flange_shake is not None:
            _check_shake(phase, phase.flange_shake.frequency_Hz, path, faults)
    check_tip_path(phase, faults)
    if phase.tip_target is not None:
        _check_tip_target(phase.tip_target, phase, scenario.soft_robot, path)


def _moves(phase: PhaseTable) -> list[str]:
    return [key for key in _MOVES if getattr(phase, key) is not None]


def _check_shake(phase: PhaseTable, frequency_Hz: float, path: str, faults: Faults) -> None:
    with faults:
        if phase.ramp != "linear":
            raise ScenarioError(f"{path}.ramp", f"flange_shake needs ramp = 'linear'; it is '{phase.ramp}'")
    if phase.duration_s * frequency_Hz < 3.0:
        raise ScenarioError(
            f"{path}.duration_s", f"{phase.duration_s:g} is shorter than 3 periods of flange_shake"
        )


def _check_tip_target(target: TipTargetTable, phase: PhaseTable, robot: AnySoftRobot, path: str) -> None:
    where = f"{path}.tip_target"
    if (target.position_m is None) == (target.height_m is None):
        given = "neither" if target.position_m is None else "both"
        raise ScenarioError(where, f"give position_m or height_m; {given} is given")
    if moves := _moves(phase):
        raise ScenarioError(f"{path}.{moves[0]}", "cannot stand beside tip_target in one phase")
    if target.reach_with != "cables":
        if target.height_m is not None:
            raise ScenarioError(f"{where}.height_m", "needs reach_with = 'cables'")
        return
    if not robot.cable_names():
        raise ScenarioError(f"{where}.reach_with", f"soft robot '{robot.name}' has no cables")
    if phase.cable_tension_N is not None:
        raise ScenarioError(f"{path}.cable_tension_N", "cannot stand beside a target reached with cables")


def _check_tensions(tensions: Sequence[float] | None, cables: Sequence[str], path: str) -> None:
    if isinstance(tensions, tuple) and len(tensions) != len(cables):  # a table has been refused before
        raise ScenarioError(
            path, f"has {len(tensions)} entries; there are {len(cables)} cables: {listing(cables)}"
        )


def _check_unique(entries: Iterable[_Named], path: str, faults: Faults, taken: Iterable[str] = ()) -> None:
    seen = set(taken)
    for entry in entries:
        with faults:
            if entry.name in seen:
                raise ScenarioError(f"{path}.{entry.name}", "the name is used twice; names must differ")
            seen.add(entry.name)
