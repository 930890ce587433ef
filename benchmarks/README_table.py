"""Measures the figures of README's table and writes them between its markers.

    python benchmarks/README_table.py [ROW ...]

Without names: all rows, which takes some two hours of one idle core (grasps 1.5). Rows that are not named
keep their figures.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks import grasps, inverse_kinematics, paper_examples, real_time, tip_heights, tip_targets
from benchmarks.measure.page_tables import put_table
from cosim.build.arms import find_arm
from cosim.kinematics.arm import Arm

ROOT: Final = Path(__file__).resolve().parents[1]
TABLE: Final = "figures"


def speed() -> str:
    own, paper = (
        real_time.least("ur5e_hexagon_arm", changes, 3) for changes in ([], ["model.published=true"])
    )
    factors = [each.simulated_s / each.wall_s for each in (own, paper)]
    return (
        f"{own.simulated_s:g} s in {own.wall_s:.1f} s, {factors[0]:.1f} times real time; the paper's lumped "
        f"model {factors[1]:.1f} times"
    )


def examples() -> str:
    rows = [
        row
        for name in paper_examples.EXAMPLES
        for row in paper_examples.compare(name, paper_examples.Model())
    ]
    return f"every node of {len(rows)} stages within {1e3 * max(row.error_m for row in rows):.0e} mm"


def targets() -> str:
    found = [entry for entry in tip_targets.measure(50) if entry.arm_follows]
    moved = max(entry.dynamic_tip_mm for entry in found if entry.dynamic_tip_mm is not None)
    return f"at most {max(entry.iterations for entry in found)} iterations, motions end within {moved:.2f} mm"


def heights() -> str:
    found = [height for _, height in tip_heights.measure(tip_heights.DESIGNS, tip_heights.TARGETS)]
    held = [height.held_mm for height in found if height.held_mm is not None]
    reached = sum(height.found_N is not None for height in found)
    return f"{reached} of {len(found)} found, motions end within {max(held):.2g} mm"


def held() -> str:
    cases = [
        grasps.grasp(shape, mass, seed, {})
        for seed, mass, shape in product(range(5), grasps.MASSES_G, grasps.SHAPES)
    ]
    return f"{sum(case['held'] for case in cases)} of {len(cases)} held ([grasps](docs/grasps.md))"


def kinematics() -> str:
    found = inverse_kinematics.reachable(Arm(find_arm("ur5e")), 1000, np.random.default_rng(0))
    return f"{found['solved']} solved, median {found['median_ms']:.2f} ms"


ROWS: Final[dict[str, tuple[str, str, Callable[[], str]]]] = {
    "speed": ("reference scenario, from the command to the prompt", "real_time.py ur5e_hexagon_arm", speed),
    "examples": ("the paper's examples at true equilibrium", "paper_examples.py", examples),
    "targets": ("50 tip targets, flange tilted up to 90 degrees", "tip_targets.py", targets),
    "heights": ("200 tip heights of 30 designs", "tip_heights.py", heights),
    "grasps": ("75 grasps, 20 to 300 g, default fingers", "grasps.py", held),
    "kinematics": ("inverse kinematics, 1,000 poses", "inverse_kinematics.py", kinematics),
}
"""Name of a row: what is measured, the script that prints more of it, and its figure."""


def kept(page: Path) -> dict[str, str]:
    """Return the figures that stand in README's table, by what is measured."""
    lines = page.read_text(encoding="utf-8").partition(f"<!-- {TABLE}:")[2].splitlines()
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return {row[0]: row[1] for row in cells if len(row) == 3}


def main(names: list[str]) -> None:
    """Measure rows, and write the table."""
    page, lines = ROOT / "README.md", ["| what | figure | command |", "|---|---|---|"]
    before = kept(page)
    for name, (what, script, measured) in ROWS.items():
        figure = measured() if not names or name in names else before.get(what, "")
        lines.append(f"| {what} | {figure} | `python benchmarks/{script}` |")
        print(lines[-1], flush=True)
    put_table(page, TABLE, "\n".join(lines))


if __name__ == "__main__":
    unknown = set(sys.argv[1:]) - set(ROWS)
    if unknown:
        raise SystemExit(f"no rows {', '.join(sorted(unknown))}; there are {', '.join(ROWS)}")
    main(sys.argv[1:])
