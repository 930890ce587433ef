"""Cost against size: time of one Newton iteration of a soft arm of 1 to 200 units, with the fitted exponent.

    python benchmarks/scale.py [--json FILE]

One iteration: energy, gradient and Hessian, a factorisation, a solve; CPU time of one core, best of seven.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.atlas.extremes import Extreme, body_of
from cosim.frames import Pose
from cosim.soft.body import Loads
from cosim.soft.linear_solver import BandedCholesky
from cosim.soft.newton import NewtonSolver
from cosim.soft.state import Clamp, SoftState
from cosim.soft.system import Inertia, SoftSystem

UNITS = (1, 2, 5, 10, 20, 50, 100, 200)
FITTED_FROM = 10  # smaller ones are mostly the overhead of calls
STEP_S = 0.002


def best_of(run: Callable[[], object], repeats: int = 7) -> float:
    """Return the least CPU time of a call [s]."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        run()
        times.append(time.process_time() - began)
    return min(times)


def row(units: int) -> dict[str, float]:
    """Return the figures of an arm of so many units."""
    body = body_of(Extreme(units=units))
    system = SoftSystem(body)
    solver = NewtonSolver(system, Clamp.of_base(body).mask(body.nodes))
    state = SoftState.drawn(body, Pose())
    loads = Loads(1e3, (0.0,) * len(body.cables))
    inertia = Inertia(body.node_mass / STEP_S**2, state.positions)
    tension = system.segment_tension(state.positions, loads)

    def evaluate() -> None:
        system.evaluate(state.positions, loads, tension, state.angles, inertia=inertia)

    assembly = best_of(evaluate)
    factor = best_of(lambda: solver.linear.factor(system.blocks))
    solve = best_of(lambda: solver.linear.solve(system.gradient))
    assert isinstance(solver.linear, BandedCholesky)
    return {
        "units": units,
        "components": solver.linear.size,
        "bandwidth": solver.linear.bandwidth,
        "assembly_ms": 1e3 * assembly,
        "factor_ms": 1e3 * factor,
        "solve_ms": 1e3 * solve,
        "iteration_ms": 1e3 * (assembly + factor + solve),
    }


def exponent(rows: list[dict[str, float]], key: str) -> float:
    """Return b of the least-squares fit cost = a units^b."""
    large = [entry for entry in rows if entry["units"] >= FITTED_FROM]
    logs = np.log([[entry["units"], entry[key]] for entry in large])
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    from cosim.soft.compilation import compile_kernels

    compile_kernels(print)
    rows = [row(units) for units in UNITS]
    keys = list(rows[0])
    print("  ".join(f"{key:>12}" for key in keys))
    for entry in rows:
        print("  ".join(f"{entry[key]:12.4g}" for key in keys))
    exponents = {key: exponent(rows, key) for key in keys if key.endswith("_ms")}
    fits = ", ".join(f"{key[:-3]} {b:.2f}" for key, b in exponents.items())
    print(f"exponents from {FITTED_FROM} units on: {fits}")
    if options.json:
        options.json.write_text(json.dumps({"rows": rows, "exponents": exponents}, indent=2) + "\n")


if __name__ == "__main__":
    main()
