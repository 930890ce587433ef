"""What commands one cable through a run: its tension, or its unstretched length, by a winch or at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, final

from cosim.base.frames import Array
from cosim.devices.winch import Winch, WinchState
from cosim.soft.elements.cable import Cable, base_tension
from cosim.soft.elements.cable_length import stretch_at

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
    """

    begin: float
    wanted: float
    length_m: float | None = None
    winch: WinchState | None = None


@final
class CableDrive:
    """Drives one cable.

    Args:
        cable: of the soft body.
        winch: that winds it; None: a commanded length is there at once.
        tension_N: before the first phase.
    """

    def __init__(self, cable: Cable, winch: Winch | None, tension_N: float) -> None:
        self.cable, self.winch = cable, winch
        self._state = CableDriveState(tension_N, tension_N)

    @property
    def length_m(self) -> float | None:
        """Unstretched length off the drum; None while the tension is commanded."""
        return self._state.length_m

    @property
    def lost_steps(self) -> int:
        """Steps that the winch has lost since the length is commanded."""
        return 0 if self._state.winch is None else self._state.winch.lost

    @property
    def given_tension_N(self) -> float:
        """Commanded tension; zero, and without meaning, while the length is commanded."""
        return self._state.wanted if self._state.length_m is None else 0.0

    def tension_N(self, positions: Array) -> float:
        """Return the tension at the base end at the given shape (n, 3) [m]."""
        length = self._state.length_m
        return self._state.wanted if length is None else base_tension(self.cable, positions, length)

    def unstretched_m(self, positions: Array) -> float:
        """Return the commanded length; while the tension is, that by which it would be the same."""
        if self._state.length_m is not None:
            return self._state.wanted
        return self.cable.length(positions) - stretch_at(self._state.wanted, self.cable.stiffness_N_m)

    def begin(self, order: Order | None, positions: Array) -> None:
        """Begin a phase; nothing changes at this instant.

        Args:
            order: what the phase asks; None: all stays.
            positions: (n, 3) [m].
        """
        state = self._prepared(order, positions)
        self._state = replace(state, begin=state.wanted)

    def move(
        self,
        order: Order | None,
        load_factor: float,
        commanded: Order | None,
        positions: Array,
        step_s: float,
    ) -> None:
        """Go on to the end of a tick.

        Args:
            order: what the phase asks; None: all stays.
            load_factor: of the phase's ramp, 0 to 1.
            commanded: by a controller, in place of the ramp; None: the ramp.
            positions: (n, 3) [m], at the start of the tick.
            step_s: length of the tick.
        """
        if commanded is not None:
            state, wanted = self._prepared(commanded, positions), commanded[1]
            state = replace(state, begin=wanted)
        else:
            state = self._prepared(order, positions)
            end = _end(order, state.begin)
            wanted = end if load_factor >= 1.0 else state.begin + load_factor * (end - state.begin)
        state = replace(state, wanted=wanted)
        if state.length_m is not None and self.winch is not None and state.winch is not None:
            tension = base_tension(self.cable, positions, state.length_m)
            turned = self.winch.advanced(state.winch, wanted, tension, self.cable.stiffness_N_m, step_s)
            state = replace(state, length_m=self.winch.length_m(turned), winch=turned)
        elif state.length_m is not None:
            state = replace(state, length_m=wanted)
        self._state = state

    def save_state(self) -> CableDriveState:
        """Return what the next tick depends on."""
        return self._state

    def restore_state(self, state: CableDriveState) -> None:
        """Return to a state of `save_state`."""
        self._state = state

    def _prepared(self, order: Order | None, positions: Array) -> CableDriveState:
        """Return the state in which an order can be followed, with the present tension."""
        if order is None or (order[0] == "tension") == (self._state.length_m is None):
            return self._state
        if order[0] == "tension":
            tension = self.tension_N(positions)
            return CableDriveState(tension, tension)
        length = self.unstretched_m(positions)
        winch = None if self.winch is None else WinchState(length)
        return CableDriveState(length, length, length, winch)


def _end(order: Order | None, begin: float) -> float:
    """Return the tension [N] or length [m] at the end of a ramp."""
    if order is None:
        return begin
    return begin - order[1] if order[0] == "shortening" else order[1]
