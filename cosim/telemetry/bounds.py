"""Warnings of figures beyond a bound: strength, range of a section model, error bars, energy of eyelets."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from cosim.base.names import PUT_IN, TERMS
from cosim.telemetry.run_errors import RunErrors

BARS: Final = {
    "tip_m": ("tip", "mm", 1e3),
    "sag_m": ("sag", "mm", 1e3),
    "length_m": ("length", "mm", 1e3),
    "volume_m3": ("volume", "cm^3", 1e6),
    "cable_tension_N": ("tension", "N", 1.0),
    "peak_strain": ("strain of frames", "%", 1e2),
}
"""Of each figure that has a bar: name, unit, and how many of it are one in SI."""
_DAMPED: Final = ("damping_J", "air_drag_J", "material_damping_J")
_SEEN_SHARE: Final = 0.01
"""Of all energy put in and taken in a phase: less is not worth a warning."""
_LARGE: Final = 0.25
"""Of a figure: a larger bar is a warning."""
_CAUSES: Final = {
    "of_mesh": "the mesh is coarse: fidelity = 'refined' divides every triangle into four",
    "of_tick": "ticks are long: shorten clock.tick_s",
    "of_solver": "the solver's tolerance is large: lower it",
    "of_section": "the section model is off its film: use fidelity = 'lumped'",
}


def bar_warnings(phases: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a warning for phases with error bars above a quarter of their figures, and the cause.

    Phases with the same figures and bars share one.

    Bars of tip and sag are compared with the length.

    Args:
        phases: of a summary, with their `error`.
    """
    found: dict[str, list[str]] = {}
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
        found.setdefault(f"{', '.join(texts)}; {cause}", []).append(f"'{phase['name']}'")
    return [
        f"at the end of phase{'s' * (len(names) > 1)} {', '.join(names)} figures may be far off: {text}"
        for text, names in found.items()
    ]


def bar_lines(errors: RunErrors, names: Sequence[str]) -> list[str]:
    """Return a line for each phase end of a run: its error bars, what that of the tip is made of, or why not.

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
    """Return the size of the figure that a bar is of; infinite where there is none."""
    if key == "peak_strain":
        value = phase.get("stiffener", {}).get("peak_strain")
    else:
        value = phase.get("length_m" if key in ("tip_m", "sag_m") else key)
    if value is None or not np.size(value):
        return math.inf
    return float(np.max(np.abs(value)))


_OUTSIDE_IN_m3: Final = -1e-8  # films that press on one another yield by less
_SHORTEST: Final = 0.98  # frames that rest on one another yield by less


def shape_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a warning for each phase that ends with films or frames that have passed through one another."""
    found = []
    for phase in phases:
        end = f"at the end of phase '{phase['name']}'"
        for name, chamber in phase["chambers"].items():
            if chamber["volume_m3"] < _OUTSIDE_IN_m3:
                found.append(
                    f"{end} {name} is inside out: its volume is {1e6 * chamber['volume_m3']:.3g} cm^3, its "
                    'films have passed through one another; contact.self_contact = "auto" keeps them apart, '
                    "without model.published"
                )
        ratio = phase["extension_ratio"]
        if ratio is not None and ratio < _SHORTEST:
            frames = (
                "; frames of beams rest on one another with stiffener.rest_on_one_another = true in the soft "
                "robot's file"
            )
            found.append(
                f"{end} the stack is shorter than laid flat: its extension ratio is {ratio:.2g}"
                f"{frames if 'stiffener' in phase else ''}"
            )
    return found


def section_warnings(model: Mapping[str, Any] | None) -> list[str]:
    """Return what to say of a section model whose accuracy is not known.

    Args:
        model: `RunInfo.section_model`.
    """
    if model is None or math.isfinite(model["tip_error"]):
        return []
    return [
        "the section model's accuracy is not known: it has no equilibrium at some loads at which its film "
        "has one; compare with fidelity = 'lumped' before you rely on its figures"
    ]


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


def eyelet_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the phase in which losses of one way make most, if that exceeds the damping.

    Args:
        phases: of the summary; energies are those since the start.
    """
    before, worst, most = dict.fromkeys(TERMS, 0.0), "", 0.0
    for phase in phases:
        energy = phase.get("energy")
        if not energy:
            continue
        here = {name: energy[name] - before[name] for name in TERMS}
        made, damped = here["eyelets_made_J"], sum(here[name] for name in _DAMPED)
        passed, before = sum(abs(here[name]) for name in PUT_IN), energy
        if made > max(most, damped, _SEEN_SHARE * passed):
            most = made
            worst = (
                f"phase '{phase['name']}': eyelets make {1e3 * made:.3g} mJ where cables slide back, more "
                f"than the {1e3 * damped:.3g} mJ that declared damping takes; losses = 'directed' of the "
                "robot's [[cable]] opposes the way they slide"
            )
    return [worst] if worst else []
