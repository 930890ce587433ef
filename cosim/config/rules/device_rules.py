"""Rules on cable lengths, pumps, winches and controllers, and on what cannot stand beside them."""

from __future__ import annotations

from collections.abc import Iterable

from cosim.config.rules.gas_rules import gas_rules
from cosim.config.schema.devices import ControllerTable, PumpTable
from cosim.config.schema.given_body import AnySoftRobot
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.faults import Faults
from cosim.config.toml.registered_kinds import check_registered
from cosim.config.toml.suggestions import listing, unknown_name_message
from cosim.errors import ScenarioError

SETPOINTS = {"control_bending_angle_rad": "bending_angle_rad", "control_tip_height_m": "tip_height_m"}
"""Key of a phase -> what the controllers that it names measure."""

_NEEDED = {"bang_bang": ("increment",), "pi": ("proportional_gain", "integral_gain_per_s"), "python": ()}
_PERIOD_ROUNDING = 1e-6
_WITHOUT_LENGTHS = {"rigid": "keeps its shape, and with it the routes of all cables"}


def check_devices(scenario: Scenario, faults: Faults) -> None:
    """Check devices, and what phases ask of them.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        _check_mode(scenario)
    with faults:
        for pump in scenario.pumps:
            with faults:
                _check_pump(pump, scenario.soft_robot, f"pump.{pump.name}", faults)
    with faults:
        _check_winches(scenario, scenario.soft_robot.cable_names(), faults)
    with faults:
        for controller in scenario.controllers:
            with faults:
                _check_controller(controller, scenario, f"controller.{controller.name}", faults)
    with faults:
        for index, phase in enumerate(scenario.phases):
            with faults:
                path = f"phase.{phase.name}"
                for check in (_check_lengths, _check_fidelity, _check_control):
                    with faults:
                        check(phase, scenario, path)
                _check_pumping(phase, index, scenario, path, faults)
    with faults:
        _check_commands(scenario)
    _check_targets(scenario)


def _check_commands(scenario: Scenario) -> None:
    """Check that sources of commands are known, and stand beside nothing that they would make untrue."""
    for place, entry in enumerate(scenario.commands, start=1):
        path = f"command.{place}"
        check_registered(entry, path)
        if (
            scenario.pumps
            or scenario.winches
            or scenario.controllers
            or any(map(uses_lengths, scenario.phases))
        ):
            raise ScenarioError(
                path,
                "cannot stand beside pumps, winches, controllers or cable lengths: they follow and report "
                "what the phases ask for, not what this makes of it; let a controller command instead",
            )
        if any(phase.tip_key is not None for phase in scenario.phases):
            raise ScenarioError(path, "cannot stand beside a tip target or path, which is planned without it")


def _check_targets(scenario: Scenario) -> None:
    """Check that no tip target comes after what the run alone can know."""
    moved, pumped = False, False
    for phase in scenario.phases:
        moved = moved or uses_lengths(phase) or bool(acting(phase))
        pumped = pumped or phase.pump_pressure_Pa is not None
        if phase.tip_key is not None and (moved or pumped):
            cause = "pump" if pumped else "commanded cable length or controller"
            raise ScenarioError(
                f"phase.{phase.name}.{phase.tip_key}",
                f"is planned before the run, which cannot know what a {cause} has done by then; put it into "
                "a phase before the first of these",
            )


def uses_lengths(phase: PhaseTable) -> bool:
    """Return whether a phase commands cable lengths."""
    return phase.cable_length_m is not None or phase.cable_shortening_m is not None


def acting(phase: PhaseTable) -> dict[str, float | None]:
    """Return the controllers that act in a phase, with their setpoints; None for one without."""
    named: dict[str, float | None] = dict.fromkeys(phase.control)
    for key in SETPOINTS:
        named.update(getattr(phase, key) or {})
    return named


def _check_mode(scenario: Scenario) -> None:
    if scenario.mode == "dynamic":
        return
    for kind, devices in (
        ("pump", scenario.pumps), ("winch", scenario.winches), ("controller", scenario.controllers)
    ):  # fmt: skip
        for device in devices:
            raise ScenarioError(
                f"{kind}.{device.name}",
                f"acts in time: needs mode = 'dynamic'; the mode is '{scenario.mode}'",
            )


def _check_pump(pump: PumpTable, robot: AnySoftRobot, path: str, faults: Faults) -> None:
    with faults:
        if pump.vent_above_Pa is not None and pump.vent_kg_s_Pa == 0.0:
            raise ScenarioError(
                f"{path}.vent_kg_s_Pa", "is missing: the valve of vent_above_Pa lets nothing through"
            )
    names = robot.chamber_names()
    if pump.chamber is None and len(names) > 1:
        raise ScenarioError(f"{path}.chamber", f"is missing; there are: {listing(names)}")
    if pump.chamber is not None and pump.chamber not in names:
        raise ScenarioError(f"{path}.chamber", unknown_name_message("chamber", pump.chamber, names))


def _check_cables(named: Iterable[str], cables: tuple[str, ...], path: str) -> None:
    for name in named:
        if name not in cables:
            raise ScenarioError(path, unknown_name_message("cable", name, cables))


def _check_winches(scenario: Scenario, cables: tuple[str, ...], faults: Faults) -> None:
    for winch in scenario.winches:
        with faults:
            _check_cables(winch.cables, cables, f"winch.{winch.name}.cables")
    taken: dict[str, str] = {}
    for winch in scenario.winches:
        path = f"winch.{winch.name}.cables"
        for name in winch.cables:
            if name in taken:
                raise ScenarioError(path, f"cable '{name}' is wound by winch '{taken[name]}' already")
            taken[name] = winch.name


def _check_controller(controller: ControllerTable, scenario: Scenario, path: str, faults: Faults) -> None:
    with faults:
        _check_period(controller.period_s, scenario.clock.tick_s, f"{path}.period_s")
    with faults:
        cables = scenario.soft_robot.cable_names()
        _check_cables(controller.cables, cables, f"{path}.cables")
        if not controller.cables and controller.kind != "python":
            raise ScenarioError(f"{path}.cables", f"is missing; there are: {listing(cables)}")
    for key in _NEEDED[controller.kind]:
        with faults:
            if getattr(controller, key) is None:
                raise ScenarioError(f"{path}.{key}", f"is missing; kind '{controller.kind}' needs it")
    if controller.kind != "python":
        _check_output(controller, path, faults)


def _check_period(period_s: float, tick_s: float, path: str) -> None:
    ticks = period_s / tick_s
    if round(ticks) < 1 or abs(ticks - round(ticks)) > _PERIOD_ROUNDING * ticks:
        raise ScenarioError(path, f"{period_s:g} must be a whole number of ticks of {tick_s:g} s")


def _check_output(controller: ControllerTable, path: str, faults: Faults) -> None:
    with faults:
        if controller.output_max is not None and controller.output_max <= controller.output_min:
            raise ScenarioError(
                f"{path}.output_max",
                f"{controller.output_max:g} must be above output_min, {controller.output_min:g}",
            )
    if controller.commands == "cable_tension_N" and controller.output_min < 0.0:
        raise ScenarioError(
            f"{path}.output_min", f"{controller.output_min:g} N: a cable cannot push, give 0 or more"
        )


def _check_lengths(phase: PhaseTable, scenario: Scenario, path: str) -> None:
    cables = scenario.soft_robot.cable_names()
    lengths, shortenings = phase.cable_length_m or {}, phase.cable_shortening_m or {}
    for key, given in (("cable_length_m", lengths), ("cable_shortening_m", shortenings)):
        _check_cables(given, cables, f"{path}.{key}")
        if given and phase.cable_tension_N is not None:
            raise ScenarioError(
                f"{path}.{key}", "cannot stand beside cable_tension_N, which commands the same cables"
            )
    for name in lengths:
        if name in shortenings:
            raise ScenarioError(
                f"{path}.cable_shortening_m.{name}", "cannot stand beside cable_length_m of the same cable"
            )


def _check_fidelity(phase: PhaseTable, scenario: Scenario, path: str) -> None:
    """Check that cables are commanded by length only where the soft robot's model knows lengths."""
    reason = _WITHOUT_LENGTHS.get(scenario.fidelity)
    if reason is None:
        return
    by_length = {entry.name for entry in scenario.controllers if entry.commands == "cable_shortening_m"}
    for key in ("cable_length_m", "cable_shortening_m", *SETPOINTS):
        given = getattr(phase, key) or {}
        if given and (key not in SETPOINTS or by_length & set(given)):
            raise ScenarioError(
                f"{path}.{key}",
                f"commands cable lengths, while fidelity = '{scenario.fidelity}' {reason}; take 'lumped'",
            )


def _check_pumping(phase: PhaseTable, index: int, scenario: Scenario, path: str, faults: Faults) -> None:
    chambers = scenario.soft_robot.chamber_names()
    pumps = {pump.name: pump for pump in scenario.pumps}
    for name in phase.pump_pressure_Pa or {}:
        where = f"{path}.pump_pressure_Pa.{name}"
        with faults:
            if name not in pumps:
                raise ScenarioError(where, unknown_name_message("pump", name, tuple(pumps)))
            chamber = pumps[name].chamber or chambers[0]
            if chamber in chambers and not gas_rules(scenario)[index][chambers.index(chamber)].sealed:
                raise ScenarioError(where, "needs gas = 'sealed': a pump changes the amount of a trapped gas")


def _check_control(phase: PhaseTable, scenario: Scenario, path: str) -> None:
    known = {controller.name: controller for controller in scenario.controllers}
    moved = dict.fromkeys(phase.cable_length_m or {}, "cable_length_m or cable_shortening_m")
    moved |= dict.fromkeys(phase.cable_shortening_m or {}, "cable_length_m or cable_shortening_m")
    for key in ("control", *SETPOINTS):
        for name in getattr(phase, key) or ():
            where = f"{path}.{key}" if key == "control" else f"{path}.{key}.{name}"
            if name not in known:
                raise ScenarioError(where, unknown_name_message("controller", name, tuple(known)))
            controller = known[name]
            if key in SETPOINTS and controller.kind != "python" and controller.measures != SETPOINTS[key]:
                raise ScenarioError(where, f"controller '{name}' measures {controller.measures}")
            if key == "control" and controller.kind != "python":
                right = next(k for k, quantity in SETPOINTS.items() if quantity == controller.measures)
                raise ScenarioError(where, f"'{name}' needs a setpoint: give {right} = {{ {name} = ... }}")
            if controller.cables and phase.cable_tension_N is not None:
                raise ScenarioError(where, "moves cables that cable_tension_N commands in the same phase")
            for cable in controller.cables:
                if cable in moved:
                    raise ScenarioError(where, f"moves cable '{cable}', which {moved[cable]} moves as well")
                moved[cable] = f"controller '{name}'"
