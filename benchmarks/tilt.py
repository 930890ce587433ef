"""How stiff are the necks of a unit: moment over angle of its upper hole ring, against the mesh.

    python benchmarks/tilt.py [--law plain] [--framed] [--hexagon] [--fused 0 5 8] [--pressures 10 30]

One square unit of film 0.11 mm thick, open ends, film bending as a discrete shell, seam without hinge, as the
finite elements of tests/reference have it. It is inflated to the highest pressure, straight, with its upper
ring free to rise; there, and on the way back, that ring is turned by 1 degree about a horizontal axis through
its centre, at the height and place it has.
Meshes are named by `refine` and `refine_holes`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))


from cosim.build.kernel_modules import compile_kernels
from cosim.build.soft_body import build_soft_body
from cosim.config.schema.film import FilmTable, NeckTable, StackTable
from cosim.config.schema.scenario import ModelTable
from cosim.config.schema.soft_robot import HingeTable, MassTable, SoftRobotTable, StiffenerTable
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.verification.stacks import OpenSpecimen, tilt_stiffness

FRAME_STIFFNESS_N_M = 1e6
STEPS_KPA = (
    0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 6.0, 7.0, 8.0, 10.0, 12.0, 15.0, 20.0, 25.0, 30.0,
)  # fmt: skip
LEAST_KPA = 5.0
SQUARE: dict[str, Any] = {
    "sides": 4, "corner_radius_m": 0.03 * 2**0.5, "hole_radius_m": 0.002 * 2**0.5,
    "ring_heights": (0.2, 0.5, 0.8),
}  # fmt: skip
HEXAGON: dict[str, Any] = {
    "sides": 6, "corner_radius_m": 0.05, "hole_radius_m": 0.01, "ring_heights": (0.25, 0.5, 0.75),
}  # fmt: skip
MESHES = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (2, 0))


def unit(
    refine: int,
    holes: int,
    fused_radius_m: float = 0.0,
    law: str = "plain",
    framed: bool = False,
    hexagon: bool = False,
) -> SoftBody:
    """Return the body of one unit.

    Args:
        refine: how often every triangle is cut.
        holes: how often those at the holes are, before.
        fused_radius_m: within which films are fused; 0 for none.
        law: of the film.
        framed: whether a stiff frame holds the seam.
        hexagon: whether it is the first unit of the hexagonal arm, else a square one.
    """
    stack = StackTable(
        **(HEXAGON if hexagon else SQUARE), units=1, unit_height_m=0.002, refine=refine, refine_holes=holes,
        neck=NeckTable(fused_radius_m) if fused_radius_m else None,
    )  # fmt: skip
    film: Any = {"young_modulus_Pa": 1.3e9, "poisson_ratio": 0.2, "thickness_m": 0.11e-3, "law": law}
    robot = SoftRobotTable(
        name="unit", source="tilt", stack=stack, film=FilmTable(**film),
        hinge=HingeTable(rule="shell"), mass=MassTable(1e-3),
        stiffener=StiffenerTable("stiff" if framed else "none", FRAME_STIFFNESS_N_M),
    )  # fmt: skip
    return build_soft_body(robot, ModelTable())


def study(mesh: tuple[int, int], fused_mm: float, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Return the rows of one mesh, pressure by pressure."""
    refine, holes = mesh
    a = arguments
    sample = OpenSpecimen(unit(refine, holes, 1e-3 * fused_mm, a.law, a.framed, a.hexagon))
    rows, began = [], time.process_time()
    key = {"refine": refine, "refine_holes": holes, "fused_mm": fused_mm}
    highest = max(arguments.pressures)
    upwards = [step for step in STEPS_KPA if step < highest]
    downwards = sorted({highest, *upwards[upwards.index(LEAST_KPA) :], *arguments.pressures}, reverse=True)
    for place, pressure in enumerate((*upwards, *downwards)):
        try:
            sample.load_to(1e3 * pressure)
            if place < len(upwards) or pressure not in arguments.pressures:
                continue
            stiffness = 1e3 * tilt_stiffness(sample)
        except ConvergenceError as error:
            print(f"{key} {pressure:g} kPa: {error}", flush=True)
            break
        row = {
            **key, "pressure_kPa": pressure, "triangles": len(sample.body.triangles),
            "extension_mm": 1e3 * sample.extension_m, "tilt_mNm_rad": stiffness,
            "cpu_s": time.process_time() - began,
        }  # fmt: skip
        rows.append(row)
        print(
            f"refine {refine} holes {holes} fused {fused_mm:>4g} mm  {row['triangles']:>5} triangles "
            f"{pressure:>4g} kPa  {row['extension_mm']:6.2f} mm  {stiffness:7.1f} mN m/rad "
            f"{row['cpu_s']:6.1f} s",
            flush=True,
        )
    return rows


def main() -> None:
    """Print tilt stiffness of every mesh; write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--law", default="plain")
    parser.add_argument("--framed", action="store_true")
    parser.add_argument("--hexagon", action="store_true")
    parser.add_argument("--fused", type=float, nargs="+", default=[0.0], metavar="MM")
    parser.add_argument("--pressures", type=float, nargs="+", default=[10.0, 30.0], metavar="KPA")
    parser.add_argument(
        "--meshes", nargs="+", metavar="REFINE,HOLES", default=[f"{r},{h}" for r, h in MESHES]
    )
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    compile_kernels()
    rows = []
    for text in arguments.meshes:
        refine, holes = map(int, text.split(","))
        for fused in arguments.fused:
            if holes or not fused:
                rows += study((refine, holes), fused, arguments)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
