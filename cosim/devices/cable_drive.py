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
from dataclasses import dataclass, replace
from typing import final

from cosim.base.frames import Array
from cosim.config.schema.devices import WinchTable
from cosim.devices.orders import Order, _end
from cosim.devices.winch import WinchState
from cosim.soft.elements.cable import Cable, base_tension, step_spring, stretch_at


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
