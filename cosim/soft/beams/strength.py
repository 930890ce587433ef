"""Which stiffeners of a body are nearest to their strength."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from cosim.base.frames import Array
from cosim.soft.beams.beam_rings import BeamRings
from cosim.soft.body.body import SoftBody


class StiffenerStrain(NamedTuple):
    """How far stiffeners are strained.

    Args:
        peak: largest strain of a fibre.
        strength: that their material bears; infinite where nobody said it.
    """

    peak: float
    strength: float


def stiffener_strain(body: SoftBody, positions: Array) -> StiffenerStrain | None:
    """Return the strain of the stiffeners nearest to their strength, or farthest beyond it; None without any.

    Of those whose strength nobody said, the strain of those strained most.

    Args:
        body: with or without rings of beams.
        positions: (n, 3) [m].
    """
    x, found = np.array(positions, order="C"), list[StiffenerStrain]()
    for beams in body.of_kind(BeamRings):
        strains = beams.peak_strains(x, beams.first_memory(body.positions))
        found.append(StiffenerStrain(float(strains.max()), beams.section.strength_strain))
    return max(found, key=lambda entry: (entry.peak / entry.strength, entry.peak), default=None)


def stiffener_report(body: SoftBody) -> str:
    """Return what stiffeners a body has, for people."""
    sections = dict.fromkeys(beams.section for beams in body.of_kind(BeamRings))
    texts = [
        f"beams of {1e3 * section.width_m:g} x {1e3 * section.height_m:g} mm, "
        f"{1e-9 * section.young_modulus_Pa:g} GPa"
        + (f", strength {100.0 * section.strength_strain:g} %" if section.strength_strain < math.inf else "")
        for section in sections
    ]
    texts += ["stiff"] if body.frames is not None else []
    return "; ".join(texts) or "none"
