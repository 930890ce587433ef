"""Cost against size: time of one Newton iteration and of a tick of a soft arm of 1 to 200 units, and of
refined meshes of the ten-unit arm, with the fitted exponents.

    python benchmarks/scale.py [--json FILE] [--motion]

One iteration: energy, gradient and Hessian, a factorisation, a solve. A tick: of 2 ms, the median of twelve
while the flange is jerked from rest and the pressure rises. `--motion` adds the mean tick of a smooth motion.
CPU time of one core. All sizes are measured in turn, round by round, each for about as long: a machine whose
speed changes changes it for all. Of a round the median counts, of the rounds the least.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.atlas.extremes import Extreme, body_of
from benchmarks.measure.calls import call_times, median_s
from benchmarks.measure.soft_ticks import STEP_S, jerk_times, motion_times
from cosim.base.frames import Array, Pose
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_soft_robot
from cosim.config.schema.scenario import ModelTable
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.elements.mass_terms import Inertia
from cosim.soft.linear.cholesky import EnvelopeCholesky
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.state import Clamp, SoftState

UNITS = (1, 2, 5, 10, 20, 50, 100, 200)
REFINEMENTS = (0, 1, 2)
UNITS_BOUND, REFINED_BOUND = 1.1, 1.5
FITTED_FROM = 10  # smaller ones are mostly the overhead of calls
_ROUNDS, _MOTION_TICKS = 5, 20
_CALLS_S, _TICKS_S = 0.1, 1.5  # how long a part of an iteration, or ticks, are repeated in a round


def refined_arm(refine: int) -> SoftBody:
    """Return the ten-unit arm with every triangle divided into four so many times."""
    robot = load_soft_robot("hexagon_arm")
    assert robot.stack is not None, "a stack of units"
    return build_soft_body(
        replace(robot, stack=replace(robot.stack, refine=refine)), ModelTable(published=True)
    )


class Iteration:
    """What one Newton iteration of a body consists of, and its least times so far [ms]."""

    def __init__(self, body: SoftBody) -> None:
        system = SoftSystem(body)
        solver = NewtonSolver(system, Clamp.of_base(body).mask(body.nodes))
        state = SoftState.drawn(body, Pose())
        loads = Loads((1e3,), (0.0,) * len(body.cables))
        inertia = Inertia(body.node_mass / STEP_S**2, state.positions)
        tension = system.segment_share(state.positions, loads)
        self.linear = solver.linear
        self.parts: dict[str, Callable[[], object]] = {
            "assembly_ms": lambda: system.evaluate(
                state.positions, loads, tension, state.memory, inertia=inertia
            ),
            "factor_ms": lambda: self.linear.factor(system.blocks),
            "solve_ms": lambda: self.linear.solve(system.gradient),
        }
        self.least = dict.fromkeys(self.parts, math.inf)

    def measure(self) -> None:
        """Run every part for a while."""
        for name, run in self.parts.items():
            repeats = 3 + int(_CALLS_S / call_times(run, 1)[0])
            self.least[name] = min(self.least[name], 1e3 * median_s(run, repeats))

    def row(self, name: str, value: int) -> dict[str, float]:
        """Return the figures; `name` and `value` say which body it is."""
        linear = self.linear
        return {
            name: value,
            "components": linear.size,
            "bandwidth": linear.bandwidth if isinstance(linear, EnvelopeCholesky) else math.nan,
            **self.least,
            "iteration_ms": sum(self.least.values()),
        }


def measured(name: str, bodies: dict[int, SoftBody], motion: bool) -> list[dict[str, float]]:
    """Return the figures of some bodies, measured in turn."""
    iterations = {value: Iteration(body) for value, body in bodies.items()}
    for _ in range(_ROUNDS):
        for iteration in iterations.values():
            iteration.measure()
    rows = [iteration.row(name, value) for value, iteration in iterations.items()]
    for entry, times in zip(rows, least_ticks(bodies, jerk_times), strict=True):
        entry["tick_ms"] = 1e3 * float(np.median(times))
    if motion:
        moved = least_ticks(bodies, lambda body: motion_times(body, _MOTION_TICKS))
        for entry, times in zip(rows, moved, strict=True):
            entry["motion_ms"] = 1e3 * float(np.mean(times))
    return rows


def least_ticks(bodies: dict[int, SoftBody], run: Callable[[SoftBody], list[float]]) -> list[Array]:
    """Return the time [s] of each tick of each body."""

    def in_a_round(body: SoftBody) -> Array:
        """Return the medians of so many repetitions as take a while."""
        times = [run(body)]
        while sum(map(sum, times)) < _TICKS_S:
            times.append(run(body))
        return np.asarray(np.median(times, axis=0))

    rounds = [[in_a_round(body) for body in bodies.values()] for _ in range(_ROUNDS)]
    return [np.min(times, axis=0) for times in zip(*rounds, strict=True)]


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
    """Measure, print, write; return 1 where a tick grows faster than asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument(
        "--motion", action="store_true", help="also the mean tick of a smooth motion (minutes)"
    )
    options = parser.parse_args()
    from cosim.build.kernel_modules import compile_kernels

    compile_kernels(print)
    rows = measured("units", {units: body_of(Extreme(units=units)) for units in UNITS}, options.motion)
    fits = exponents([entry for entry in rows if entry["units"] >= FITTED_FROM], "units")
    show(rows, fits, f"against units, from {FITTED_FROM} on (tick: at most {UNITS_BOUND})")
    refined = measured("refine", {k: refined_arm(k) for k in REFINEMENTS}, options.motion)
    refined_fits = exponents(refined, "components")
    show(refined, refined_fits, f"against components under refinement (tick: at most {REFINED_BOUND})")
    if options.json:
        figures = {"rows": rows, "exponents": fits, "refined": refined, "refined_exponents": refined_fits}
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    return int(fits["tick_ms"] > UNITS_BOUND or refined_fits["tick_ms"] > REFINED_BOUND)


if __name__ == "__main__":
    sys.exit(main())
