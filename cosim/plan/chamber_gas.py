"""The gas in the chambers through a run: each chamber has a given pressure, or a sealed amount of gas that
may leak or flow through orifices.
"""

from dataclasses import dataclass, replace
from typing import Annotated, final

import numpy as np

from cosim.base.state_checks import check_indices
from cosim.config.gas_rules import GasRule
from cosim.config.schema.settings import GasTable
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.plan.commands import CommandRamp, SoftCommand
from cosim.soft.body.loads import between
from cosim.soft.elements.gas import SealedGas, exchange, leak


@final
@dataclass(frozen=True)
class ChamberGasState:
    """State of a `ChamberGas`.

    Args:
        sealed: gas in each chamber; None while its pressure is given.
        pressures_Pa: gauge, of each chamber at the last update.
        rules: of each chamber in the present phase.
        orifices: (chamber, chamber, conductance [kg/(s Pa)]).
    """

    sealed: Annotated[tuple[SealedGas | None, ...], ("c",)] = ()
    pressures_Pa: Annotated[tuple[float, ...], ("c",)] = ()
    rules: Annotated[tuple[GasRule, ...], ("c",)] = ()
    orifices: tuple[tuple[int, int, float], ...] = ()

    @property
    def open_orifices(self) -> list[tuple[int, int, float]]:
        """Orifices with sealed gas on both sides."""
        return [
            (first, second, conductance)
            for first, second, conductance in self.orifices
            if self.sealed[first] is not None and self.sealed[second] is not None
        ]


@final
class ChamberGas:
    """Tracks the gas in each chamber, and inserts it in planned commands.

    Args:
        settings: of sealed gas.
    """

    def __init__(self, settings: GasTable) -> None:
        self._settings = settings
        self._state = ChamberGasState()
        self._ramp: CommandRamp | None = None
        self._as_planned = False  # whether all chambers have the ramp's pressures

    @property
    def state(self) -> ChamberGasState:
        """The state of the gas in all chambers."""
        return self._state

    @state.setter
    def state(self, state: ChamberGasState) -> None:
        for orifice in state.orifices:
            check_indices(np.array(orifice[:2]), len(state.rules), "chambers")
        self._state, self._ramp = state, None

    def begin(self, rules: tuple[GasRule, ...], soft: SoftRobot) -> None:
        """Begin a phase: seal chambers at their present pressure, or open them; the pressures do not change.

        Args:
            rules: of each chamber.
            soft: in its present shape.

        Raises:
            InputError: a chamber to be sealed has no volume.
        """
        pressures, before = soft.pressures_Pa, self._state.sealed or (None,) * len(rules)
        places = {chamber.name: k for k, chamber in enumerate(soft.body.gas_chambers)}
        orifices = tuple(
            (places[entry.chambers[0]], places[entry.chambers[1]], entry.conductance_kg_s_Pa)
            for entry in self._settings.orifices
        )
        sealed: tuple[SealedGas | None, ...] = (None,) * len(rules)
        if any(rule.sealed for rule in rules):
            rows = zip(rules, before, pressures, soft.volumes_m3, strict=True)
            sealed = tuple(gas or self._seal(*space) if rule.sealed else None for rule, gas, *space in rows)
        self.state = ChamberGasState(sealed, pressures, rules, orifices)

    def _seal(self, pressure_Pa: float, volume_m3: float) -> SealedGas:
        """Return the gas of a chamber that is sealed at a gauge pressure."""
        settings = self._settings
        return SealedGas(
            settings.ambient_Pa + pressure_Pa, volume_m3, settings.exponent, settings.ambient_Pa,
            settings.temperature_K,
        )  # fmt: skip

    @property
    def flows(self) -> bool:
        """Whether gas leaks or passes through an orifice in the present phase."""
        return any(rule.leak_kg_s_Pa for rule in self._state.rules) or bool(self._state.open_orifices)

    def content(self, chamber: int) -> SealedGas | None:
        """Return the sealed gas in a chamber (by index); None while its pressure is given."""
        sealed = self._state.sealed
        return sealed[chamber] if sealed else None

    def set_gas(self, chamber: int, gas: SealedGas) -> None:
        """Replace the sealed gas in a chamber (by index)."""
        sealed = self._state.sealed
        self._state = replace(self._state, sealed=(*sealed[:chamber], gas, *sealed[chamber + 1 :]))

    def filled(self, command: SoftCommand) -> SoftCommand:
        """Return a command with the present gas in place of the planned pressures."""
        return self._with(command, self._state.pressures_Pa)

    def between(self, begin: SoftCommand, end: SoftCommand, load_factor: float) -> SoftCommand:
        """Return the command at a load factor of a phase; sealed gas replaces planned pressures.

        Args:
            begin: planned command at the start of the phase.
            end: planned command at its end.
            load_factor: 0 to 1.
        """
        ramp, state = self._ramp, self._state
        if ramp is None or ramp.begin is not begin or ramp.end is not end:
            ramp = self._ramp = CommandRamp(begin, end)
            self._as_planned = begin.pressure_Pa == state.pressures_Pa and not self.holds_gas
        planned = ramp.at(load_factor)
        if self._as_planned:
            return planned
        pressures = tuple(
            now if gas is not None else wanted if load_factor >= 1.0 else between(now, wanted, load_factor)
            for gas, now, wanted in zip(state.sealed, state.pressures_Pa, end.pressure_Pa, strict=True)
        )
        return self._with(planned, pressures)

    def _with(self, command: SoftCommand, pressures: tuple[float, ...]) -> SoftCommand:
        if not self.holds_gas and pressures == command.pressure_Pa:
            return command
        return replace(command, pressure_Pa=pressures, gas=self._state.sealed)

    @property
    def holds_gas(self) -> bool:
        """Whether any chamber is sealed."""
        sealed = self._state.sealed
        return sealed.count(None) < len(sealed)

    def advance(self, soft: SoftRobot, step_s: float) -> None:
        """Advance leaks and flows through orifices by a time step, at the present volumes.

        Args:
            soft: with pressures and volumes of its chambers.
            step_s: time step [s].
        """
        if not self.holds_gas:
            return
        state = self._state
        triples = zip(state.sealed, soft.pressures_Pa, state.pressures_Pa, strict=True)
        pressures = tuple(kept if gas is None else present for gas, present, kept in triples)
        sealed = self._flown(soft.volumes_m3, step_s) if self.flows else state.sealed
        self._state = replace(state, sealed=sealed, pressures_Pa=pressures)

    def _flown(self, volumes_m3: tuple[float, ...], step_s: float) -> tuple[SealedGas | None, ...]:
        """Return the gas in each chamber after leaks and flows through orifices."""
        sealed = list(self._state.sealed)
        for k, rule in enumerate(self._state.rules):
            gas = sealed[k]
            if gas is not None and rule.leak_kg_s_Pa:
                sealed[k] = leak(gas, volumes_m3[k], rule.leak_kg_s_Pa, step_s)
        for first, second, conductance in self._state.open_orifices:
            one, other = sealed[first], sealed[second]
            if one is not None and other is not None:
                space = volumes_m3[first], volumes_m3[second]
                sealed[first], sealed[second] = exchange((one, other), space, conductance, step_s)
        return tuple(sealed)
