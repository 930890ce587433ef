"""How near meshes of the default arm come to that refined twice, and what they cost.

    python benchmarks/default_mesh.py [MESH ..] [--pressures 10 20 30 40] [--reference FILE]

The arm of `ur5e_hexagon_arm` without contact: hung and inflated, turned, pulled by 3 N a cable with its first
rim held, and lifted by 30 mm above where it hangs by itself; its first unit alone, with open ends, tilted at
its place. Every cell is the largest error over the pressures, with its sign; the tip's is over the arm's
length. CPU time is of the arm's statics, and of the ticks of its scenario until it is inflated, the least of
three. The mesh refined twice takes two minutes; with --reference it is read from FILE, or written there.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.kernel_modules import compile_kernels
from cosim.build.options import fidelity_body
from cosim.build.simulation import build
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.errors import SolverError
from cosim.soft.beams.beam_rings import stiffener_strain
from cosim.soft.body.loads import Loads
from cosim.soft.geometry import polygonal_stack
from cosim.soft.geometry.polygonal_stack import Ring
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, Equilibrium, StepOptions
from cosim.soft.solve.tip_search import find_tensions
from cosim.soft.solve.tip_target import TipTarget
from cosim.verification.stacks import OpenSpecimen, tilt_stiffness

HANGING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.3, 0.0, 0.7]))
TURN_RAD, PIECES, LIFT_M, PULL_N = -0.28 * np.pi, 4, 0.03, 3.0
UNIT_KPA = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0)
DRAWN = {"soft_robot.stack.mesh": "drawn"}
REFERENCE = {**DRAWN, "soft_robot.stack.refine": 2}
MESHES: dict[str, tuple[Mapping[str, Any], Sequence[Ring]]] = {
    "drawn": (DRAWN, ()),
    "drawn, holes cut twice": ({**DRAWN, "soft_robot.stack.refine_holes": 2}, ()),
    "drawn, mid rings at 0.6": ({**DRAWN, "soft_robot.stack.mid_ring_fraction": 0.6}, ()),
    "drawn, hinges half as stiff": ({**DRAWN, "soft_robot.hinge.stiffness_factor": 5.0}, ()),
    "drawn, hinges of a shell": ({**DRAWN, "soft_robot.hinge.rule": "shell"}, ()),
    "drawn, wrinkles of 10 mm": ({**DRAWN, "soft_robot.film.wrinkle_panel_m": 0.01}, ()),
    "rings 0.42, 1; four nodes a side of the rim": ({}, (Ring(0.42), Ring(1.0, 4))),
    "rings 0.3, 0.65, 1; two nodes": ({}, (Ring(0.3), Ring(0.65), Ring(1.0))),
    "rings 0.15, 0.58, 1; four at the rim": ({}, (Ring(0.15), Ring(0.58), Ring(1.0, 4))),
    "rings 0.3, 0.65, 1; four on all": ({}, (Ring(0.3, 4), Ring(0.65, 4), Ring(1.0, 4))),
    "graded": ({}, ()),
    "graded, all diagonals from inside": (
        {},
        tuple(r._replace(from_inside=True) for r in polygonal_stack.GRADED),
    ),
    "graded, all from outside": ({}, tuple(r._replace(from_inside=False) for r in polygonal_stack.GRADED)),
    "graded, evenly": ({}, (Ring(0.25), Ring(0.5), Ring(0.75, from_inside=False), Ring(1.0, 4, False))),
    "drawn, refined once": ({**DRAWN, "soft_robot.stack.refine": 1}, ()),
}
"""Changes of the scenario and, where they are not those of graded meshes, the rings of a film."""


@contextmanager
def mesh_of(name: str) -> Iterator[Scenario]:
    """Yield the scenario with a mesh, whose rings last as long as the context."""
    changes, rings = MESHES[name]
    with mock.patch.object(polygonal_stack, "GRADED", tuple(rings) or polygonal_stack.GRADED):
        yield load_scenario("ur5e_hexagon_arm", changes)


class Arm:
    """The arm at a pressure: hung, turned, pulled and lifted."""

    def __init__(self, scenario: Scenario, pressure_Pa: float) -> None:
        options = NewtonOptions(tolerance_N=1e-5, start_tolerance_N=1e-5, iterations_max=300)
        self.body = fidelity_body(scenario)
        self.soft = SoftArm(self.body, HANGING, options, StepOptions())
        self.hung = self.soft.start(HANGING, Loads((pressure_Pa,), (0.0, 0.0)))

    def tip(self, here: Equilibrium) -> Array:
        """Return the tip's place (3,) [m]."""
        return self.body.tip_position(here.state.positions)

    def figures(self) -> dict[str, list[float]]:
        """Return tips [m], extension [m], volume [m^3], strain, and the tension that lifts it [N]."""
        soft, body, here = self.soft, self.body, self.hung
        drawn = np.linalg.norm(body.tip_position(body.positions))
        volume = soft.shape_reader().figures([here.state.positions]).volumes_m3[0].sum()
        for piece in range(1, PIECES + 1):
            turn = rotation_from_vector(np.array([0.0, TURN_RAD * piece / PIECES, 0.0]))
            here = soft.follow(here, Pose(turn @ HANGING.rotation, HANGING.translation), here.loads)
        strain = stiffener_strain(body, here.state.positions)
        assert strain is not None
        rim = np.setdiff1d(body.rings["unit_1.outer"], body.base)
        soft.hold(Clamp.of_base(body).extended(rim, here.state.positions, here.world_from_flange))
        pulled, end = here, replace(here.loads, cable_tension_N=(PULL_N, PULL_N))
        for piece in range(1, PIECES):
            loads = here.loads.interpolated(end, piece / (PIECES - 1))
            pulled = soft.follow(pulled, here.world_from_flange, loads)
        target = TipTarget(height=float(self.tip(here)[2]) + LIFT_M)
        lifted = find_tensions(soft.equilibrium_solver, here, target).equilibrium
        return {
            "tip": [*self.tip(here), *self.tip(pulled)],
            "length": [float(np.linalg.norm(self.tip(self.hung) - HANGING.translation))],
            "extension": [float(np.linalg.norm(self.tip(self.hung) - HANGING.translation) - drawn)],
            "volume": [float(volume)],
            "strain": [strain.peak],
            "tension": [float(np.mean(lifted.loads.cable_tension_N))],
        }


def tilt(robot: SoftRobotTable, pressures_kPa: Sequence[float]) -> dict[float, float]:
    """Return the tilt stiffness [N m/rad] of the first unit at each pressure [kPa]."""
    assert robot.stack is not None
    one = replace(robot, stack=replace(robot.stack, units=1), cables=())
    sample, found = OpenSpecimen(build_soft_body(one, load_scenario("ur5e_hexagon_arm").model)), {}
    for pressure in sorted({*UNIT_KPA, *pressures_kPa}):
        sample.load_to(1e3 * pressure)
        found[pressure] = tilt_stiffness(sample)
    return found


def statics(scenario: Scenario, pressures_kPa: Sequence[float]) -> dict[str, dict[str, list[float]]]:
    """Return the figures of a mesh by pressure [kPa], as text."""
    assert isinstance(scenario.soft_robot, SoftRobotTable)
    tilts = tilt(scenario.soft_robot, pressures_kPa)
    return {f"{kPa:g}": {**Arm(scenario, 1e3 * kPa).figures(), "tilt": [tilts[kPa]]} for kPa in pressures_kPa}


def tick_seconds(scenario: Scenario) -> float:
    """Return the CPU time of the ticks until the arm is inflated, the least of three [s]."""
    found = []
    for _ in range(3):
        ticks = build(replace(scenario, phases=scenario.phases[:2])).steps()
        next(ticks)
        began = time.process_time()
        for _ in ticks:
            pass
        found.append(time.process_time() - began)
    return min(found)


def errors(found: dict[str, Any], truth: dict[str, Any]) -> list[str]:
    """Return the cells of a row: the largest error of each figure [%]."""
    cells = []
    for key in ("tip", "extension", "volume", "tilt", "tension", "strain"):
        off = []
        for pressure, row in found.items():
            one, other = np.array(row[key]), np.array(truth[pressure][key])
            if key == "tip":
                apart = np.linalg.norm((one - other).reshape(2, 3), axis=1).max()
                off.append(float(apart / truth[pressure]["length"][0]))
            else:
                off.append(float(one[0] / other[0]) - 1.0)
        cells.append(f"{100.0 * max(off, key=abs):{'' if key == 'tip' else '+'}.1f}")
    return cells


def main() -> None:
    """Print a row for every mesh."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("meshes", nargs="*", metavar="MESH", help=f"all if omitted: {'; '.join(MESHES)}")
    parser.add_argument("--pressures", type=float, nargs="+", default=[10.0, 20.0, 30.0, 40.0], metavar="KPA")
    parser.add_argument("--reference", type=Path)
    options = parser.parse_args()
    compile_kernels(print)
    if options.reference is not None and options.reference.exists():
        truth = json.loads(options.reference.read_text(encoding="utf-8"))
    else:
        truth = statics(load_scenario("ur5e_hexagon_arm", REFERENCE), options.pressures)
        if options.reference is not None:
            options.reference.write_text(json.dumps(truth), encoding="utf-8")
    titles = "mesh | nodes | tip | extension | volume | tilt | tension | strain | statics [s] | ticks [s]"
    print(f"| {titles} |\n|{'---|' * 10}", flush=True)
    for name in options.meshes or MESHES:
        with mesh_of(name) as scenario:
            began = time.process_time()
            try:
                cells = errors(statics(scenario, options.pressures), truth)
            except SolverError as error:
                print(f"| {name} | {error} |", flush=True)
                continue
            spent = time.process_time() - began
            cells = [
                str(fidelity_body(scenario).nodes),
                *cells,
                f"{spent:.1f}",
                f"{tick_seconds(scenario):.2f}",
            ]
            print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
