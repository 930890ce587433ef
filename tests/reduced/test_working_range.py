"""The section that is nearest to the end of its model's range is named with its strain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cosim.errors import ConvergenceError, OutOfRangeError
from cosim.reduced.section_model import SectionBody, frames_from_strains, strains
from cosim.reduced.sections.coefficients import BENT, HIGH, LOW
from cosim.reduced.solve.working_range import check_pressure, place_in_range
from tests.small_section import section

PRESSURE_Pa = 25e3


def test_the_section_that_uses_most_of_its_range_is_named() -> None:
    body = section()
    straight = body.straight(PRESSURE_Pa)
    body.set_pressure(PRESSURE_Pa)
    limits, values = body.coefficients.copy(), strains(straight[:-1], straight[1:])
    assert not place_in_range(body, straight, PRESSURE_Pa).at_its_end
    bent = values.copy()
    bent[1, 3:5] = np.sqrt(limits[1, BENT]) * np.array([0.6, 0.8])
    found = place_in_range(body, frames_from_strains(straight[0], bent), PRESSURE_Pa)
    assert found.fraction == pytest.approx(1.0)
    angle = np.degrees(np.arcsin(np.sqrt(limits[1, BENT])))
    assert found.text == (
        f"section 2 of 4 (unit_1.outer to unit_2.outer) is bent by {angle:.1f} degrees, "
        f"its model ends at {angle:.1f} (at 25 kPa)"
    )
    short = values.copy()
    short[3, 2] *= 1.0 + 0.97 * limits[3, LOW]
    found = place_in_range(body, frames_from_strains(straight[0], short), PRESSURE_Pa)
    assert found.fraction == pytest.approx(0.97, abs=0.01)
    assert found.at_its_end
    assert found.text.startswith("section 4 of 4 (unit_3.outer to tip) is shortened by ")
    long = values.copy()
    long[3, 2] *= 1.0 + 0.97 * limits[3, HIGH]
    found = place_in_range(body, frames_from_strains(straight[0], long), PRESSURE_Pa)
    assert found.text.startswith("section 4 of 4 (unit_3.outer to tip) is stretched by ")


def test_no_bend_is_within_a_range_whose_square_has_fallen_below_zero() -> None:
    body = section()
    straight = body.straight(PRESSURE_Pa)
    body.set_pressure(PRESSURE_Pa)
    limit, bent = float(body.coefficients[1, BENT]), strains(straight[:-1], straight[1:])
    bent[1, 3:5] = 0.01
    body.coefficients[1, BENT] = -1e-6  # as a spline through few pressures may be between them
    try:
        found = place_in_range(body, frames_from_strains(straight[0], bent), PRESSURE_Pa)
    finally:
        body.coefficients[1, BENT] = limit
    assert found.at_its_end
    assert found.text.startswith("section 2 of 4 (unit_1.outer to unit_2.outer) is bent by ")


@pytest.mark.parametrize("end", [0.0, -1e-6])
def test_no_stretch_is_within_a_range_that_ends_at_the_middle_or_before(end: float) -> None:
    body = section()
    straight = body.straight(PRESSURE_Pa)
    body.set_pressure(PRESSURE_Pa)
    limit, long = float(body.coefficients[1, HIGH]), strains(straight[:-1], straight[1:])
    long[1, 2] *= 1.01
    body.coefficients[1, HIGH] = end  # as a spline through few pressures may be between them
    try:
        found = place_in_range(body, frames_from_strains(straight[0], long), PRESSURE_Pa)
    finally:
        body.coefficients[1, HIGH] = limit
    assert found.at_its_end
    assert found.text.startswith("section 2 of 4 (unit_1.outer to unit_2.outer) is stretched by 1.0 %")


def test_frames_at_right_angles_may_round_to_a_sine_above_one() -> None:
    first = section().straight(PRESSURE_Pa)[0]
    value = np.array([0.0, 0.0, 0.02, np.nextafter(1.0, 2.0), 0.0, 0.0])
    frames = frames_from_strains(first, value[None])
    assert strains(frames[:-1], frames[1:])[0] == pytest.approx(value, abs=1e-12)


def test_a_pressure_beyond_the_samples_is_refused() -> None:
    end = section().model.spline.largest_Pa
    check_pressure(section(), end, 0.0, 1)
    with pytest.raises(
        OutOfRangeError, match=r"44 kPa, its model ends at 40; use fidelity = 'lumped'"
    ) as refused:
        check_pressure(section(), 1.1 * end, 0.0, 1)
    assert isinstance(refused.value, ConvergenceError)
    assert refused.value.place.startswith("its gas is at 44 kPa")


@pytest.mark.parametrize("drawn_out", [1.0, 4.0])
def test_no_node_gets_beyond_the_reach_of_sections_at_their_ends(drawn_out: float) -> None:
    """Of stubby sections, whose rims are as wide as the stack is long, and of slender ones."""
    model = section().model
    body, farthest = SectionBody(section().body, replace(model, length=drawn_out * model.length)), []
    for pressure in body.model.spline.pressures(7):
        straight = body.straight(pressure)
        body.set_pressure(pressure)
        values = strains(straight[:-1], straight[1:])
        values[:, 2] = (1.0 + body.coefficients[:, HIGH]) / body.inverse_length
        for bend in (0.0, 0.5, 1.0):
            values[:, 4] = bend * np.sqrt(body.coefficients[:, BENT])
            nodes = body.positions(frames_from_strains(straight[0], values), pressure)
            farthest.append(float(np.linalg.norm(nodes, axis=1).max()))
    # the bound stands off by the rim's radius, as nodes are beside the axis, and by a twentieth
    assert max(farthest) < body.reach_m < 1.05 * (max(farthest) + 0.06)
