"""Volume of a hydraulic pouch muscle: three welded pouches in a row beside two measured volumes.

    python benchmarks/pouch_volume.py

The muscle of a surgical robot by public code (class kineSolver: "hydraulic muscle") is 30 mm wide and
68.80 mm long when flat, 25 / (1 - 2 / pi), in three pouches. Full, cylinders would hold 15.07 ml in all.
The code has two ratios of real to that volume, a former one as 12.6195 / 15.066 (ml), a later one as 0.9024.
Its film, pressure and welds are not known, and nothing is fitted: the film hardly stretches. For comparison,
a bag of inextensible sheets with sides w <= h holds about
    V = w^3 (h / (pi w) - 0.142 (1 - 10^(-h / w)))
(A. C. Robin, Paper Bag Problem, Mathematics Today, June 2004, 104).
"""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import cosim

WIDTH_mm, POUCHES = 30.0, 3
LENGTH_mm: Final = 25.0 / (1.0 - 2.0 / math.pi)
INKSCAPE: Final = 'xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"'
MEASURED_ml: Final = {"former": 12.6195, "later": 0.9024 * 15.066}
PRESSURES_kPa: Final = (5.0, 20.0, 50.0)
FILM: Final = {"young_modulus_Pa": 2e9, "poisson_ratio": 0.3, "thickness_m": 0.05e-3, "density_kg_m3": 950.0}
"""Taken, not known: polymer film."""


def bag_ml() -> float:
    """Return the volume [ml] of three inextensible bags of the pouches' size."""
    w, h = LENGTH_mm / POUCHES, WIDTH_mm
    return 1e-3 * POUCHES * w**3 * (h / (math.pi * w) - 0.142 * (1.0 - 10.0 ** (-h / w)))


def drawing(pouches: int, passage_mm: float) -> str:
    """Return an SVG of pouches in a row, whose seams in between are open in the middle."""
    length, half = LENGTH_mm * pouches / POUCHES, WIDTH_mm / 2.0
    outline = f"M 0 0 H {WIDTH_mm} V {length} H 0 Z"
    seams = ""
    for k in range(1, pouches):
        y = length * k / pouches
        seams += f" M 0 {y} H {half - passage_mm / 2.0} M {half + passage_mm / 2.0} {y} H {WIDTH_mm}"
    lines = {
        "CUT": outline,
        "SEAL": seams,
        "PORT": f"M {half - 0.5} {0.4 * length / pouches} h 1 v 1 h -1 Z",
        "BASE": f"M {half - 3} {length - 1} H {half + 3} V {length} H {half - 3} Z",
        "TIP": f"M {half - 3} 0 H {half + 3}",
    }
    lines = {layer: d for layer, d in lines.items() if d}
    paths = "".join(
        f'<g inkscape:label="{layer}" id="{layer}"><path fill="none" d="{d}"/></g>'
        for layer, d in lines.items()
    )
    size = f'width="{WIDTH_mm}mm" height="{length}mm" viewBox="0 0 {WIDTH_mm} {length}"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" {INKSCAPE} {size}>{paths}</svg>'


def robot(folder: Path, pouches: int, edge_mm: float) -> Path:
    """Write a robot cut as drawn; return its file."""
    (folder / "pouch.svg").write_text(drawing(pouches, 3.0))
    film = "\n".join(f"{key} = {value}" for key, value in FILM.items())
    text = f"""schema = 2
name = "pouch"
source = "public code, see the benchmark"
base = ["base"]
[body]
kind = "pattern"
file = "pouch.svg"
edge = "sealed"
mesh_m = {1e-3 * edge_mm}
center = ["base", "tip"]
[[body.set]]
name = "base"
layer = "BASE"
[[body.set]]
name = "tip"
layer = "TIP"
[film]
law = "wrinkling"
{film}
[hinge]
rule = "shell"
"""
    path = folder / "pouch.toml"
    path.write_text(text)
    return path


def inflated(pouches: int, edge_mm: float) -> list[tuple[float, float, float]]:
    """Return pressure [kPa], volume of three pouches [ml] and contraction [%] of a row.

    Args:
        pouches: of the row, 1 or 3.
        edge_mm: of triangles.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        phases: list[dict[str, Any]] = [
            {"name": f"p{p:g}", "duration_s": 1.0, "increments": 10, "pressure_Pa": 1e3 * p}
            for p in PRESSURES_kPa
        ]
        changes = {
            "soft_robot": str(robot(folder, pouches, edge_mm)),
            "model.published": False, "gravity_m_s2": [0.0, 0.0, 0.0], "phase": phases,
            "contact.enabled": False, "contact.self_contact": False,
        }  # fmt: skip
        flat, found = 1e-3 * LENGTH_mm * pouches / POUCHES, []
        simulation = cosim.Simulation("three_unit_inflation", overrides=changes)
        for p in PRESSURES_kPa:
            film = simulation.step(ticks=10)
            volume = 1e6 * float(film.chamber_volume_m3.sum()) * POUCHES / pouches
            found.append((p, volume, 100.0 * (1.0 - film.center_line_m / flat)))
        return found


def main() -> int:
    """Print the table."""
    known = {**MEASURED_ml, "inextensible bag": bag_ml()}
    print(", ".join(f"{key} {value:.2f} ml" for key, value in known.items()))
    for pouches, edge_mm in ((1, 2.0), (1, 1.0), (3, 2.0)):
        for p, volume, short in inflated(pouches, edge_mm):
            off = ", ".join(f"{100.0 * (volume / value - 1.0):+.0f} %" for value in known.values())
            row = f"{pouches} in a row, edges {edge_mm} mm, {p:g} kPa: {volume:.2f} ml"
            print(f"{row} ({off}), {short:.1f} % shorter", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
