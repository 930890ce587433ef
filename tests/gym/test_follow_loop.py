"""A loop at 50 Hz from Python: the tip of an arm follows a target that moves."""

from __future__ import annotations

from typing import Any

import numpy as np

import cosim

RADIUS_m, SPEED_m_s, STEP_S, GAIN_per_s = 0.03, 0.03, 0.02, 4.0
RIGID: dict[str, Any] = {"phase": [], "fidelity": "rigid", "clock.tick_s": 0.004, "contact.enabled": False}


def test_a_tip_follows_a_moving_target() -> None:
    here = cosim.Simulation("ur5e_hexagon_arm", overrides=RIGID)
    seen = here.measure()
    center, errors = seen.tip_position - np.array([RADIUS_m, 0.0, 0.0]), []
    for k in range(60):
        angle = SPEED_m_s / RADIUS_m * STEP_S * (k + 1)  # where the target is at the end of the step
        around = np.array([np.cos(angle), np.sin(angle), 0.0])
        target, moves = center + RADIUS_m * around, SPEED_m_s * np.array([-around[1], around[0], 0.0])
        errors.append(np.linalg.norm(seen.tip_position - (target - STEP_S * moves)))
        velocity = moves + GAIN_per_s * (target - STEP_S * moves - seen.tip_position)
        here.step(cosim.Command(flange_twist=[*velocity, 0.0, 0.0, 0.0]), ticks=5)
        seen = here.measure()
        assert seen.limits == ()
    # the servos lag by some milliseconds of 30 mm/s; the loop takes up the rest
    assert max(errors[20:]) < 1e-3
