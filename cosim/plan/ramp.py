"""Progress of a ramp: from a phase's first to its last value over the ramp's time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

_ROUNDING = 1e-12  # of an instant that is a whole number of ticks


@final
@dataclass(frozen=True)
class Progress:
    """Progress of a ramp at one instant.

    Args:
        value: s, 0 to 1.
        rate: ds/dt [1/s].
        acceleration: d2s/dt2 [1/s^2].
    """

    value: float
    rate: float
    acceleration: float


def progress(kind: Literal["smooth", "linear", "step"], time_s: float, duration_s: float) -> Progress:
    """Return the progress of a ramp.

    smooth (minimum jerk): s = 10 u^3 - 15 u^4 + 6 u^5 with u = t / duration; linear: s = u;
    step: s = 1 from t > 0. Where rate or acceleration jumps, at the ends of a linear ramp, they are those of
    the time after: the start belongs to the ramp, the end to what follows it.
    Source: Flash and Hogan, J. Neurosci. 5 (1985) 1688, for the minimum-jerk polynomial.

    Args:
        kind: of the ramp.
        time_s: since the phase began.
        duration_s: of the ramp.
    """
    if time_s < 0.0 or (time_s == 0.0 and kind != "linear"):
        return Progress(0.0, 0.0, 0.0)
    if time_s >= duration_s * (1.0 - _ROUNDING) or kind == "step":
        return Progress(1.0, 0.0, 0.0)
    u = time_s / duration_s
    if kind == "linear":
        return Progress(u, 1.0 / duration_s, 0.0)
    value = u**3 * (10.0 - 15.0 * u + 6.0 * u * u)
    rate = 30.0 * u * u * (1.0 - u) ** 2 / duration_s
    acceleration = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / duration_s**2
    return Progress(value, rate, acceleration)
