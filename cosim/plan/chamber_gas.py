"""The gas in the chambers through a run: each at a given pressure, or a sealed amount that may flow."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, final

import numpy as np

from cosim.base.state_check import check_indices
from cosim.config.rules.gas_rules import GasRule
from cosim.config.schema.solver import GasTable
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.plan.robot_command import CommandRamp, SoftCommand
from cosim.soft.elements.gas import SealedGas, exchange, leak


@final
@dataclass(frozen=True)
class ChamberGasState:
    """Where a `ChamberGas` is.

    Args:
        sealed: amount of gas in each chamber; None while its pressure is given.
        pressures_Pa: gauge, of each chamber at the last look.
        rules: of each chamber in the present phase.
        orifices: (chamber, chamber, conductance [kg/(s Pa)]).
    """

    sealed: Annotated[tuple[SealedGas | None, ...], ("c",)]
    pressures_Pa: Annotated[tuple[float, ...], ("c",)]
    rules: Annotated[tuple[GasRule, ...], ("c",)]
    orifices: tuple[tuple[int, int, float], ...]


@final
class ChamberGas:
    """Knows what is in each chamber at present, and puts it into what is planned.

    Args:
        settings: of the gas where it is sealed.
    """

    def __init__(self, settings: GasTable) -> None:
        self._settings = settings
        self._rules: tuple[GasRule, ...] = ()
        self._sealed: list[SealedGas | None] = []
        self._pressures: tuple[float, ...] = ()
        self._orifices: list[tuple[int, int, float]] = []
        self._ramp: CommandRamp | None = None
        self._as_planned = False  # whether nothing in the chambers is other than the ramp has it

    def begin(self, rules: tuple[GasRule, ...], soft: SoftSide) -> None:
        """Begin a phase: seal what is in the chambers, or open them; nothing changes at this instant.

        Args:
            rules: of each chamber.
            soft: in its present shape.

        Raises:
            InputError: there is nothing to seal, as a chamber has no volume.
        """
        self._pressures, self._rules, self._ramp = soft.pressures_Pa, rules, None
        places = {chamber.name: k for k, chamber in enumerate(soft.body.gas_chambers)}
        self._orifices = [
            (places[entry.chambers[0]], places[entry.chambers[1]], entry.conductance_kg_s_Pa)
            for entry in self._settings.orifices
        ]
        before = self._sealed or [None] * len(rules)
        if not any(rule.sealed for rule in rules):
            self._sealed = [None] * len(rules)
            return
        settings, volumes = self._settings, soft.volumes_m3
        self._sealed = [
            None
            if not rule.sealed
            else gas
            or SealedGas(
                settings.ambient_Pa + pressure, volume, settings.exponent, settings.ambient_Pa,
                settings.temperature_K,
            )
            for rule, gas, pressure, volume in zip(rules, before, self._pressures, volumes, strict=True)
        ]  # fmt: skip

    @property
    def flows(self) -> bool:
        """Whether gas leaks or passes through an orifice in the present phase."""
        return any(rule.leak_kg_s_Pa for rule in self._rules) or bool(self._open_orifices())

    def content(self, chamber: int) -> SealedGas | None:
        """Return the sealed gas in a chamber (by index); None while its pressure is given."""
        return self._sealed[chamber] if self._sealed else None

    def set_gas(self, chamber: int, gas: SealedGas) -> None:
        """Replace the sealed gas in a chamber (by index)."""
        self._sealed[chamber] = gas

    def filled(self, command: SoftCommand) -> SoftCommand:
        """Return a command with what is in the chambers in place of the planned pressure."""
        return self._with(command, self._pressures)

    def between(self, begin: SoftCommand, end: SoftCommand, load_factor: float) -> SoftCommand:
        """Return what is asked for at a load factor in a phase: only given pressures change as planned.

        Args:
            begin: planned, at the start of the phase.
            end: planned, at its end.
            load_factor: 0 to 1.
        """
        ramp = self._ramp
        if ramp is None or ramp.begin is not begin or ramp.end is not end:
            ramp = self._ramp = CommandRamp(begin, end)
            self._as_planned = begin.pressure_Pa == self._pressures and not self.holds_gas
        planned = ramp.at(load_factor)
        if self._as_planned:
            return planned
        pressures = tuple(
            now
            if gas is not None
            else wanted
            if load_factor >= 1.0
            else (1.0 - load_factor) * now + load_factor * wanted
            for gas, now, wanted in zip(self._sealed, self._pressures, end.pressure_Pa, strict=True)
        )
        return self._with(planned, pressures)

    def _with(self, command: SoftCommand, pressures: tuple[float, ...]) -> SoftCommand:
        if not self.holds_gas and pressures == command.pressure_Pa:
            return command
        return replace(command, pressure_Pa=pressures, gas=tuple(self._sealed))

    @property
    def holds_gas(self) -> bool:
        """Whether any chamber is sealed."""
        return self._sealed.count(None) < len(self._sealed)

    def advance(self, soft: SoftSide, step_s: float) -> None:
        """Let sealed gases leak, and flow through orifices, for a while at the present volumes."""
        if not self.holds_gas:
            return
        now = soft.pressures_Pa
        triples = zip(self._sealed, now, self._pressures, strict=True)
        self._pressures = tuple(kept if gas is None else present for gas, present, kept in triples)
        if not self.flows:
            return
        volumes = soft.volumes_m3
        for k, (rule, gas) in enumerate(zip(self._rules, self._sealed, strict=True)):
            if gas is not None and rule.leak_kg_s_Pa:
                self._sealed[k] = leak(gas, volumes[k], rule.leak_kg_s_Pa, step_s)
        for first, second, conductance in self._open_orifices():
            one, other = self._sealed[first], self._sealed[second]
            if one is not None and other is not None:
                pair, space = (one, other), (volumes[first], volumes[second])
                self._sealed[first], self._sealed[second] = exchange(pair, space, conductance, step_s)

    def _open_orifices(self) -> list[tuple[int, int, float]]:
        """Return (chamber, chamber, conductance [kg/(s Pa)]) of orifices with sealed gas on both sides."""
        return [
            (first, second, conductance)
            for first, second, conductance in self._orifices
            if self._sealed[first] is not None and self._sealed[second] is not None
        ]

    def save_state(self) -> ChamberGasState:
        """Return what is in the chambers."""
        return ChamberGasState(tuple(self._sealed), self._pressures, self._rules, tuple(self._orifices))

    def restore_state(self, state: ChamberGasState) -> None:
        """Return to a state of `save_state`."""
        for orifice in state.orifices:
            check_indices(np.array(orifice[:2]), len(state.rules), "chambers")
        self._sealed, self._pressures = list(state.sealed), state.pressures_Pa
        self._rules, self._orifices, self._ramp = state.rules, list(state.orifices), None
