"""Schema of a scenario's fidelity, and of how it is chosen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, final

from cosim.config.toml.constraints import Positive, Text

Fidelity: TypeAlias = Literal["rigid", "section", "lumped", "refined", "auto"]
"""From the cheapest to the dearest; "auto" is chosen by measurement."""


@final
@dataclass(frozen=True)
class AutoTable:
    """What fidelity, tick and integrator shall meet with `fidelity = "auto"`; at least one requirement.

    Errors are those against the lumped model at the finest tick of the measurement.

    Args:
        budget: least real-time factor of a recorded run, as `cosim run` prints it on an idle machine; the
            nearest to the reference among these is taken.
        tolerance_m: largest error of the tip, and of objects that can move; the fastest within it is taken.
        force_tolerance_N: largest error of the flange force's moving mean over 40 ms.
        chosen: what was chosen, with its figures; cosim writes it into the scenario as it ran.
    """

    budget: Positive | None = None
    tolerance_m: Positive | None = None
    force_tolerance_N: Positive | None = None
    chosen: Text | None = None
