"""Cost against size: time of one Newton iteration of a soft arm of 1 to 200 units, and of refined meshes of
the ten-unit arm, with the fitted exponents.

    python benchmarks/scale.py [--json FILE]

One iteration: energy, gradient and Hessian, a factorisation, a solve; CPU time of one core, best of seven.
A tick: of 2 ms, one new tangent and as many iterations with a kept one as serve; median of twelve, while
the flange swings and the pressure rises.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.atlas.extremes import Extreme, body_of
from benchmarks.measure.calls import least_ms
from cosim.coupling.soft_arm import SoftArm
from cosim.frames import Pose, rotation_from_vector
from cosim.scenario.loading import load_soft_robot
from cosim.scenario.soft_build import build_soft_body
from cosim.scenario.solver_schema import ChamberModel
from cosim.soft.body import Loads, SoftBody
from cosim.soft.dynamics import StepOptions
from cosim.soft.envelope_cholesky import EnvelopeCholesky
from cosim.soft.newton import NewtonOptions, NewtonSolver
from cosim.soft.state import Clamp, SoftState
from cosim.soft.system import Inertia, SoftSystem

UNITS = (1, 2, 5, 10, 20, 50, 100, 200)
REFINEMENTS = (0, 1, 2)
REFINED_BOUND = 1.5
FITTED_FROM = 10  # smaller ones are mostly the overhead of calls
STEP_S, TICKS = 0.002, 12


_REPEATS = 7


def refined_arm(refine: int) -> SoftBody:
    """Return the ten-unit arm with every triangle divided into four so many times."""
    robot = load_soft_robot("hexagon_arm")
    return build_soft_body(replace(robot, chamber=replace(robot.chamber, refine=refine)), ChamberModel())


def tick(body: SoftBody) -> float:
    """Return the CPU time of a tick of the dynamic mode [s]."""
    options = StepOptions(newton=NewtonOptions(reuse_max=6), damping_per_s=2.0)
    hanging = Pose(np.diag([1.0, -1.0, -1.0]))
    arm, times = SoftArm(body, hanging, NewtonOptions(), options), []
    for k in range(1, TICKS + 1):
        swing = rotation_from_vector(np.array([0.0, 0.3 * np.sin(6.0 * k * STEP_S), 0.0]))
        loads = Loads(100.0 * k, (0.0,) * len(body.cables))
        began = time.process_time()
        arm.advance(Pose(swing @ hanging.rotation), loads, STEP_S)
        times.append(time.process_time() - began)
    return float(np.median(times))


def row(name: str, value: int, body: SoftBody) -> dict[str, float]:
    """Return the figures of one Newton iteration; `name` and `value` say which body it is."""
    system = SoftSystem(body)
    solver = NewtonSolver(system, Clamp.of_base(body).mask(body.nodes))
    state = SoftState.drawn(body, Pose())
    loads = Loads(1e3, (0.0,) * len(body.cables))
    inertia = Inertia(body.node_mass / STEP_S**2, state.positions)
    tension = system.segment_tension(state.positions, loads)

    def evaluate() -> None:
        system.evaluate(state.positions, loads, tension, state.angles, inertia=inertia)

    assembly = least_ms(evaluate, _REPEATS)
    factor = least_ms(lambda: solver.linear.factor(system.blocks), _REPEATS)
    solve = least_ms(lambda: solver.linear.solve(system.gradient), _REPEATS)
    linear = solver.linear
    return {
        name: value,
        "components": linear.size,
        "bandwidth": linear.bandwidth if isinstance(linear, EnvelopeCholesky) else math.nan,
        "assembly_ms": assembly,
        "factor_ms": factor,
        "solve_ms": solve,
        "iteration_ms": assembly + factor + solve,
    }


def exponents(rows: list[dict[str, float]], size: str) -> dict[str, float]:
    """Return b of the least-squares fits cost = a size^b."""
    found = {}
    for key in rows[0]:
        if key.endswith("_ms"):
            logs = np.log([[entry[size], entry[key]] for entry in rows])
            found[key] = float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])
    return found


def show(rows: list[dict[str, float]], fits: dict[str, float], words: str) -> None:
    """Print a table and its exponents."""
    print("  ".join(f"{key:>12}" for key in rows[0]))
    for entry in rows:
        print("  ".join(f"{value:12.4g}" for value in entry.values()))
    print(f"exponents {words}: " + ", ".join(f"{key[:-3]} {b:.2f}" for key, b in fits.items()))


def main() -> int:
    """Measure, print, write; return 1 where a refined mesh costs more than asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    from cosim.soft.compilation import compile_kernels

    compile_kernels(print)
    rows = [row("units", units, body_of(Extreme(units=units))) for units in UNITS]
    fits = exponents([entry for entry in rows if entry["units"] >= FITTED_FROM], "units")
    show(rows, fits, f"against units, from {FITTED_FROM} on")
    refined = [
        {**row("refine", k, refined_arm(k)), "tick_ms": 1e3 * tick(refined_arm(k))} for k in REFINEMENTS
    ]
    refined_fits = exponents(refined, "components")
    show(refined, refined_fits, f"against components under refinement (tick: at most {REFINED_BOUND})")
    if options.json:
        figures = {"rows": rows, "exponents": fits, "refined": refined, "refined_exponents": refined_fits}
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    return int(refined_fits["tick_ms"] > REFINED_BOUND)


if __name__ == "__main__":
    sys.exit(main())
