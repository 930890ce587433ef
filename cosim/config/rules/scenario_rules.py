"""Rules that tie several values of a scenario together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, Protocol

from cosim.base.resources import list_arms
from cosim.config.arms.arm_files import is_arm_path, unknown_arm
from cosim.config.rules.body_source_rules import check_source
from cosim.config.rules.cell_rules import check_cell
from cosim.config.rules.device_rules import check_devices
from cosim.config.rules.fidelity_rules import check_fidelity
from cosim.config.rules.gas_rules import check_gas
from cosim.config.rules.given_body_rules import check_given_body
from cosim.config.rules.known_rules import check_known
from cosim.config.rules.object_rules import check_objects
from cosim.config.rules.size_rules import check_sizes
from cosim.config.rules.support_rules import check_holding, check_rings
from cosim.config.rules.tip_path_rules import check_tip_path
from cosim.config.schema.given_body import AnySoftRobot, GivenBodyTable
from cosim.config.schema.phase import PhaseTable, TipTargetTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.soft_robot import AttachmentTable, SoftRobotTable
from cosim.config.toml.faults import Faults
from cosim.config.toml.registered_kinds import check_registered
from cosim.config.toml.suggestions import listing
from cosim.errors import ScenarioError

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
