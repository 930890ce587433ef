"""A controller that presses: it lowers the flange as long as the force is too small."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import cosim


@final
@dataclass(frozen=True)
class Press(cosim.Controller[None]):
    """Presses the soft robot down on a body with a set force.

    The flange sinks at the speed gain * (force - felt), within bounds.

    Args:
        on: name of the body.
        force_N: that is wanted.
        gain_m_Ns: speed over missing force.
        speed_max_m_s: of the flange.
    """

    on: str
    force_N: float
    gain_m_Ns: float = 0.01
    speed_max_m_s: float = 0.02

    def start(self, seen: cosim.Measurement) -> None:
        """Nothing is remembered."""

    def act(self, state: None, seen: cosim.Measurement) -> tuple[None, cosim.Command]:
        felt = -float(seen.contact_force_N[self.on][2])
        wanted = self.gain_m_Ns * (self.force_N - felt)
        speed = min(max(wanted, -self.speed_max_m_s), self.speed_max_m_s)
        return None, cosim.Command(flange_twist=(0.0, 0.0, -speed, 0.0, 0.0, 0.0))
