"""A square unit, drawn as a pair of sheets and as a stack of polygons: one film, meshed in two ways.

    python benchmarks/pattern_against_stack.py [--edges 0.005 0.0035 0.0025] [--refine 1 2] [--law wrinkling]

Prints length, volume and, at 10 and 40 kPa, the tilt under a force at the tip, of each mesh of both. The tilt
is the mean of those by forces along x and along y. 10 kPa come again on the way back from 40. At the end: how
much the last pattern differs from the last stack.

The default law is a tension field: a unit has one shape at a pressure, however fine its mesh. The law
"wrinkling" is made for coarse meshes: fine ones fold by themselves and have several stable shapes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import cosim
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_soft_robot
from cosim.config.schema.scenario import ModelTable
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.membrane import Membranes

HALF_m: Final = 0.03
HOLE_m: Final = 0.002
PITCH_m: Final = 0.002
FORCE_N: Final = 0.05
SLACK: Final = 1e-3
"""Part of the plain law's stiffness that a tension field keeps; flat films need more than other robots."""
REST: Final = """
[film]
law = "{law}"
young_modulus_Pa = 1.3e9
poisson_ratio = 0.2
thickness_m = 0.11e-3
density_kg_m3 = 1000.0
[hinge]
rule = "shell"
"""
PRESSURES_kPa: Final = {"at_2": 2, "at_5": 5, "at_10": 10, "at_20": 20, "at_40": 40, "again_10": 10}
TILTED: Final = ("at_10", "at_40", "again_10")
FORCES: Final = {"x": f"[{FORCE_N}, 0.0, 0.0]", "y": f"[0.0, {FORCE_N}, 0.0]"}


def pattern(edge_m: float, rest: str) -> str:
    """Return the robot's file as two sheets."""
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
        f"outline_m = {square}\nholes_m = [{hole}]\nport_m = [{0.5 * a}, 0.0]\nedge = 'sealed'\n"
        f"pair_height_m = {PITCH_m}\nplane = 'flat'\nmesh_m = {edge_m}\n{ends}{rest}"
    )


def stack(refine: int, rest: str) -> str:
    """Return the robot's file as a stack of polygons."""
    return (
        f'schema = 2\nname = "stack"\nsource = "a benchmark"\n[stack]\nsides = 4\nunits = 1\n'
        f"corner_radius_m = {2**0.5 * HALF_m}\nhole_radius_m = {2**0.5 * HOLE_m}\n"
        f"mid_ring_fraction = 0.464\nunit_height_m = {PITCH_m}\nring_heights = [0.25, 0.5, 0.75]\n"
        f"first_corner_rad = {-0.75 * np.pi}\nmesh = 'graded'\nrefine = {refine}\n{rest}"
    )


def scenario(robot: Path) -> str:
    """Return the scenario's file: pressures, and a force at each that is tilted."""
    phases = []
    for name, kPa in PRESSURES_kPa.items():
        phases.append(f'name = "{name}"\nincrements = 5\npressure_Pa = {kPa}e3\n')
        for axis, force in FORCES.items() if name in TILTED else ():
            at_tip = "[[phase.force]]\nrings = ['tip']\ntotal_N = "
            phases.append(f'name = "{name}_{axis}"\nincrements = 5\n{at_tip}{force}\n')
            phases.append(f'name = "{name}_{axis}_gone"\nincrements = 3\n{at_tip}[0.0, 0.0, 0.0]\n')
    return (
        f'schema = 2\ntitle = "t"\nrobot = "none"\nsoft_robot = "{robot.name}"\nmode = "quasistatic"\n'
        "start = { flange = { position_m = [0.0, 0.0, 0.5], direction = [0.0, 0.0, -1.0] } }\n"
        + "".join(f"[[phase]]\nduration_s = 1.0\n{phase}" for phase in phases)
    )


def body_of(robot: Path) -> SoftBody:
    """Return the film of a robot's file, with more stiffness where it is slack."""
    body = build_soft_body(load_soft_robot(str(robot)), ModelTable())
    if body.membranes[0].film.law != "tension_field":
        return body
    film = replace(body.membranes[0].film, compressive_fraction=SLACK)
    elements = (replace(part, film=film) if isinstance(part, Membranes) else part for part in body.elements)
    return replace(body, elements=tuple(elements))


def found_of(robot_file: str) -> tuple[cosim.RunResult, dict[str, float]]:
    """Return the run of a robot, and what it has [mm, ml, degrees] by name and pressure."""
    with tempfile.TemporaryDirectory() as folder:
        robot, run = Path(folder, "robot.toml"), Path(folder, "run.toml")
        robot.write_text(robot_file, encoding="utf-8")
        run.write_text(scenario(robot), encoding="utf-8")
        result = cosim.run(run, body=body_of(robot), error=False)
    names = [phase["name"] for phase in result.summary["phases"]]
    last = {n: np.flatnonzero(np.asarray(result.phase) == k)[-1] for k, n in enumerate(names)}
    length = 1e3 * np.linalg.norm(result.tip_position - result.flange_position, axis=1)
    tilt = np.degrees(result.bending_angle_rad)
    figures = {f"length {p}": float(length[last[p]]) for p in PRESSURES_kPa}
    figures |= {f"volume {p}": float(1e6 * result.volume_m3[last[p]].item()) for p in PRESSURES_kPa}
    figures |= {f"tilt {p}": float(np.mean([tilt[last[f"{p}_{axis}"]] for axis in FORCES])) for p in TILTED}
    return result, figures


def main() -> None:
    """Print a line for each mesh, and the differences of the last two."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--edges", type=float, nargs="*", default=[0.005, 0.0035, 0.0025])
    parser.add_argument("--refine", type=int, nargs="*", default=[1, 2])
    parser.add_argument("--law", choices=["tension_field", "wrinkling"], default="tension_field")
    given = parser.parse_args()
    rest = REST.format(law=given.law)
    robots = [("stack", f"refined {k}", stack(k, rest)) for k in given.refine]
    robots += [("pattern", f"{1e3 * e:g} mm", pattern(e, rest)) for e in given.edges]
    ends: dict[str, dict[str, float]] = {}
    for name, mesh, text in robots:
        started = time.process_time()
        result, ends[name] = found_of(text)
        spent = time.process_time() - started
        print(f"{name}, {mesh}, {result.node_position.shape[1]} nodes ({spent:.0f} s)")
        for kind in ("length", "volume", "tilt"):
            own = (f"{k.removeprefix(kind)} kPa {v:.2f}" for k, v in ends[name].items() if k.startswith(kind))
            print(f"  {kind}:{';'.join(own)}", flush=True)
    if len(ends) == 2:
        more = {k: 100.0 * (v / ends["stack"][k] - 1.0) for k, v in ends["pattern"].items()}
        print("pattern over stack:", "; ".join(f"{k} {v:+.1f} %" for k, v in more.items()))


if __name__ == "__main__":
    main()
