"""x"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final, final

from cosim.config.schema.devices import WinchTable

_MOST_STEPS: Final = 2.0**53
"""That whole numbers count; a winch that is asked for more winds for ever anyway."""


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
