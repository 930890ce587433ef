"""Where in its plan a run has failed, in words."""

from __future__ import annotations

from collections.abc import Sequence


def whereabouts(
    phase: str, step: str, pressures_Pa: Sequence[float], tensions_N: Sequence[float], cables: Sequence[str]
) -> str:
    """Return phase, step, pressures and the largest cable tension of a step that has failed.

    Args:
        phase: its name.
        step: which tick or increment.
        pressures_Pa: of the chambers, gauge, before the step.
        tensions_N: planned at its end, or as devices drive them.
        cables: their names.
    """
    low, high = 1e-3 * min(pressures_Pa), 1e-3 * max(pressures_Pa)
    parts = [f"phase '{phase}'", step, f"{low:.4g} kPa" if low == high else f"{low:.4g} to {high:.4g} kPa"]
    largest = max(tensions_N, default=0.0)
    if largest > 0.0:
        parts.append(f"cable {cables[tensions_N.index(largest)]} at {largest:.4g} N")
    elif tensions_N:
        parts.append("cables slack")
    return ", ".join(parts)
