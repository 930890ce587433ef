"""The plan of a run: what is asked of the robot in every phase and at every tick, gas and loads included.

What is asked of the robot at a tick or increment, always complete; and the loads that follow from it.

The gas in the chambers through a run: each at a given pressure, or a sealed amount that may flow.

What a phase asks for at each of its ticks, worked out for many ticks at once, or increments.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.state import check_indices
from cosim.config.gas_rules import GasRule
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.settings import GasTable
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.plan.motion import JointPath, JointReference, PlannedTipPath, Progress, progress
from cosim.soft.body.loads import Loads, between, force_between
from cosim.soft.elements.gas import SealedGas, exchange, leak

_RAMPED: Final = ("pressure_Pa", "cable_tension_N", "nodal_force")


@final
@dataclass(frozen=True, eq=False)
class SoftCommand:
    """What is asked of a soft robot at one instant.

    Args:
        pressure_Pa: gauge, of each chamber; without meaning where gas is sealed.
        gas: sealed in each chamber; None where its pressure is given.
        cable_tension_N: of each cable at its base end; without meaning where its length is commanded.
        cable_length_m: unstretched, of each cable; None where its tension is commanded.
        nodal_force: (nodes, 3) [N], dead load that a phase puts on it, world axes; None for none.
        cable_stiffening: q of each cable in a step, see `cable`; empty: 1 of all.
    """

    pressure_Pa: Annotated[tuple[float, ...], ("chambers",)]
    gas: Annotated[tuple[SealedGas | None, ...], ("chambers",)]
    cable_tension_N: Annotated[tuple[float, ...], ("cables",)]
    cable_length_m: Annotated[tuple[float | None, ...], ("cables",)]
    nodal_force: Annotated[Array, ("nodes", 3)] | None = None
    cable_stiffening: tuple[float, ...] = ()

    def unsealed(self) -> "SoftCommand":
        """Return the same with its pressures given, whatever gas is sealed."""
        return self if not any(self.gas) else replace(self, gas=(None,) * len(self.gas))


@final
@dataclass(frozen=True, eq=False)
class RobotCommand:
    """What is asked of the whole robot in one tick or increment; a controller's `Command` names a part of it.

    Args:
        joints: what the servos follow.
        soft: what the soft robot is asked for at its end.
    """

    joints: JointReference
    soft: SoftCommand


def loads_of(command: SoftCommand, gravity: tuple[float, float, float]) -> Loads:
    """Return what acts on a soft body that is asked for something; contact is found as it moves.

    Args:
        command: to it.
        gravity: (3,) [m/s^2], world.

    Raises:
        InputError: a negative tension, or a length that is not above 0.
    """
    gas, lengths = command.gas, command.cable_length_m
    asked = vars(command) | {
        "gas": gas if gas.count(None) < len(gas) else (),
        "cable_length_m": lengths if lengths.count(None) < len(lengths) else (),
    }
    return Loads(gravity=gravity, **asked)


@final
class CommandRamp:
    """Planned commands over the progress of a phase.

    Args:
        begin: at its start, all pressures and tensions given.
        end: at its end, the same.
    """

    def __init__(self, begin: SoftCommand, end: SoftCommand) -> None:
        self.begin, self.end = begin, end
        self._as_end = {name: value for name, value in vars(end).items() if name not in _RAMPED}
        self._pushed_otherwise = begin.nodal_force is not end.nodal_force
        self._changes = (
            self._pushed_otherwise
            or begin.pressure_Pa != end.pressure_Pa
            or begin.cable_tension_N != end.cable_tension_N
        )

    def at(self, load_factor: float) -> SoftCommand:
        """Return what is asked for at a load factor, 0 to 1: the end itself there, or if nothing changes."""
        begin, end = self.begin, self.end
        if load_factor >= 1.0 or not self._changes:
            return end
        force = end.nodal_force
        if self._pushed_otherwise:
            force = force_between(begin.nodal_force, force, load_factor)
        return type(end)(
            pressure_Pa=_between(begin.pressure_Pa, end.pressure_Pa, load_factor),
            cable_tension_N=_between(begin.cable_tension_N, end.cable_tension_N, load_factor),
            nodal_force=force,
            **self._as_end,
        )


def _between(begin: tuple[float, ...], end: tuple[float, ...], load_factor: float) -> tuple[float, ...]:
    return tuple([between(a, b, load_factor) for a, b in zip(begin, end, strict=True)])


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
    """Knows what is in each chamber at present, and puts it into what is planned.

    Args:
        settings: of the gas where it is sealed.
    """

    def __init__(self, settings: GasTable) -> None:
        self._settings = settings
        self._state = ChamberGasState()
        self._ramp: CommandRamp | None = None
        self._as_planned = False  # whether nothing in the chambers is other than the ramp has it

    @property
    def state(self) -> ChamberGasState:
        """What is in the chambers."""
        return self._state

    @state.setter
    def state(self, state: ChamberGasState) -> None:
        for orifice in state.orifices:
            check_indices(np.array(orifice[:2]), len(state.rules), "chambers")
        self._state, self._ramp = state, None

    def begin(self, rules: tuple[GasRule, ...], soft: SoftSide) -> None:
        """Begin a phase: seal what is in the chambers, or open them; nothing changes at this instant.

        Args:
            rules: of each chamber.
            soft: in its present shape.

        Raises:
            InputError: there is nothing to seal, as a chamber has no volume.
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
        """Return a command with what is in the chambers in place of the planned pressure."""
        return self._with(command, self._state.pressures_Pa)

    def between(self, begin: SoftCommand, end: SoftCommand, load_factor: float) -> SoftCommand:
        """Return what is asked for at a load factor in a phase: only given pressures change as planned.

        Args:
            begin: planned, at the start of the phase.
            end: planned, at its end.
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

    def advance(self, soft: SoftSide, step_s: float) -> None:
        """Let sealed gases leak, and flow through orifices, for a while at the present volumes."""
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


@final
@dataclass(frozen=True)
class Holding:
    """What is held otherwise from the start of a phase on.

    Args:
        release: (m,) nodes let go.
        hold: (n, 3) bool, components held from then on.
    """

    release: IntArray
    hold: Mask

    def apply(self, soft: SoftSide, world_from_flange: Pose) -> None:
        """Change what a soft body is held by, where it is now."""
        if len(self.release):
            soft.let_go(self.release)
        if self.hold.any():
            soft.hold_also(self.hold, world_from_flange)


@final
@dataclass(frozen=True)
class PhasePlan:
    """One phase, ready to run.

    Args:
        phase: as in the scenario.
        joints: joint angles along it.
        begin: asked of the soft robot at its start, as if no gas was sealed.
        end: at its end, the same.
        gas: how the gas of each chamber is given.
        holding: what is held otherwise from its start on.
        tip_target: (3,) [m]; components that are free are NaN; None without a target.
        flange: where it is to be at its end.
        tip_path: that the tip follows; None without one.
    """

    phase: PhaseTable
    joints: JointPath
    begin: SoftCommand
    end: SoftCommand
    gas: tuple[GasRule, ...]
    holding: Holding
    tip_target: Array | None
    flange: Pose
    tip_path: PlannedTipPath | None = None

    def tip_wanted(self, done: int, tick_s: float) -> Array | None:
        """Return where the tip is to be (3,) [m] at the start of a tick; None without a path or target.

        Args:
            done: ticks of the phase at its end, at least one.
            tick_s: length of a tick [s].
        """
        if self.tip_path is None:
            return self.tip_target
        course, ticks = self.tip_path.course, max(1, round(self.phase.duration_s / tick_s))
        return course.at((done - 1) / ticks * course.duration_s).position


@final
@dataclass(frozen=True)
class Plan:
    """All phases of a run, and where it starts.

    Args:
        start: pose of the flange.
        joints: (joints,) [rad] at the start.
        command: to the soft robot at the start.
        gravity: (3,) [m/s^2], world.
        phases: in order.
    """

    start: Pose
    joints: Array
    command: SoftCommand
    gravity: tuple[float, float, float]
    phases: tuple[PhasePlan, ...]


_TICKS = 256  # worked out at once


@final
class TickReferences:
    """References of the arm and progress of the loads, tick by tick.

    Args:
        planned: the phase.
        tick_s: length of a tick [s].
    """

    def __init__(self, planned: PhasePlan, tick_s: float) -> None:
        self.planned, self._tick_s = planned, tick_s
        self._first = 0
        self._joints: JointReference | None = None
        self._shares: list[float] = []

    @property
    def _ramp_s(self) -> float:
        """Length of the ramp [s]; a linear one ends with a tick, so that the last one is no shorter step."""
        phase, tick_s = self.planned.phase, self._tick_s
        whole = max(1, round(phase.duration_s / tick_s)) * tick_s
        return whole if phase.ramp == "linear" else phase.duration_s

    def at(self, done: int) -> tuple[JointReference, float]:
        """Return what the servos follow in a tick, and the share of the ramp at its end.

        The servos act on the error at the start of a tick, so they get the reference of that instant.

        Args:
            done: ticks of the phase at its end, at least one.
        """
        joints, place = self._worked_out(done)
        return joints.row(place), self._shares[place]

    def from_on(self, done: int, most: int | None = None) -> tuple[JointReference, list[float]]:
        """Return what `at` does for a tick and those after it that have been worked out, `most` of them."""
        joints, place = self._worked_out(done)
        end = None if most is None else place + most
        return joints.some(place, end), self._shares[place:end]

    def _worked_out(self, done: int) -> tuple[JointReference, int]:
        """Return references of many ticks, and the place of one among them."""
        place = done - 1 - self._first
        if self._joints is None or not 0 <= place < len(self._shares):
            return self._work_out((done - 1) // _TICKS * _TICKS), (done - 1) % _TICKS
        return self._joints, place

    def _work_out(self, first: int) -> JointReference:
        phase, duration_s = self.planned.phase, self._ramp_s
        instants = [
            progress(phase.ramp, tick * self._tick_s, duration_s) for tick in range(first, first + _TICKS + 1)
        ]
        self._first, self._joints = first, self.planned.joints.through(instants[:-1])
        self._shares = [instant.value for instant in instants[1:]]
        return self._joints


@final
class IncrementReferences:
    """References of the arm and progress of the loads, increment by increment.

    Args:
        planned: the phase.
    """

    def __init__(self, planned: PhasePlan) -> None:
        self.planned = planned

    def at(self, done: int) -> tuple[JointReference, float]:
        """Return where the joints are to be after so many increments, and the share of the ramp there."""
        share = done / self.planned.phase.increments
        return self.planned.joints.at(Progress(share, 0.0, 0.0)), share
