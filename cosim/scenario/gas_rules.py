"""How the gas is given in every phase of a scenario, and what a scenario cannot ask of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

from cosim.errors import ScenarioError
from cosim.scenario.phase_schema import Phase
from cosim.scenario.schema import Scenario


@final
@dataclass(frozen=True)
class GasRule:
    """How the gas is given in a phase.

    Args:
        sealed: whether its amount is, instead of its pressure.
        leak_kg_s_Pa: mass lost per second and pascal of gauge pressure.
    """

    sealed: bool = False
    leak_kg_s_Pa: float = 0.0


def gas_rules(phases: Sequence[Phase]) -> tuple[GasRule, ...]:
    """Return the rule in force in every phase; what a phase omits stays as it was."""
    rule, rules = GasRule(), []
    for phase in phases:
        sealed = rule.sealed if phase.gas is None else phase.gas == "sealed"
        kept = rule.leak_kg_s_Pa if phase.leak_kg_s_Pa is None else phase.leak_kg_s_Pa
        rule = GasRule(sealed, kept if sealed else 0.0)
        rules.append(rule)
    return tuple(rules)


def check_gas(scenario: Scenario) -> None:
    """Check what the phases ask of the gas.

    Raises:
        ScenarioError: the first rule that is broken.
    """
    was_sealed, pressure_Pa = False, scenario.start.pressure_Pa
    for phase, rule in zip(scenario.phases, gas_rules(scenario.phases), strict=True):
        path = f"phase.{phase.name}"
        if rule.sealed:
            _check_sealed(phase, rule, scenario, path)
            if not was_sealed and not pressure_Pa + scenario.gas.ambient_Pa > 0.0:
                raise ScenarioError(
                    f"{path}.gas",
                    f"seals {pressure_Pa:g} Pa at an ambient_Pa of {scenario.gas.ambient_Pa:g}; "
                    "their sum, the absolute pressure, must be above 0",
                )
        elif phase.leak_kg_s_Pa is not None:
            raise ScenarioError(f"{path}.leak_kg_s_Pa", "needs gas = 'sealed'; here the pressure is given")
        elif was_sealed and phase.pressure_Pa is None:
            raise ScenarioError(
                f"{path}.pressure_Pa", "is missing: the phase before is sealed, so there is none to keep"
            )
        was_sealed = rule.sealed
        pressure_Pa = pressure_Pa if phase.pressure_Pa is None else phase.pressure_Pa


def _check_sealed(phase: Phase, rule: GasRule, scenario: Scenario, path: str) -> None:
    if not scenario.chamber.closed:
        raise ScenarioError(f"{path}.gas", "'sealed' needs chamber.closed = true; open ends hold no gas")
    if phase.pressure_Pa is not None:
        raise ScenarioError(
            f"{path}.pressure_Pa",
            "cannot stand beside a sealed gas, whose pressure follows from the volume; set it in a phase "
            "before, or open the chamber with gas = 'prescribed'",
        )
    if rule.leak_kg_s_Pa and phase.tip_target is not None:
        raise ScenarioError(
            f"{path}.tip_target",
            f"cannot stand beside a leak ({rule.leak_kg_s_Pa:g} kg/(s Pa)), which takes the tip off its "
            "target; give leak_kg_s_Pa = 0",
        )


def gas_report(scenario: Scenario) -> str:
    """Return in words how the gas is modelled."""
    rules = gas_rules(scenario.phases)
    names = [phase.name for phase, rule in zip(scenario.phases, rules, strict=True) if rule.sealed]
    if not names:
        return "at a given pressure"
    text = f"sealed in {', '.join(names)}: p V^{scenario.gas.exponent:g} stays"
    leaks = max(rule.leak_kg_s_Pa for rule in rules)
    return text + (f", leak up to {leaks:g} kg/(s Pa)" if leaks else "")
