"""Warnings of strained stiffeners name a strain that is above what they bear, also where it is hardly so."""

from __future__ import annotations

import math

import pytest

from cosim.telemetry.texts.bound_warnings import section_warnings, strength_warnings


@pytest.mark.parametrize(("peak", "told"), [(0.0221, "2.2"), (0.02004, "2.004"), (0.31, "31")])
def test_the_strain_is_reported_in_enough_digits(peak: float, told: str) -> None:
    phase = {"name": "pull", "stiffener": {"peak_strain": peak, "strength_strain": 0.02}}
    (warning,) = strength_warnings([phase])
    assert f"strain {told} %, limit 2 %; lower the pressure" in warning


@pytest.mark.parametrize("peak", [0.019, 0.02, None])
def test_strain_within_the_limit_is_not_reported(peak: float | None) -> None:
    assert not strength_warnings(
        [{"name": "pull", "stiffener": {"peak_strain": peak, "strength_strain": 0.02}}]
    )


def test_a_section_model_of_unknown_accuracy_is_warned_of() -> None:
    known = {"tip_error_m": 1e-3, "tip_error": 0.01}
    assert not section_warnings(None)
    assert not section_warnings(known)
    (warning,) = section_warnings(known | {"tip_error": math.inf})
    assert "accuracy is unknown" in warning
    assert "fidelity = 'lumped'" in warning
