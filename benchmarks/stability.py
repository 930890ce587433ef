"""Stability atlas: which extremes run, which run slowly, which fail by name; nothing else may happen.

    python benchmarks/stability.py [--json FILE] [--png FILE] [--maps NAME ...]
    python benchmarks/stability.py --symmetric
    python benchmarks/stability.py --statics [NAME ...]
    python benchmarks/stability.py --saddle

Each point is a short run of a small soft arm, or of the UR5e with the reference scenario's, at the ends of
what may be asked for. Exit code 1 if any failure has no name, or the reference scenario is not stable from
0.1 to 20 ms at every pressure from 0 to 100 kPa. With --symmetric: symmetric bodies are loaded beyond
their branchings; 1 if one is silent, or does not end on a stable branch. With --statics: all static solutions
of the shipped scenarios are counted; 1 if one is unstable. With --saddle: the pouch of tests/cases/saddle in
statics and in time, and how firmly it stays where it comes to rest; 1 if statics branch or end elsewhere.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.atlas.extremes import Extreme, Verdict, probe
from benchmarks.atlas.on_arm import POSES, ArmExtreme, probe_arm
from benchmarks.atlas.saddle import saddle_table
from benchmarks.atlas.symmetric import symmetric_table
from benchmarks.measure.stability import static_table

TICKS_S = (1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 3e-2, 5e-2, 0.1)
FEW_TICKS_S = (1e-5, 1e-4, 5e-4, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1)
DEFAULT_TICKS_S = (5e-4, 1e-3, 2e-3, 4e-3, 1e-2, 2e-2, 5e-2)
PRESSURES_Pa = tuple(1e3 * p for p in (-20, -10, -5, -1, 0, 1, 5, 10, 30, 60, 100, 150, 200))
FEW_PRESSURES_Pa = tuple(1e3 * p for p in (-20, -5, 0, 1, 10, 30, 60, 100, 200))
REFERENCE_Pa = tuple(1e3 * p for p in (-20, -5, 0, 10, 20, 30, 40, 50, 60, 70, 80, 90, 100, 150, 200))
MODULI_Pa = (1e5, 1e6, 1e7, 1e8, 5e8, 1e9, 1e10, 1e11, 1e12)
THICKNESSES_m = (1e-6, 3e-6, 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 5e-3)
MASSES_kg = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
TENSIONS_N = (0.0, 0.1, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)
JUMPS_m = (1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.2, 0.5)
SPINS_rad_s = (0.1, 0.5, 1.0, 2.0, 5.0, 10.0, 15.0, 20.0)
SLIVERS = (1e-12, 1e-9, 1e-7, 1e-5, 1e-3, 0.05, 0.5, 0.95, 0.999, 0.99999, 1.0 - 1e-7, 1.0 - 1e-9)
REQUIRED_TICKS_S, REQUIRED_Pa = (1e-4, 2e-2), (0.0, 100e3)

Values = Sequence[Any]


@dataclass(frozen=True)
class Map:
    """Two things varied, over a background.

    Args:
        title: what it shows.
        x: field and values.
        y: field and values.
        base: everything else.
    """

    title: str
    x: tuple[str, Values]
    y: tuple[str, Values]
    base: Extreme | ArmExtreme = Extreme()


def _tick_maps() -> list[Map]:
    tick, few = ("tick_s", TICKS_S), ("tick_s", FEW_TICKS_S)
    pressure, little = ("pressure_Pa", PRESSURES_Pa), ("pressure_Pa", FEW_PRESSURES_Pa)
    return [
        Map("pressure", tick, pressure),
        Map("pressure, no gravity", few, little, Extreme(gravity_m_s2=0.0)),
        Map("pressure, BDF2", few, little, Extreme(integrator="bdf2")),
        Map("pressure, tension field", few, little, Extreme(law="tension_field")),
        Map("pressure, edge strain", few, little, Extreme(law="edge_strain")),
        Map("pressure, open chamber", few, little, Extreme(closed=False)),
        Map("film modulus", tick, ("young_modulus_Pa", MODULI_Pa)),
        Map("film thickness", tick, ("thickness_m", THICKNESSES_m)),
        Map("node mass", tick, ("node_mass_kg", MASSES_kg)),
        Map("cables, slowly", few, ("tension_N", TENSIONS_N)),
        Map("cables, at once", few, ("tension_N", TENSIONS_N), Extreme(cable="jerk")),
        Map("cables, cut", few, ("tension_N", TENSIONS_N), Extreme(cable="cut")),
        Map("cables, cut, BDF2", few, ("tension_N", TENSIONS_N), Extreme(cable="cut", integrator="bdf2")),
        Map("flange jump", tick, ("jump_m", JUMPS_m)),
        Map("flange spin", tick, ("spin_rad_s", SPINS_rad_s)),
    ]


def _other_maps() -> list[Map]:
    still, little, flat = Extreme(statics=True), ("pressure_Pa", FEW_PRESSURES_Pa), Extreme(pressure_Pa=0.0)
    five = ("pressure_Pa", (-20e3, 0.0, 10e3, 30e3, 200e3))
    return [
        Map("film", ("young_modulus_Pa", MODULI_Pa), ("thickness_m", THICKNESSES_m)),
        Map("film, flat", ("young_modulus_Pa", MODULI_Pa), ("thickness_m", THICKNESSES_m), flat),
        Map("mass and film", ("node_mass_kg", MASSES_kg), ("young_modulus_Pa", MODULI_Pa)),
        Map("cables cut", little, ("tension_N", TENSIONS_N), Extreme(cable="cut")),
        Map("jump and spin", ("jump_m", JUMPS_m), ("spin_rad_s", SPINS_rad_s)),
        Map("slivers", ("sliver", SLIVERS), little),
        Map("triangles turned over", ("flipped", (0, 1, 2, 5, 10, 42, 84, 168)), little),
        Map("units", ("units", (1, 2, 5, 10, 20, 50, 100, 200)), five, Extreme(ticks=12)),
        Map("statics", ("young_modulus_Pa", MODULI_Pa), ("pressure_Pa", PRESSURES_Pa), still),
        Map("statics", ("thickness_m", THICKNESSES_m), ("pressure_Pa", PRESSURES_Pa), still),
        Map("statics, cables", little, ("tension_N", TENSIONS_N), still),
        Map("statics, flange jump", little, ("jump_m", JUMPS_m), still),
        Map("statics, slivers", ("sliver", SLIVERS), little, still),
    ]  # fmt: skip


def _arm_maps() -> list[Map]:
    few, short = ("tick_s", FEW_TICKS_S), ArmExtreme(short=True)
    default = ArmExtreme(published=False, integrator="bdf2")
    steps = (0.001, 0.01, 0.03, 0.1, 0.2, 0.3, 0.5)
    return [
        Map("UR5e, reference scenario", ("tick_s", TICKS_S), ("pressure_Pa", REFERENCE_Pa), ArmExtreme()),
        Map("UR5e, reference, BDF2", few, ("pressure_Pa", FEW_PRESSURES_Pa), ArmExtreme(integrator="bdf2")),
        Map("UR5e, default robot", ("tick_s", DEFAULT_TICKS_S), ("pressure_Pa", (10e3, 30e3)), default),
        Map("UR5e, mass ratio", few, ("mass_ratio", (1e-4, 1e-3, 1e-2, 0.1, 0.3, 1.0, 3.0, 10.0)), short),
        Map("UR5e, poses", few, ("pose", tuple(POSES)), short),
        Map("UR5e, reference jumps", few, ("step_m", steps), short),
        Map("UR5e, a ball in the way", few, ("object_kg", (1e-3, 0.01, 0.1, 1.0, 10.0, 100.0)), short),
    ]


def maps() -> list[Map]:
    """Return all maps."""
    return [*_tick_maps(), *_other_maps(), *_arm_maps()]


def sweep(chart: Map) -> list[dict[str, Any]]:
    """Run all points of a map."""
    points = []
    for x, y in product(chart.x[1], chart.y[1]):
        verdict = _probe(replace(chart.base, **{chart.x[0]: x, chart.y[0]: y}))
        points.append({chart.x[0]: x, chart.y[0]: y, **vars(verdict)})
    return points


def _probe(extreme: Extreme | ArmExtreme) -> Verdict:
    return probe(extreme) if isinstance(extreme, Extreme) else probe_arm(extreme)


def unstable_reference(points: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the points of the reference scenario within the required region that do not run."""
    (t0, t1), (p0, p1) = REQUIRED_TICKS_S, REQUIRED_Pa
    inside = [p for p in points if t0 <= p["tick_s"] <= t1 and p0 <= p["pressure_Pa"] <= p1]
    return [point for point in inside if point["kind"] not in ("stable", "slow")]


def main() -> int:
    """Sweep, print, write; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--png", type=Path)
    parser.add_argument("--maps", nargs="*", help="titles that contain any of these words only")
    parser.add_argument("--symmetric", action="store_true", help="load symmetric bodies instead")
    parser.add_argument(
        "--statics",
        nargs="*",
        metavar="NAME",
        help="count stable static solutions of scenarios (all) instead",
    )
    parser.add_argument("--saddle", action="store_true", help="follow the symmetric pouch instead")
    options = parser.parse_args()
    if options.saddle:
        return 1 if saddle_table() else 0
    if options.symmetric:
        return 1 if symmetric_table() else 0
    if options.statics is not None:
        return 1 if static_table(options.statics) else 0
    began, results = time.process_time(), []
    for chart in maps():
        if options.maps and not any(word in chart.title for word in options.maps):
            continue
        points = sweep(chart)
        results.append({"title": chart.title, "x": chart.x[0], "y": chart.y[0], "points": points})
        counts = Counter(point["kind"] for point in points)
        seconds = sum(point["seconds"] for point in points)
        print(
            f"{chart.title:<28} {chart.x[0]:>16} x {chart.y[0]:<16} {dict(counts)}, {seconds:.1f} s",
            flush=True,
        )
    return _finish(results, time.process_time() - began, options)


def _finish(results: list[dict[str, Any]], seconds: float, options: argparse.Namespace) -> int:
    points = [point for result in results for point in result["points"]]
    counts = Counter(point["kind"] for point in points)
    names = Counter(point["name"] for point in points if point["kind"] == "named")
    print(f"{len(points)} points in {seconds:.0f} s of CPU time: {dict(counts)}")
    for name, count in names.most_common():
        print(f"  {count:5d}  {name}")
    nameless = [point for point in points if point["kind"] == "unnamed"]
    for point in nameless:
        print("UNNAMED", {key: value for key, value in point.items() if key != "seconds"})
    reference = [p for r in results if r["title"] == "UR5e, reference scenario" for p in r["points"]]
    missing = unstable_reference(reference)
    for point in missing:
        print("REQUIRED REGION", point)
    if options.json:
        summary = {"points": len(points), "kinds": counts, "named": names, "cpu_s": seconds, "maps": results}
        options.json.write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    if options.png:
        from benchmarks.atlas.plot import draw  # matplotlib is a development tool

        draw(results, options.png)
    return 1 if nameless or missing else 0


if __name__ == "__main__":
    sys.exit(main())
