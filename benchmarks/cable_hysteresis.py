"""How far a soft arm bends over its cables' tension, pulled and let go: the loop, and the work lost in it.

    python benchmarks/cable_hysteresis.py [--robot hexagon_arm] [--pressure 30] [--low 4] [--high 12]
                                          [--steps 32]

Equilibria of the robot's film, hung up straight, all cables alike: pulled from the lowest tension to the
highest, let go to the lowest, and both once more. The area of the second loop, tension over the cables'
length, is compared with the work that its eyelets have lost; both laws of losses.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_soft_robot
from cosim.config.schema.scenario import ModelTable
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.cable import Cable
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, SoftState

HANGING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 1.0]))


def loop(body: SoftBody, pressure_Pa: float, tensions_N: list[float]) -> Array:
    """Return tension [N], bending [rad], length of all cables [m] and work lost so far [J], row by row."""
    system, clamp = SoftSystem(body), Clamp.of_base(body)
    newton = NewtonSolver(system, clamp.mask(body.nodes))
    solver = EquilibriumSolver(newton, clamp, NewtonOptions(tolerance_N=1e-6))
    here = solver.hang(SoftState.drawn(body, HANGING), HANGING, (0.0, 0.0, -9.81))
    none = (0.0,) * len(body.cables)
    here = solver.load(here, Loads((pressure_Pa,) * len(body.gas_chambers), none))
    rows, lost, down = [], 0.0, HANGING.rotation[:, 2]
    for tension in tensions_N:
        before = here.state.memory
        loads = replace(here.loads, cable_tension_N=(tension,) * len(body.cables))
        here = solver.follow(here, HANGING, loads)
        x = here.state.positions
        lost += system.lost_at_eyelets(x, before, here.state.memory)
        bending = np.arccos(np.clip(body.tip_direction(x) @ down, -1.0, 1.0))
        rows.append((tension, bending, sum(cable.length(x) for cable in body.cables), lost))
    return np.array(rows)


def main() -> None:
    """Print the loop of each law of losses."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("--robot", default="hexagon_arm")
    parser.add_argument("--pressure", type=float, default=30.0, help="kPa")
    parser.add_argument("--low", type=float, default=4.0, help="N")
    parser.add_argument("--high", type=float, default=12.0, help="N")
    parser.add_argument("--steps", type=int, default=32, help="from the lowest to the highest tension")
    a = parser.parse_args()
    drawn = build_soft_body(load_soft_robot(a.robot), ModelTable())
    up = np.linspace(a.low, a.high, a.steps + 1)
    cycle = [*up[1:].tolist(), *up[::-1][1:].tolist()]
    for directed in (True, False):
        cables = (replace(cable, directed=directed) for cable in drawn.cables)
        began = time.process_time()
        rows = loop(drawn.with_other(Cable, *cables), 1e3 * a.pressure, [a.low, *cycle, *cycle])
        first = np.degrees(rows[: a.steps + 1, 1])
        tension, bending, length, lost = rows[len(cycle) :].T  # the second loop, which is closed
        area = -float(0.5 * (tension[1:] + tension[:-1]) @ np.diff(length))
        name = "directed" if directed else "one way"
        work = f"area of the loop {1e3 * area:.2f} mJ, lost at eyelets {1e3 * (lost[-1] - lost[0]):.2f} mJ"
        print(f"{name}: {work}; {time.process_time() - began:.0f} s of CPU time")
        shown = slice(None, None, max(a.steps // 8, 1))
        print("  tension [N]  " + " ".join(f"{value:6.1f}" for value in up[shown]))
        degrees = np.degrees(bending)
        print("  at first     " + " ".join(f"{value:6.1f}" for value in first[shown]))
        print("  pulled [deg] " + " ".join(f"{value:6.1f}" for value in degrees[: a.steps + 1][shown]))
        print("  let go [deg] " + " ".join(f"{value:6.1f}" for value in degrees[a.steps :][::-1][shown]))


if __name__ == "__main__":
    main()
