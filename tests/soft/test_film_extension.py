"""Units of wrinkling film on coarse meshes extend as finite elements say, where plain film stays at half."""

from __future__ import annotations

import pytest

from benchmarks.film_extension import SNAPPING, inflated, pushed


@pytest.mark.parametrize("level", [0, 1])
def test_a_unit_extends_as_finite_elements_say(level: int) -> None:
    plain, wrinkling = inflated("one_square", "plain", level), inflated("one_square", "wrinkling", level)
    for key, error in wrinkling["error"].items():
        # refine 1 at 10 kPa is 7.3 % short of the band, the others from 10 kPa on at most 2.6 %
        assert abs(error) < (SNAPPING if float(key) < 10.0 else 0.075), key
        assert plain["error"][key] < -0.19
    # chords of the drawn mesh enclose less than the film they stand for: finite elements have 42.4 ml
    assert (36.0, 39.5)[level] < wrinkling["volume_ml"]["10"] < 42.4
    assert wrinkling["iterations"] < 1.5 * plain["iterations"]


def test_pull_and_push_cost_three_times_the_iterations_at_most() -> None:
    plain, wrinkling = pushed("plain", 0), pushed("wrinkling", 0)
    assert wrinkling["iterations"] < 3.0 * plain["iterations"]
    assert len(wrinkling["height_mm"]) == len(plain["height_mm"])
    assert wrinkling["height_mm"][9] > 2.0 * plain["height_mm"][9]
