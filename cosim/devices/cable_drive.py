"""Drives one cable through a run: by its tension, or by its unstretched length, with a winch or
instantaneously.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import final

from cosim.base.frames import Array
from cosim.config.schema.devices import WinchTable
from cosim.devices.orders import Order
from cosim.devices.winch import WinchState
from cosim.soft.elements.cable import Cable, base_tension, step_spring, stretch_at


@final
@dataclass(frozen=True)
class CableDriveState:
    """State of a cable drive.

    Args:
        begin: commanded tension [N] or unstretched length [m] at the start of the phase.
        wanted: present commanded value [N or m].
        length_m: unstretched length off the drum; None while the tension is commanded.
        winch: state of the winch while the length is commanded.
        stretch_m: of the cable at the start of the tick; 0 for a slack one.
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
        winch: that winds it; None: a commanded length is reached instantaneously.
        tension_N: before the first phase.
        tick_s: length of a tick; infinite in statics.
    """

    def __init__(
        self, cable: Cable, winch: WinchTable | None, tension_N: float, tick_s: float = math.inf
    ) -> None:
        self.cable, self.winch, self._tick_s = cable, winch, tick_s
        self.state = self.at_rest(tension_N)
        """State, on which the next tick depends."""

    def at_rest(self, tension_N: float) -> CableDriveState:
        """Return the state under a commanded tension after the cable's creep has ended."""
        stretch = max(stretch_at(tension_N, self.cable.stiffness_N_m), 0.0)
        return CableDriveState(tension_N, tension_N, stretch_m=stretch)

    @property
    def spring(self) -> tuple[float, float]:
        """q of this tick, and L_0' - L_0 [m], see `step_spring`."""
        return step_spring(self.cable, self.state.stretch_m, self._tick_s)

    @property
    def step_length_m(self) -> float | None:
        """L_0' of this tick; None while the tension is commanded."""
        length = self.state.length_m
        return None if length is None else length + self.spring[1]

    @property
    def lost_steps(self) -> int:
        """Steps that the winch has lost since the length has been commanded."""
        return 0 if self.state.winch is None else self.state.winch.lost

    @property
    def given_tension_N(self) -> float:
        """Commanded tension; zero, and without effect, while the length is commanded."""
        return self.state.wanted if self.state.length_m is None else 0.0

    def tension_N(self, positions: Array) -> float:
        """Return the tension at the base end at the given shape (n, 3) [m]."""
        length = self.step_length_m
        if length is None:
            return self.state.wanted
        return base_tension(self.cable, positions, length, self.spring[0])

    def unstretched_m(self, positions: Array) -> float:
        """Return the commanded length, or under a commanded tension the unstretched length off the drum."""
        return self.off_drum_m(positions) if self.state.length_m is None else self.state.wanted

    def off_drum_m(self, positions: Array) -> float:
        """Return the unstretched length off the drum; under a commanded tension, route minus stretch."""
        if self.state.length_m is not None:
            return self.state.length_m
        stiffening, longer = self.spring
        stretch = stretch_at(self.state.wanted, self.cable.stiffness_N_m) / stiffening
        return self.cable.length(positions) - longer - stretch

    def begin(self, order: Order | None, positions: Array) -> None:
        """Begin a phase; tension and length do not change at this instant.

        Args:
            order: command of the phase; None: unchanged.
            positions: (n, 3) [m].
        """
        state = self._prepared(order, positions)
        self.state = replace(state, begin=state.wanted)

    def move(
        self, order: Order | None, load_factor: float, commanded: Order | None, positions: Array
    ) -> None:
        """Set the commanded value at the end of a tick; a winch turns afterwards, see `Drum`.

        Args:
            order: command of the phase; None: unchanged.
            load_factor: of the phase's ramp, 0 to 1.
            commanded: command of a controller, in place of the ramp; None: the ramp.
            positions: (n, 3) [m], at the start of the tick.
        """
        stretch = max(self.cable.length(positions) - self.off_drum_m(positions), 0.0)
        self.state = replace(self.state, stretch_m=stretch)
        if commanded is not None:
            state, wanted = self._prepared(commanded, positions), commanded.value
            state = replace(state, begin=wanted)
        else:
            state = self._prepared(order, positions)
            end = state.begin if order is None else order.end(state.begin)
            wanted = end if load_factor >= 1.0 else state.begin + load_factor * (end - state.begin)
        state = replace(state, wanted=wanted)
        if state.length_m is not None and state.winch is None:
            state = replace(state, length_m=wanted)
        self.state = state

    def _prepared(self, order: Order | None, positions: Array) -> CableDriveState:
        """Return the state for the kind of a command, with the present tension."""
        if order is None or (order.kind == "tension") == (self.state.length_m is None):
            return self.state
        if order.kind == "tension":
            tension = self.tension_N(positions)
            return replace(self.state, begin=tension, wanted=tension, length_m=None, winch=None)
        length = self.unstretched_m(positions)
        winch = None if self.winch is None else WinchState(length)
        return replace(self.state, begin=length, wanted=length, length_m=length, winch=winch)
