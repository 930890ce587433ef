"""Whether the energy balance of runs in time closes, and what share of their losses the integrator takes.

    python benchmarks/energy.py [NAME ...] [--integrator bdf2]

Cases: the reference, an arm that curls onto itself, a jerk of the reference's flange by 30 mm, the grasp of a
roll, and the arm with sealed chambers, moved in time. All energy is of the whole run, at shipped ticks.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cosim
from cosim.base.names import LOST, PUT_IN

JERK = {"name": "jerk", "duration_s": 0.1, "settle_s": 0.5, "flange_shift_m": [0.03, 0.0, 0.0]}
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    "reference": ("ur5e_hexagon_arm", {}),
    "curls": ("hexagon_arm_curls", {}),
    "jerk": ("ur5e_hexagon_arm", {"start.pressure_Pa": 20e3, "phase": [JERK]}),
    "roll": ("gripper_lifts_roll", {}),
    "sealed arm": ("sealed_arm", {"mode": "dynamic"}),
}


def main() -> None:
    """Run the cases and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--integrator", default="bdf2", choices=("bdf2", "implicit_euler"))
    options = parser.parse_args()
    print("| case | tick [ms] | put in and taken [J] | rest [%] | numerical share of losses [%] | CPU [s] |")
    print("|---|---:|---:|---:|---:|---:|")
    for case in options.names or CASES:
        began, (scenario, changes) = time.process_time(), CASES[case]
        changes = changes | {"solver.integrator": options.integrator}
        run = cosim.run(scenario, overrides=changes, error=False)
        energy = run.summary["phases"][-1]["energy"]
        turned, lost = sum(abs(energy[name]) for name in PUT_IN), sum(energy[name] for name in LOST)
        rest = f"{100.0 * abs(energy['rest_J']) / turned:.3f}"
        cells = (
            case, f"{1e3 * run.stage.tick_s:g}", f"{turned:.4g}", rest,
            f"{100.0 * energy['numerical_J'] / lost:.1f}", f"{time.process_time() - began:.0f}",
        )  # fmt: skip
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
