"""Sentences on error bars, and warnings of large ones."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from cosim.telemetry.run_errors import RunErrors

BARS: Final = {
    "tip_m": ("tip", "mm", 1e3),
    "sag_m": ("sag", "mm", 1e3),
    "length_m": ("length", "mm", 1e3),
    "volume_m3": ("volume", "cm^3", 1e6),
    "cable_tension_N": ("tension", "N", 1.0),
    "peak_strain": ("strain of frames", "%", 1e2),
}
"""Name, unit, and factor from SI units of each figure with an error bar."""
_LARGE: Final = 0.25
"""Error bar over its figure, above which there is a warning."""
_CAUSES: Final = {
    "of_mesh": "the mesh is coarse: fidelity = 'refined' divides every triangle into four",
    "of_tick": "ticks are long: shorten clock.tick_s",
    "of_solver": "the solver's tolerance is large: lower it",
    "of_section": "the section model differs from its film: use fidelity = 'lumped'",
}


def bar_warnings(phases: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a warning for phases with error bars above a quarter of their figures, and the cause.

    Phases with the same figures and bars share a warning. Bars of tip and sag are compared with the length.

    Args:
        phases: of a summary, with their `error`.
    """
    warnings: dict[str, list[str]] = {}
    for phase in phases:
        bars = phase.get("error")
        if bars is None or bars["reason"]:
            continue
        large = {key: size for key in BARS if (size := _figure(phase, key)) * _LARGE < (bars[key] or 0.0)}
        if not large:
            continue
        texts = []
        for key, size in large.items():
            name, unit, scale = BARS[key]
            of = "a length of " if key in ("tip_m", "sag_m") else ""
            texts.append(f"{name} by {scale * bars[key]:.2g} of {of}{scale * size:.3g} {unit}")
        key = max(large, key=lambda key: bars[key] / max(large[key], 1e-300))
        parts = {part: bars.get(part, {}).get(key, 0.0) for part in _CAUSES}
        cause = _CAUSES[max(parts, key=lambda part: parts[part])]
        warnings.setdefault(f"{', '.join(texts)}; {cause}", []).append(f"'{phase['name']}'")
    return [
        f"at the end of phase{'s' * (len(names) > 1)} {', '.join(names)} figures may be far off: {text}"
        for text, names in warnings.items()
    ]


def bar_lines(errors: RunErrors, names: Sequence[str]) -> list[str]:
    """Return a line for each phase end of a run: its error bars and the parts of the tip's, or why not.

    Args:
        errors: of the run.
        names: of its phases.
    """
    lines, width = [errors.reason] if errors.reason else [], max(map(len, names), default=0)
    for phase, bars in sorted(errors.phases.items()):
        known = {key: scale * bars[key] for key, (_, _, scale) in BARS.items() if bars[key] is not None}
        texts = [f"{BARS[key][0]} {value:.2g} {BARS[key][1]}" for key, value in known.items()]
        parts = {part: 1e3 * bars[part]["tip_m"] for part in _CAUSES if "tip_m" in bars.get(part, {})}
        texts += [f"tip by {part.removeprefix('of_')} {value:.2g} mm" for part, value in parts.items()]
        lines.append(f"{names[phase]:<{width}}  {bars['reason'] or ', '.join(texts)}")
    return lines


def _figure(phase: Mapping[str, Any], key: str) -> float:
    """Return the magnitude of a bar's figure; infinite if the phase does not have it."""
    if key == "peak_strain":
        value = phase.get("stiffener", {}).get("peak_strain")
    else:
        value = phase.get("length_m" if key in ("tip_m", "sag_m") else key)
    if value is None or not np.size(value):
        return math.inf
    return float(np.max(np.abs(value)))
