"""A pouch sealed all round, pulled at its long seams, against the plane pouch motor: what its ends cost.

    python benchmarks/sealed_pouch.py [--degrees 30] [--edges 12]

The pouch is one length long between its seams and 1, 3 and 10 lengths wide. Its seams are held at the
distance L sin(angle) / angle. Printed: the pull per width over p L cos(angle) / angle, and volume over that
of the arcs.
Source of the plane answer: R. Niiyama et al., Pouch Motors, Soft Robotics 2 (2015) 59.
"""

from __future__ import annotations

import argparse
import math
import os
import sys
from dataclasses import replace
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from cosim.build.patterns import drawn_pattern
from cosim.config.schema.pattern import PatternSetTable, PatternTable
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.verification.case import UNLOADED, Specimen

LENGTH_m: Final = 0.1
PRESSURE_Pa: Final = 1000.0
FILM: Final = Film(0.5e9, 0.0, 1e-4, "tension_field", 1.0)
FRACTIONS: Final = (1.0, 0.1, 0.01, 1e-3)


def pouch(lengths: float, angle: float, edge_m: float) -> tuple[float, float]:
    """Return pull and volume over those of the plane answer."""
    x, y = 0.5 * LENGTH_m, 0.5 * LENGTH_m * lengths
    outline = ((-x, -y), (x, -y), (x, y), (-x, y))
    sets = (
        PatternSetTable("all", box_m=(outline[0], outline[2])),
        PatternSetTable("tip", box_m=(outline[0], outline[2])),
    )
    mesh = drawn_pattern(
        PatternTable(
            outline_m=outline, port_m=(0.013, 0.0), edge="sealed", plane="flat", mesh_m=edge_m, sets=sets
        ),
        "all",
    )
    flat = mesh.positions - mesh.positions.mean(axis=0)
    front, back = (np.unique(mesh.triangles[mesh.face_groups[name]]) for name in ("front", "back"))
    rim = np.intersect1d(front, back)
    seam = np.abs(np.abs(flat[:, 0]) - x) < 1e-9
    radius = x / angle
    turn = flat[:, 0] / radius
    end = np.clip((y - np.abs(flat[:, 1])) / (0.5 * LENGTH_m), 0.0, 1.0) ** 0.5
    dome = radius * (np.cos(turn) - math.cos(angle)) * end
    start = np.stack([radius * np.sin(turn), flat[:, 1], np.zeros(len(flat))], axis=1)
    start[seam, 0] = np.sign(flat[seam, 0]) * radius * math.sin(angle)
    start[front, 2], start[back, 2] = dome[front], -dome[back]
    start[rim, 2] = 0.0
    held = np.zeros_like(flat, dtype=bool)
    held[rim, 2] = True
    held[seam, 0] = True
    held[:, 1] = np.abs(flat[:, 1]) < 1e-9
    if not held[:, 1].any():
        held[np.abs(flat[:, 1]).argmin(), 1] = True
    options = NewtonOptions(tolerance_N=1e-4, iterations_max=5000, step_max_m=0.1 * x)
    for fraction in FRACTIONS:
        specimen = Specimen(
            SoftBody.from_arrays(flat, mesh.triangles, replace(FILM, compressive_fraction=fraction)),
            held,
            options,
        )
        found = specimen.solve(specimen.drawn(start), replace(UNLOADED, pressure_Pa=(PRESSURE_Pa,)))
        start = found.state.positions
    pull = float(specimen.gradient(found)[seam & (flat[:, 0] > 0.0), 0].sum())
    volume = float(specimen.system.gas.enclosed_volumes(start[None])[0, 0])
    plane = 0.5 * (angle - math.sin(angle) * math.cos(angle)) / angle**2
    width = 2.0 * y
    return (
        pull / (PRESSURE_Pa * LENGTH_m * width * math.cos(angle) / angle),
        volume / (width * LENGTH_m**2 * plane),
    )


def main() -> None:
    """Print a line for each width."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--degrees", type=float, default=30.0)
    parser.add_argument("--edges", type=int, default=12, help="to a length")
    parser.add_argument("--lengths", type=float, nargs="*", default=[1.0, 3.0, 10.0])
    given = parser.parse_args()
    for lengths in given.lengths:
        pull, volume = pouch(lengths, math.radians(given.degrees), LENGTH_m / given.edges)
        print(
            f"{lengths:g} lengths wide: pull {pull:.3f}, volume {volume:.3f} of the plane answer", flush=True
        )


if __name__ == "__main__":
    main()
