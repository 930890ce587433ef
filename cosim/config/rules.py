"""Rules that tie tables of a scenario together; those of one table are beside its fields."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final, final

from cosim.base.resources import list_arms
from cosim.config import arm_files, device_rules
from cosim.config.schema import film, objects, soft_robot
from cosim.config.schema.phase import (
    CELL_KEYS,
    JOINT_KEYS,
    SETPOINTS,
    ForceTable,
    PhaseTable,
    StartTable,
    SupportTable,
    given_values,
    values_after,
)
from cosim.config.schema.scenario import NO_ARM, AnySoftRobot, GivenBodyTable, Scenario, unknown_cables
from cosim.config.toml.keys import listing, matching, unknown_name_message
from cosim.config.toml.quantities import OneOrByName
from cosim.config.toml.rules import Fault, Faults, Told, check, rule, rules_of
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
    """Check what single values cannot show: names that must exist, lengths that must agree.

    Args:
        scenario: whose values are right by themselves.
        faults: gets the rules that are broken.
    """
    check(scenario, "", None, _RULES, faults)


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


def file_of(scenario: Scenario, what: str) -> soft_robot.SoftRobotTable:
    """Return the soft robot of a scenario as its file has it.

    Args:
        scenario: checked.
        what: needs it, for the message.

    Raises:
        ScenarioError: it is given as arrays.
    """
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        raise ScenarioError(
            "soft_robot", f"'{robot.name}' is given as arrays; {what} needs a soft robot's file"
        )
    return robot


@rule
def _the_arm_is_known(scenario: Scenario) -> Told:
    if scenario.robot not in (*list_arms(), NO_ARM) and not arm_files.is_arm_path(scenario.robot):
        yield "robot", arm_files.unknown_arm(scenario.robot, (NO_ARM,))


@rule
def _without_phases_it_is_stepped(scenario: Scenario) -> Told:
    if scenario.endless and scenario.mode != "dynamic":
        yield Fault(
            "mode",
            f"'{scenario.mode}' follows the increments of phases, and there is no [[phase]]; give one, or "
            "mode = 'dynamic', which cosim.Simulation steps and commands",
        )


@rule
def _no_object_has_its_name(wire: objects.WireTable, scenario: Scenario) -> Told:
    if wire.name in [entry.name for entry in scenario.objects]:
        yield "", "the name is used twice; names must differ"


@rule
def _stacks_alone_have_other_models(scenario: Scenario) -> Told:
    """A soft body that is not a stack of units is asked for nothing that only a stack has."""
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
def _a_given_body_is_closed_as_given(scenario: Scenario) -> Told:
    robot, closed = scenario.soft_robot, scenario.model.closed
    if isinstance(robot, GivenBodyTable) and closed != robot.closed:
        yield Fault(
            "model.closed",
            f"is {str(closed).lower()}; the soft body '{robot.name}' is given with closed = {robot.closed}",
        )


@rule
def _a_rigid_one_is_closed(scenario: Scenario) -> Told:
    if scenario.fidelity == "rigid" and not scenario.model.closed:
        yield "fidelity", "'rigid' needs model.closed = true: it leaves out how an open chamber's gas pushes"


@rule
def _a_rigid_one_is_held(phase: PhaseTable, scenario: Scenario) -> Told:
    if scenario.fidelity == "rigid":
        for key, given in (("release", phase.release), ("support", phase.supports)):
            if given:
                yield key, "cannot be combined with fidelity = 'rigid': every node is held"


@rule
def _a_section_model_is_of_one_stack(scenario: Scenario) -> Told:
    robot = scenario.soft_robot
    if scenario.fidelity != "section" or isinstance(robot, GivenBodyTable):
        return
    if robot.attachments:
        yield "soft_robot.attach", f"has no section model: it is of one stack of units; {_TAKE}"
    if robot.base != (film.FIRST_RING,):
        yield (
            "soft_robot.base",
            f"is {list(robot.base)}; a section model needs ['{film.FIRST_RING}'] alone; {_TAKE}",
        )
    for cable in [cable for cable in robot.cables if cable.eyelet_loss_N > 0.0][:1]:
        yield Fault(
            f"soft_robot.cable.{cable.name}.eyelet_loss_N",
            f"is not in a section model, whose cables lose a share of their tension one way; {_TAKE}, or 0",
        )


@rule
def _copies_of_a_section_model_have_one_pressure(scenario: Scenario) -> Told:
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
def _a_section_model_is_held_by_frames(phase: PhaseTable, scenario: Scenario) -> Told:
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
def _the_mesh_is_not_too_large(scenario: Scenario) -> Told:
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
def _there_are_not_too_many_solids(scenario: Scenario) -> Told:
    solids = sum(max(1, bool(entry.shape) + len(entry.parts)) for entry in scenario.objects)
    if solids > MOST_SOLIDS:
        yield "object", f"makes {solids} solids in all; at most {MOST_SOLIDS} are allowed"


@rule
def _there_are_not_too_many_segments(scenario: Scenario) -> Told:
    segments = sum(wire.segments for wire in scenario.wires)
    if segments > MOST_SOLIDS:
        yield "wire", f"makes {segments} segments in all; at most {MOST_SOLIDS} are allowed"


@rule
def _it_ends_within_reach(scenario: Scenario) -> Told:
    """Ticks or increments, by the mode, are not too many; the phase that makes most of them is named."""
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
def _a_phase_lasts_a_tick(phase: PhaseTable, scenario: Scenario) -> Told:
    tick_s = scenario.clock.tick_s
    if phase.duration_s < tick_s:
        yield "duration_s", f"{phase.duration_s:g} is shorter than a tick ({tick_s:g} s)"


@rule
def _every_cable_has_a_tension(table: PhaseTable | StartTable, scenario: Scenario) -> Told:
    tensions, cables = table.cable_tension_N, scenario.soft_robot.cable_names()
    if not isinstance(tensions, tuple) or len(tensions) == len(cables):  # a table has been refused before
        return
    if tensions or isinstance(table, PhaseTable):
        yield Fault(
            "cable_tension_N",
            f"has {len(tensions)} entries; there are {len(cables)} cables: {listing(cables)}",
        )


@rule
def _cables_reach_a_target(phase: PhaseTable, scenario: Scenario) -> Told:
    robot, target = scenario.soft_robot, phase.tip_target
    if target is not None and target.reach_with == "cables" and not robot.cable_names():
        yield "tip_target.reach_with", f"soft robot '{robot.name}' has no cables"


@rule
def _objects_hang_on_others(entry: objects.ObjectTable, scenario: Scenario) -> Told:
    names = tuple(each.name for each in scenario.objects)
    for key, joint in (("hinge", entry.hinge), ("slide", entry.slide)):
        if joint is not None and joint.parent is not None and joint.parent not in names:
            yield f"{key}.parent", unknown_name_message("object", joint.parent, names)


@rule
def _none_hangs_on_itself(entry: objects.ObjectTable, scenario: Scenario) -> Told:
    joints = {each.name: each.hinge or each.slide for each in scenario.objects}
    line: list[str] = [entry.name]
    while (joint := joints.get(line[-1])) is not None and joint.parent is not None:
        if joint.parent in line:
            yield "", f"hangs on itself: {' on '.join([*line, joint.parent])}"
            return
        line.append(joint.parent)


@rule
def _wires_are_tied_to_objects(wire: objects.WireTable, scenario: Scenario) -> Told:
    names = tuple(entry.name for entry in scenario.objects)
    for key, held in (("first", wire.first), ("last", wire.last)):
        if held is not None and held not in names:
            yield key, unknown_name_message("object", held, names)


@rule
def _a_cell_is_there_to_be_driven(phase: PhaseTable, scenario: Scenario) -> Told:
    for key in CELL_KEYS:
        if getattr(phase, key) is not None:
            if scenario.scene is None:
                yield key, "needs a cell with a joint of that name: [scene] mjcf"
            elif scenario.mode == "quasistatic":
                yield key, "needs mode = 'dynamic': in statics a cell stands still"


@rule
def _without_an_arm_nothing_is_around(scenario: Scenario) -> Told:
    if scenario.robot == NO_ARM:
        given = {"object": scenario.objects, "scene": scenario.scene, "arm_base": scenario.arm_base}
        given |= {f"start.{key}": getattr(scenario.start, key) for key in JOINT_KEYS}
        for key in [key for key, value in given.items() if value]:
            yield key, f"needs an arm; robot is '{NO_ARM}'"


@rule
def _an_arm_moves_or_supports_hold(phase: PhaseTable, scenario: Scenario) -> Told:
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
def _something_holds_it(scenario: Scenario) -> Told:
    robot = scenario.soft_robot
    held, supported = _expanded(robot.base, robot), False
    for phase in scenario.phases:
        for ring in [ring for ring in phase.release if not _expanded([ring], robot) <= held][:1]:
            yield f"phase.{phase.name}.release", f"'{ring}' is not held; held are: {listing(sorted(held))}"
        held = held - _expanded(phase.release, robot) | _expanded(phase.clamp, robot)
        supported = supported or bool(phase.supports)
        if not held and not supported:
            yield f"phase.{phase.name}.release", "lets go of all that holds the soft robot; support it"


def _unknown_rings(rings: Iterable[str], scenario: Scenario, key: str) -> Told:
    known = scenario.soft_robot.ring_names()
    for ring in [ring for ring in rings if not matching(ring, known)][:1]:
        yield key, unknown_name_message("ring", ring, known)


@rule
def _rings_are_there(phase: PhaseTable, scenario: Scenario) -> Told:
    yield from _unknown_rings(phase.release, scenario, "release")
    yield from _unknown_rings(phase.clamp, scenario, "clamp")


@rule
def _nodes_are_there(group: SupportTable | ForceTable, scenario: Scenario) -> Told:
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


@final
@dataclass(frozen=True)
class GasRule:
    """How the gas of a chamber is given in a phase.

    Args:
        sealed: whether its amount is, instead of its pressure.
        leak_kg_s_Pa: mass lost per second and pascal of gauge pressure.
    """

    sealed: bool = False
    leak_kg_s_Pa: float = 0.0


def gas_rules(scenario: Scenario) -> tuple[tuple[GasRule, ...], ...]:
    """Return the rule in force in every phase for each chamber; what a phase omits stays as it was.

    Raises:
        ScenarioError: a phase names a chamber that does not exist, or gives too few or too many values.
    """
    names = scenario.soft_robot.chamber_names()
    kinds: tuple[str, ...] = ("prescribed",) * len(names)
    leaks, rules = (0.0,) * len(names), []
    for phase in scenario.phases:
        path = f"phase.{phase.name}"
        kinds = values_after(kinds, phase.gas, names, f"{path}.gas")
        leaks = values_after(leaks, phase.leak_kg_s_Pa, names, f"{path}.leak_kg_s_Pa")
        leaks = tuple(leak if kind == "sealed" else 0.0 for leak, kind in zip(leaks, kinds, strict=True))
        pairs = zip(kinds, leaks, strict=True)
        rules.append(tuple(GasRule(kind == "sealed", leak) for kind, leak in pairs))
    return tuple(rules)


def _gas_in(phase: PhaseTable, scenario: Scenario) -> tuple[GasRule, ...]:
    pairs = zip(scenario.phases, gas_rules(scenario), strict=True)
    return next(own for each, own in pairs if each is phase)


def gas_report(scenario: Scenario) -> str:
    """Return in words how the gas is modelled."""
    rules, names = gas_rules(scenario), scenario.soft_robot.chamber_names()
    pairs = zip(scenario.phases, rules, strict=True)
    phases = [phase.name for phase, own in pairs if any(rule.sealed for rule in own)]
    chambers = f"{len(names)} chambers ({', '.join(names)}), " if len(names) > 1 else ""
    if not phases:
        return chambers + "at a given pressure"
    text = f"{chambers}sealed in {', '.join(phases)}: p V^{scenario.gas.exponent:g} stays"
    leaks = max(rule.leak_kg_s_Pa for own in rules for rule in own)
    orifices = len(scenario.gas.orifices)
    text += f", {orifices} orifice{'s' * (orifices > 1)}" if orifices else ""
    return text + (f", leak up to {leaks:g} kg/(s Pa)" if leaks else "")


@rule
def _every_chamber_has_a_value(table: PhaseTable | StartTable, scenario: Scenario) -> Told:
    names = scenario.soft_robot.chamber_names()
    for key in ("gas", "leak_kg_s_Pa", "pressure_Pa"):
        try:
            given_values(getattr(table, key, None), names, key)
        except ScenarioError as error:
            yield from error.faults


@rule
def _gas_is_given_where_it_is_not_sealed(scenario: Scenario) -> Told:
    names, rules = scenario.soft_robot.chamber_names(), gas_rules(scenario)
    pressures = values_after((0.0,) * len(names), scenario.start.pressure_Pa, names, "start.pressure_Pa")
    before = (GasRule(),) * len(names)
    for phase, own in zip(scenario.phases, rules, strict=True):
        given = given_values(phase.pressure_Pa, names, f"phase.{phase.name}.pressure_Pa")
        for was, now, wanted, pressure in zip(before, own, given, pressures, strict=True):
            for key, message in _gas_told(was, now, wanted, pressure, phase, scenario):
                yield f"phase.{phase.name}.{key}", message
        before = own
        pressures = values_after(pressures, phase.pressure_Pa, names, "")


def _gas_told(
    was: GasRule, now: GasRule, wanted: float | None, before_Pa: float, phase: PhaseTable, scenario: Scenario
) -> Told:
    """Yield what is wrong with the gas of one chamber in one phase."""
    if not now.sealed:
        if was.sealed and wanted is None:
            yield (
                "pressure_Pa",
                "is missing: the phase before is sealed, so it has no pressure that could be kept",
            )
        return
    ambient_Pa = scenario.gas.ambient_Pa
    if not scenario.model.closed:
        yield "gas", "'sealed' needs model.closed = true; open ends hold no gas"
    if wanted is not None:
        yield Fault(
            "pressure_Pa",
            "cannot be combined with a sealed gas, whose pressure follows from the volume; set it in a phase "
            "before, or open the chamber with gas = 'prescribed'",
        )
    if not was.sealed and not before_Pa + ambient_Pa > 0.0:
        yield Fault(
            "gas",
            f"seals {before_Pa:g} Pa at an ambient_Pa of {ambient_Pa:g}; "
            "their sum, the absolute pressure, must be above 0",
        )
    if phase.tip_key is not None and now.leak_kg_s_Pa:
        yield Fault(
            phase.tip_key,
            f"cannot be combined with a leak ({now.leak_kg_s_Pa:g} kg/(s Pa)), which takes the tip off its "
            "target; give leak_kg_s_Pa = 0",
        )
    elif phase.tip_key is not None and scenario.gas.orifices:
        yield phase.tip_key, "cannot be combined with an orifice, through which gas flows on at the target"


@rule
def _a_sealed_gas_leaks(phase: PhaseTable, scenario: Scenario) -> Told:
    """A leak is given to sealed chambers; one number for all needs one of them to be sealed."""
    names, setting = scenario.soft_robot.chamber_names(), phase.leak_kg_s_Pa
    if setting is None:
        return
    rules = _gas_in(phase, scenario)
    leaks = given_values(setting, names, f"phase.{phase.name}.leak_kg_s_Pa")
    single = not isinstance(setting, tuple | Mapping) and any(entry.sealed for entry in rules)
    for name, entry, leak in zip(names, rules, leaks, strict=True):
        if leak is not None and not entry.sealed and not single:
            where = f" in {name}" if len(names) > 1 else ""
            yield "leak_kg_s_Pa", f"needs gas = 'sealed'; here the pressure is given{where}"
            return


@rule
def _devices_have_time(scenario: Scenario) -> Told:
    if scenario.mode == "dynamic":
        return
    names = [f"pump.{entry.name}" for entry in scenario.pumps]
    names += [f"winch.{entry.name}" for entry in scenario.winches]
    names += [f"controller.{entry.name}" for entry in scenario.controllers]
    names += [f"sensor.{entry.name}" for entry in scenario.sensors]
    for key in names[:1]:
        yield key, f"acts in time: needs mode = 'dynamic'; the mode is '{scenario.mode}'"


@rule
def _commands_stand_alone(scenario: Scenario) -> Told:
    """Sources of commands stand beside nothing that they would make untrue."""
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
def _targets_come_before_what_acts(scenario: Scenario) -> Told:
    """No tip target comes after what the run alone can know."""
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
def _lengths_are_of_cables(phase: PhaseTable, scenario: Scenario) -> Told:
    yield from unknown_cables(phase.cable_length_m or (), scenario, "cable_length_m")
    yield from unknown_cables(phase.cable_shortening_m or (), scenario, "cable_shortening_m")


@rule
def _a_rigid_one_has_no_lengths(phase: PhaseTable, scenario: Scenario) -> Told:
    """Cables are commanded by length only where the soft robot's model knows lengths."""
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


@rule
def _pumps_act_on_sealed_gas(phase: PhaseTable, scenario: Scenario) -> Told:
    chambers = scenario.soft_robot.chamber_names()
    pumps = {pump.name: pump for pump in scenario.pumps}
    for name in phase.pump_pressure_Pa or {}:
        if name not in pumps:
            yield f"pump_pressure_Pa.{name}", unknown_name_message("pump", name, tuple(pumps))
            continue
        chamber = pumps[name].chamber or chambers[0]
        if chamber in chambers and not _gas_in(phase, scenario)[chambers.index(chamber)].sealed:
            yield Fault(
                f"pump_pressure_Pa.{name}", "needs gas = 'sealed': a pump changes the amount of a trapped gas"
            )


_RULES: Final = (*rules_of(globals()), *device_rules.DEVICE_RULES)
