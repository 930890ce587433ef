"""Cables and pumps as they are driven: winches and their stepper motors, pumps and their pressure switches.

A stepper motor that winds a cable on a drum through a gear.

A step winds l = step angle x drum radius / gear ratio. The driver counts the steps that it commands; the drum
follows unless the cable pulls too hard: steps that would lift the tension above the stall force
F = stall torque x gear ratio / drum radius are lost, and a tension above it drags the drum back by whole
steps. Nothing tells the driver: it continues from its count, so the length stays wrong by what was lost.
Within a tick the eyelets count as fixed, a step of l lifts the tension by k l (k the cable's stiffness): near
stall the motor is therefore slowed down to (F - T) / (k tick), never taken beyond. Of several cables on one
drum T is the sum of their tensions, and k that of their stiffnesses.

What commands one cable through a run: its tension, or its unstretched length, by a winch or at once.

What is asked of cables and pumps: by a phase, and from outside in its place.

A pump that a pressure switch turns on and off, with a vent valve, and its work on a chamber's gas.

The switch sees the gauge pressure of some ticks ago. With the setpoint r and the band b
    on below r - b/2, off above r + b/2, in between as before;
    the valve opens above r + v and closes below r; it stays shut where no v is given.
While on, the pump delivers q (1 - p / p_max) kg/s against the gauge pressure p (the usual straight line of a
diaphragm pump; q without p_max). At constant volume and temperature dp/dm = R T / V, so that a step has the
closed form p(t) = p_max - (p_max - p_0) exp(-q R T t / (V p_max)), whatever its length.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias, final

from cosim.base.frames import Array
from cosim.config.schema.devices import PumpTable, WinchTable
from cosim.errors import InputError
from cosim.plan.plan import PhasePlan
from cosim.soft.elements.cable import Cable, base_tension, step_spring, stretch_at
from cosim.soft.elements.gas import SealedGas, leak

_MOST_STEPS: Final = 2.0**53
"""That whole numbers count; a winch that is asked for more winds for ever anyway."""
_ALIKE_STEPS: Final = 0.5
"""By how much the lengths commanded of cables on one drum may differ, in steps."""


@final
@dataclass(frozen=True)
class WinchState:
    """Where a winch is.

    Args:
        unwound_m: unstretched length of cable off the drum at count 0.
        commanded: the driver's count of steps, winding positive.
        lost: steps of those that the drum did not follow, and steps by which it was dragged back.
        budget: steps that the rate still allows.
    """

    unwound_m: float
    commanded: int = 0
    lost: int = 0
    budget: float = 0.0

    def length_m(self, winch: WinchTable) -> float:
        """Return the unstretched length of cable that is off the drum."""
        return self.unwound_m - (self.commanded - self.lost) * winch.step_m

    def advanced(
        self, winch: WinchTable, wanted_m: float, tension_N: float, stiffness_N_m: float, step_s: float
    ) -> WinchState:
        """Return the state one tick later.

        Args:
            winch: whose it is.
            wanted_m: unstretched length to go to, as the driver counts; whole steps are taken.
            tension_N: of the cable at the drum, before.
            stiffness_N_m: k, of the cable.
            step_s: length of the tick.
        """
        to_wind = (self.unwound_m - wanted_m) / winch.step_m
        missing = round(min(max(to_wind, -_MOST_STEPS), _MOST_STEPS)) - self.commanded
        budget = self.budget + winch.step_rate_per_s * step_s
        steps = max(-math.floor(budget), min(missing, math.floor(budget)))
        room = (winch.stall_force_N - tension_N) / (stiffness_N_m * winch.step_m)
        dragged = max(math.ceil(-room), 0)
        stuck = max(steps - max(math.floor(room), 0), 0)
        return replace(
            self,
            commanded=self.commanded + steps,
            lost=self.lost + dragged + stuck,
            # parts of a step add up from tick to tick, whole ones not taken do not
            budget=min(budget - abs(steps), 1.0),
        )


Order: TypeAlias = tuple[Literal["tension", "length", "shortening"], float]
"""What a phase asks of a cable, at the end of its ramp [N or m]."""


@final
@dataclass(frozen=True)
class CableDriveState:
    """Where a drive is.

    Args:
        begin: tension [N] or unstretched length [m] at the start of the phase.
        wanted: now.
        length_m: unstretched length off the drum; None while the tension is commanded.
        winch: of the winch while the length is commanded.
        stretch_m: of the cable where the tick begins; of a slack one 0.
    """

    begin: float
    wanted: float
    length_m: float | None = None
    winch: WinchState | None = None
    stretch_m: float = 0.0


@final
class CableDrive:
    """Drives one cable.

    Args:
        cable: of the soft body.
        winch: that winds it; None: a commanded length is there at once.
        tension_N: before the first phase.
        tick_s: length of a tick; infinite in statics.
    """

    def __init__(
        self, cable: Cable, winch: WinchTable | None, tension_N: float, tick_s: float = math.inf
    ) -> None:
        self.cable, self.winch, self._tick_s = cable, winch, tick_s
        self.state = self.at_rest(tension_N)
        """What the next tick depends on."""

    def at_rest(self, tension_N: float) -> CableDriveState:
        """Return the state under a commanded tension at which the cable has crept to rest."""
        stretch = max(stretch_at(tension_N, self.cable.stiffness_N_m), 0.0)
        return CableDriveState(tension_N, tension_N, stretch_m=stretch)

    @property
    def spring(self) -> tuple[float, float]:
        """q of this tick, and by how much L_0' is longer than L_0 [m], see `step_spring`."""
        return step_spring(self.cable, self.state.stretch_m, self._tick_s)

    @property
    def step_length_m(self) -> float | None:
        """L_0' of this tick; None while the tension is commanded."""
        length = self.state.length_m
        return None if length is None else length + self.spring[1]

    @property
    def lost_steps(self) -> int:
        """Steps that the winch has lost since the length is commanded."""
        return 0 if self.state.winch is None else self.state.winch.lost

    @property
    def given_tension_N(self) -> float:
        """Commanded tension; zero, and without meaning, while the length is commanded."""
        return self.state.wanted if self.state.length_m is None else 0.0

    def tension_N(self, positions: Array) -> float:
        """Return the tension at the base end at the given shape (n, 3) [m]."""
        length = self.step_length_m
        if length is None:
            return self.state.wanted
        return base_tension(self.cable, positions, length, self.spring[0])

    def unstretched_m(self, positions: Array) -> float:
        """Return the commanded length; while the tension is, that off the drum."""
        return self.off_drum_m(positions) if self.state.length_m is None else self.state.wanted

    def off_drum_m(self, positions: Array) -> float:
        """Return the unstretched length off the drum; under a commanded tension what its stretch leaves."""
        if self.state.length_m is not None:
            return self.state.length_m
        stiffening, longer = self.spring
        stretch = stretch_at(self.state.wanted, self.cable.stiffness_N_m) / stiffening
        return self.cable.length(positions) - longer - stretch

    def begin(self, order: Order | None, positions: Array) -> None:
        """Begin a phase; nothing changes at this instant.

        Args:
            order: what the phase asks; None: all stays.
            positions: (n, 3) [m].
        """
        state = self._prepared(order, positions)
        self.state = replace(state, begin=state.wanted)

    def move(
        self, order: Order | None, load_factor: float, commanded: Order | None, positions: Array
    ) -> None:
        """Take over what is wanted at the end of a tick; a winch turns afterwards, see `Drum`.

        Args:
            order: what the phase asks; None: all stays.
            load_factor: of the phase's ramp, 0 to 1.
            commanded: by a controller, in place of the ramp; None: the ramp.
            positions: (n, 3) [m], at the start of the tick.
        """
        stretch = max(self.cable.length(positions) - self.off_drum_m(positions), 0.0)
        self.state = replace(self.state, stretch_m=stretch)
        if commanded is not None:
            state, wanted = self._prepared(commanded, positions), commanded[1]
            state = replace(state, begin=wanted)
        else:
            state = self._prepared(order, positions)
            end = _end(order, state.begin)
            wanted = end if load_factor >= 1.0 else state.begin + load_factor * (end - state.begin)
        state = replace(state, wanted=wanted)
        if state.length_m is not None and state.winch is None:
            state = replace(state, length_m=wanted)
        self.state = state

    def _prepared(self, order: Order | None, positions: Array) -> CableDriveState:
        """Return the state in which an order can be followed, with the present tension."""
        if order is None or (order[0] == "tension") == (self.state.length_m is None):
            return self.state
        if order[0] == "tension":
            tension = self.tension_N(positions)
            return replace(self.state, begin=tension, wanted=tension, length_m=None, winch=None)
        length = self.unstretched_m(positions)
        winch = None if self.winch is None else WinchState(length)
        return replace(self.state, begin=length, wanted=length, length_m=length, winch=winch)


@final
@dataclass(frozen=True)
class Drum:
    """One motor with the cables that it winds, all by the same length.

    Args:
        winch: its kind.
        drives: of its cables.
    """

    winch: WinchTable
    drives: tuple[CableDrive, ...]

    def turn(self, positions: Array, step_s: float) -> None:
        """Turn for one tick towards what its cables are commanded.

        Args:
            positions: (n, 3) [m], at the start of the tick.
            step_s: length of the tick.

        Raises:
            InputError: its cables are commanded differently.
        """
        states = [drive.state for drive in self.drives]
        wound = [state.winch for state in states if state.winch is not None]
        if not wound:
            return
        steps = [
            (winch.unwound_m - state.wanted) / self.winch.step_m
            for state, winch in zip(states, wound, strict=False)
        ]
        if len(wound) < len(states) or max(steps) - min(steps) > _ALIKE_STEPS:
            raise InputError(
                f"winch '{self.winch.name}': one motor winds its {len(states)} cables, which are commanded "
                "differently; command the same shortening of all of them"
            )
        tension = sum(drive.tension_N(positions) for drive in self.drives)
        stiffness = sum(drive.cable.stiffness_N_m * drive.spring[0] for drive in self.drives)
        turned = wound[0].advanced(self.winch, states[0].wanted, tension, stiffness, step_s)
        for drive, own in zip(self.drives, wound, strict=True):
            after = replace(turned, unwound_m=own.unwound_m)
            drive.state = replace(drive.state, length_m=after.length_m(self.winch), winch=after)


def drums_of(winches: Sequence[WinchTable], drives: Mapping[str, CableDrive]) -> tuple[Drum, ...]:
    """Return the motors of winches.

    Args:
        winches: kinds.
        drives: of all cables, by name.
    """
    groups = (
        (winch, names)
        for winch in winches
        for names in ([winch.cables] if winch.one_motor else [(name,) for name in winch.cables])
    )
    return tuple(Drum(winch, tuple(drives[name] for name in names)) for winch, names in groups)


def _end(order: Order | None, begin: float) -> float:
    """Return the tension [N] or length [m] at the end of a ramp."""
    if order is None:
        return begin
    return begin - order[1] if order[0] == "shortening" else order[1]


@final
@dataclass(frozen=True)
class LiveOrders:
    """What is commanded from outside; None: nothing is.

    Args:
        cables: of each cable.
        pump_pressure_Pa: setpoint of each pump.
    """

    cables: tuple[Order | None, ...]
    pump_pressure_Pa: tuple[float | None, ...]


def orders_of(planned: PhasePlan, names: tuple[str, ...]) -> list[Order | None]:
    """Return what a phase asks of each cable."""
    phase = planned.phase
    target = phase.tip_target
    if phase.cable_tension_N is not None or (target is not None and target.reach_with == "cables"):
        return [("tension", tension) for tension in planned.end.cable_tension_N]
    lengths, shortenings = phase.cable_length_m or {}, phase.cable_shortening_m or {}
    orders: list[Order | None] = []
    for name in names:
        if name in lengths:
            orders.append(("length", lengths[name]))
        else:
            orders.append(("shortening", shortenings[name]) if name in shortenings else None)
    return orders


@final
@dataclass(frozen=True)
class Pump:
    """What a pump, its switch and its valve can do.

    Args:
        table: of the scenario.
        delay_ticks: age of what the switch sees.
    """

    table: PumpTable
    delay_ticks: int = 0

    def standing(self, pressure_Pa: float) -> PumpState:
        """Return the state of a pump that is off beside a gauge pressure that has stood for long."""
        return PumpState(DelayLine.filled(pressure_Pa, self.delay_ticks))

    def switched(self, state: PumpState, pressure_Pa: float, setpoint_Pa: float) -> PumpState:
        """Return the state after the switch has taken in one more reading.

        Args:
            state: before.
            pressure_Pa: gauge pressure now.
            setpoint_Pa: r.
        """
        seen, sensor = state.sensor.passed(pressure_Pa)
        half, vent = 0.5 * self.table.band_Pa, self.table.vent_above_Pa
        on = seen < setpoint_Pa - half or (state.on and seen <= setpoint_Pa + half)
        above = vent is not None and seen > setpoint_Pa + vent
        open_ = above or (state.venting and seen >= setpoint_Pa)
        started = state.starts + (on and not state.on)
        return replace(state, sensor=sensor, on=on, venting=open_, starts=started)

    def worked(
        self, state: PumpState, gas: SealedGas, volume_m3: float, step_s: float
    ) -> tuple[PumpState, SealedGas]:
        """Return state and gas after pump and valve have worked for a while as they are switched.

        Args:
            state: says whether they are on.
            gas: before.
            volume_m3: of the chamber.
            step_s: time.
        """
        if state.venting:
            gas = leak(gas, volume_m3, self.table.vent_kg_s_Pa, step_s)
        if not state.on:
            return state, gas
        here = gas.at(volume_m3)
        mass = self._delivered(here, step_s)
        done = replace(state, delivered_kg=state.delivered_kg + mass, on_s=state.on_s + step_s)
        return done, here.with_mass(here.mass_kg + mass)

    def _delivered(self, gas: SealedGas, step_s: float) -> float:
        flow, most = self.table.flow_kg_s, self.table.pressure_max_Pa
        if most is None:
            return flow * step_s
        rise = gas.pressure_Pa / gas.mass_kg  # dp/dm = R T / V
        room = max(most - (gas.pressure_Pa - gas.ambient_Pa), 0.0)
        return -room / rise * math.expm1(-flow * rise * step_s / most)


@final
@dataclass(frozen=True)
class PumpState:
    """Where a pump is.

    Args:
        sensor: readings on their way to the switch [Pa].
        on: whether the pump runs.
        venting: whether the valve is open.
        starts: how often it was switched on.
        delivered_kg: mass delivered so far.
        on_s: time for which it ran.
    """

    sensor: DelayLine
    on: bool = False
    venting: bool = False
    starts: int = 0
    delivered_kg: float = 0.0
    on_s: float = 0.0


@final
@dataclass(frozen=True)
class DelayLine:
    """Values on their way, the oldest first.

    Args:
        waiting: one value per tick of the delay; none without delay.
    """

    waiting: tuple[float, ...] = ()

    @classmethod
    def filled(cls, value: float, ticks: int) -> DelayLine:
        """Return a line of a number of ticks in which a value has stood for long."""
        return cls((value,) * ticks)

    def passed(self, value: float) -> tuple[float, DelayLine]:
        """Return what comes out when a value goes in, and the line afterwards."""
        oldest, *waiting = (*self.waiting, value)
        return oldest, DelayLine(tuple(waiting))


@final
@dataclass(frozen=True)
class PumpDriveState:
    """Where a pump is in a run.

    Args:
        setpoint_Pa: of the present phase; None: it does not work.
        pump: of the pump; None before it first works.
    """

    setpoint_Pa: float | None = None
    pump: PumpState | None = None


@final
class PumpDrive:
    """One pump.

    Args:
        pump: what it can do.
        chamber: index of the chamber.
    """

    def __init__(self, pump: Pump, chamber: int) -> None:
        self.name, self.pump, self.chamber = pump.table.name, pump, chamber
        self.state = PumpDriveState()
        """What the next tick depends on."""

    def begin(self, setpoint_Pa: float | None, pressure_Pa: float) -> None:
        """Begin a phase.

        Args:
            setpoint_Pa: None: it does not work.
            pressure_Pa: gauge, in the chamber at present.
        """
        pump = self.state.pump
        if pump is None:
            pump = self.pump.standing(pressure_Pa)
        elif self.state.setpoint_Pa is None:
            # the sensor has looked on all the time
            pump = replace(pump, sensor=self.pump.standing(pressure_Pa).sensor)
        if setpoint_Pa is None:
            pump = replace(pump, on=False, venting=False)
        self.state = PumpDriveState(setpoint_Pa, pump)

    def work(self, gas: SealedGas, volume_m3: float, step_s: float, commanded_Pa: float | None) -> SealedGas:
        """Return the gas after the pump has worked for a tick.

        Args:
            gas: before.
            volume_m3: of the chamber.
            step_s: length of the tick.
            commanded_Pa: setpoint by a controller, in place of the phase's.
        """
        setpoint, pump = self.state.setpoint_Pa, self.state.pump
        if commanded_Pa is not None:
            setpoint = commanded_Pa
        if setpoint is None or pump is None:
            return gas
        pump = self.pump.switched(pump, gas.gauge_pressure(volume_m3), setpoint)
        pump, gas = self.pump.worked(pump, gas, volume_m3, step_s)
        self.state = PumpDriveState(setpoint, pump)
        return gas
