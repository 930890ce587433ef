"""A stepper motor that winds a cable on a drum through a gear.

A step winds l = step angle x drum radius / gear ratio. The driver counts the steps that it commands; the drum
follows unless the cable pulls too hard: steps that would lift the tension above the stall force
F = stall torque x gear ratio / drum radius are lost, and a tension above it drags the drum back by whole
steps. Nothing tells the driver: it goes on from its count, so the length stays wrong by what was lost.
Within a tick the eyelets count as fixed, a step of l lifts the tension by k l (k the cable's stiffness): near
stall the motor is therefore slowed down to (F - T) / (k tick), never taken beyond.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, final

from cosim.errors import InputError

_MOST_STEPS: Final = 2.0**53
"""That whole numbers count; a winch that is asked for more winds for ever anyway."""


@final
@dataclass(frozen=True)
class Winch:
    """What a winch can do.

    Args:
        step_angle_rad: of the motor, per commanded (micro)step.
        gear_ratio: turns of the motor per turn of the drum.
        drum_radius_m: to the middle of the cable.
        step_rate_per_s: highest rate of commanded steps.
        stall_torque_Nm: of the motor, above which it loses steps.

    Raises:
        InputError: a value that is not above 0.
    """

    step_angle_rad: float
    gear_ratio: float
    drum_radius_m: float
    step_rate_per_s: float
    stall_torque_Nm: float

    def __post_init__(self) -> None:
        for name in ("step_angle_rad", "gear_ratio", "drum_radius_m", "step_rate_per_s", "stall_torque_Nm"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise InputError(f"winch: {name} is {getattr(self, name)}; it must be positive and finite")

    @property
    def step_m(self) -> float:
        """Length l of cable per step."""
        return self.step_angle_rad * self.drum_radius_m / self.gear_ratio

    @property
    def speed_m_s(self) -> float:
        """Highest speed of the cable."""
        return self.step_rate_per_s * self.step_m

    @property
    def stall_force_N(self) -> float:
        """Tension F above which steps are lost."""
        return self.stall_torque_Nm * self.gear_ratio / self.drum_radius_m

    def length_m(self, state: WinchState) -> float:
        """Return the unstretched length of cable that is off the drum."""
        return state.unwound_m - (state.commanded - state.lost) * self.step_m

    def advanced(
        self, state: WinchState, wanted_m: float, tension_N: float, stiffness_N_m: float, step_s: float
    ) -> WinchState:
        """Return the state one tick later.

        Args:
            state: before.
            wanted_m: unstretched length to go to, as the driver counts; whole steps are taken.
            tension_N: of the cable at the drum, before.
            stiffness_N_m: k, of the cable.
            step_s: length of the tick.
        """
        to_wind = (state.unwound_m - wanted_m) / self.step_m
        missing = round(min(max(to_wind, -_MOST_STEPS), _MOST_STEPS)) - state.commanded
        budget = state.budget + self.step_rate_per_s * step_s
        steps = max(-math.floor(budget), min(missing, math.floor(budget)))
        room = (self.stall_force_N - tension_N) / (stiffness_N_m * self.step_m)
        dragged = max(math.ceil(-room), 0)
        stuck = max(steps - max(math.floor(room), 0), 0)
        return replace(
            state,
            commanded=state.commanded + steps,
            lost=state.lost + dragged + stuck,
            # parts of a step add up from tick to tick, whole ones not taken do not
            budget=min(budget - abs(steps), 1.0),
        )


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
