"""What statics guess of the next increment, from those before."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import cosim
from cosim.base.frames import Array, Wrench
from cosim.stepping.arm_carrier import ArmCarrier
from cosim.stepping.extrapolation import next_of

TURNS = """
schema = 2
title = "An arm turns a soft robot whose weight bends it"
robot = "ur5e"
soft_robot = "hexagon_arm"
mode = "quasistatic"
model.published = true
payload_compensation = false

[start]
flange = { position_m = [0.3, 0.0, 0.7], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 10e3

[[phase]]
name = "turn"
duration_s = 1.0
increments = 12
flange_turn = { axis = [0.0, 1.0, 0.0], angle_rad = -0.3 }
"""


def test_a_parabola_is_extrapolated_and_a_single_value_stays() -> None:
    times = np.arange(5.0)[:, None, None]
    trail = 1.0 + times * [[2.0, -1.0], [0.5, 3.0]] + 0.3 * times**2
    assert next_of(trail[:4]) == pytest.approx(trail[4], abs=1e-13)
    assert next_of(trail[:1]) == pytest.approx(trail[0], abs=0.0)
    line = 2.0 * trail[2] - trail[1]
    assert next_of(trail[:3]) == pytest.approx(line, abs=1e-13)


def test_a_line_is_used_if_a_parabola_is_not_far_nearer() -> None:
    kinked = np.array([0.0, 1.0, 2.0, 4.0])[:, None]  # both were off by one
    assert next_of(kinked) == pytest.approx([6.0], abs=1e-13)


def test_an_arm_with_extrapolated_deflection_needs_fewer_rounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, rounds = tmp_path / "turns.toml", [0]
    path.write_text(TURNS, encoding="utf-8")
    begin, relax = ArmCarrier.track, ArmCarrier.relax_under

    def track(carrier: ArmCarrier, reference: Array, deflection: Array) -> None:
        rounds.append(0)
        begin(carrier, reference, deflection)

    def relax_under(carrier: ArmCarrier, reference: Array, wrench: Wrench) -> bool:
        rounds[-1] += 1
        return relax(carrier, reference, wrench)

    monkeypatch.setattr(ArmCarrier, "track", track)
    monkeypatch.setattr(ArmCarrier, "relax_under", relax_under)
    cosim.run(path)
    assert max(rounds[5:]) < rounds[1], rounds
