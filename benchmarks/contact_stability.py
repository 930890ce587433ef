"""A light cube between two inflated pads: which exchange of contact forces is stable at which tick.

    python benchmarks/contact_stability.py [--json FILE] [--seconds S]

A 40 mm cube is pressed between two balls of film (5 kPa, 4 mm overlap a side) and held by friction against
its weight. "explicit": the film's force of the last tick acts on the cube; "carried": besides, the film's
algorithmic mass rides on the cube as armature. Stable: the cube stays within 2 mm, and swings less in the
last fifth of the time than in the first.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from cosim.errors import SolverError

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from tests.coupling.pads import GRASP, Grasp

MASSES_KG = (0.01, 0.05)
TICKS_S = (5e-4, 1e-3, 2e-3, 5e-3)
LOST_M = 0.03


def hold(mass_kg: float, tick_s: float, seconds: float, *, carried: bool) -> dict[str, Any]:
    """Return how a cube fares between the pads."""
    grasp, path, ratio, ended = Grasp(mass_kg, tick_s, carried=carried), [], 0.0, "held"
    began = time.thread_time()
    for _ in range(round(seconds / tick_s)):
        try:
            grasp.tick()
        except SolverError as error:
            ended = type(error).__name__
            break
        path.append(grasp.cube_position - GRASP)
        ratio = max(ratio, grasp.mass.ratio if grasp.mass is not None else 0.0)
        if np.abs(path[-1]).max() > LOST_M:
            ended = "thrown out"
            break
    spent = time.thread_time() - began
    way = np.array(path)
    fifth = max(2, len(way) // 5)
    head, tail = way[:fifth], way[-fifth:]
    furthest, unrest = float(np.abs(way).max()), float(np.ptp(tail, axis=0).max())
    return {
        "mass_kg": mass_kg,
        "tick_s": tick_s,
        "exchange": "carried" if carried else "explicit",
        "ended": ended,
        "stable": ended == "held" and furthest < 2e-3 and unrest < float(np.ptp(head, axis=0).max()),
        "furthest_m": furthest,
        "unrest_m": unrest,
        "algorithmic_mass_ratio": ratio if carried else None,
        "ms_per_tick": 1e3 * spent / len(way),
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--seconds", type=float, default=0.4)
    options = parser.parse_args()
    figures = []
    for mass in MASSES_KG:
        for tick in TICKS_S:
            for carried in (True, False):
                found = hold(mass, tick, options.seconds, carried=carried)
                figures.append(found)
                ratio = f", mass ratio {found['algorithmic_mass_ratio']:.2f}" if carried else ""
                print(
                    f"{1e3 * mass:4.0f} g, {1e3 * tick:3.1f} ms, {found['exchange']:<8}: "
                    f"{'stable' if found['stable'] else 'NOT STABLE, ' + found['ended']}, furthest "
                    f"{1e3 * found['furthest_m']:.3f} mm, unrest {1e3 * found['unrest_m']:.4f} mm{ratio}, "
                    f"{found['ms_per_tick']:.2f} ms a tick",
                    flush=True,
                )
    if options.json:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
