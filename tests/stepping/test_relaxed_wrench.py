"""An arm and a soft robot that push each other find a common place."""

from __future__ import annotations

import numpy as np
import pytest

import cosim
from cosim.base.frames import Wrench
from cosim.errors import ConvergenceError
from cosim.stepping import quasistatic
from cosim.stepping.relaxed_wrench import RelaxedWrench


def stiff(given: Wrench) -> Wrench:
    """Return what a floor 1.5 times as stiff as the arm answers; common ground is at 4 N."""
    return Wrench(np.array([0.0, 0.0, 10.0]) - 1.5 * given.force, -1.2 * given.torque)


def test_wrenches_that_would_swing_for_ever_settle() -> None:
    relaxed, found = RelaxedWrench(), Wrench(np.array([0.0, 0.0, 5.0]), np.array([0.0, 0.1, 0.0]))
    for _ in range(16):
        found = stiff(relaxed.next(found))
    assert found.force == pytest.approx([0.0, 0.0, 4.0], abs=1e-6)
    assert found.torque == pytest.approx(np.zeros(3), abs=1e-6)


def test_the_first_rounds_take_the_wrench_as_it_is() -> None:
    relaxed = RelaxedWrench()
    for k in range(4):
        found = Wrench(np.array([0.0, 0.0, (-1.0) ** k]))
        assert relaxed.next(found) is found


def test_arm_and_soft_robot_without_common_equilibrium_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    # one round does not suffice for the servos to give way to a weight of 8.5 N
    monkeypatch.setattr(quasistatic, "_ROUNDS_MAX", 1)
    with pytest.raises(
        ConvergenceError, match="no common equilibrium: after 1 rounds the flange still moves"
    ):
        cosim.run(
            "ur5e_hexagon_arm",
            overrides={"model.published": True, "mode": "quasistatic", "payload_compensation": False},
        )
