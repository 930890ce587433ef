"""Rules that tie the tables of a scenario together. The rules of a single table are in the class of that
table.
"""

from collections.abc import Iterable, Mapping
from typing import Final

from cosim.base.resources import list_arms
from cosim.config import arm_files, device_rules, gas_rules
from cosim.config.device_rules import unknown_cables
from cosim.config.schema import objects, soft_robot, stack
from cosim.config.schema.given_body import AnySoftRobot, GivenBodyTable
from cosim.config.schema.phase import (
    CELL_KEYS,
    JOINT_KEYS,
    SETPOINTS,
    ForceTable,
    PhaseTable,
    StartTable,
    SupportTable,
)
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.settings import FrictionPairTable
from cosim.config.toml.keys import listing, matching, unknown_name_message
from cosim.config.toml.quantities import OneOrByName
from cosim.config.toml.rules import Fault, Faults, Violations, check, rule, rules_of
from cosim.errors import ScenarioError

MOST_TRIANGLES: Final = 200_000
MOST_TICKS: Final = 1_000_000_000
MOST_INCREMENTS: Final = 10_000_000
MOST_SOLIDS: Final = 2_000
_REFINE_MAX: Final = 4
_MOTIONS: Final = ("flange", "flange_turn", "flange_shift_m", "tip_path", *JOINT_KEYS)
_NEEDS: Final = {"section": "a stack of units", "refined": "a geometry that can be drawn finer"}
_TAKE: Final = "use fidelity = 'lumped'"


def check_scenario(scenario: Scenario, faults: Faults) -> None:
    """Check a scenario's rules, such as names that must exist and lengths that must agree.

    Args:
        scenario: whose values are within their types and bounds.
        faults: gets the broken rules.
    """
    check(scenario, "", None, _RULES, faults)


def check_ends(scenario: Scenario) -> None:
    """Check that a scenario ends, that is, that it has phases.

    Raises:
        ScenarioError: it has none.
    """
    if scenario.endless:
        raise ScenarioError(
            "phase",
            "is missing: the scenario holds its start without end; give a [[phase]] with a duration_s, or "
            "step and command it with cosim.Simulation",
        )


def file_of(scenario: Scenario, what: str) -> soft_robot.SoftRobotTable:
    """Return the table of a scenario's soft robot.

    Args:
        scenario: checked.
        what: needs the table, for the message.

    Raises:
        ScenarioError: the soft body is given as arrays, so it has no table.
    """
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        raise ScenarioError(
            "soft_robot", f"'{robot.name}' is given as arrays; {what} needs a soft robot's file"
        )
    return robot


@rule
def _the_arm_is_known(scenario: Scenario) -> Violations:
    if scenario.robot not in (*list_arms(), NO_ARM) and not arm_files.is_arm_path(scenario.robot):
        yield "robot", arm_files.unknown_arm(scenario.robot, (NO_ARM,))


@rule
def _without_phases_it_is_stepped(scenario: Scenario) -> Violations:
    if scenario.endless and scenario.mode != "dynamic":
        yield Fault(
            "mode",
            f"'{scenario.mode}' follows the increments of phases, and there is no [[phase]]; give one, or "
            "mode = 'dynamic', which cosim.Simulation steps and commands",
        )


@rule
def _no_object_has_its_name(wire: objects.WireTable, scenario: Scenario) -> Violations:
    if wire.name in [entry.name for entry in scenario.objects]:
        yield "", "the name is used twice; names must differ"


@rule
def _stacks_alone_have_other_models(scenario: Scenario) -> Violations:
    """Fidelities and switches that need a stack of units are refused for other soft bodies."""
    robot, fidelity = scenario.soft_robot, scenario.fidelity
    given = isinstance(robot, GivenBodyTable)
    if isinstance(robot, soft_robot.SoftRobotTable) and robot.all_stacks:
        if fidelity == "refined" and robot.stack and robot.stack.refine >= _REFINE_MAX:
            yield Fault(
                "fidelity",
                "'refined' is one refinement more than soft_robot.stack.refine, which is at its bound of "
                f"{_REFINE_MAX} already",
            )
        return
    body = f"'{robot.name}' is {'given as arrays' if given else 'not drawn as a stack of units alone'}"
    if fidelity in _NEEDS:
        yield Fault(
            "fidelity",
            f"'{fidelity}' needs {_NEEDS[fidelity]}; the soft body {body}: take 'lumped' or 'rigid'",
        )
    elif scenario.model.published:
        yield "model.published", f"is true; the paper's model is one of stacks of units, {body}"
    elif not scenario.model.all_hinges:
        yield "model.all_hinges", f"is false; the published hinges are those of stacks, {body}"


@rule
def _a_given_body_is_closed_as_given(scenario: Scenario) -> Violations:
    robot, closed = scenario.soft_robot, scenario.model.closed
    if isinstance(robot, GivenBodyTable) and closed != robot.closed:
        yield Fault(
            "model.closed",
            f"is {str(closed).lower()}; the soft body '{robot.name}' is given with closed = {robot.closed}",
        )


@rule
def _a_rigid_one_is_closed(scenario: Scenario) -> Violations:
    if scenario.fidelity == "rigid" and not scenario.model.closed:
        yield "fidelity", "'rigid' needs model.closed = true: it leaves out how an open chamber's gas pushes"


@rule
def _a_rigid_one_is_held(phase: PhaseTable, scenario: Scenario) -> Violations:
    if scenario.fidelity == "rigid":
        for key, given in (("release", phase.release), ("support", phase.supports)):
            if given:
                yield key, "cannot be combined with fidelity = 'rigid': every node is held"


@rule
def _a_section_model_is_of_one_stack(scenario: Scenario) -> Violations:
    robot = scenario.soft_robot
    if scenario.fidelity != "section" or isinstance(robot, GivenBodyTable):
        return
    if robot.attachments:
        yield "soft_robot.attach", f"has no section model: it is of one stack of units; {_TAKE}"
    if robot.base != (stack.FIRST_RING,):
        yield (
            "soft_robot.base",
            f"is {list(robot.base)}; a section model needs ['{stack.FIRST_RING}'] alone; {_TAKE}",
        )
    for cable in [cable for cable in robot.cables if cable.eyelet_loss_N > 0.0][:1]:
        yield Fault(
            f"soft_robot.cable.{cable.name}.eyelet_loss_N",
            f"is not in a section model, whose cables lose a share of their tension one way; {_TAKE}, or 0",
        )


@rule
def _copies_of_a_section_model_have_one_pressure(scenario: Scenario) -> Violations:
    robot = scenario.soft_robot
    if scenario.fidelity != "section" or isinstance(robot, GivenBodyTable) or not robot.copies:
        return
    settings: list[tuple[str, OneOrByName[float] | None]] = [
        ("start.pressure_Pa", scenario.start.pressure_Pa)
    ]
    settings += [(f"phase.{phase.name}.pressure_Pa", phase.pressure_Pa) for phase in scenario.phases]
    for key, given in settings:
        values = tuple(given.values()) if isinstance(given, Mapping) else given
        if isinstance(values, tuple) and (len(values) < robot.copies.count or len(set(values)) > 1):
            yield key, f"is not alike for all copies, as their section models need it; {_TAKE}"
    for phase in scenario.phases:
        gas = tuple(phase.gas.values()) if isinstance(phase.gas, Mapping) else phase.gas
        if gas is not None and "sealed" in (gas if isinstance(gas, tuple) else (gas,)):
            yield f"phase.{phase.name}.gas", f"is sealed; section models of copies need pressures; {_TAKE}"


@rule
def _a_section_model_is_held_by_frames(phase: PhaseTable, scenario: Scenario) -> Violations:
    robot = scenario.soft_robot
    if scenario.fidelity != "section":
        return
    if phase.supports:
        yield "support", f"is not in a section model; {_TAKE}"
    if isinstance(robot, GivenBodyTable) or robot.stack is None:
        return  # is refused by itself
    frames = robot.stack.frame_rings()
    for key in ("clamp", "release"):
        for ring in [ring for ring in getattr(phase, key) if ring not in frames][:1]:
            yield key, f"names '{ring}'; a section model holds outer rings and the tip only; {_TAKE}"


@rule
def _the_mesh_is_not_too_large(scenario: Scenario) -> Violations:
    finer = scenario.fidelity == "refined"
    triangles = scenario.soft_robot.triangles * (4 if finer else 1)
    if triangles > MOST_TRIANGLES:
        also = ", fidelity = 'refined'" if finer else ""
        yield Fault(
            "soft_robot.stack",
            f"makes {triangles:,} triangles, copies and attachments counted; at most {MOST_TRIANGLES:,} are "
            f"allowed: take fewer units, sides, refine{also}",
        )


@rule
def _there_are_not_too_many_solids(scenario: Scenario) -> Violations:
    solids = sum(max(1, bool(entry.shape) + len(entry.parts)) for entry in scenario.objects)
    if solids > MOST_SOLIDS:
        yield "object", f"makes {solids} solids in all; at most {MOST_SOLIDS} are allowed"


@rule
def _there_are_not_too_many_segments(scenario: Scenario) -> Violations:
    segments = sum(wire.segments for wire in scenario.wires)
    if segments > MOST_SOLIDS:
        yield "wire", f"makes {segments} segments in all; at most {MOST_SOLIDS} are allowed"


@rule
def _it_ends_within_reach(scenario: Scenario) -> Violations:
    """The number of ticks or increments is bounded; the message names the phase with most of them."""
    if scenario.endless:
        return
    quasistatic, tick_s = scenario.mode == "quasistatic", scenario.clock.tick_s
    counts = [p.increments if quasistatic else (p.duration_s + p.settle_s) / tick_s for p in scenario.phases]
    most, what = (MOST_INCREMENTS, "increments") if quasistatic else (MOST_TICKS, "ticks")
    if sum(counts) > most:
        phase = scenario.phases[max(range(len(counts)), key=counts.__getitem__)]
        key = (
            "increments" if quasistatic else "duration_s" if phase.duration_s > phase.settle_s else "settle_s"
        )
        yield Fault(
            f"phase.{phase.name}.{key}",
            f"all phases make {sum(counts):.3g} {what}; at most {most:g} are allowed",
        )


@rule
def _a_phase_lasts_a_tick(phase: PhaseTable, scenario: Scenario) -> Violations:
    tick_s = scenario.clock.tick_s
    if phase.duration_s < tick_s:
        yield "duration_s", f"{phase.duration_s:g} is shorter than a tick ({tick_s:g} s)"


@rule
def _every_cable_has_a_tension(table: PhaseTable | StartTable, scenario: Scenario) -> Violations:
    tensions, cables = table.cable_tension_N, scenario.soft_robot.cable_names()
    if not isinstance(tensions, tuple) or len(tensions) == len(cables):  # a table has been refused before
        return
    if tensions or isinstance(table, PhaseTable):
        yield Fault(
            "cable_tension_N",
            f"has {len(tensions)} entries; there are {len(cables)} cables: {listing(cables)}",
        )


@rule
def _cables_reach_a_target(phase: PhaseTable, scenario: Scenario) -> Violations:
    robot, target = scenario.soft_robot, phase.tip_target
    if target is not None and target.reach_with == "cables" and not robot.cable_names():
        yield "tip_target.reach_with", f"soft robot '{robot.name}' has no cables"


@rule
def _objects_hang_on_others(entry: objects.ObjectTable, scenario: Scenario) -> Violations:
    names = tuple(each.name for each in scenario.objects)
    for key, joint in (("hinge", entry.hinge), ("slide", entry.slide)):
        if joint is not None and joint.parent is not None and joint.parent not in names:
            yield f"{key}.parent", unknown_name_message("object", joint.parent, names)


@rule
def _none_hangs_on_itself(entry: objects.ObjectTable, scenario: Scenario) -> Violations:
    joints = {each.name: each.hinge or each.slide for each in scenario.objects}
    line: list[str] = [entry.name]
    while (joint := joints.get(line[-1])) is not None and joint.parent is not None:
        if joint.parent in line:
            yield "", f"hangs on itself: {' on '.join([*line, joint.parent])}"
            return
        line.append(joint.parent)


@rule
def _wires_are_tied_to_objects(wire: objects.WireTable, scenario: Scenario) -> Violations:
    names = tuple(entry.name for entry in scenario.objects)
    for key, held in (("first", wire.first), ("last", wire.last)):
        if held is not None and held not in names:
            yield key, unknown_name_message("object", held, names)


@rule
def _a_cell_is_there_to_be_driven(phase: PhaseTable, scenario: Scenario) -> Violations:
    for key in CELL_KEYS:
        if getattr(phase, key) is not None:
            if scenario.scene is None:
                yield key, "needs a cell with a joint of that name: [scene] mjcf"
            elif scenario.mode == "quasistatic":
                yield key, "needs mode = 'dynamic': in statics a cell stands still"


@rule
def _without_an_arm_nothing_is_around(scenario: Scenario) -> Violations:
    if scenario.robot == NO_ARM:
        given = {"object": scenario.objects, "scene": scenario.scene, "arm_base": scenario.arm_base}
        given |= {f"start.{key}": getattr(scenario.start, key) for key in JOINT_KEYS}
        for key in [key for key, value in given.items() if value]:
            yield key, f"needs an arm; robot is '{NO_ARM}'"


@rule
def _an_arm_moves_or_supports_hold(phase: PhaseTable, scenario: Scenario) -> Violations:
    if scenario.robot != NO_ARM:
        if phase.supports:
            yield "support", f"needs robot = '{NO_ARM}'; on an arm, use clamp"
        return
    for key in _MOTIONS:
        if getattr(phase, key) is not None:
            yield key, f"needs an arm; robot is '{NO_ARM}', which holds the base"
    if phase.tip_target is not None and phase.tip_target.reach_with != "cables":
        yield "tip_target.reach_with", f"must be 'cables': robot is '{NO_ARM}', which holds the base"


def _expanded(rings: Iterable[str], robot: AnySoftRobot) -> set[str]:
    known = robot.ring_names()
    return {name for ring in rings for name in matching(ring, known)}


@rule
def _something_holds_it(scenario: Scenario) -> Violations:
    robot = scenario.soft_robot
    held, supported = _expanded(robot.base, robot), False
    for phase in scenario.phases:
        for ring in [ring for ring in phase.release if not _expanded([ring], robot) <= held][:1]:
            yield f"phase.{phase.name}.release", f"'{ring}' is not held; held are: {listing(sorted(held))}"
        held = held - _expanded(phase.release, robot) | _expanded(phase.clamp, robot)
        supported = supported or bool(phase.supports)
        if not held and not supported:
            yield f"phase.{phase.name}.release", "lets go of all that holds the soft robot; support it"


def _unknown_rings(rings: Iterable[str], scenario: Scenario, key: str) -> Violations:
    known = scenario.soft_robot.ring_names()
    for ring in [ring for ring in rings if not matching(ring, known)][:1]:
        yield key, unknown_name_message("ring", ring, known)


@rule
def _rings_are_there(phase: PhaseTable, scenario: Scenario) -> Violations:
    yield from _unknown_rings(phase.release, scenario, "release")
    yield from _unknown_rings(phase.clamp, scenario, "clamp")


@rule
def _nodes_are_there(group: SupportTable | ForceTable, scenario: Scenario) -> Violations:
    robot = scenario.soft_robot
    yield from _unknown_rings(group.rings, scenario, "rings")
    rings = _expanded(group.rings, robot)
    if group.corners is None or not rings:
        return
    sides = min(map(robot.sides_of, rings))
    if not group.corners:
        yield "corners", "is empty; leave it out for all nodes of the rings"
    elif not sides:
        yield "corners", "are of stacks of units; name a ring of these nodes alone"
    for corner in [corner for corner in group.corners if not 0 <= corner < sides][:1] if sides else ():
        yield "corners", f"{corner} does not exist; corners 0 to {sides - 1} do"


@rule
def _friction_is_between_known_bodies(pair: FrictionPairTable, scenario: Scenario) -> Violations:
    palm = () if scenario.soft_robot.palm is None else ("palm",)
    around = [each.name for each in scenario.objects] + [wire.name for wire in scenario.wires]
    names = ("film", "floor", *palm, *around)
    for name in [name for name in pair.between if name not in names][:1]:
        yield "between", unknown_name_message("body", name, names)
    if pair.between == ("film", "film"):
        yield "between", "of film on film, set contact.self_friction"


@rule
def _devices_have_time(scenario: Scenario) -> Violations:
    if scenario.mode == "dynamic":
        return
    names = [f"pump.{entry.name}" for entry in scenario.pumps]
    names += [f"winch.{entry.name}" for entry in scenario.winches]
    names += [f"controller.{entry.name}" for entry in scenario.controllers]
    names += [f"sensor.{entry.name}" for entry in scenario.sensors]
    for key in names[:1]:
        yield key, f"acts in time: needs mode = 'dynamic'; the mode is '{scenario.mode}'"


@rule
def _commands_stand_alone(scenario: Scenario) -> Violations:
    """Command sources are refused with devices, cable lengths and tip targets, which they would change."""
    if not scenario.commands:
        return
    lengths = any(phase.commands_lengths for phase in scenario.phases)
    if scenario.pumps or scenario.winches or scenario.controllers or lengths:
        yield Fault(
            "command.1",
            "cannot be combined with pumps, winches, controllers or cable lengths: they follow and report "
            "the commands of the phases, not these changes; let a controller command instead",
        )
    elif any(phase.tip_key is not None for phase in scenario.phases):
        yield "command.1", "cannot be combined with a tip target or path, which is planned without it"


@rule
def _targets_come_before_what_acts(scenario: Scenario) -> Violations:
    """A tip target is planned before the run, so no device may change the soft robot before it."""
    moved, pumped = False, False
    followers = {entry.name for entry in scenario.controllers if entry.follows_tip}
    for phase in scenario.phases:
        moved = moved or phase.commands_lengths or bool(phase.acting().keys() - followers)
        pumped = pumped or phase.pump_pressure_Pa is not None
        if phase.tip_key is not None and (moved or pumped):
            cause = "pump" if pumped else "commanded cable length or controller"
            yield Fault(
                f"phase.{phase.name}.{phase.tip_key}",
                f"is planned before the run, which cannot know what a {cause} has done by then; put it into "
                "a phase before the first of these",
            )
            return


@rule
def _lengths_are_of_cables(phase: PhaseTable, scenario: Scenario) -> Violations:
    yield from unknown_cables(phase.cable_length_m or (), scenario, "cable_length_m")
    yield from unknown_cables(phase.cable_shortening_m or (), scenario, "cable_shortening_m")


@rule
def _a_rigid_one_has_no_lengths(phase: PhaseTable, scenario: Scenario) -> Violations:
    """With fidelity = "rigid" no cable is commanded by length: its route does not change."""
    if scenario.fidelity != "rigid":
        return
    by_length = {entry.name for entry in scenario.controllers if entry.commands == "cable_shortening_m"}
    for key in ("cable_length_m", "cable_shortening_m", *SETPOINTS):
        given = getattr(phase, key) or {}
        if given and (key not in SETPOINTS or by_length & set(given)):
            yield Fault(
                key,
                "commands cable lengths, while fidelity = 'rigid' keeps its shape, and with it the routes of "
                "all cables; take 'lumped'",
            )
            return


_RULES: Final = (*rules_of(globals()), *gas_rules.GAS_RULES, *device_rules.DEVICE_RULES)
