"""A home that is found: far from singularities, within the limits, upright however the arm is mounted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from cosim.base.resources import robots_directory
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm

URDF = robots_directory() / "ur5e" / "ur5e.urdf"


def least_singular_value(arm: Arm, q: np.ndarray) -> float:
    scaled = arm.jacobian(q) / np.repeat([arm.reach, 1.0], 3)[:, None]
    return float(np.linalg.svd(scaled, compute_uv=False)[-1])


@pytest.mark.parametrize("base", ["", "base.quaternion = [0.0, 1.0, 0.0, 0.0]"], ids=["floor", "ceiling"])
def test_a_home_is_found(tmp_path: Path, base: str) -> None:
    table = tmp_path / "arm.toml"
    table.write_text(f'file = "{URDF}"\n{base}\n')
    file = find_arm(str(table))
    arm, given = Arm(file), Arm(find_arm("ur5e"))
    assert (file.home >= arm.lower).all()
    assert (file.home <= arm.upper).all()
    # as far from singularities as the home that people use for this arm
    assert least_singular_value(arm, file.home) >= least_singular_value(given, given.home)
    np.testing.assert_array_equal(file.home, find_arm(str(table)).home)
    away = arm.forward(file.home).translation - arm.shoulder
    upright = file.world_from_base.rotation[:, 2]
    assert away @ upright >= 0.25 * arm.reach
