"""An inflated tube as a beam: stiffness in bending and shear, and where it wrinkles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np

from cosim.verification.support.case import Case, Figure
from cosim.verification.support.inflated_tube import FORCE_N, PRESSURE_PA, ROWS, SIDES, InflatedTube


@final
@dataclass(frozen=True)
class InflatedCantilever(Case):
    """Tip deflection and wrinkling moment of a tube clamped at one end.

    The first ring is clamped after inflation, where it then is, so that the clamp does not neck the tube.
    """

    name: ClassVar[str] = "inflated_cantilever"
    title: ClassVar[str] = "Inflated tube as a cantilever"
    source: ClassVar[str] = (
        "Le van and Wielgosz, Thin-Walled Struct. 43 (2005) 1166; Stein and Hedgepeth 1961"
    )

    def run(self) -> tuple[Figure, ...]:
        beam = InflatedTube.make()
        held = np.arange(beam.body.nodes) < SIDES
        found, moved = beam.bent(held, beam.shear_force(ROWS, FORCE_N))
        deflection = abs(float(moved[beam.ring(ROWS), 0].mean())) / FORCE_N
        bending, shear = beam.flexibility()
        exact = beam.length**3 / 3.0 * bending + beam.length * shear
        wrinkling = 0.5 * math.pi * PRESSURE_PA * beam.radius**3
        return (
            Figure("tip deflection / force", "m/N", deflection, exact, 3e-2),
            Figure("wrinkling moment", "N m", beam.wrinkling_moment(found, FORCE_N), wrinkling, 3e-2),
        )


@final
@dataclass(frozen=True)
class InflatedThreePoint(Case):
    """Deflection of a tube on two supports, loaded in the middle: half of it, on its plane of symmetry.

    The support is a ring kept round in its plane, free to move along the tube and to tilt.
    """

    name: ClassVar[str] = "inflated_three_point"
    title: ClassVar[str] = "Inflated tube in three-point bending"
    source: ClassVar[str] = "Le van and Wielgosz, Thin-Walled Struct. 43 (2005) 1166"

    def run(self) -> tuple[Figure, ...]:
        beam = InflatedTube.make()
        held = np.zeros((beam.body.nodes, 3), dtype=bool)
        held[beam.ring(0), 2] = True
        held[beam.ring(ROWS), :2] = True
        _, moved = beam.bent(held, beam.shear_force(0, 0.5 * FORCE_N))
        deflection = abs(float(moved[beam.ring(0), 0].mean())) / FORCE_N
        bending, shear = beam.flexibility()
        span = 2.0 * beam.length
        exact = span**3 / 48.0 * bending + span / 4.0 * shear
        return (Figure("deflection of the middle / force", "m/N", deflection, exact, 3e-2),)
