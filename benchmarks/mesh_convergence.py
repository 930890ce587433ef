"""Three meshes of each robot from a pattern or a mesh file: how far its tip moves between them.

    python benchmarks/mesh_convergence.py [pouch_finger inflated_pad bellows_gripper ring_gripper ...]

Patterns are meshed at other edge lengths; of `bellows_gripper` one finger is drawn with more segments around
the back, across the strip and along a flank; `fabric_boom` and `ring_gripper` with more sides and rows.
Printed: nodes, the tip in the world from the flange [mm], and its change over the robot's length. Of
`ring_gripper` it is how far the wall is from the axis at half its height, over the radius. Of
`bellows_gripper` a second row has how far 0.5 N push the tip back, and its change over itself.
"""

from __future__ import annotations

import argparse
import math
import os
import re
import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import cosim
from cosim.base.frames import Array
from cosim.base.resources import soft_robot_path

Triangles = list[tuple[int, int, int]]
Runs = Iterator[cosim.RunResult]
PATTERN_EDGES_m: Final = {"pouch_finger": (3.5e-3, 2.5e-3, 1.75e-3), "diamond_finger": (5e-3, 3.5e-3, 2.5e-3)}
PAD_EDGES_m: Final = (7e-3, 5e-3, 3.5e-3)
PATTERN_SCENARIOS: Final = {"pouch_finger": "pouch_finger_bends", "diamond_finger": "diamond_finger_folds"}
BELLOWS: Final = ((8, 4, 2), (12, 6, 3), (24, 12, 6))
BOOMS: Final = ((16, 24), (24, 36), (32, 48))
RINGS: Final = ((32, 8), (48, 12), (64, 16))
LENGTH_m: Final = {
    "pouch_finger": 0.12, "diamond_finger": 0.11, "inflated_pad": 0.1, "bellows_gripper": 0.108,
    "ring_gripper": 0.04, "fabric_boom": 1.0,
}  # fmt: skip
INFLATED: Final = """schema = 2
title = "inflated"
robot = "none"
soft_robot = "{robot}"
mode = "quasistatic"
[start]
flange = {{ position_m = [0.0, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }}
[[phase]]
name = "inflate"
duration_s = 1.0
increments = 8
pressure_Pa = {pressure_Pa}
"""
PUSHED: Final = """
[[phase]]
name = "push"
duration_s = 1.0
increments = 4
[[phase.force]]
rings = ["tip"]
total_N = [0.5, 0.0, 0.0]
"""


def patterns(name: str) -> Runs:
    """Run a pattern at rest on nothing, at each edge length."""
    for edge_m in PATTERN_EDGES_m[name]:
        changes: dict[str, Any] = {"soft_robot.body.mesh_m": edge_m, "robot": "none"}
        yield cosim.run(PATTERN_SCENARIOS[name], overrides=changes, error=False)


def inflated(folder: Path, robot: str | Path, pressure_Pa: float, more: str = "") -> cosim.RunResult:
    """Run a robot at rest on nothing."""
    (folder / "inflate.toml").write_text(INFLATED.format(robot=robot, pressure_Pa=pressure_Pa) + more)
    return cosim.run(folder / "inflate.toml", error=False)


def pads(folder: Path) -> Runs:
    """Inflate the pad, at each edge length."""
    text = soft_robot_path("inflated_pad").read_text()
    for edge_m in PAD_EDGES_m:
        (folder / "pad.toml").write_text(re.sub(r"mesh_m = .*", f"mesh_m = {edge_m}", text))
        yield inflated(folder, "pad.toml", 10e3)


def rings(folder: Path) -> Runs:
    """Inflate the ring around nothing."""
    (folder / "ring.toml").write_text(soft_robot_path("ring_gripper").read_text())
    for around, rows in RINGS:
        write_ring(folder / "ring_gripper.obj", around, rows)
        yield inflated(folder, "ring.toml", 30e3)


def bellows(folder: Path, more: str = "") -> Runs:
    """Run one finger of the gripper, without its palm."""
    text = re.sub(
        r"\[copies\].*?(?=\[body\])", "", soft_robot_path("bellows_gripper").read_text(), flags=re.S
    )
    (folder / "finger.toml").write_text(text.replace(', "copies", "palm"', ""))
    for back, strip, flank in BELLOWS:
        write_bellows(folder / "bellows_gripper.obj", back, strip, flank)
        yield inflated(folder, "finger.toml", 60e3, more)


def booms(folder: Path) -> Runs:
    """Run the boom on its arm."""
    (folder / "boom.toml").write_text(soft_robot_path("fabric_boom").read_text())
    for sides, rows in BOOMS:
        angles = 2.0 * np.pi * np.arange(sides) / sides
        ring = [(0.065 * math.cos(a), 0.065 * math.sin(a)) for a in angles.tolist()]
        points = [(x, y, j / rows) for j in range(rows + 1) for x, y in ring]
        write_obj(folder / "fabric_boom.obj", points, {"boom": wall(rows, sides, range(sides // 2), 0)})
        yield cosim.run(
            "fabric_boom_reaches", overrides={"soft_robot": str(folder / "boom.toml")}, error=False
        )


def write_bellows(path: Path, back: int, strip: int, flank: int) -> None:
    """Write a finger as drawn in `robots/bellows_gripper.obj` [mm], with so many segments."""
    rows = [(0.0, 6.0), (8.0, 6.0)]
    for fold in range(6):
        for end in ((16.0 + 16.0 * fold, 24.0), (24.0 + 16.0 * fold, 6.0)):
            ways = [(k / flank, rows[-1]) for k in range(1, flank + 1)]
            rows += [(a + (end[0] - a) * s, b + (end[1] - b) * s) for s, (a, b) in ways]
    rows.append((108.0, 6.0))
    points = [
        point
        for z, high in rows
        for point in (
            *((0.0, 16.0 - 32.0 * k / strip, z) for k in range(strip)),
            *(
                (high * math.sin(a), -16.0 * math.cos(a), z)
                for a in (math.pi * k / back for k in range(back))
            ),
        )
    ]
    around, count = strip + back, len(rows) - 1
    mirrored = [k for k in range(around) if (k < strip / 2 if k < strip else k - strip < back / 2)]
    groups = {"strip": wall(count, around, mirrored, 0, strip), "folds": wall(count, around, mirrored, strip)}
    write_obj(path, points, groups)


def write_ring(path: Path, around: int, rows: int) -> None:
    """Write a ring as drawn in `robots/ring_gripper.obj` [mm], with so many segments."""
    places = [(40.0, 40.0 + 50.0 * k / rows) for k in range(rows + 1)] + [(50.0, 90.0), (50.0, 40.0)]
    angles = [2.0 * math.pi * k / around for k in range(around)]
    points = [(r * math.cos(a), r * math.sin(a), z) for r, z in places for a in angles]
    count = around * (rows + 3)  # the last row is the first
    faces = [(a % count, c % count, b % count) for a, b, c in wall(rows + 3, around, range(around // 2), 0)]
    inner = 2 * around * rows
    write_obj(path, points, {"wall": faces[:inner], "housing": faces[inner:]})


def wall(rows: int, around: int, mirrored: Collection[int], first: int, last: int | None = None) -> Triangles:
    """Return triangles of a tube's strips first to last, those that are `mirrored` split the other way."""
    found: Triangles = []
    for row in range(rows):
        for k in range(first, around if last is None else last):
            a, b = row * around + k, row * around + (k + 1) % around
            c, d = a + around, b + around
            found += [(a, b, d), (a, d, c)] if k in mirrored else [(a, b, c), (b, d, c)]
    return found


def write_obj(path: Path, points: Sequence[tuple[float, float, float]], groups: dict[str, Triangles]) -> None:
    """Write nodes and groups of triangles."""
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*point) for point in points]
    for name, triangles in groups.items():
        lines += [f"g {name}", *("f {} {} {}".format(*(i + 1 for i in each)) for each in triangles)]
    path.write_text("\n".join(lines) + "\n")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("robots", nargs="*", default=list(LENGTH_m))
    with TemporaryDirectory() as made:
        folder = Path(made)
        kinds: dict[str, Callable[[], Runs]] = {name: partial(patterns, name) for name in PATTERN_EDGES_m}
        kinds |= {"inflated_pad": partial(pads, folder), "bellows_gripper": partial(bellows, folder)}
        kinds |= {"ring_gripper": partial(rings, folder), "fabric_boom": partial(booms, folder)}
        for name in parser.parse_args().robots:
            compare(name, kinds[name](), partial(tip, name), LENGTH_m[name])
            if name == "bellows_gripper":
                compare(f"{name}, pushed", bellows(folder, PUSHED), yielding, None)


def tip(name: str, result: cosim.RunResult) -> Array:
    """Return the tip [m] from the flange; of the ring how far its wall is from the axis."""
    if name == "ring_gripper":
        drawn, found = (nodes - result.flange_position[-1] for nodes in result.node_position[[0, -1]])
        middle = np.abs(drawn[:, 2] + 0.065) < 1e-6
        return np.hypot(*found[middle, :2].T).mean(keepdims=True)
    at = np.flatnonzero(result.phase == 2)[-1] if name == "fabric_boom" else -1
    return np.asarray(result.tip_position[at] - result.flange_position[at])


def yielding(result: cosim.RunResult) -> Array:
    """Return how far [m] the tip goes back under the force."""
    before, after = result.tip_position[[np.flatnonzero(result.phase == 0)[-1], -1], 0]
    return np.array([after - before])


def compare(name: str, runs: Runs, measured: Callable[[cosim.RunResult], Array], size: float | None) -> None:
    """Print what is measured of each run, and its change over a length, or over itself."""
    last = None
    for result in runs:
        found = measured(result)
        whole = size or np.linalg.norm(found)
        change = "" if last is None else f"{100 * np.linalg.norm(found - last) / whole:.2f} %"
        print(name, result.node_position.shape[1], np.round(1e3 * found, 2), change, flush=True)
        last = found


if __name__ == "__main__":
    main()
