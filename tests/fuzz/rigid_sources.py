"""Sets of files of arms, cells, bodies and objects, which nothing is wrong with."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from math import cos, pi, sin
from typing import Final

from cosim.base.resources import arm_path

_INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>'
_URDF = f"""<robot name="two"><material name="grey"><color rgba="0.5 0.5 0.5 1"/></material>
<link name="root">
<visual><geometry><box size="0.1 0.1 0.1"/></geometry><material name="grey"/></visual></link>
<link name="upper">{_INERTIAL}<collision><origin xyz="0 0 0.1" rpy="0 0.1 0"/>
<geometry><mesh filename="box.stl" scale="0.1 0.1 0.1"/></geometry></collision></link>
<link name="hand">{_INERTIAL}<collision><geometry>
<cylinder radius="0.02" length="0.1"/></geometry></collision></link>
<joint name="swing" type="revolute"><parent link="root"/><child link="upper"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.2" rpy="0 0 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/>
<dynamics damping="0.1" friction="0.1"/></joint>
<joint name="lift" type="revolute"><parent link="upper"/><child link="hand"/><axis xyz="0 1 0"/>
<origin xyz="0.3 0 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>
"""
_ARM_MJCF = """<mujoco model="three"><compiler angle="degree" meshdir="."/><option timestep="0.001"/>
<default><default class="arm">
<joint axis="0 0 1" armature="0.2" damping="0.5" range="-170 170"/></default></default>
<asset><mesh name="m" file="box.obj" scale="0.1 0.1 0.1"/><material name="blue" rgba="0 0 1 1"/></asset>
<worldbody><geom name="floor" type="plane" size="1 1 0.1"/>
<body name="base" pos="0.1 0.2 0.3" euler="0 0 30">
<geom type="cylinder" size="0.06 0.05" mass="3"/>
<body name="link1" pos="0 0 0.1" childclass="arm"><joint name="j1"/>
<geom type="mesh" mesh="m" material="blue"/>
<body name="link2" pos="0 0 0.15" quat="1 1 0 0"><joint name="j2" pos="0.02 -0.01 0.03" ref="25"/>
<inertial pos="0.01 0.02 0.1" mass="2" fullinertia="0.03 0.025 0.01 0.001 -0.002 0.0005"/>
<geom type="capsule" size="0.04" fromto="0 0 0 0.3 0 0"/><site name="flange" pos="0 0 0.05" euler="0 0 45"/>
<include file="part.xml"/></body></body></body></worldbody>
<actuator><motor joint="j1" gear="60" forcelimited="true" forcerange="-5 5"/></actuator>
<keyframe><key name="home" qpos="-0.6 0.7"/></keyframe></mujoco>
"""
_ARM_TOML = """title = "two"
file = "arm.urdf"
flange = "hand"
home = [0.1, 0.2]
package_paths = ["."]
base = { position_m = [0.0, 0.0, 0.1], quaternion = [1.0, 0.0, 0.0, 0.1] }
adapter = { position_m = [0.0, 0.0, 0.05], quaternion = [1.0, 0.0, 0.1, 0.0], mass_kg = 0.1, radius_m = 0.02 }
servos = { stiffness = [500.0, 500.0], damping = [50.0, 50.0], armature = [0.1, 0.1] }
[limits]
lower = [-2.0, -2.0]
upper = [2.0, 2.0]
velocity = [1.0, 1.0]
acceleration = [10.0, 10.0]
effort = [20.0, 20.0]
"""
_CELL = """<mujoco model="cell"><compiler angle="degree"/><option timestep="0.001" gravity="0 0 -9.81"/>
<default><geom friction="0.8 0.005 0.0001"/></default>
<asset><material name="steel" rgba="0.2 0.3 0.4 1"/><mesh name="m" file="box.obj" scale="0.1 0.1 0.1"/>
<hfield name="hills" nrow="3" ncol="3" size="1 1 0.1 0.1" elevation="0 0 1 0 1 0 1 0 0"/>
<texture name="t" type="2d" builtin="checker" width="8" height="8" rgb1="1 0 0" rgb2="0 0 1"/></asset>
<worldbody><body name="table" pos="0.9 0 0.1" euler="0 0 20"><geom name="top" type="box" size="0.2 0.2 0.1"
material="steel"/><body name="post" pos="-0.1 0.05 0.2"><geom type="cylinder" size="0.05 0.1"/>
<geom type="mesh" mesh="m" pos="0 0 0.2" quat="1 0.1 0 0"/></body></body>
<replicate count="3" offset="0.2 0 0" euler="0 0 10">
<geom type="capsule" size="0.05 0.1" pos="0.5 1 0.3"/></replicate>
<body name="belt" pos="0 -0.9 0.1"><joint name="belt" type="slide" axis="0 1 0" range="-0.1 0.1"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/><geom type="ellipsoid" size="0.1 0.2 0.05"/>
<include file="part.xml"/></body>
<geom type="hfield" hfield="hills" contype="0" conaffinity="0"/></worldbody></mujoco>
"""
_PART: Final = (
    '<mujocoinclude><geom name="included" type="sphere" size="0.03" pos="0 0 0.1"/></mujocoinclude>\n'
)
_SCENARIO = """schema = 2
title = "a tube beside a cell and an object"
robot = "ur5e"
soft_robot = "tube.toml"
scene.mjcf = "cell.xml"
start.flange = { position_m = [0.4, 0.0, 0.7], direction = [0.0, 0.0, -1.0] }
[[object]]
name = "roll"
shape = "mesh"
file = "box.stl"
scale = 0.05
position_m = [0.0, 0.8, 0.4]
quaternion = [1.0, 0.0, 0.1, 0.0]
mass_kg = 0.2
friction = 0.5
[[object]]
name = "slab"
position_m = [0.0, 1.2, 0.1]
[[object.part]]
shape = "box"
size_m = [0.1, 0.1, 0.1]
[[object.part]]
shape = "mesh"
file = "box.obj"
scale = 0.03
position_m = [0.0, 0.0, 0.2]
[[phase]]
name = "hold"
duration_s = 0.1
cell_shift_m.belt = 0.05
"""
_TUBE = """schema = 2
name = "tube"
source = "made up"
base = ["base"]
[body]
kind = "mesh"
file = "tube.obj"
[[body.set]]
name = "base"
axis = "z"
at_m = 0.0
[[body.set]]
name = "tip"
axis = "z"
at_m = 0.2
[[body.set]]
name = "side"
points_m = [[0.03, 0.0, 0.0], [0.03, 0.0, 0.1], [0.03, 0.0, 0.2]]
[film]
young_modulus_Pa = 20e6
poisson_ratio = 0.3
thickness_m = 1e-4
law = "wrinkling"
wrinkle_panel_m = 0.02
[hinge]
stiffness_factor = 1.0
[mass]
node_mass_kg = 5e-4
[[cable]]
name = "side"
line = "side"
capstan_factor = 0.9
"""


@cache
def sources() -> tuple[tuple[str, str, Mapping[str, bytes]], ...]:
    """Return (name, checked file, files) of all sets."""
    folder = arm_path("ur5e").parent
    ur5e = {name: (folder / name).read_bytes() for name in ("ur5e.urdf", "arm.toml")}
    box = {"box.obj": _box_obj(), "box.stl": _box_stl()}
    part = {"part.xml": _PART.encode()}
    cell = {"cell.xml": _CELL.encode(), **part, **box}
    scenario = {"s.toml": _SCENARIO.encode(), "tube.toml": _TUBE.encode(), "tube.obj": _tube_obj(), **cell}
    return (
        ("URDF", "arm.urdf", {"arm.urdf": _URDF.encode(), "box.stl": box["box.stl"]}),
        ("UR5e", "arm.toml", ur5e),
        ("MJCF", "arm.xml", {"arm.xml": _ARM_MJCF.encode(), **part, "box.obj": box["box.obj"]}),
        ("arm.toml", "arm.toml", {"arm.toml": _ARM_TOML.encode(), "arm.urdf": _URDF.encode(), **box}),
        ("scene", "s.toml", scenario),
        ("scene", "s.toml", scenario),
    )


def _box_faces() -> tuple[list[tuple[int, ...]], list[tuple[int, int, int]]]:
    """Return the corners of a cube and its triangles, counter-clockwise seen from outside."""
    corners = list(product((0, 1), repeat=3))
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return corners, [(a, b, c) for q in quads for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]


def _obj(points: Sequence[tuple[float, ...]], triangles: Sequence[tuple[int, ...]]) -> bytes:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points]
    lines += ["g film", *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles)]
    return ("\n".join(lines) + "\n").encode()


def _box_obj() -> bytes:
    corners, triangles = _box_faces()
    return _obj([tuple(map(float, corner)) for corner in corners], triangles)


def _box_stl() -> bytes:
    corners, triangles = _box_faces()
    facets = (
        struct.pack("<12fH", 0, 0, 0, *(x for corner in triangle for x in corners[corner]), 0)
        for triangle in triangles
    )
    return bytes(80) + struct.pack("<I", len(triangles)) + b"".join(facets)


def _tube_obj() -> bytes:
    """Return a tube of 5 rows of 8 nodes, 30 mm wide and 0.2 m long."""
    sides, rows = 8, 5
    points = [
        (0.03 * cos(2 * pi * k / sides), 0.03 * sin(2 * pi * k / sides), 0.2 * row / (rows - 1))
        for row in range(rows)
        for k in range(sides)
    ]
    triangles = []
    for row, k in product(range(rows - 1), range(sides)):
        a, b = row * sides + k, row * sides + (k + 1) % sides
        triangles += [(a, b, b + sides), (a, b + sides, a + sides)]
    return _obj(points, triangles)
