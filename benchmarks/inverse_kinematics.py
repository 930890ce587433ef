"""How often and how fast the inverse kinematics finds a configuration.

1,000 flange poses of random configurations, each from a random start; then 100 poses that no
configuration reaches: half beyond the reach, half with the wrist centre inside the cylinder about the
first axis that a UR arm's wrist offset keeps free. Times are of one process, solve by solve.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import numpy as np

from cosim.base.frames import Pose, rotation_from_quaternion
from cosim.base.resources import list_arms
from cosim.build.arms import find_arm
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import solve

TOLERANCE = 1e-6  # m and rad


def reachable(arm: Arm, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return rates and times over poses that the arm can reach."""
    seconds, solved, restarts = [], 0, []
    for _ in range(count):
        target = arm.forward(rng.uniform(*arm.drawn_from))
        seed = rng.uniform(*arm.drawn_from)
        begun = time.perf_counter()
        try:
            solution = solve(arm, target, seed)
        except UnreachableError:
            seconds.append(time.perf_counter() - begun)
            continue
        seconds.append(time.perf_counter() - begun)
        restarts.append(solution.restarts)
        within = max(solution.position_error_m, solution.rotation_error_rad) <= TOLERANCE
        solved += int(within and np.all(solution.q >= arm.lower) and np.all(solution.q <= arm.upper))
    return {
        "poses": count,
        "solved": solved,
        "solved_percent": 100.0 * solved / count,
        "median_ms": 1e3 * float(np.median(seconds)),
        "p99_ms": 1e3 * float(np.quantile(seconds, 0.99)),
        "median_restarts": float(np.median(restarts)),
    }


def unreachable(arm: Arm, count: int, rng: np.random.Generator) -> dict[str, Any]:
    """Return how many unreachable poses are named as such, and how fast."""
    seconds, named = [], 0
    for k in range(count):
        rotation = rotation_from_quaternion(rng.normal(size=4))
        if k % 2:
            direction = rng.normal(size=3)
            distance = arm.reach * rng.uniform(1.001, 1.5)
            position = arm.shoulder + distance * direction / np.linalg.norm(direction)
        else:
            angle, radius = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(0.0, 0.12)
            centre = np.array([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(-0.3, 0.8)])
            position = centre + 0.0996 * rotation[:, 2]
        begun = time.perf_counter()
        try:
            solve(arm, Pose(rotation, position), arm.home)
        except UnreachableError:
            named += 1
        seconds.append(time.perf_counter() - begun)
    return {
        "poses": count,
        "named": named,
        "median_ms": 1e3 * float(np.median(seconds)),
        "longest_ms": 1e3 * max(seconds),
    }


def main() -> None:
    """Print the figures, as lines or as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arm", default="ur5e", choices=list_arms())
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    arm, rng = Arm(find_arm(arguments.arm)), np.random.default_rng(0)
    figures: dict[str, Any] = {"arm": arm.name, "reachable": reachable(arm, 1000, rng)}
    if arguments.arm == "ur5e":  # the unreachable poses are made for its wrist
        figures["unreachable"] = unreachable(arm, 100, rng)
    if arguments.json:
        print(json.dumps(figures, indent=2))
        return
    for group in ("reachable", "unreachable"):
        for name, value in figures.get(group, {}).items():
            print(f"{group} {name}: {value:.6g}")


if __name__ == "__main__":
    main()
