"""What an integrator makes of the soft side's mass in an exchange that is one tick late."""

from __future__ import annotations

from typing import Final

from cosim.soft.dynamics import Integrator

_BDF2_GAIN: Final = 4.0


def exchange_gain(integrator: Integrator) -> float:
    """Return how many times less mass an exchange that is one tick late bears than with implicit Euler.

    With r the mass ratio, changes d of the flange's velocity follow d_n+1 = -r d_n with implicit Euler,
    d_n+1 = -r (9 d_n - 6 d_n-1 + d_n-2) / 4 with BDF2: stable below r = 1 and r = 1/4.
    """
    return _BDF2_GAIN if integrator == "bdf2" else 1.0
