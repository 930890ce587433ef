"""Rules that tie several values of a scenario together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final

from cosim.base.arms import arm_names
from cosim.config.rules.device_rules import check_devices
from cosim.config.rules.fidelity_rules import check_fidelity
from cosim.config.rules.gas_rules import check_gas
from cosim.config.rules.object_rules import check_objects
from cosim.config.rules.size_rules import check_sizes
from cosim.config.rules.support_rules import check_holding, check_rings
from cosim.config.schema.phase import PhaseTable, TipTargetTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.soft_robot import CableTable, SoftRobotTable
from cosim.config.toml.suggestions import unknown_name_message
from cosim.errors import ScenarioError

LEAST_NODE_MASS_kg: Final = 1e-12
_MOVES = ("flange", "flange_turn", "flange_shift_m", "flange_shake")


def check_scenario(scenario: Scenario) -> None:
    """Check what single values cannot show: names that must exist, lengths that must agree.

    Raises:
        ScenarioError: the first rule that is broken.
    """
    robots = (*arm_names(), NO_ARM)
    if scenario.robot not in robots:
        raise ScenarioError("robot", unknown_name_message("arm", scenario.robot, robots))
    check_soft_robot(scenario.soft_robot, "soft_robot")
    _check_calibrated(scenario)
    _check_unique((entry.name for entry in scenario.objects), "object")
    _check_unique([entry.name for entry in scenario.objects] + [wire.name for wire in scenario.wires], "wire")
    _check_unique((entry.name for entry in scenario.phases), "phase")
    _check_unique((entry.name for entry in scenario.pumps), "pump")
    _check_unique((entry.name for entry in scenario.winches), "winch")
    _check_unique((entry.name for entry in scenario.controllers), "controller")
    cables = scenario.soft_robot.cable_names()
    if scenario.start.cable_tension_N:
        _check_tensions(scenario.start.cable_tension_N, cables, "start.cable_tension_N")
    check_objects(scenario.objects, scenario.wires)
    for phase in scenario.phases:
        _check_phase(phase, scenario, f"phase.{phase.name}")
    check_sizes(scenario)
    check_holding(scenario)
    check_fidelity(scenario)
    check_gas(scenario)
    check_devices(scenario)


def _check_calibrated(scenario: Scenario) -> None:
    robot = scenario.soft_robot
    if not scenario.chamber.calibrated:
        return
    if robot.attachments:
        raise ScenarioError("chamber.calibrated", "is of one soft robot; this one has attachments")
    if robot.calibration is None:
        raise ScenarioError(
            "chamber.calibrated",
            f"soft robot '{robot.name}' has no [calibration]; make one: cosim calibrate {robot.name} --write",
        )
    if robot.chamber.refine != 0:
        raise ScenarioError(
            "chamber.calibrated",
            f"a calibration is of the unrefined mesh; soft_robot.chamber.refine is {robot.chamber.refine}",
        )


def check_soft_robot(robot: SoftRobotTable, path: str) -> None:
    """Check a soft robot's geometry, clamped rings and cables; `path` is that of its table.

    Raises:
        ScenarioError: the first rule that is broken.
    """
    chamber = robot.chamber
    smallest = chamber.corner_radius_m * chamber.taper ** (chamber.units - 1)
    if smallest <= chamber.hole_radius_m:
        raise ScenarioError(
            f"{path}.chamber.hole_radius_m",
            f"{chamber.hole_radius_m:g} must be below the last unit's corner radius, {smallest:.4g}",
        )
    film_mass = robot.film.density_kg_m3 * robot.film.thickness_m * chamber.unit_height_m**2
    if robot.mass.node_mass_kg < LEAST_NODE_MASS_kg and film_mass < LEAST_NODE_MASS_kg:
        raise ScenarioError(
            f"{path}.mass.node_mass_kg",
            f"every node needs mass, {LEAST_NODE_MASS_kg:g} kg at least; give node_mass_kg or "
            "film.density_kg_m3",
        )
    if robot.film.compressive_fraction and robot.film.law != "tension_field":
        raise ScenarioError(
            f"{path}.film.compressive_fraction",
            f"goes with law = 'tension_field'; the law is '{robot.film.law}'",
        )
    check_rings(robot.base, robot, f"{path}.base")
    _check_unique((cable.name for cable in robot.cables), f"{path}.cable")
    for cable in robot.cables:
        _check_cable(cable, robot, f"{path}.cable.{cable.name}")
    check_attachments(robot, path)


def check_attachments(robot: SoftRobotTable, path: str) -> None:
    """Check what a soft robot carries on its tip; `path` is that of the robot's table.

    Raises:
        ScenarioError: the first rule that is broken.
    """
    _check_unique((entry.name for entry in robot.attachments), f"{path}.attach")
    for entry in robot.attachments:
        where, part = f"{path}.attach.{entry.name}", entry.robot
        check_soft_robot(part, f"{where}.robot")
        if robot.copies is not None:
            raise ScenarioError(where, "cannot stand beside copies, which have no single tip")
        if part.film != robot.film:
            raise ScenarioError(f"{where}.robot.film", f"differs from the film of '{robot.name}'; must not")
        if part.hinge.fold_barrier_rad != robot.hinge.fold_barrier_rad:
            raise ScenarioError(
                f"{where}.robot.hinge.fold_barrier_rad",
                f"{part.hinge.fold_barrier_rad:g} differs from that of '{robot.name}', "
                f"{robot.hinge.fold_barrier_rad:g}; must not",
            )


def _check_cable(cable: CableTable, robot: SoftRobotTable, path: str) -> None:
    sides, units = robot.chamber.sides, robot.chamber.units
    if cable.corner >= sides:
        raise ScenarioError(f"{path}.corner", f"{cable.corner} does not exist; corners 0 to {sides - 1} do")
    first, last = cable.units
    if last > units:
        raise ScenarioError(f"{path}.units", f"unit {last} does not exist; units 1 to {units} do")
    if first >= last:
        raise ScenarioError(f"{path}.units", f"[{first}, {last}] must run from a unit to a later one")
    if (cable.capstan_factor is None) == (cable.friction_coefficient is None):
        given = "neither" if cable.capstan_factor is None else "both"
        raise ScenarioError(path, f"give capstan_factor or friction_coefficient; {given} is given")


def _check_phase(phase: PhaseTable, scenario: Scenario, path: str) -> None:
    robot = scenario.soft_robot
    if phase.duration_s < scenario.clock.tick_s:
        raise ScenarioError(
            f"{path}.duration_s", f"{phase.duration_s:g} is shorter than a tick ({scenario.clock.tick_s:g} s)"
        )
    if phase.cable_tension_N is not None:
        _check_tensions(phase.cable_tension_N, robot.cable_names(), f"{path}.cable_tension_N")
    moves = [key for key in _MOVES if getattr(phase, key) is not None]
    if phase.flange is not None and len(moves) > 1:
        raise ScenarioError(f"{path}.{moves[1]}", "cannot stand beside flange, which already gives the pose")
    if phase.flange_shake is not None:
        _check_shake(phase, phase.flange_shake.frequency_Hz, path)
    if phase.tip_target is not None:
        _check_tip_target(phase.tip_target, phase, moves, robot, path)


def _check_shake(phase: PhaseTable, frequency_Hz: float, path: str) -> None:
    if phase.ramp != "linear":
        raise ScenarioError(f"{path}.ramp", f"flange_shake needs ramp = 'linear'; it is '{phase.ramp}'")
    if phase.duration_s * frequency_Hz < 3.0:
        raise ScenarioError(
            f"{path}.duration_s", f"{phase.duration_s:g} is shorter than 3 periods of flange_shake"
        )


def _check_tip_target(
    target: TipTargetTable, phase: PhaseTable, moves: Sequence[str], robot: SoftRobotTable, path: str
) -> None:
    where = f"{path}.tip_target"
    if (target.position_m is None) == (target.height_m is None):
        given = "neither" if target.position_m is None else "both"
        raise ScenarioError(where, f"give position_m or height_m; {given} is given")
    if moves:
        raise ScenarioError(f"{path}.{moves[0]}", "cannot stand beside tip_target in one phase")
    if target.reach_with != "cables":
        if target.height_m is not None:
            raise ScenarioError(f"{where}.height_m", "needs reach_with = 'cables'")
        return
    if not robot.cables:
        raise ScenarioError(f"{where}.reach_with", f"soft robot '{robot.name}' has no cables")
    if phase.cable_tension_N is not None:
        raise ScenarioError(f"{path}.cable_tension_N", "cannot stand beside a target reached with cables")


def _check_tensions(tensions: Sequence[float], cables: Sequence[str], path: str) -> None:
    if len(tensions) != len(cables):
        names = ", ".join(cables) or "none"
        raise ScenarioError(path, f"has {len(tensions)} entries; there are {len(cables)} cables: {names}")


def _check_unique(names: Iterable[str], path: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ScenarioError(f"{path}.{name}", "the name is used twice; names must differ")
        seen.add(name)
