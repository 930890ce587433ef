"""What film, hinges and stiffeners store and bear at the end of a phase."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from cosim.base.frames import Array
from cosim.telemetry.snapshot import RunInfo


def elastic_figures(run: RunInfo, positions: Array) -> dict[str, Any]:
    """Return the figures of a phase that ends with the film's nodes at positions (n, 3) [m]."""
    figures: dict[str, Any] = {}
    if run.hinge_energy_share is not None:
        figures["hinge_energy_share"] = run.hinge_energy_share(positions)
    strain = None if run.stiffener_strain is None else run.stiffener_strain(positions)
    if strain is not None:
        strength = strain.strength if strain.strength < math.inf else None
        figures["stiffener"] = {"peak_strain": strain.peak, "strength_strain": strength}
    return figures


def strength_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a warning for each phase that ends with stiffeners beyond their strength."""
    found = []
    for phase in phases:
        peak, strength = (phase.get("stiffener", {}).get(key) for key in ("peak_strain", "strength_strain"))
        if peak is not None and strength is not None and peak > strength:
            found.append(
                f"at the end of phase '{phase['name']}' the stiffeners are strained by "
                f"{_percent_beyond(peak, strength)} %, beyond the {100.0 * strength:.2g} % that they bear"
            )
    return found


def _percent_beyond(value: float, bound: float) -> str:
    """Return a value above a bound in percent, in as many digits as tell it from the bound, at least two."""
    texts = (f"{100.0 * value:.{digits}g}" for digits in range(2, 17))
    return next((text for text in texts if float(text) > float(f"{100.0 * bound:.2g}")), f"{100.0 * value}")
