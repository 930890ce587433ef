"""Texts of arms and of scenarios on them."""

from __future__ import annotations

INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>'

TWO_JOINTS = f"""<robot name="two"><link name="root"/>
<link name="upper">{INERTIAL}</link><link name="hand">{INERTIAL}</link>
<joint name="swing" type="revolute"><parent link="root"/><child link="upper"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.2"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>
<joint name="lift" type="revolute"><parent link="upper"/><child link="hand"/><axis xyz="0 1 0"/>
<origin xyz="0.3 0 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>
"""

_SCENARIO = """schema = 2
title = "an arm of one's own"
robot = "ROBOT"
soft_robot = "hexagon_arm"

[start]
flange.position_m = [0.4, 0.0, 0.4]
flange.direction = [0.0, 0.0, -1.0]

[[phase]]
name = "hang"
duration_s = 0.1
"""


def scenario_with(robot: str) -> str:
    """Return the text of a scenario on an arm."""
    return _SCENARIO.replace("ROBOT", robot)
