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
model.published = true

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


_LINK = '<inertial pos="0.01 0.02 0.1" mass="{mass}" fullinertia="0.03 0.025 0.01 0.001 -0.002 0.0005"/>'

SIX_JOINTS_MJCF = f"""<mujoco model="six">
<compiler angle="degree" autolimits="true"/>
<option timestep="0.001" integrator="RK4" gravity="0 0 -3"/>
<default><default class="arm"><joint axis="0 0 1" armature="0.2" damping="0.5" frictionloss="0.1"
range="-170 170"/><geom type="capsule" size="0.04" rgba="0.2 0.4 0.6 1"/></default></default>
<worldbody><geom name="floor" type="plane" size="1 1 0.1"/><light pos="0 0 3"/>
<body name="base" pos="0.1 0.2 0.3" euler="0 0 30"><geom type="cylinder" size="0.06 0.05" mass="3"/>
<body name="link1" pos="0 0 0.1" childclass="arm"><joint name="j1"/>{_LINK.format(mass=3)}
<geom fromto="0 0 0 0 0 0.1"/>
<body name="link2" pos="0 0 0.15" euler="90 10 0"><joint name="j2" pos="0.02 -0.01 0.03" ref="25"/>
{_LINK.format(mass=2)}<geom fromto="0 0 0 0.3 0 0"/>
<body name="link3" pos="0.3 0 0"><joint name="j3" axis="0.2 0.1 1" limited="false"/>{_LINK.format(mass=1.5)}
<geom fromto="0 0 0 0.25 0 0"/>
<body name="link4" pos="0.25 0 0" euler="0 90 0"><joint name="j4"/>{_LINK.format(mass=1)}
<body name="link5" pos="0 0 0.1" euler="0 -90 0"><joint name="j5"/>{_LINK.format(mass=0.8)}
<body name="link6" pos="0 0 0.08" euler="0 90 0"><joint name="j6"/>{_LINK.format(mass=0.5)}
<site name="attachment_site" pos="0 0 0.05" euler="0 0 45"/>
<camera name="eye"/><site name="flange"/>
</body></body></body></body></body></body></body></worldbody>
<actuator><motor joint="j1" gear="60" forcelimited="true" forcerange="-5 5"/><position joint="j2" kp="100"/>
</actuator>
<keyframe><key name="zero" qpos="0 0 0 0 0 0"/>
<key name="home" qpos="-0.6 1.7 -1.5 0.1 -1.5 -1.3"/></keyframe>
</mujoco>
"""

GANTRY_MJCF = SIX_JOINTS_MJCF.replace(
    '<joint name="j1"/>', '<joint name="j1" type="slide" range="-0.5 0.5"/>'
).replace('qpos="-0.6 1.7 -1.5 0.1 -1.5 -1.3"', 'qpos="-0.1 1.9 -1.1 0 -1.8 -0.4"')
