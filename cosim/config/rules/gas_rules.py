"""How the gas of each chamber is given in every phase of a scenario, and what one cannot ask of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

from cosim.config.schema.per_chamber import given_values, values_after
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.faults import Faults
from cosim.config.toml.suggestions import unknown_name_message
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
