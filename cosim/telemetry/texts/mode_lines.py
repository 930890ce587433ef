"""Sentences on natural modes, from the rows of a summary."""

import math
from collections.abc import Sequence
from typing import Any


def swing_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the first phase whose lowest mode is overdamped by the integrator.

    It loses nine tenths of its amplitude in a period, and more than by declared damping.

    Args:
        phases: of the summary.
    """
    for phase in phases:
        for mode in phase.get("modes", ())[:1]:
            frequency, numerical = mode["frequency_Hz"], mode["numerical_decay_per_s"] or 0.0
            if numerical > max(mode["declared_decay_per_s"] or 0.0, math.log(10.0) * frequency):
                return [
                    f"phase '{phase['name']}': the soft robot cannot swing at its lowest frequency, "
                    f"{frequency:.3g} Hz: ticks damp it by {numerical:.2g} per s; use solver.integrator = "
                    "'bdf2' or a shorter clock.tick_s"
                ]
    return []


def swing_lines(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the natural modes of the phase with the lowest frequency; empty without any.

    Args:
        phases: of the summary.
    """
    known = [phase for phase in phases if phase.get("modes")]
    if not known:
        return []
    phase = min(known, key=lambda phase: float(phase["modes"][0]["frequency_Hz"]))
    modes = phase["modes"]
    frequencies = ", ".join(f"{mode['frequency_Hz']:.3g}" for mode in modes)
    text = f"{frequencies} Hz (phase '{phase['name']}')"
    if modes[0]["declared_decay_per_s"] is None:
        return [text]
    declared, numerical = (
        ", ".join(f"{mode[key]:.2g}" for mode in modes)
        for key in ("declared_decay_per_s", "numerical_decay_per_s")
    )
    return [f"{text}; they decay at {declared} per s as declared, and by ticks at {numerical} more"]
