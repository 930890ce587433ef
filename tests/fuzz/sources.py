"""Files of scenarios and soft robots to mutate: those of cosim, and two with tables that these lack."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, Final

from cosim.base.resources import (
    data_directory,
    list_scenarios,
    list_soft_robots,
    robots_directory,
    soft_robot_path,
)
from cosim.config.several_arms import ARMS
from cosim.config.soft_robot_files import RobotFiles
from cosim.config.toml.rules import Faults

_PILLOW: Final = """schema = 2
name = "pillow"
source = "drawn by hand"
base = ["base"]
[known]
measured = ["film.fabric"]
[body]
kind = "pattern"
outline_m = [[0.0, 0.0], [0.04, 0.0], [0.04, 0.12], [0.0, 0.12]]
edge = "sealed"
seams_m = [[[0.01, 0.06], [0.03, 0.06]]]
port_m = [0.02, 0.03]
mesh_m = 0.01
center = ["middle"]
[[body.fold]]
line_m = [[0.0, 0.09], [0.04, 0.09]]
rest_angle_rad = 0.6
sheet = "front"
[[body.set]]
name = "base"
line_m = [[0.0, 0.0], [0.04, 0.0]]
[[body.set]]
name = "middle"
line_m = [[0.0, 0.09], [0.04, 0.09]]
[[body.set]]
name = "tip"
line_m = [[0.0, 0.12], [0.04, 0.12]]
[film]
law = "tension_field"
poisson_ratio = 0.3
thickness_m = 0.2e-3
density_kg_m3 = 850.0
[film.fabric]
modulus_warp_Pa = 0.395e9
modulus_weft_Pa = 0.3e9
shear_modulus_Pa = 0.1435e9
warp_direction = [0.0, 0.0, 1.0]
straight_modulus_warp_Pa = 1.25e9
straight_modulus_weft_Pa = 1.25e9
straight_strain_warp = 0.01
straight_strain_weft = 0.01
[hinge]
rule = "shell"
"""
_RAILS: Final = """schema = 2
title = "an arm on a rail and a turntable, with sensors, cameras and a controller"
robot = "ur5e"
soft_robot = "light_hexagon_arm"
[arm_base]
position_m = [0.0, 0.0, 0.3]
[[arm_base.rail]]
axis = [0.0, 1.0, 0.0]
range_m = [0.0, 2.5]
speed_m_s = 1.0
acceleration_m_s2 = 2.0
mass_kg = 20.0
[[arm_base.turntable]]
range_rad = [-3.0, 3.0]
speed_rad_s = 0.5
center_m = [0.0, 0.1, 0.0]
[start]
flange = { position_m = [0.45, 0.25, 1.0], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 5e3
joint_shift_m = { rail = 0.25 }
joint_angle_rad = { turntable = 0.1 }
[[sensor]]
name = "tip"
kind = "tip_position"
noise = 1e-3
bias = [0.0, 0.0, 2e-3]
delay_s = 0.02
rate_Hz = 100.0
quantum = 1e-4
seed = 1
[[sensor]]
name = "gas"
kind = "pressure"
noise = [50.0]
[[sensor]]
name = "bent"
kind = "bending_angle"
[[sensor]]
name = "wound"
kind = "cable_length"
of = ["right"]
[[camera]]
name = "wrist"
on = "flange"
position_m = [0.0, 0.08, 0.02]
direction = [0.0, 0.0, 1.0]
up = [0.0, 1.0, 0.0]
size = [64, 48]
fov_rad = 0.9
rate_Hz = 10.0
[[camera]]
name = "room"
position_m = [2.0, 0.0, 1.0]
direction = [-1.0, 0.0, 0.0]
[[controller]]
name = "angle"
kind = "pi"
period_s = 0.02
cables = ["right"]
proportional_gain = 1.0
integral_gain_per_s = 10.0
output_max = 30.0
sensors = ["bent"]
[[phase]]
name = "turn"
duration_s = 0.5
increments = 3
joint_angle_rad = { turntable = 0.2 }
flange = { position_m = [0.45, 0.3, 1.0], direction = [0.0, 0.0, -1.0] }
[[phase]]
name = "hold"
duration_s = 0.5
increments = 3
control_bending_angle_rad = { angle = 0.1 }
"""
_FOLDERS: Final = ("scenarios", "robots")
TOML: Final = ".toml"


@cache
def sources() -> tuple[tuple[str, Mapping[str, Any], bool], ...]:
    """Return (name, table, whether of a robot) of all files; of scenarios also with their robots put in."""
    pillow, rails = tomllib.loads(_PILLOW), tomllib.loads(_RAILS)
    named = {name: _read(data_directory() / "scenarios" / f"{name}{TOML}") for name in list_scenarios()}
    named |= {"rails": rails, "rails_pillow": {**rails, "soft_robot": pillow, "sensor": [], "controller": []}}
    named["rails_pillow"]["phase"] = rails["phase"][:1]
    found: list[tuple[str, Mapping[str, Any], bool]] = []
    for name, read in named.items():
        if ARMS in read:
            continue  # each of its arms is a scenario like the others
        table = {**read, "name": name}
        robot = RobotFiles(Faults()).expand(table["soft_robot"], data_directory() / "scenarios", "soft_robot")
        found += [(name, table, False), (f"{name}+robot", {**table, "soft_robot": robot}, False)]
    found += [(name, _read(soft_robot_path(name)), True) for name in list_soft_robots()]
    return (*found, ("pillow", pillow, True))


def put_beside(folder: Path) -> None:
    """Link what the files name beside themselves into a folder: drawings, meshes and cells."""
    beside = [robots_directory().parent / name for name in _FOLDERS]
    for path in [path for place in beside for path in place.iterdir() if path.suffix != TOML]:
        if not (folder / path.name).exists():
            (folder / path.name).symlink_to(path)


def _read(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))
