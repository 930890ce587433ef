"""Frames that rest on one another: derivatives, no force apart, an arm stowed, deployed and stowed again."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.results.result import RunResult
from cosim.soft.elements.frame_stops import FrameStops
from tests.derivatives import RELATIVE, assembled, derivative_errors

PITCH_m = 2.62e-3
STATICS: dict[str, Any] = {
    "mode": "quasistatic",
    "phase.deploy.increments": 20,
    "phase.deflate.increments": 20,
    "phase.stow.increments": 15,
}


def two_rims(apart_m: float) -> tuple[FrameStops, Array]:
    """Return the stops of two rims that taper by 2.5 mm, and places in which they are so far apart."""
    angle = np.pi / 3.0 * np.arange(6)
    rim = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    drawn = np.concatenate([0.05 * rim, 0.0475 * rim + (0.0, 0.0, 2e-3)])
    stops = FrameStops.from_shape(drawn, np.arange(12).reshape(2, 6), PITCH_m)
    x = drawn.copy()
    x[6:, 2] = apart_m
    return stops, x


def test_derivatives() -> None:
    stops, x = two_rims(2.1e-3)
    x += 1e-4 * np.random.default_rng(0).normal(size=x.shape)
    assert max(derivative_errors(assembled(stops.pairs, stops.add, 12), x, 1e-6)) < RELATIVE


def test_frames_push_only_where_they_would_be_in_one_another() -> None:
    stops, x = two_rims(PITCH_m + 2e-5)
    energy, gradient, _ = assembled(stops.pairs, stops.add, 12)(x)
    assert energy == 0.0
    assert not gradient.any()
    stops, x = two_rims(PITCH_m - 1e-4)
    _, gradient, _ = assembled(stops.pairs, stops.add, 12)(x)
    # 1e5 N/m, by what the slanted distance has lost, along it
    slanted = np.hypot(PITCH_m - 1e-4, 2.5e-3)
    lost = np.hypot(PITCH_m, 2.5e-3) - slanted
    assert -gradient[6:, 2].sum() == pytest.approx(1e5 * lost * (PITCH_m - 1e-4) / slanted, rel=1e-9)
    assert gradient.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


@pytest.fixture(scope="module")
def deployed() -> RunResult:
    return cosim.run(load_scenario("hexagon_arm_deploys", STATICS), error=False)


def test_a_stowed_arm_rests_on_its_frames_and_returns_there(deployed: RunResult) -> None:
    scenario = load_scenario("hexagon_arm_deploys")
    body = build_soft_body(scenario.soft_robot, scenario.model)  # type: ignore[arg-type]
    ends = [int(np.flatnonzero(deployed.phase == k)[-1]) for k in range(5)]
    packed, stowed = (deployed.node_position[ends[k]] for k in (0, 4))
    assert stowed == pytest.approx(packed, abs=1e-6)
    height = -stowed[:, 2]  # it hangs
    rims = [height[body.rings[f"unit_{unit}.outer"]].mean() for unit in range(1, 11)]
    assert np.diff(rims) == pytest.approx(PITCH_m, abs=1e-4)  # 9 N on 1e5 N/m
    for unit in range(1, 11):  # the films of a unit stay apart
        inside = height[body.rings[f"unit_{unit}.upper"]] - height[body.rings[f"unit_{unit}.lower"]]
        assert inside.min() > 1e-3


@pytest.mark.long
def test_a_deployed_arm_is_where_the_drawn_one_is_inflated_to(deployed: RunResult) -> None:
    changes: dict[str, Any] = {
        **STATICS,
        "soft_robot.stiffener.rest_on_one_another": False,
        "start.cable_tension_N": [0.0] * 3,
        "phase.stow.cable_tension_N": [0.0] * 3,
    }
    drawn = cosim.run(load_scenario("hexagon_arm_deploys", changes), error=False)
    one, other = (run.node_position[np.flatnonzero(run.phase == 2)[-1]] for run in (deployed, drawn))
    assert np.linalg.norm(one - other, axis=1).max() < 1e-4
    timed = cosim.Simulation("hexagon_arm_deploys")
    timed.step(420)  # to the end of the phase in which it deploys
    assert timed.snapshot.node_position == pytest.approx(one, abs=1e-4)
    phases = {phase["name"]: phase for phase in deployed.summary["phases"]}
    assert phases["carry"]["pack_ratio"] == pytest.approx(1.0, abs=1e-4)
    ratio = phases["deploy"]["length_m"] / phases["carry"]["length_m"]
    assert phases["deploy"]["pack_ratio"] == pytest.approx(ratio, rel=1e-4)
    assert ratio > 5.0  # what the paper reports of this arm
