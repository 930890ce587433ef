"""How the gas of each chamber is given in every phase, as a pressure or as a sealed amount, and the rules for
it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, final

from cosim.config.schema.named_values import given_values, values_after
from cosim.config.schema.phase import PhaseTable, StartTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import OrificeTable
from cosim.config.toml.keys import unknown_name_message
from cosim.config.toml.rules import Fault, Violations, rule, rules_of
from cosim.errors import ScenarioError


@final
@dataclass(frozen=True)
class GasRule:
    """How the gas of a chamber is given in a phase.

    Args:
        sealed: whether the amount of gas is given; otherwise its pressure is.
        leak_kg_s_Pa: mass lost per second and pascal of gauge pressure.
    """

    sealed: bool = False
    leak_kg_s_Pa: float = 0.0


def gas_rules(scenario: Scenario) -> tuple[tuple[GasRule, ...], ...]:
    """Return the rule of each chamber in every phase; an omitted value stays that of the previous phase.

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
    """Return a phrase that says how the gas is modelled, such as "at a given pressure"."""
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
def _every_chamber_has_a_value(table: PhaseTable | StartTable, scenario: Scenario) -> Violations:
    names = scenario.soft_robot.chamber_names()
    for key in ("gas", "leak_kg_s_Pa", "pressure_Pa"):
        try:
            given_values(getattr(table, key, None), names, key)
        except ScenarioError as error:
            yield from error.faults


@rule
def _gas_is_given_where_it_is_not_sealed(scenario: Scenario) -> Violations:
    names, rules = scenario.soft_robot.chamber_names(), gas_rules(scenario)
    pressures = values_after((0.0,) * len(names), scenario.start.pressure_Pa, names, "start.pressure_Pa")
    before = (GasRule(),) * len(names)
    for phase, own in zip(scenario.phases, rules, strict=True):
        given = given_values(phase.pressure_Pa, names, f"phase.{phase.name}.pressure_Pa")
        for was, now, wanted, pressure in zip(before, own, given, pressures, strict=True):
            for key, message in _gas_violations(was, now, wanted, pressure, phase, scenario):
                yield f"phase.{phase.name}.{key}", message
        before = own
        pressures = values_after(pressures, phase.pressure_Pa, names, "")


def _gas_violations(
    was: GasRule, now: GasRule, wanted: float | None, before_Pa: float, phase: PhaseTable, scenario: Scenario
) -> Violations:
    """Yield the faults of one chamber's gas in one phase.

    Args:
        was: rule of the previous phase.
        now: rule of this phase.
        wanted: pressure that the phase gives [Pa, gauge]; None: it gives none.
        before_Pa: gauge pressure at the end of the previous phase.
        phase: the phase.
        scenario: that it is in.
    """
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
def _a_sealed_gas_leaks(phase: PhaseTable, scenario: Scenario) -> Violations:
    """Only sealed chambers leak; with one number for all chambers at least one must be sealed."""
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
def _an_orifice_joins_two_chambers(orifice: OrificeTable, scenario: Scenario) -> Violations:
    names = scenario.soft_robot.chamber_names()
    for name in [name for name in orifice.chambers if name not in names][:1]:
        yield "chambers", unknown_name_message("chamber", name, names)
    if orifice.chambers[0] == orifice.chambers[1]:
        yield "chambers", f"joins '{orifice.chambers[0]}' to itself; name two chambers"


@rule
def _pumps_act_on_sealed_gas(phase: PhaseTable, scenario: Scenario) -> Violations:
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


GAS_RULES: Final = rules_of(globals())
