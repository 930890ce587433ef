"""Position of a chain in the working range of its model: the strains and pressures that were sampled."""

import math
from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.errors import OutOfRangeError
from cosim.reduced.section_model import SectionBody
from cosim.reduced.sections.coefficients import BENT, HIGH, LOW

_AT_ITS_END: Final = 0.95
"""Fraction of the range; if no solution is found beyond it, the reason is the end of the model."""
_ROUNDING: Final = 1e-9
_NO_STRETCH: Final = 1e-100  # a stretch over it is finite, and beyond any range
INSTEAD: Final = "use fidelity = 'lumped', which has no such limit"


@final
@dataclass(frozen=True)
class PlaceInRange:
    """The section that is nearest to the end of its range.

    Args:
        fraction: of the range that it uses; 1 at its end.
        text: which section, which strain, its value and the end of its range.
    """

    fraction: float
    text: str

    @property
    def at_its_end(self) -> bool:
        """Whether the end of the model explains a step or an equilibrium without solution."""
        return self.fraction > _AT_ITS_END


def place_in_range(
    section: SectionBody, frames: Array, pressure_Pa: float, *, bends_only: bool = False
) -> PlaceInRange:
    """Return the place in the working range of the section that uses most of its range.

    Args:
        section: model.
        frames: (f, 4, 3).
        pressure_Pa: gauge.
        bends_only: whether to ignore stretch.
    """
    section.set_pressure(pressure_Pa)
    values, limits = section.frames.strains(frames), section.coefficients
    stretch = values[:, 2] * section.inverse_length - 1.0
    # a spline through few pressures may change sign between them: there the range is empty
    bend_end = np.sqrt(np.maximum(limits[:, BENT], np.finfo(float).tiny))
    bend = np.hypot(values[:, 3], values[:, 4])
    stretch_end = np.where(
        stretch < 0.0, np.minimum(limits[:, LOW], -_NO_STRETCH), np.maximum(limits[:, HIGH], _NO_STRETCH)
    )
    fractions = np.stack([np.where(bends_only, 0.0, stretch / stretch_end), bend / bend_end])
    kind, worst = divmod(int(np.argmax(fractions)), len(stretch))
    copy, index = divmod(worst, count := len(stretch) // section.frames.copies)
    names = ("flange", *section.body.frame_rings, "tip")
    section_text = f"section {index + 1} of {count} ({names[index]} to {names[index + 1]})"
    if section.frames.copies > 1:
        section_text += f" of copy {copy + 1}"
    if kind:
        angle, end_angle = _degrees(bend[worst]), _degrees(bend_end[worst])
        state = f"is bent by {angle} degrees, its model ends at {end_angle}"
    else:
        word = "shortened" if stretch[worst] < 0.0 else "stretched"
        used, end = (100.0 * abs(stretch[worst]), 100.0 * abs(stretch_end[worst]))
        state = f"is {word} by {used:.1f} %, its model ends at {end:.1f} %"
    return PlaceInRange(
        float(fractions[kind, worst]), f"{section_text} {state} (at {1e-3 * pressure_Pa:.3g} kPa)"
    )


def check_pressure(section: SectionBody, pressure_Pa: float, residual_N: float, iterations: int) -> None:
    """Check that a solution is within the pressures that a model was built from.

    Args:
        section: model.
        pressure_Pa: gauge, of the solution.
        residual_N: of the solution.
        iterations: spent on it.

    Raises:
        OutOfRangeError: it is beyond them.
    """
    end = section.model.spline.largest_Pa
    if pressure_Pa > end * (1.0 + _ROUNDING):
        text = f"its gas is at {1e-3 * pressure_Pa:.4g} kPa, its model ends at {1e-3 * end:.4g}"
        raise OutOfRangeError(f"the section model ends here: {text}; {INSTEAD}", residual_N, iterations, text)


def _degrees(sine: float) -> str:
    return f"{math.degrees(math.asin(min(float(sine), 1.0))):.1f}"
