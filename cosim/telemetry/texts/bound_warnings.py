"""Warnings of figures beyond a bound: strength, shape, range of a section model, energy of eyelets."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

from cosim.base.names import PUT_IN, TERMS

_DAMPED: Final = ("damping_J", "air_drag_J", "material_damping_J")
_LEAST_FRACTION: Final = 0.01
"""Least energy for a warning, over all energy exchanged in a phase."""
_INSIDE_OUT_m3: Final = -1e-8
"""Volume below which a chamber is inside out; films in contact penetrate by less."""
_SHORTEST: Final = 0.98
"""Extension ratio below which a stack is too short; frames in contact yield by less."""


def shape_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a warning for each phase that ends with films or frames that have passed through one another."""
    warnings = []
    for phase in phases:
        end = f"at the end of phase '{phase['name']}'"
        for name, chamber in phase["chambers"].items():
            if chamber["volume_m3"] < _INSIDE_OUT_m3:
                warnings.append(
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
            warnings.append(
                f"{end} the stack is shorter than laid flat: its extension ratio is {ratio:.2g}"
                f"{frames if 'stiffener' in phase else ''}"
            )
    return warnings


def section_warnings(model: Mapping[str, Any] | None) -> list[str]:
    """Return a warning of a section model with unknown accuracy, if it is one.

    Args:
        model: `RunInfo.section_model`.
    """
    if model is None or math.isfinite(model["tip_error"]):
        return []
    return [
        "the section model's accuracy is unknown: it has no equilibrium at some loads at which its film has "
        "one; compare with fidelity = 'lumped' before you rely on its figures"
    ]


def strength_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a warning for each phase that ends with stiffeners beyond their strength."""
    warnings = []
    for phase in phases:
        peak, strength = (phase.get("stiffener", {}).get(key) for key in ("peak_strain", "strength_strain"))
        if peak is not None and strength is not None and peak > strength:
            warnings.append(
                f"at the end of phase '{phase['name']}' stiffeners may break: strain "
                f"{_percent_beyond(peak, strength)} %, limit {100.0 * strength:.2g} %; lower the pressure or "
                "use a larger section"
            )
    return warnings


def _percent_beyond(value: float, bound: float) -> str:
    """Return a value above a bound in percent, with as many digits as it differs by, at least two."""
    texts = (f"{100.0 * value:.{digits}g}" for digits in range(2, 17))
    return next((text for text in texts if float(text) > float(f"{100.0 * bound:.2g}")), f"{100.0 * value}")


def eyelet_warnings(phases: Sequence[dict[str, Any]]) -> list[str]:
    """Return a sentence on the phase in which eyelets make most energy, if that exceeds the damping.

    Args:
        phases: of the summary; their energies are sums since the start.
    """
    before, worst, most = dict.fromkeys(TERMS, 0.0), "", 0.0
    for phase in phases:
        energy = phase.get("energy")
        if not energy:
            continue
        change = {name: energy[name] - before[name] for name in TERMS}
        made, damped = change["eyelets_made_J"], sum(change[name] for name in _DAMPED)
        exchanged, before = sum(abs(change[name]) for name in PUT_IN), energy
        if made > max(most, damped, _LEAST_FRACTION * exchanged):
            most = made
            worst = (
                f"phase '{phase['name']}': eyelets make {1e3 * made:.3g} mJ where cables slide back, more "
                f"than the {1e3 * damped:.3g} mJ that declared damping takes; losses = 'directed' of the "
                "robot's [[cable]] opposes the way they slide"
            )
    return [worst] if worst else []
