"""A resting soft arm over many ticks: does its tip creep, does the process grow?

    python benchmarks/long_run.py [--ticks N] [--json FILE]

An inflated arm of two units with two tensioned cables rests on a held flange. Exit code 1 if its tip moved
by more than 1 nm, or the process has grown by more than 1 MB after the first tenth of the ticks.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.atlas.extremes import HANGING, Extreme, body_of
from cosim.coupling.soft_arm import SoftArm
from cosim.soft.body import Loads
from cosim.soft.dynamics import StepOptions
from cosim.soft.newton import NewtonOptions

TICK_S = 0.002
DRIFT_m, GROWTH_kB = 1e-9, 1000


def resting_arm() -> tuple[SoftArm, Loads]:
    """Return an arm in equilibrium and the loads that it bears."""
    body = body_of(Extreme())
    arm = SoftArm(body, HANGING, NewtonOptions(1e-9, start_tolerance_N=1e-9), StepOptions())
    solver = arm.equilibrium_solver
    loads = Loads(30e3, (2.0, 1.0))
    hung = solver.solve(arm.state, HANGING, Loads(0.0, (0.0, 0.0)))
    arm.settle(solver.follow(hung, HANGING, loads))
    return arm, loads


def main() -> int:
    """Run, print, write; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ticks", type=int, default=100_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    arm, loads = resting_arm()
    start = arm.body.tip_position(arm.state.positions)
    memory = drift = 0.0
    for tick in range(1, options.ticks + 1):
        arm.advance(HANGING, loads, TICK_S)
        if tick == max(1, options.ticks // 10):
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if tick % 1000 == 0 or tick == options.ticks:
            moved = arm.body.tip_position(arm.state.positions) - start
            drift = max(drift, float(np.linalg.norm(moved)))
    growth = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - memory
    speed = float(np.abs(arm.state.velocities).max())
    print(f"{options.ticks} ticks: tip moved {drift:.2e} m, fastest node {speed:.2e} m/s")
    print(f"resident memory grown by {growth:.0f} kB after the first tenth")
    if options.json:
        figures = {"ticks": options.ticks, "drift_m": drift, "speed_m_s": speed, "growth_kB": growth}
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    return int(drift > DRIFT_m or growth > GROWTH_kB)


if __name__ == "__main__":
    sys.exit(main())
