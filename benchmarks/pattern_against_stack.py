"""A square unit, drawn as a pair of sheets and as a stack of polygons: one film, meshed in two ways.

    python benchmarks/pattern_against_stack.py [--edges 0.005 0.0035 0.0025] [--refine 1 2]

Prints length, volume and, at 10 and 40 kPa, the tilt under a force at the tip, of each mesh of both.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import cosim

HALF_m: Final = 0.03
HOLE_m: Final = 0.002
PITCH_m: Final = 0.002
FORCE_N: Final = 0.05
REST: Final = """
[film]
law = "wrinkling"
young_modulus_Pa = 1.3e9
poisson_ratio = 0.2
thickness_m = 0.11e-3
density_kg_m3 = 1000.0
[hinge]
rule = "shell"
"""
PRESSURES_kPa: Final = (2, 5, 10, 20, 40)
TILTED_kPa: Final = (10, 40)


def pattern(edge_m: float) -> str:
    """Return the robot's file as two sheets, whose holes are open ends."""
    a, h = HALF_m, HOLE_m
    square = f"[[{-a}, {-a}], [{a}, {-a}], [{a}, {a}], [{-a}, {a}]]"
    hole = f"[[{-h}, {-h}], [{h}, {-h}], [{h}, {h}], [{-h}, {h}]]"
    ends = "".join(
        f'[[body.set]]\nname = "{name}"\nbox_m = [[{-1.05 * h}, {-1.05 * h}], [{1.05 * h}, {1.05 * h}]]\n'
        f'sheet = "{sheet}"\n'
        for name, sheet in (("base", "back"), ("tip", "front"))
    )
    return (
        f'schema = 2\nname = "pattern"\nsource = "a benchmark"\nbase = ["base"]\n[body]\nkind = "pattern"\n'
        f"outline_m = {square}\nholes_m = [{hole}]\nport_m = [{0.5 * a}, 0.0]\nedge = 'open'\n"
        f"seams_m = [{square[:-1]}, [{-a}, {-a}]]]\n"
        f"plane = 'flat'\nmesh_m = {edge_m}\n{ends}{REST}"
    )


def stack(refine: int) -> str:
    """Return the robot's file as a stack of polygons."""
    return (
        f'schema = 2\nname = "stack"\nsource = "a benchmark"\n[stack]\nsides = 4\nunits = 1\n'
        f"corner_radius_m = {2**0.5 * HALF_m}\nhole_radius_m = {2**0.5 * HOLE_m}\n"
        f"mid_ring_fraction = 0.464\nunit_height_m = {PITCH_m}\nring_heights = [0.25, 0.5, 0.75]\n"
        f"first_corner_rad = {-0.75 * np.pi}\nmesh = 'graded'\nrefine = {refine}\n{REST}"
    )


def scenario(robot: Path) -> str:
    """Return the scenario's file: pressures, and a force at each that is tilted."""
    phases = []
    for p in PRESSURES_kPa:
        phases.append(f'[[phase]]\nname = "p{p}"\nduration_s = 1.0\nincrements = 5\npressure_Pa = {p}e3\n')
        if p in TILTED_kPa:
            phases.append(
                f'[[phase]]\nname = "tilt{p}"\nduration_s = 1.0\nincrements = 5\n[[phase.force]]\n'
                f"rings = ['tip']\ntotal_N = [{FORCE_N}, 0.0, 0.0]\n"
            )
            phases.append(
                f'[[phase]]\nname = "back{p}"\nduration_s = 1.0\nincrements = 3\n[[phase.force]]\n'
                f"rings = ['tip']\ntotal_N = [0.0, 0.0, 0.0]\n"
            )
    return (
        f'schema = 2\ntitle = "t"\nrobot = "none"\nsoft_robot = "{robot.name}"\nmode = "quasistatic"\n'
        "start = { flange = { position_m = [0.0, 0.0, 0.5], direction = [0.0, 0.0, -1.0] } }\n"
        + "".join(phases)
    )


def main() -> None:
    """Print a line for each mesh."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--edges", type=float, nargs="*", default=[0.005, 0.0035, 0.0025])
    parser.add_argument("--refine", type=int, nargs="*", default=[1, 2])
    given = parser.parse_args()
    robots = [("stack", f"refined {k}", stack(k)) for k in given.refine]
    robots += [("pattern", f"{1e3 * e:g} mm", pattern(e)) for e in given.edges]
    for name, mesh, text in robots:
        with tempfile.TemporaryDirectory() as folder:
            robot, run = Path(folder, f"{name}.toml"), Path(folder, "run.toml")
            robot.write_text(text, encoding="utf-8")
            run.write_text(scenario(robot), encoding="utf-8")
            started = time.process_time()
            found = cosim.run(run, error=False)
        names = [phase["name"] for phase in found.summary["phases"]]
        last = {n: np.flatnonzero(np.asarray(found.phase) == k)[-1] for k, n in enumerate(names)}
        length = 1e3 * np.linalg.norm(found.tip_position - found.flange_position, axis=1)
        volume, tilt = 1e6 * found.volume_m3, np.degrees(found.bending_angle_rad)
        print(f"{name}, {mesh}, {len(found.node_position[0])} nodes ({time.process_time() - started:.0f} s)")
        print("  kPa: length mm, volume ml:", "; ".join(
            f"{p}: {length[last[f'p{p}']]:.1f}, {volume[last[f'p{p}']].item():.1f}" for p in PRESSURES_kPa
        ), flush=True)  # fmt: skip
        print("  tilt, degrees:", "; ".join(
            f"{p}: {tilt[last[f'tilt{p}']]:.2f}" for p in TILTED_kPa), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
