"""A stepper motor that winds a cable on a drum through a gear. A step winds l = step angle x drum radius /
gear ratio. The driver counts the steps that it commands; the drum follows unless the cable pulls too hard.
Steps that would raise the tension above the stall force F = stall torque x gear ratio / drum radius are lost,
and a tension above F pulls the drum back by whole steps. The driver has no feedback, so the length stays
wrong by the lost steps. Within a tick the eyelets count as fixed, and a step of l raises the tension by k l,
with the cable's stiffness k: near stall the motor slows down to (F - T) / (k tick). For several cables on one
drum, T and k are the sums of their tensions and stiffnesses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, final

from cosim.config.schema.devices import WinchTable

_MOST_STEPS: Final = 2.0**53
"""Largest number of steps that a float represents exactly."""


@final
@dataclass(frozen=True)
class WinchState:
    """State of a winch.

    Args:
        unwound_m: unstretched length of cable off the drum at count 0.
        commanded: the driver's count of steps, winding positive.
        lost: steps that the drum did not follow, and steps by which it was pulled back.
        budget: steps that the rate still allows.
    """

    unwound_m: float
    commanded: int = 0
    lost: int = 0
    budget: float = 0.0

    def length_m(self, winch: WinchTable) -> float:
        """Return the unstretched length of cable off the drum."""
        return self.unwound_m - (self.commanded - self.lost) * winch.step_m

    def advanced(
        self, winch: WinchTable, wanted_m: float, tension_N: float, stiffness_N_m: float, step_s: float
    ) -> WinchState:
        """Return the state one tick later.

        Args:
            winch: table of the winch.
            wanted_m: commanded unstretched length by the driver's count; rounded to whole steps.
            tension_N: of the cable at the drum, at the start of the tick.
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
            # fractions of a step accumulate over ticks, unused whole steps do not
            budget=min(budget - abs(steps), 1.0),
        )
