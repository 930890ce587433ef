"""Rules on gas, cable lengths, pumps, winches and controllers, and on what excludes what.

How the gas of each chamber is given in every phase of a scenario, and what one cannot ask of it.

Rules on cable lengths, pumps, winches and controllers, and on what cannot stand beside them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import final

from cosim.config.schema.phase import PhaseTable, given_values, values_after
from cosim.config.schema.scenario import AnySoftRobot, ControllerTable, PumpTable, Scenario
from cosim.config.toml.keys import listing, unknown_name_message
from cosim.config.toml.parsing import check_registered
from cosim.config.toml.reading import Faults
from cosim.errors import ScenarioError


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


def check_gas(scenario: Scenario, faults: Faults) -> None:
    """Check what the phases ask of the gas.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    names = scenario.soft_robot.chamber_names()
    with faults:
        _check_orifices(scenario, names, faults)
    with faults:
        given_values(scenario.start.pressure_Pa, names, "start.pressure_Pa")
    for phase in scenario.phases:
        for key in ("gas", "leak_kg_s_Pa", "pressure_Pa"):
            with faults:
                given_values(getattr(phase, key), names, f"phase.{phase.name}.{key}")
    pressures = values_after((0.0,) * len(names), scenario.start.pressure_Pa, names, "start.pressure_Pa")
    before = (GasRule(),) * len(names)
    for phase, rules in zip(scenario.phases, gas_rules(scenario), strict=True):
        path = f"phase.{phase.name}"
        with faults:
            given = given_values(phase.pressure_Pa, names, f"{path}.pressure_Pa")
            for was, rule, wanted in zip(before, rules, given, strict=True):
                if rule.sealed:
                    _check_sealed(phase, rule, wanted, scenario, path)
                elif was.sealed and wanted is None:
                    raise ScenarioError(
                        f"{path}.pressure_Pa",
                        "is missing: the phase before is sealed, so there is none to keep",
                    )
        with faults:
            for was, rule, pressure in zip(before, rules, pressures, strict=True):
                if rule.sealed and not was.sealed:
                    _check_sealing(pressure, scenario.gas.ambient_Pa, path)
        with faults:
            _check_leak(phase, rules, names, path)
        before = rules
        pressures = values_after(pressures, phase.pressure_Pa, names, f"{path}.pressure_Pa")


def _check_sealed(
    phase: PhaseTable, rule: GasRule, pressure_Pa: float | None, scenario: Scenario, path: str
) -> None:
    if not scenario.model.closed:
        raise ScenarioError(f"{path}.gas", "'sealed' needs model.closed = true; open ends hold no gas")
    if pressure_Pa is not None:
        raise ScenarioError(
            f"{path}.pressure_Pa",
            "cannot stand beside a sealed gas, whose pressure follows from the volume; set it in a phase "
            "before, or open the chamber with gas = 'prescribed'",
        )
    if phase.tip_key is None:
        return
    if rule.leak_kg_s_Pa:
        raise ScenarioError(
            f"{path}.{phase.tip_key}",
            f"cannot stand beside a leak ({rule.leak_kg_s_Pa:g} kg/(s Pa)), which takes the tip off its "
            "target; give leak_kg_s_Pa = 0",
        )
    if scenario.gas.orifices:
        raise ScenarioError(
            f"{path}.{phase.tip_key}",
            "cannot stand beside an orifice, through which gas flows on at the target",
        )


def _check_sealing(pressure_Pa: float, ambient_Pa: float, path: str) -> None:
    if not pressure_Pa + ambient_Pa > 0.0:
        raise ScenarioError(
            f"{path}.gas",
            f"seals {pressure_Pa:g} Pa at an ambient_Pa of {ambient_Pa:g}; "
            "their sum, the absolute pressure, must be above 0",
        )


def _check_leak(phase: PhaseTable, rules: tuple[GasRule, ...], names: tuple[str, ...], path: str) -> None:
    """Check that a leak is given to sealed chambers; one number for all needs one of them to be sealed."""
    leaks = given_values(phase.leak_kg_s_Pa, names, f"{path}.leak_kg_s_Pa")
    single = not isinstance(phase.leak_kg_s_Pa, tuple | Mapping) and any(rule.sealed for rule in rules)
    for name, rule, leak in zip(names, rules, leaks, strict=True):
        if leak is not None and not rule.sealed and not single:
            where = f" in {name}" if len(names) > 1 else ""
            raise ScenarioError(
                f"{path}.leak_kg_s_Pa", f"needs gas = 'sealed'; here the pressure is given{where}"
            )


def _check_orifices(scenario: Scenario, names: tuple[str, ...], faults: Faults) -> None:
    for place, orifice in enumerate(scenario.gas.orifices, start=1):
        path = f"gas.orifice.{place}.chambers"
        with faults:
            for name in orifice.chambers:
                if name not in names:
                    raise ScenarioError(path, unknown_name_message("chamber", name, names))
            if orifice.chambers[0] == orifice.chambers[1]:
                raise ScenarioError(path, f"joins '{orifice.chambers[0]}' to itself; name two chambers")


def gas_report(scenario: Scenario) -> str:
    """Return in words how the gas is modelled."""
    rules, names = gas_rules(scenario), scenario.soft_robot.chamber_names()
    phases = [
        phase.name
        for phase, own in zip(scenario.phases, rules, strict=True)
        if any(rule.sealed for rule in own)
    ]
    chambers = f"{len(names)} chambers ({', '.join(names)}), " if len(names) > 1 else ""
    if not phases:
        return chambers + "at a given pressure"
    text = f"{chambers}sealed in {', '.join(phases)}: p V^{scenario.gas.exponent:g} stays"
    leaks = max(rule.leak_kg_s_Pa for own in rules for rule in own)
    orifices = len(scenario.gas.orifices)
    text += f", {orifices} orifice{'s' * (orifices > 1)}" if orifices else ""
    return text + (f", leak up to {leaks:g} kg/(s Pa)" if leaks else "")


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
