"""What `Simulation.step` may command of gas, cables and pumps, what it has commanded, and its bounds.

Which commands a chamber takes: its pressure where that is given, an amount of gas where that is sealed in.

A phase that seals a chamber, or opens it, ends what was commanded of it before: it has nothing to act on any
more. Where a pump works, its setpoint is commanded.

What bounds the commands of `Simulation.step`: whatever cannot be is refused before anything moves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, chain
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias, final

from cosim.config.gas_rules import gas_rules
from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import check_command, check_one_order_each, named_values, numbers, over
from cosim.devices.controller import Command
from cosim.devices.orders import LiveOrders, Order
from cosim.devices.pump import PumpDrive
from cosim.errors import InputError
from cosim.plan.chamber_gas import ChamberGas

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm
    from cosim.plan.arm_limits import ArmLimits


_Values: TypeAlias = tuple[float | None, ...]
WHO: Final = "step"
"""Commands, in messages."""


@final
@dataclass(frozen=True)
class LiveValues:
    """Values of everything that can be commanded by name; None: as planned.

    Args:
        pressure_Pa: gauge, of each chamber.
        gas_kg: of each chamber.
        cable_tension_N: of each cable.
        cable_length_m: unstretched, of each cable.
        pump_pressure_Pa: setpoint of each pump.
    """

    pressure_Pa: Annotated[_Values, ("chambers",)]
    gas_kg: Annotated[_Values, ("chambers",)]
    cable_tension_N: Annotated[_Values, ("cables",)]
    cable_length_m: Annotated[_Values, ("cables",)]
    pump_pressure_Pa: Annotated[_Values, ("pumps",)]

    @classmethod
    def of(cls, command: Command, scenario: Scenario, who: str) -> LiveValues:
        """Return what a command names.

        Args:
            command: any.
            scenario: checked.
            who: commands, for messages.

        Raises:
            InputError: it names what there is not, or a value that is not allowed.
            InstabilityError: a value is not finite.
        """
        robot, pumps = scenario.soft_robot, tuple(pump.name for pump in scenario.pumps)
        chambers, cables = robot.chamber_names(), robot.cable_names()
        check_command(command, who)
        values = cls(
            named_values(command.pressure_Pa, chambers, who, "pressure_Pa", lowest=-scenario.gas.ambient_Pa),
            named_values(command.gas_kg, chambers, who, "gas_kg", lowest=0.0),
            named_values(command.cable_tension_N, cables, who, "cable_tension_N", lowest=0.0),
            named_values(command.cable_length_m, cables, who, "cable_length_m", above=0.0),
            named_values(command.pump_pressure_Pa, pumps, who, "pump_pressure_Pa"),
        )
        check_one_order_each(values.cable_tension_N, values.cable_length_m, cables, who)
        return values

    @property
    def drives_cables(self) -> bool:
        """Whether a length is commanded."""
        return any(value is not None for value in self.cable_length_m)

    def followed_by(self, new: LiveValues) -> LiveValues:
        """Return what is commanded once something new is; of a cable, length or tension."""
        pressure, gas, tension, length, pump = map(tuple, map(over, new._columns, self._columns))
        tension, length = _unless(new.cable_length_m, tension), _unless(new.cable_tension_N, length)
        return LiveValues(pressure, gas, tension, length, pump)

    def beginning(self, end: LiveValues, present: LiveValues) -> LiveValues:
        """Return where these values continue from to those of `end`: what is there, if not commanded yet."""
        triples = zip(self._columns, end._columns, present._columns, strict=True)
        return LiveValues(*[
            tuple([
                None if to is None else there if now is None else now
                for now, to, there in zip(*columns, strict=True)
            ])
            for columns in triples
        ])  # fmt: skip

    def reaches(self, end: LiveValues) -> bool:
        """Return whether these values name all that others do, but for the setpoints of pumps."""
        pairs = zip(chain(*self._columns[:-1]), chain(*end._columns[:-1]), strict=True)
        return all(to is None or here is not None for here, to in pairs)

    def between(self, end: LiveValues, share: float) -> LiveValues:
        """Return the values at a share of the way, 0 to 1; setpoints of pumps are at the end at once."""
        if share >= 1.0:
            return end
        rest, found = 1.0 - share, list(end._columns)
        for k, (here, there) in enumerate(zip(self._columns[:-1], end._columns, strict=False)):
            pairs = zip(here, there, strict=True)
            found[k] = tuple([b if a is None or b is None else rest * a + share * b for a, b in pairs])
        return LiveValues(*found)

    @property
    def _columns(self) -> tuple[_Values, ...]:
        """All values, by what they are of; setpoints of pumps come last."""
        return (
            self.pressure_Pa, self.gas_kg, self.cable_tension_N, self.cable_length_m, self.pump_pressure_Pa,
        )  # fmt: skip

    def orders(self, wound: Sequence[bool], end: LiveValues) -> LiveOrders:
        """Return what devices are asked for; a winch gets the length of the end at once."""
        rows = zip(self.cable_tension_N, self.cable_length_m, wound, end.cable_length_m, strict=True)
        return LiveOrders(tuple(_order(*row) for row in rows), self.pump_pressure_Pa)


def _order(tension: float | None, length: float | None, wound: bool, wanted: float | None) -> Order | None:
    if tension is not None:
        return "tension", tension
    length = wanted if wound else length
    return None if length is None else ("length", length)


def _unless(instead: _Values, values: _Values) -> _Values:
    return tuple([value if other is None else None for value, other in zip(values, instead, strict=True)])


@final
@dataclass(frozen=True)
class GasOrders:
    """Knows the chambers of a scenario, and the phases that seal or open them.

    Args:
        before: ticks of the run before each phase, and before its end.
        phases: their names.
        sealed: whether a phase seals a chamber, by phase and chamber.
        chambers: their names.
        pumped: index of the chamber of each pump.
        pumps: their names.
    """

    before: tuple[int, ...]
    phases: tuple[str, ...]
    sealed: tuple[tuple[bool, ...], ...]
    chambers: tuple[str, ...]
    pumped: tuple[int, ...]
    pumps: tuple[str, ...]

    @classmethod
    def of(cls, scenario: Scenario) -> GasOrders:
        """Return those of a checked scenario."""
        chambers, phases = scenario.soft_robot.chamber_names(), scenario.phases
        counts = [scenario.ticks(phase) for phase in phases]
        return cls(
            (0, *accumulate(counts)),
            tuple(phase.name for phase in phases),
            tuple(tuple(rule.sealed for rule in rules) for rules in gas_rules(scenario)),
            chambers,
            tuple(chambers.index(pump.chamber or chambers[0]) for pump in scenario.pumps),
            tuple(pump.name for pump in scenario.pumps),
        )

    def check(self, new: LiveValues, gas: ChamberGas, pumps: Sequence[PumpDrive]) -> None:
        """Check that what is commanded of chambers acts on what there is in them now.

        Args:
            new: values that are commanded.
            gas: in the chambers.
            pumps: in order.

        Raises:
            InputError: a pressure is commanded where gas is sealed or the other way round, or gas of a pump.
        """
        for k, name in enumerate(self.chambers):
            sealed = gas.content(k) is not None
            if sealed and new.pressure_Pa[k] is not None:
                raise InputError(f"{WHO}: pressure_Pa of '{name}', in which gas is sealed; command gas_kg")
            if not sealed and new.gas_kg[k] is not None:
                raise InputError(f"{WHO}: gas_kg of '{name}', whose pressure is given; command pressure_Pa")
        for pump, setpoint in zip(pumps, new.pump_pressure_Pa, strict=True):
            works = pump.state.setpoint_Pa is not None or setpoint is not None
            if works and new.gas_kg[pump.chamber] is not None:
                raise InputError(
                    f"{WHO}: gas_kg of '{self.chambers[pump.chamber]}', which pump '{pump.name}' fills; "
                    "command pump_pressure_Pa"
                )

    def check_reached(self, new: LiveValues, phase: int, first: int, ticks: int) -> None:
        """Check that no phase ends what is commanded before it is reached.

        Args:
            new: values that are commanded.
            phase: index of that of the first tick.
            first: ticks of the run before it.
            ticks: within which the values are to be reached.

        Raises:
            InputError: one does.
        """
        for later in range(phase + 1, len(self.phases)):
            after = self.before[later] - first
            if after >= ticks:
                return
            _, ended = self.left(new, later)
            if ended:
                raise InputError(
                    f"{WHO}: {ended[0]}; it begins after {after} of these {ticks} ticks: end the step there"
                )

    def left(self, values: LiveValues, phase: int) -> tuple[LiveValues, tuple[str, ...]]:
        """Return what is left of what has been commanded as a phase begins, and what it ends, in words.

        Args:
            values: that have been commanded.
            phase: its index.
        """
        words: list[str] = []
        sealed, name = self.sealed[phase], self.phases[phase]
        pressure, gas, setpoint = map(list, (values.pressure_Pa, values.gas_kg, values.pump_pressure_Pa))
        for k, chamber in enumerate(self.chambers):
            if sealed[k] and pressure[k] is not None:
                words.append(f"pressure_Pa of '{chamber}': phase '{name}' seals its gas; command gas_kg")
                pressure[k] = None
            if not sealed[k] and gas[k] is not None:
                words.append(f"gas_kg of '{chamber}': phase '{name}' gives its pressure; command pressure_Pa")
                gas[k] = None
        for k, (pump, chamber_index) in enumerate(zip(self.pumps, self.pumped, strict=True)):
            if not sealed[chamber_index] and setpoint[k] is not None:
                chamber = self.chambers[chamber_index]
                words.append(
                    f"pump_pressure_Pa of '{pump}': phase '{name}' gives the pressure of '{chamber}'; "
                    "command pressure_Pa"
                )
                setpoint[k] = None
        if not words:
            return values, ()
        given = {"pressure_Pa": pressure, "gas_kg": gas, "pump_pressure_Pa": setpoint}
        return replace(values, **{key: tuple(column) for key, column in given.items()}), tuple(words)

    def pumped_by(self, new: LiveValues, values: LiveValues) -> LiveValues:
        """Return values without the amounts of gas of chambers whose pumps are commanded now."""
        taken = {
            k for k, setpoint in zip(self.pumped, new.pump_pressure_Pa, strict=True) if setpoint is not None
        }
        if not taken:
            return values
        kept = [None if k in taken else amount for k, amount in enumerate(values.gas_kg)]
        return replace(values, gas_kg=tuple(kept))


_MOTIONS: Final = ("flange", "flange_twist", "joint_position")


@final
@dataclass(frozen=True)
class LiveBounds:
    """What of a scenario bounds its commands.

    Args:
        arm: kinematics; None where the base is held.
        limits: of its joints.
        section_Pa: largest pressure of a section model; None: another model.
        out_of_reach_Pa: largest planned pressure where contact is left out, as nothing is within reach of the
            plan; None otherwise.
    """

    arm: Arm | None = None
    limits: ArmLimits | None = None
    section_Pa: float | None = None
    out_of_reach_Pa: float | None = None

    def check(self, command: Command, values: LiveValues, scenario: Scenario) -> list[str]:
        """Return the keys of a command that move the flange.

        Args:
            command: see there.
            values: that it names.
            scenario: checked.

        Raises:
            InputError: it asks for what cannot be.
            InstabilityError: a number is not finite.
        """
        if scenario.mode != "dynamic":
            raise InputError(
                f"{WHO}: commands act in time: needs mode = 'dynamic', this is a quasistatic run"
            )
        moves = [key for key in _MOTIONS if getattr(command, key) is not None]
        if len(moves) > 1:
            raise InputError(f"{WHO} commands {' and '.join(moves)}, which all move the flange; give one")
        if moves and self.arm is None:
            raise InputError(
                f"{WHO} commands {moves[0]}, but robot = 'none' has no joints to move the flange"
            )
        numbers(command.flange_twist, 6, WHO, "flange_twist")
        joints = 0 if self.arm is None else self.arm.joint_count
        numbers(command.joint_position, joints, WHO, "joint_position")
        numbers(command.joint_velocity, joints, WHO, "joint_velocity")
        if command.joint_velocity is not None and command.joint_position is None:
            raise InputError(f"{WHO} commands joint_velocity, which is that at joint_position; give both")
        if values.drives_cables and scenario.fidelity == "rigid":
            raise InputError(f"{WHO} commands cable lengths, while fidelity = 'rigid' keeps its shape")
        self._check_range(values, moves, scenario.soft_robot.chamber_names())
        return moves

    def _check_range(self, values: LiveValues, moves: list[str], chambers: Sequence[str]) -> None:
        """Refuse what lies beyond a section model, or beyond what was looked at for contact."""
        for name, pressure in zip(chambers, values.pressure_Pa, strict=True):
            if pressure is not None and self.section_Pa is not None and pressure > self.section_Pa:
                raise InputError(
                    f"{WHO}: pressure_Pa of '{name}' is {pressure:g}; the section model ends at "
                    f"{self.section_Pa:g}: at 45 kPa, or 1.1 times the largest one of start and phases"
                )
        most = self.out_of_reach_Pa
        beyond = most is not None and any(p is not None and p > most for p in values.pressure_Pa)
        if most is not None and (moves or beyond):
            raise InputError(
                f"{WHO} commands {moves[0] if moves else 'a pressure beyond the plan'}, while contact is "
                "left out as nothing is within reach of the planned way; set contact.only_in_reach = false, "
                "or contact.enabled = false if nothing is to be touched"
            )
