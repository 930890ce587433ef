"""Spiral cables: which nodes they lead through, and that three of them twist a stack without bending it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import cosim
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario

NAME = "hexagon_arm_torsion"
EVERY_INCREMENT = {"recording.frames_per_s": 1e4, "soft_robot.stack.refine": 0}


def twist_rad(turn: int) -> tuple[float, float]:
    """Return by how much the tip has turned about the axis, and leant to a side, with 2 N on each cable."""
    changes: dict[str, Any] = {f"soft_robot.cable.{name}.corners_per_unit": turn for name in "abc"}
    short = {"phase.inflate.increments": 20, "phase.twist.increments": 5}
    pull = {"phase.twist.cable_tension_N": [2.0] * 3}
    scenario = load_scenario(NAME, {**EVERY_INCREMENT, **short, **pull, **changes})
    result = cosim.run(scenario, error=False)
    tip = build_soft_body(scenario.soft_robot, scenario.model).rings["tip"]  # type: ignore[arg-type]
    begin, end = (int(np.flatnonzero(result.phase == k)[-1]) for k in range(2))
    arms = [result.node_position[row, tip, :2] - result.tip_position[row, :2] for row in (begin, end)]
    angles = [np.arctan2(arm[:, 1], arm[:, 0]) for arm in arms]
    turned = float(np.mean(np.angle(np.exp(1j * (angles[1] - angles[0])))))
    return turned, float(np.arccos(min(1.0, result.tip_direction[end, 2])))


def test_a_spiral_cable_goes_on_by_a_corner_from_unit_to_unit() -> None:
    scenario = load_scenario(NAME, {"soft_robot.cable.c.corners_per_unit": -2})
    body = build_soft_body(scenario.soft_robot, scenario.model)  # type: ignore[arg-type]
    for cable, begin, turn in zip(body.cables, (0, 2, 4), (1, 1, -2), strict=True):
        rings = [body.rings[f"unit_{unit}.outer"] for unit in range(1, 6)]
        wanted = [ring[len(ring) // 6 * ((begin + turn * k) % 6)] for k, ring in enumerate(rings)]
        assert cable.nodes.tolist() == wanted


def test_three_spiral_cables_twist_an_arm_against_their_sense_and_do_not_bend_it() -> None:
    right, leant = twist_rad(1)
    left, _ = twist_rad(-1)
    assert -np.radians(1.2) < right < -np.radians(0.8)
    assert left == pytest.approx(-right, rel=0.02)
    assert leant < 1e-6


@pytest.mark.parametrize("units", [3, 10])
def test_a_cable_to_the_last_unit_goes_with_the_number_of_units(units: int) -> None:
    scenario = load_scenario("ur5e_hexagon_arm", {"soft_robot.stack.units": units})
    body = build_soft_body(scenario.soft_robot, scenario.model)  # type: ignore[arg-type]
    for cable in body.cables:
        assert [node in body.rings[f"unit_{unit}.outer"] for unit, node in enumerate(cable.nodes, 1)] == [
            True
        ] * units


def test_a_cable_begins_at_a_unit_with_a_number() -> None:
    with pytest.raises(cosim.InputError, match=r"soft_robot\.cable\.left\.units"):
        load_scenario("ur5e_hexagon_arm", {"soft_robot.cable.left.units": ["last", 10]})
