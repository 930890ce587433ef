"""Figure 7H: the paper's bang-bang law holds bending angles with the tensions that statics gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cosim
from benchmarks.paper_figures import MODELS, Runs, held_tensions, static_tensions, statics_of_angles
from cosim.config.loading import load_scenario

TARGET_deg = 20


@pytest.mark.parametrize("model", ["published", pytest.param("default", marks=pytest.mark.long)])
def test_the_law_holds_an_angle_with_the_tension_that_statics_gives(model: str) -> None:
    whole = load_scenario("hexagon_arm_angles", MODELS[model])
    inflate, begin, *targets = whole.phases
    target = next(phase for phase in targets if phase.name == f"angle_{TARGET_deg}")
    phases = (inflate, replace(begin, duration_s=0.1), replace(target, duration_s=2.0))
    held = held_tensions(cosim.run(replace(whole, phases=phases), error=False))[TARGET_deg]
    angles, tensions = static_tensions(statics_of_angles(Runs(), model))
    assert angles[0] < 1e-6
    assert held == pytest.approx(float(np.interp(TARGET_deg, angles, tensions)), abs=0.1)


def test_the_published_model_needs_the_tensions_of_plain_statics() -> None:
    angles, tensions = static_tensions(statics_of_angles(Runs(), "published"))
    needed = np.interp([10, 20, 30, 40, 50], angles, tensions)
    np.testing.assert_allclose(needed, [0.7, 1.3, 1.9, 2.45, 3.1], atol=0.05)
