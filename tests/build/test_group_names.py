"""A group's film names a face group of the body, or is refused by key."""

from __future__ import annotations

from dataclasses import replace

import pytest

from cosim.base.resources import soft_robot_path
from cosim.build.file_checks import check_robot
from cosim.config.loading import load_soft_robot
from cosim.errors import ScenarioError


def test_a_group_that_a_bellows_has_not_is_refused_by_key() -> None:
    robot = load_soft_robot(soft_robot_path("bellows_gripper"))
    other = replace(robot, groups=tuple(replace(entry, name="other") for entry in robot.groups))
    told = r"soft_robot\.body: a film is for face group 'other'; there are strip, folds$"
    with pytest.raises(ScenarioError, match=told):
        check_robot(other)
