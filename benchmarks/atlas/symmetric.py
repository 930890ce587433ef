"""Symmetric bodies that may stand where they would not stay: pouches, stacks, grippers.

Each is loaded beyond where its straight equilibrium ends. What is looked at: whether it ends on a stable
branch, and whether the branching is named.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import cosim
from cosim.soft.solve.branching import WHOLE

SEED = 20261124
NAMED = "branching", "snap"


@dataclass(frozen=True)
class Outcome:
    """How a body ended.

    Args:
        stability: in words, at the end.
        load: at which it first branches or snaps with more than a wrinkle, of the largest; None: nowhere.
        how: "branching" or "snap"; "" for none.
    """

    stability: str
    load: float | None
    how: str

    @property
    def good(self) -> bool:
        """Whether it is stable, and has said where it branched."""
        return self.stability != "unstable" and self.how in NAMED


@dataclass(frozen=True)
class Symmetric:
    """One body under one load.

    Args:
        name: what it is.
        drawn: whether its sizes are drawn at random.
        run: loads it.
    """

    name: str
    drawn: bool
    run: Callable[[], Outcome]


def _outcome(stability: str, rows: list[dict[str, Any]]) -> Outcome:
    large = [row for row in rows if row["extent"] >= WHOLE]
    if not large:
        return Outcome(stability, None, "")
    return Outcome(stability, large[0]["load_factor"], NAMED[large[0]["snap"]])


def _ran(scenario: str, pouch: tuple[float, float] | None = None) -> Outcome:
    """Run a scenario's text; what its last phase does counts."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "symmetric.toml"
        path.write_text(scenario, encoding="utf-8")
        if pouch is not None:
            write_pouch(Path(folder), *pouch)
        summary = cosim.run(path).summary
    last = summary["phases"][-1]
    rows = [row for row in summary["branchings"] if row["phase"] == last["name"]]
    return _outcome(last["stability"], rows)


def write_pouch(folder: Path, width_m: float, length_m: float) -> None:
    """Write a flat pouch, clamped where it is open, as a soft robot of a mesh file.

    Args:
        folder: of pouch.obj and pouch.toml.
        width_m: across.
        length_m: from the clamp to the closed end.
    """
    across, along = 6, max(6, round(6.0 * length_m / width_m))
    numbers, lines = dict[tuple[int, int, int], int](), list[str]()

    def node(side: int, i: int, k: int) -> int:
        joined = i in (0, across) or k == along
        key = (0 if joined else side, i, k)
        if key not in numbers:
            depth = 0.0 if joined else side * 0.075 * width_m * math.sin(math.pi * i / across)
            lines.append(f"v {width_m * (i / across - 0.5)!r} {depth!r} {length_m * k / along!r}")
            numbers[key] = len(numbers) + 1
        return numbers[key]

    faces = list[str]()
    for side in (1, -1):
        for i in range(across):
            for k in range(along):
                a, b = node(side, i, k), node(side, i + 1, k)
                c, d = node(side, i + 1, k + 1), node(side, i, k + 1)
                # diagonals mirrored about the middle and between the sides
                halves = ((a, b, d), (b, c, d)) if i < across // 2 else ((a, b, c), (a, c, d))
                faces += [f"f {p} {r} {q}" if side > 0 else f"f {p} {q} {r}" for p, q, r in halves]
    (folder / "pouch.obj").write_text("\n".join([*lines, *faces]) + "\n", encoding="utf-8")
    (folder / "pouch.toml").write_text(POUCH.format(length=length_m, width=width_m), encoding="utf-8")


POUCH = """
schema = 2
name = "pouch"
source = "drawn by a benchmark"
base = ["base"]
known.assumed = ["film"]
body.kind = "mesh"
body.file = "pouch.obj"

[[body.set]]
name = "base"
axis = "z"
at_m = 0.0

[[body.set]]
name = "tip"
axis = "z"
at_m = {length!r}

[film]
law = "wrinkling"
wrinkle_panel_m = {width!r}
young_modulus_Pa = 0.5e9
poisson_ratio = 0.3
thickness_m = 0.1e-3
density_kg_m3 = 1150.0
"""

HELD = """
schema = 2
title = "A symmetric body"
robot = "none"
mode = "quasistatic"
{more}
[start]
flange = {{ position_m = [0.0, 0.0, 0.5], direction = {direction} }}
"""


def pouch(width_m: float, length_m: float, pressure_Pa: float) -> Outcome:
    """Inflate a flat pouch that sticks out sideways."""
    head = HELD.format(direction="[1.0, 0.0, 0.0]", more='soft_robot = "pouch.toml"')
    phase = f'[[phase]]\nname = "inflate"\nduration_s = 0.5\nincrements = 20\npressure_Pa = {pressure_Pa!r}\n'
    return _ran(head + phase, (width_m, length_m))


def stack(sides: int, units: int, pressure_Pa: float, push_N: float) -> Outcome:
    """Push an inflated straight stack back towards its flange."""
    name = {4: "square_core_cables", 6: "hexagon_arm"}[sides]
    cable = f'[{{ name = "a", corner = 0, units = [1, {units}], capstan_factor = 0.8 }}]'
    robot = f'{{ file = "{name}", stack = {{ units = {units} }}, cable = {cable} }}'
    more = f"soft_robot = {robot}\nmodel.published = true\ngravity_m_s2 = [0.0, 0.0, 0.0]\n"
    head = HELD.format(direction="[0.0, 0.0, -1.0]", more=more)
    phases = f"""
[[phase]]
name = "inflate"
duration_s = 0.5
increments = 5
pressure_Pa = {pressure_Pa!r}

[[phase]]
name = "push"
duration_s = 0.5
increments = 10

[[phase.force]]
rings = ["tip"]
total_N = [0.0, 0.0, {push_N!r}]
"""
    return _ran(head + phases)


def gripper(radius_m: float, units: int, pressure_Pa: float, shift_m: float) -> Outcome:
    """Push two straight fingers down on an edge."""
    robot = (
        f'{{ file = "three_finger_gripper", stack = {{ units = {units} }}, copies = {{ count = 2, '
        f"radius_m = {radius_m!r}, tilt_rad = 0.0 }}, "
        f'cable = [{{ name = "a", corner = 0, units = [1, {units}], capstan_factor = 0.8 }}] }}'
    )
    more = f"soft_robot = {robot}\nmodel.published = true\n"
    head = HELD.format(direction="[0.0, 0.0, -1.0]", more=more)
    head = head.replace('"none"', '"ur5e"').replace("[0.0, 0.0, 0.5]", "[0.45, 0.0, 0.5]")
    phases = f"""
[[object]]
name = "edge"
shape = "box"
size_m = [0.4, 0.02, 0.1]
position_m = [0.45, 0.0, {0.5 - 0.012 * units - 0.09!r}]

[[phase]]
name = "inflate"
duration_s = 0.5
increments = 5
pressure_Pa = {pressure_Pa!r}

[[phase]]
name = "push"
duration_s = 0.5
increments = 10
flange_shift_m = [0.0, 0.0, {-shift_m!r}]
"""
    return _ran(head + phases)


def symmetric_bodies() -> Iterator[Symmetric]:
    """Yield the bodies; every third or so is drawn at random."""
    random = np.random.default_rng(SEED)

    def between(low: float, high: float) -> float:
        return float(np.round(random.uniform(low, high), 4))

    given = (0.035, 0.14, 20e3), (0.04, 0.16, 12e3), (0.05, 0.15, 12e3), (0.06, 0.12, 12e3)
    pouches = [(each, False) for each in given]
    pouches += [((between(0.03, 0.06), between(0.1, 0.16), 20e3), True) for _ in range(2)]
    for (width_m, length_m, pressure_Pa), drawn in pouches:
        title = f"pouch {1e3 * width_m:g} x {1e3 * length_m:g} mm at {1e-3 * pressure_Pa:g} kPa"
        yield Symmetric(title, drawn, partial(pouch, width_m, length_m, pressure_Pa))
    stacks = [(each, False) for each in ((6, 3, 20e3, 15.0), (6, 4, 20e3, 15.0), (4, 3, 20e3, 15.0))]
    for _ in range(2):
        stacks.append(((6, int(random.integers(3, 6)), between(10e3, 30e3), between(15.0, 25.0)), True))
    for (sides, units, pressure_Pa, push_N), drawn in stacks:
        title = (
            f"stack of {units} units with {sides} sides at {1e-3 * pressure_Pa:.1f} kPa, under {push_N:.1f} N"
        )
        yield Symmetric(title, drawn, partial(stack, sides, units, pressure_Pa, push_N))
    for units, pressure_Pa in ((5, 20e3), (6, 20e3), (5, 30e3)):
        title = f"two fingers of {units} units at {1e-3 * pressure_Pa:g} kPa on an edge"
        yield Symmetric(title, False, partial(gripper, 0.05, units, pressure_Pa, 0.04))


def symmetric_table() -> int:
    """Load all bodies, and print a line on each; return how many are silent or unstable."""
    print("| body | drawn at random | branches at, share of the way | ends |\n|---|---|---:|---|")
    wrong = 0
    for body in symmetric_bodies():
        found = body.run()
        wrong += not found.good
        load = "nowhere" if found.load is None else f"{found.load:.3f}" + " (snaps)" * (found.how == "snap")
        drawn = "yes" if body.drawn else ""
        print(f"| {body.name} | {drawn} | {load} | {found.stability} |", flush=True)
    return wrong
