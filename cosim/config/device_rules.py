"""Rules that tie pumps, winches, controllers, sensors and cameras to the rest of a scenario."""

from collections.abc import Iterable
from typing import Final

from cosim.config.schema.devices import ControllerTable, PumpTable, WinchTable
from cosim.config.schema.phase import SETPOINTS, PhaseTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.schema.sensors import JOINTS, CameraTable, SensorTable
from cosim.config.toml.keys import listing, unknown_name_message
from cosim.config.toml.rules import Violations, rule, rules_of

_PERIOD_ROUNDING: Final = 1e-6
_RATE_ROUNDING: Final = 1e-9
_READ_BY: Final = {
    "bending_angle_rad": "bending_angle",
    "tip_height_m": "tip_position",
    "tip_position_m": "tip_position",
}
"""By what a controller measures: the kind of sensor that reads it."""


def unknown_cables(named: Iterable[str], scenario: Scenario, key: str) -> Violations:
    """Yield a fault for the first unknown cable that a key names.

    Args:
        named: names of cables.
        scenario: whose soft robot has the cables.
        key: that names them.
    """
    known = scenario.soft_robot.cable_names()
    for name in [name for name in named if name not in known][:1]:
        yield key, unknown_name_message("cable", name, known)


@rule
def _controllers_act_as_named(phase: PhaseTable, scenario: Scenario) -> Violations:
    known = {controller.name: controller for controller in scenario.controllers}
    for key in ("control", *SETPOINTS):
        for name in getattr(phase, key) or ():
            where = key if key == "control" else f"{key}.{name}"
            controller = known.get(name)
            if controller is None:
                yield where, unknown_name_message("controller", name, tuple(known))
            elif controller.kind == "python":
                continue
            elif controller.follows_tip:
                if key != "control":
                    yield where, f"'{name}' follows the tip_path or tip_target; give control = ['{name}']"
                elif phase.tip_key is None:
                    yield where, f"'{name}' follows a tip_path or tip_target; this phase has neither"
            elif key == "control":
                right = next(k for k, quantity in SETPOINTS.items() if quantity == controller.measures)
                yield where, f"'{name}' needs a setpoint: give {right} = {{ {name} = ... }}"
            elif controller.measures != SETPOINTS[key]:
                yield where, f"controller '{name}' measures {controller.measures}"


@rule
def _one_thing_moves_a_cable(phase: PhaseTable, scenario: Scenario) -> Violations:
    known = {controller.name: controller for controller in scenario.controllers}
    lengths = (*(phase.cable_length_m or {}), *(phase.cable_shortening_m or {}))
    moved = dict.fromkeys(lengths, "cable_length_m or cable_shortening_m")
    for key in ("control", *SETPOINTS):
        for name in [name for name in getattr(phase, key) or () if name in known]:
            where, cables = key if key == "control" else f"{key}.{name}", known[name].cables
            if cables and phase.cable_tension_N is not None:
                yield where, "moves cables that cable_tension_N commands in the same phase"
            for cable in [cable for cable in cables if cable in moved][:1]:
                yield where, f"moves cable '{cable}', which {moved[cable]} moves as well"
            moved |= dict.fromkeys(cables, f"controller '{name}'")


@rule
def _a_sensor_measures_what_there_is(sensor: SensorTable, scenario: Scenario) -> Violations:
    robot = scenario.soft_robot
    names = sensor.named(robot.chamber_names(), robot.cable_names())
    if sensor.of and not names:
        yield "of", f"is for chambers and cables; kind '{sensor.kind}' has none of them: leave it out"
    elif len(set(sensor.of)) < len(sensor.of):
        yield "of", "names something twice"
    for name in [name for name in sensor.of if names and name not in names][:1]:
        yield "of", unknown_name_message("chamber" if sensor.kind == "pressure" else "cable", name, names)
    if sensor.kind in JOINTS and scenario.robot == NO_ARM:
        yield "kind", f"'{sensor.kind}' needs an arm; robot = 'none' has no joints"
    if sensor.kind in ("cable_length", "cable_tension") and not names:
        yield "kind", f"'{sensor.kind}' needs cables; the soft robot has none"


@rule
def _a_sensor_has_a_number_for_each_value(sensor: SensorTable, scenario: Scenario) -> Violations:
    robot = scenario.soft_robot
    values = sensor.values(robot.chamber_names(), robot.cable_names())
    for key in ("noise", "bias", "quantum"):
        given = getattr(sensor, key)
        if values is not None and isinstance(given, tuple) and len(given) != len(values):
            names = f" ({listing(values)})" if values[0] else ""
            yield key, f"has {len(given)} entries; the sensor reads {len(values)} values{names}"


@rule
def _a_sensor_samples_at_ticks(sensor: SensorTable, scenario: Scenario) -> Violations:
    tick_s = scenario.clock.tick_s
    if sensor.rate_Hz is not None and sensor.rate_Hz * tick_s > 1.0 + _RATE_ROUNDING:
        yield "rate_Hz", f"{sensor.rate_Hz:g} is more than one sample a tick; at most {1.0 / tick_s:g}"


@rule
def _a_pump_has_a_chamber(pump: PumpTable, scenario: Scenario) -> Violations:
    names = scenario.soft_robot.chamber_names()
    if pump.chamber is None and len(names) > 1:
        yield "chamber", f"is missing; there are: {listing(names)}"
    if pump.chamber is not None and pump.chamber not in names:
        yield "chamber", unknown_name_message("chamber", pump.chamber, names)


@rule
def _a_winch_winds_cables(winch: WinchTable, scenario: Scenario) -> Violations:
    return unknown_cables(winch.cables, scenario, "cables")


@rule
def _one_winch_winds_a_cable(winch: WinchTable, scenario: Scenario) -> Violations:
    wound: dict[str, str] = {}
    for other in scenario.winches:
        for name in other.cables:
            if other is winch and name in wound:
                yield "cables", f"cable '{name}' is wound by winch '{wound[name]}' already"
                return
            wound[name] = other.name
        if other is winch:
            return


@rule
def _one_motor_winds_its_cables_alike(winch: WinchTable, scenario: Scenario) -> Violations:
    if not winch.one_motor:
        return
    for phase in scenario.phases:
        given, lengths = phase.cable_shortening_m or {}, phase.cable_length_m or {}
        changes = {given.get(name) for name in winch.cables}
        if len(changes) > 1 or not set(winch.cables).isdisjoint(lengths):
            yield (
                "one_motor",
                f"is true, and phase '{phase.name}' commands its cables differently; give all of "
                f"{listing(winch.cables)} the same cable_shortening_m",
            )
    for entry in scenario.controllers:
        if entry.commands == "cable_shortening_m" and 0 < len({*winch.cables} & {*entry.cables}) < len(
            {*winch.cables}
        ):
            yield (
                "one_motor",
                f"is true, and controller '{entry.name}' moves only some of its cables; give it all of "
                f"{listing(winch.cables)}",
            )


@rule
def _a_controller_acts_at_ticks(controller: ControllerTable, scenario: Scenario) -> Violations:
    tick_s = scenario.clock.tick_s
    ticks = controller.period_s / tick_s
    if round(ticks) < 1 or abs(ticks - round(ticks)) > _PERIOD_ROUNDING * ticks:
        yield "period_s", f"{controller.period_s:g} must be a whole number of ticks of {tick_s:g} s"


@rule
def _a_tip_is_followed_with_the_flange(controller: ControllerTable, scenario: Scenario) -> Violations:
    if controller.follows_tip != (controller.commands == "flange_twist"):
        yield "commands", "'flange_twist' and measures = 'tip_position_m' go together"
    elif controller.follows_tip and controller.kind != "pi":
        yield "kind", f"is '{controller.kind}'; measures = 'tip_position_m' needs 'pi'"
    elif controller.follows_tip and controller.cables:
        yield "cables", "are not moved by 'flange_twist'; leave them out"
    elif controller.follows_tip and scenario.robot == NO_ARM:
        yield "commands", "'flange_twist' needs an arm; robot is 'none'"


@rule
def _a_controller_moves_cables(controller: ControllerTable, scenario: Scenario) -> Violations:
    yield from unknown_cables(controller.cables, scenario, "cables")
    if not controller.cables and controller.kind != "python" and not controller.follows_tip:
        yield "cables", f"is missing; there are: {listing(scenario.soft_robot.cable_names())}"


@rule
def _controllers_look_through_sensors(controller: ControllerTable, scenario: Scenario) -> Violations:
    kinds = {sensor.name: sensor.kind for sensor in scenario.sensors}
    for name in [name for name in controller.sensors if name not in kinds][:1]:
        yield "sensors", unknown_name_message("sensor", name, tuple(kinds))
        return
    needed = _READ_BY.get(controller.measures)
    read = {kinds[name] for name in controller.sensors}
    if controller.kind != "python" and read and needed not in read:
        yield (
            "sensors",
            f"measures = '{controller.measures}' is read by a sensor of kind '{needed}'; name one",
        )


@rule
def _a_camera_is_on_what_there_is(camera: CameraTable, scenario: Scenario) -> Violations:
    if camera.on == "palm" and (scenario.soft_robot.palm is None or scenario.robot == NO_ARM):
        yield "on", "'palm': there is no palm on a flange; take 'flange', 'tip' or 'world'"


DEVICE_RULES: Final = rules_of(globals())
