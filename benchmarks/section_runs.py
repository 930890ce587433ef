"""Every shipped scenario of an arm of units on its section model, against the film on its own mesh.

    python benchmarks/section_runs.py [--refined] [--set KEY=VALUE ...] [SCENARIO ...]

The table has the distances of the tips at the ends of the phases and the largest along the run, also over the
length at the end, and times real time by CPU time of the loops, without recording.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import dataclass
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cosim.app.driver import build_simulation, prepared
from cosim.base.frames import Array, IntArray
from cosim.config.loading import load_scenario
from cosim.errors import CosimError

ARMS = (
    "ur5e_hexagon_arm", "light_hexagon_arm", "paper_figure_9", "hexagon_arm_curls", "hexagon_arm_deploys",
    "tip_path", "tip_path_control", "tip_path_on_rail", "pumped_arm", "sealed_arm", "arm_reaches_into_bin",
    "arm_around_bar", "ten_unit_extension", "three_unit_inflation", "hexagon_arm_angles",
    "hexagon_arm_bending", "hexagon_arm_torsion", "bending_angle", "bending_angle_control",
    "bending_angle_tip_load", "three_point_bending", "three_point_bending_cables", "fabric_boom_reaches",
)  # fmt: skip


@dataclass(frozen=True)
class Run:
    """Tips (n, 3) [m] and phases (n,) of all ticks, times real time."""

    tips: Array
    phases: IntArray
    length_m: float
    factor: float


def run_of(scenario: str, changes: dict[str, Any]) -> Run:
    """Run it."""
    checked = prepared(load_scenario(scenario, changes), lambda _: None, recording=False, contact=True)
    run = build_simulation(checked)
    batches = run.batches()
    seen = [next(batches)]
    began = time.process_time()
    seen += batches
    spent = time.process_time() - began
    tips, phases = (np.concatenate([getattr(b, name) for b in seen]) for name in ("tip_position", "phase"))
    length = float(np.linalg.norm(tips[-1] - seen[-1].flange_position[-1]))
    return Run(tips, phases, length, run.stage.duration_s / spent)


def said(error: CosimError) -> str:
    """Return the first line of an error, short."""
    return str(error).splitlines()[0][:230]


def row_of(scenario: str, given: dict[str, Any], *, refined: bool) -> str:
    """Return a row of the table."""
    try:
        one = run_of(scenario, {"fidelity": "section"} | given)
    except CosimError as error:
        return f"| `{scenario}` | {type(error).__name__}: {said(error)} |"
    cells, others = list[str](), ["lumped", "refined"] if refined else ["lumped"]
    factors = [one.factor]
    for fidelity in others:
        try:
            other = run_of(scenario, {"fidelity": fidelity} | given)
        except CosimError as error:
            cells.append(f"{fidelity} fails: {said(error)}")
            continue
        count = min(len(one.tips), len(other.tips))
        off = 1e3 * np.linalg.norm(one.tips[:count] - other.tips[:count], axis=1)
        ends = np.flatnonzero(np.diff(one.phases[:count], append=-1))
        at = ", ".join(f"{off[end]:.1f}" for end in ends[:8]) + (", ..." if len(ends) > 8 else "")
        cells.append(f"{at}; {off.max():.1f} ({0.1 * off.max() / other.length_m:.1f} %)")
        factors.append(other.factor)
    return f"| `{scenario}` | {' | '.join(cells)} | {', '.join(f'{factor:.3g}' for factor in factors)} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--refined", action="store_true", help="also against the mesh refined once")
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("scenarios", nargs="*", default=ARMS)
    options = parser.parse_args()
    given = {key: json.loads(value) for key, value in (each.split("=", 1) for each in options.set)}
    print("| scenario | tip off [mm] | times real time |")
    for scenario in options.scenarios:
        print(row_of(scenario, given, refined=options.refined), flush=True)


if __name__ == "__main__":
    main()
