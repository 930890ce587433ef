"""Rectangular sections of beams: torsion constants of the tables, and what is refused."""

from __future__ import annotations

import pytest

from cosim.errors import InputError
from cosim.soft.beams.beam_rings import RectangularSection


@pytest.mark.parametrize(
    ("width", "height", "expected"),
    [(2.0, 2.0, 0.140577), (4.0, 2.0, 0.228682), (2e-3, 2.0, 1.0 / 3.0 - 0.00021)],
)
def test_torsion_constants_are_those_of_the_tables(width: float, height: float, expected: float) -> None:
    # Timoshenko and Goodier, Theory of Elasticity, table of k_1: J / (s r^3)
    short, long = sorted((width, height))
    section = RectangularSection(width, height, 1.0)
    assert section.torsion_constant_m4 / (long * short**3) == pytest.approx(expected, rel=2e-5)


def test_impossible_sections_are_refused() -> None:
    with pytest.raises(InputError, match=r"width_m is 0\.0; it must be positive"):
        RectangularSection(0.0, 1e-3, 2e9)
    with pytest.raises(InputError, match=r"poisson_ratio is 0\.6; it must lie above -1"):
        RectangularSection(1e-3, 1e-3, 2e9, 0.6)
