"""Mutated files of arms, cells, bodies and objects: URDF, MJCF, arm.toml, scenarios, OBJ and STL."""

from __future__ import annotations

import re
import shutil
import struct
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import cos, pi, sin
from pathlib import Path
from random import Random
from typing import Final, final

from benchmarks.faults.mutations import broken, mutated, mutations_of, toml_text
from cosim.base.resources import arm_path

_INERTIAL = '<inertial><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01"/></inertial>'
_URDF = f"""<robot name="two"><material name="grey"><color rgba="0.5 0.5 0.5 1"/></material><link name="root">
<visual><geometry><box size="0.1 0.1 0.1"/></geometry><material name="grey"/></visual></link>
<link name="upper">{_INERTIAL}<collision><origin xyz="0 0 0.1" rpy="0 0.1 0"/><geometry><mesh filename="box.stl"
scale="0.1 0.1 0.1"/></geometry></collision></link>
<link name="hand">{_INERTIAL}<collision><geometry><cylinder radius="0.02" length="0.1"/></geometry></collision></link>
<joint name="swing" type="revolute"><parent link="root"/><child link="upper"/><axis xyz="0 0 1"/>
<origin xyz="0 0 0.2" rpy="0 0 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/>
<dynamics damping="0.1" friction="0.1"/></joint>
<joint name="lift" type="revolute"><parent link="upper"/><child link="hand"/><axis xyz="0 1 0"/>
<origin xyz="0.3 0 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint></robot>
"""
_ARM_MJCF = """<mujoco model="three"><compiler angle="degree" meshdir="."/><option timestep="0.001"/>
<default><default class="arm"><joint axis="0 0 1" armature="0.2" damping="0.5" range="-170 170"/></default></default>
<asset><mesh name="m" file="box.obj" scale="0.1 0.1 0.1"/><material name="blue" rgba="0 0 1 1"/></asset>
<worldbody><geom name="floor" type="plane" size="1 1 0.1"/><body name="base" pos="0.1 0.2 0.3" euler="0 0 30">
<geom type="cylinder" size="0.06 0.05" mass="3"/>
<body name="link1" pos="0 0 0.1" childclass="arm"><joint name="j1"/><geom type="mesh" mesh="m" material="blue"/>
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
<replicate count="3" offset="0.2 0 0" euler="0 0 10"><geom type="capsule" size="0.05 0.1" pos="0.5 1 0.3"/></replicate>
<body name="belt" pos="0 -0.9 0.1"><joint name="belt" type="slide" axis="0 1 0" range="-0.1 0.1"/>
<inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/><geom type="ellipsoid" size="0.1 0.2 0.05"/>
<include file="part.xml"/></body><geom type="hfield" hfield="hills" contype="0" conaffinity="0"/></worldbody></mujoco>
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
_VALUES = (
    "0", "-1", "1", "2", "1e30", "-1e30", "1e300", "1e400", "inf", "-inf", "nan", "", " ", "x", "1e-30", "1e-300",
    "100", "1 2", "0 0 0", "world", "root", "hand", "true", "false", "100000", "2147483647", "4294967296", "-5",
    "0.5", "1e6", "../../x", "/dev/zero", "/etc/passwd", "box.obj", "box.stl", "cell.xml", "arm.urdf", "arm.xml",
    "a" * 3000, "\u00e4\U0001f916", "&amp;&lt;", "&#10;", "&e;", "mesh", "plane", "hfield", "ball", "free", "slide",
    "continuous", "prismatic", "package://x/y.stl", "file://box.stl",
)  # fmt: skip
_LARGEST: Final = 1_000_000  # bytes of a file that is mutated further
_NOT_FINITE: Final = re.compile(r'"[^"]*\b(?:nan|inf)\b[^"]*"')
_ELEMENTS: Final = (
    '<include file="cell.xml"/>', '<include file="arm.xml"/>', '<include file="part.xml"/>',
    '<include file="none.xml"/>', '<include file="/dev/zero"/>', "<include/>", '<body><freejoint/><geom size="1"/></body>',
    '<replicate count="100000"><body><geom size="0.1"/></body></replicate>',
    '<replicate count="400"><replicate count="400"><geom size="0.1"/></replicate></replicate>',
    '<replicate count="30" offset="0.5 0 0"><geom size="0.1" pos="0 0 3"/></replicate>',
    '<composite type="cable" count="3000 1 1" curve="s" size="1"><geom type="capsule" size="0.01"/></composite>',
    '<flexcomp name="f" type="grid" count="100 100 100" spacing="1 1 1" mass="1"/>',
    '<flexcomp name="f" type="grid" count="3 3 3" spacing="0.1 0.1 0.1" mass="1"/>',
    '<geom type="mesh" mesh="none"/>', '<geom type="sdf" mesh="m"/>', '<joint type="ball"/>', '<joint type="hinge"/>',
    '<camera name="c" fovy="nan"/>', '<light pos="inf 0 0"/>', '<site pos="nan 0 0"/>', '<frame euler="nan 0 0"/>',
    '<geom size="1e200" mass="1e300"/>', '<geom type="box" size="1e-200 1 1"/>', '<geom fromto="0 0 0 0 0 0" type="capsule" size="1"/>',
    '<body pos="nan 0 0"><geom size="0.1"/></body>', '<body mocap="true"><geom size="0.1" pos="0 0 5"/></body>',
    '<link name="l"/>', '<joint name="j" type="fixed"><parent link="hand"/><child link="root"/></joint>',
    '<link name="l"><visual><geometry><mesh filename="none.stl"/></geometry></visual></link>',
    '<mujoco><compiler inertiafromgeom="true" boundmass="1e300"/></mujoco>', "<mujoco/>", "<worldbody/>",
    '<gazebo><a><b/></a></gazebo>', '<attach model="m" body="base" prefix="p"/>', "<!-- -->", "<![CDATA[x]]>",
    "<?xml version='1.0' encoding='utf-16'?>", "<plugin plugin='mujoco.pid'/>", "<geom type='box' size='1 1'/>",
)  # fmt: skip
_SECTIONS: Final = (
    '<asset><hfield name="h" nrow="60000" ncol="60000" size="1 1 1 1"/></asset>',
    '<asset><texture name="u" type="2d" builtin="flat" width="90000" height="90000"/></asset>',
    '<asset><mesh name="b" builtin="supersphere" params="3000 1 1"/></asset>',
    '<asset><mesh name="n" file="none.obj"/></asset>', '<asset><mesh name="n" file="tube.toml"/></asset>',
    '<asset><texture name="p" type="2d" file="box.obj"/></asset>',
    '<asset><hfield name="p" file="box.stl" size="1 1 1 1"/></asset>',
    '<asset><mesh name="n" vertex="0 0 0 1 0 0 0 nan 0 0 0 1"/></asset>',
    '<asset><model name="m" file="cell.xml"/></asset>', '<asset><model name="m" file="part.xml"/></asset>',
    '<asset><mesh name="n" vertex="0 0 0 1 0 0 0 1 0 0 0 1" face="0 1 9"/></asset>',
    '<extension><plugin plugin="none"/></extension>', '<size memory="100G"/>', '<size njmax="-5" nconmax="9999999"/>',
    '<option timestep="nan"/>', '<statistic extent="nan"/>', '<visual><map force="nan"/></visual>',
    '<compiler eulerseq="abc"/>', '<compiler angle="x"/>', '<compiler strippath="true" meshdir="/none"/>',
    '<compiler balanceinertia="true" settotalmass="1e300"/>', '<compiler autolimits="false"/>',
    '<default><geom size="nan"/></default>', '<default class="main"><default class="main"/></default>',
    '<keyframe><key qpos="nan"/></keyframe>', '<custom><numeric name="n" size="2000000000"/></custom>',
    '<custom><text name="t" data="nan"/></custom>', '<contact><exclude body1="table" body2="none"/></contact>',
    '<equality><weld body1="table" body2="post"/></equality>', '<tendon><spatial><site site="none"/></spatial></tendon>',
    '<sensor><rangefinder site="none"/></sensor>', '<deformable><flex name="f" dim="2"/></deformable>',
    '<deformable><skin name="s" file="box.obj"/></deformable>', '<equality><joint joint1="j1"/></equality>',
)  # fmt: skip


@final
@dataclass(frozen=True)
class RigidCase:
    """Files of which one has been mutated.

    Args:
        source: which set of files it was made from.
        changes: in words.
        files: contents by name.
        checked: name of the file that is checked.
        refused: whether it must be: a number of an MJCF is not finite.
    """

    source: str
    changes: str
    files: Mapping[str, bytes]
    checked: str
    refused: bool = False

    def write(self, folder: Path) -> Path:
        """Write the files into a folder, in place of all that is there; return the path of the checked one."""
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        for name, data in self.files.items():
            (folder / name).write_bytes(data)
        return folder / self.checked


def rigid_case(seed: int) -> RigidCase:
    """Return the mutated files of a seed."""
    rng = Random(seed)
    name, checked, files = rng.choice(sources())
    target = rng.choice([file for file in files if file != "part.xml" or rng.random() < 0.3])
    data = files[target]
    changed, done = data, list[str]()
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        if len(changed) < _LARGEST:
            changed, what = _mutated(target, changed, rng)
            done.append(what)
    text = changed.decode("utf-8", "replace")
    refused = target in ("cell.xml", "arm.xml", "part.xml") and _has_bad_number(text)
    return RigidCase(name, f"{target}: {'; '.join(done)}", {**files, target: changed}, checked, refused)


def unchanged() -> Iterator[RigidCase]:
    """Yield the files as they are."""
    for name, checked, files in sources():
        yield RigidCase(name, "none", files, checked)


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


def _mutated(name: str, data: bytes, rng: Random) -> tuple[bytes, str]:
    """Return a file's contents with one mutation, and what it is."""
    if not data or (name.endswith(".stl") and rng.random() < 0.8):
        return _damaged_bytes(data, rng)
    text = data.decode("utf-8", "replace")
    if rng.random() < 0.08:
        text, what = broken(text, rng)
    elif name.endswith(".toml"):
        text, what = _toml(text, rng)
    elif name.endswith((".urdf", ".xml")):
        text, what = rng.choice(_XML)(text, rng)
    else:
        text, what = _mesh(text, rng)
    return text.encode("utf-8", "surrogatepass"), what


def _toml(text: str, rng: Random) -> tuple[str, str]:
    try:
        table = tomllib.loads(text)
    except ValueError:  # already broken
        return broken(text, rng)
    if not table:
        return text, "none"
    changed, done = mutated(table, mutations_of(table, rng))
    return toml_text(changed), "; ".join(done)


def _place(pattern: str, text: str, rng: Random) -> re.Match[str] | None:
    found = list(re.finditer(pattern, text))
    return rng.choice(found) if found else None


def _replaced(pattern: str, new: Callable[[str, Random], str]) -> Callable[[str, Random], tuple[str, str]]:
    """Return a mutation that puts something in the place of one match of a pattern."""

    def mutation(text: str, rng: Random) -> tuple[str, str]:
        found = _place(pattern, text, rng)
        if found is None:
            return text, "none"
        put = new(found.group(), rng)
        return text[: found.start()] + put + text[found.end() :], f"{found.group()!r:.60} becomes {put!r:.90}"

    return mutation


def _one_word(value: str, rng: Random) -> str:
    words = value.strip('"').split() or [""]
    words[rng.randrange(len(words))] = rng.choice(_VALUES)
    return f'"{" ".join(words)}"'


def _repeated(element: str, rng: Random) -> str:
    """Return an element many times, each with a name of its own or with the same one."""
    count = rng.choice((2, 2, 30, 5000, 20_000))
    if rng.random() < 0.5:
        return count * element
    return "".join(element.replace('name="', f'name="{k}_') for k in range(count))


def _nested(element: str, rng: Random) -> str:
    depth = rng.choice((2, 60, 250, 400, 1000, 5000, 100_000))
    outer = rng.choice(("body", "frame", "link", "default", "x", 'replicate count="2"'))
    return f"{depth * f'<{outer}>'}{element}{depth * f'</{outer.split()[0]}>'}"


def _chained(_tag: str, rng: Random) -> str:
    """Return a long chain of links, for the end of a URDF."""
    count = rng.choice((9, 120, 480, 600, 20_000))
    joints = (
        f'<link name="c{k}"/><joint name="d{k}" type="fixed"><parent link="{f"c{k - 1}" if k else "hand"}"/>'
        f'<child link="c{k}"/></joint>'
        for k in range(count)
    )
    return f"{''.join(joints)}</robot>"


_TAGGED, _OPENED, _TEXT, _ATTRIBUTE = r"<[^<>/!?]+/>", r"<\w[^<>]*(?<!/)>", r'"[^"]*"', r' [\w:]+="[^"]*"'
_XML: Final = (
    _replaced(_TEXT, lambda _old, rng: f'"{rng.choice(_VALUES)}"'),
    *3 * (_replaced(_TEXT, _one_word),),
    _replaced(_TAGGED, lambda _old, _rng: ""),
    _replaced(_TAGGED, _repeated),
    _replaced(_TAGGED, _nested),
    _replaced(_ATTRIBUTE, lambda _old, _rng: ""),
    _replaced(_ATTRIBUTE, lambda old, _rng: 2 * old),
    _replaced(_ATTRIBUTE, lambda old, rng: old.replace("=", rng.choice(("s=", "_=", "2=")), 1)),
    _replaced(_OPENED, lambda old, rng: old + rng.choice(_ELEMENTS)),
    _replaced(_OPENED, lambda old, rng: old + rng.choice(_ELEMENTS)),
    _replaced(r"</\w+>\s*\Z", lambda old, rng: rng.choice(_SECTIONS) + old),
    _replaced(r"</\w+>\s*\Z", lambda old, rng: rng.choice(_SECTIONS) + old),
    _replaced(r"</robot>", _chained),
    _replaced(r"\A", lambda _old, _rng: '<!DOCTYPE a [<!ENTITY e "ee"><!ENTITY f "&e;&e;">]>'),
)  # fmt: skip


def _has_bad_number(text: str) -> bool:
    """Return whether an attribute consists of numbers of which one is not finite."""
    for found in _NOT_FINITE.findall(text):
        try:
            [float(word) for word in found.strip('"').split()]
        except ValueError:
            continue
        return True
    return False


def _mesh(text: str, rng: Random) -> tuple[str, str]:
    """Return a text of a mesh with other words or lines."""
    lines = text.splitlines()
    at = rng.randrange(len(lines))
    words = lines[at].split() or [""]
    match rng.choice(("word", "word", "word", "delete", "double", "swap", "many", "all")):
        case "word":
            words[rng.randrange(len(words))] = rng.choice(_VALUES)
            lines[at] = " ".join(words)
        case "delete":
            del lines[at]
        case "double":
            lines.insert(rng.randrange(len(lines)), lines[at])
        case "swap":
            rng.shuffle(words)
            lines[at] = " ".join(words)
        case "many":
            lines = lines * rng.choice((2, 300, 3000) if len(lines) < 1000 else (2,))
        case _:
            factor = rng.choice((1e-30, 1e-9, 1e-3, 0.0, -1.0, 1e3, 1e9, 1e30, 1e200))
            lines = [_scaled(line, factor) for line in lines]
    return "\n".join(lines) + "\n", f"line {at}: {lines[min(at, len(lines) - 1)] if lines else ''!r:.60}"


def _scaled(line: str, factor: float) -> str:
    word, *rest = line.split() or [""]
    try:
        return " ".join((word, *(repr(float(x) * factor) for x in rest))) if word == "v" else line
    except ValueError:
        return line


def _damaged_bytes(data: bytes, rng: Random) -> tuple[bytes, str]:
    """Return the bytes of a binary STL with other numbers, another count, or another length."""
    changed, at = bytearray(data or b"x"), rng.randrange(len(data or b"x"))
    match rng.choice(("bits", "float", "float", "count", "cut", "longer")):
        case "bits":
            changed[at] ^= 1 << rng.randrange(8)
        case "float":
            number = rng.choice((float("nan"), float("inf"), 0.0, 1e30, -1e-30, 1e38, 0.5))
            at = 96 + 50 * rng.randrange(12) + 4 * rng.randrange(9)
            changed[at : at + 4] = struct.pack("<f", number)
        case "count":
            changed[80:84] = struct.pack("<I", rng.choice((0, 1, 11, 13, 10**6, 2**32 - 1)))
        case "cut":
            del changed[at:]
        case _:
            changed += bytes(rng.choice((1, 50, 10**5)))
    return bytes(changed), f"bytes from {at}"


def _box_faces() -> tuple[list[tuple[int, ...]], list[tuple[int, int, int]]]:
    """Return the corners of a cube and its triangles, counter-clockwise seen from outside."""
    corners = list(product((0, 1), repeat=3))
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return corners, [(a, b, c) for q in quads for a, b, c in ((q[0], q[1], q[2]), (q[0], q[2], q[3]))]


def _obj(points: list[tuple[float, ...]], triangles: list[tuple[int, int, int]]) -> bytes:
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
