"""How far stacks of units extend with printed stiffeners of given sections, mesh by mesh.

    python benchmarks/stiffener_study.py [--json FILE] [--levels 2] [--tilt | --frames] [SECTION ...]
    python benchmarks/stiffener_study.py --shipped

A section is width x height in mm, such as 2x4, of 2 GPa, or of a plastic, such as TPU6x4; "none" is bare
film. Specimens as in the mesh study (open ends, kept upright), film with the wrinkling law. At the end of
each row: the largest strain of the stiffeners' fibres. With --tilt instead: the moment over the angle by
which the upper ring of one square unit is turned at its place. With --frames instead: lengths over stored
ones, refined (three squares at 10 kPa, the hexagonal arm in its scenario at 30 kPa); largest strain over that
at which the plastic yields, drawn / refined (squares at 40 kPa, the arm up to its turn); branchings of the
arm, drawn / refined; height of its turned tip, refined [mm]. With --shipped instead: lengths over stored ones
of `square_core` (10 kPa, open ends) and `ur5e_hexagon_arm` (30 kPa) as they come, frames and meshes included.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

from benchmarks.measure.stability import negative_pivots
from cosim import run
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario, to_table
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.errors import ConvergenceError
from cosim.soft.beams.beam_rings import BeamRings, RectangularSection, stiffener_strain
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.material import Film
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from tests.known_answers.stacks import OpenSpecimen, film_stack, squares, tilt_stiffness

PRESSURES_KPA = (2.0, 5.0, 10.0, 20.0, 40.0)
STEPS_KPA = (0.1, 0.25, 0.5, 1.0, 2.0, 3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 28.0, 40.0)
SPECIMENS = {
    "three squares": squares(3),
    "ten squares": squares(10),
    "five hexagons": PolygonalStack(6, 5, 0.05, 0.01, 0.002, 0.95),
}
SECTIONS = ("none", "1x1", "1.5x1.5", "2x2", "2.2x2.2", "3x3", "4x4", "1x4", "1.8x4", "3x4")
MODULUS_Pa = 2e9
FILM_m = 0.11e-3
PLASTICS = {"PLA": (2.3e9, 0.02), "PETG": (1.7e9, 0.051), "TPU": (26e6, 0.55)}
"""Modulus [Pa] and strain at yield, of the data sheets that docs/stiffeners.md names."""
FRAMES = (
    "PLA3x2.5", "PLA6x2", "PLA8x1.9", "PETG3x2.4", "PETG3x2.5", "PETG3.5x2.4", "PETG4x2.3", "PETG5x2.2",
    "PETG6x2.1", "PETG3.5x3",
)  # fmt: skip
_TILT_RAD = 4e-3


def specimen(stack: PolygonalStack, level: int, section: str) -> SoftBody:
    """Return a stack of wrinkling film with stiffeners of a section."""
    body = film_stack(stack, level, Film(1.3e9, 0.2, FILM_m, "wrinkling"))
    if section == "none":
        return body
    plastic, width, height = _section(section)
    rims = np.stack([ring for name, ring in body.rings.items() if name.endswith(".outer")])
    modulus = PLASTICS[plastic][0] if plastic else MODULUS_Pa
    beams = BeamRings.from_shape(body.positions, rims, RectangularSection(width, height, modulus))
    return body.with_elements(beams)


def _section(text: str) -> tuple[str, float, float]:
    """Return plastic, width and height [m] of a section such as TPU6x4."""
    size = text.lstrip("".join(PLASTICS))
    width, height = (1e-3 * float(side) for side in size.split("x"))
    return text.removesuffix(size), width, height


def study(name: str, level: int, section: str, pressures: Sequence[float] = PRESSURES_KPA) -> dict[str, Any]:
    """Return extension [mm], peak strain and negative pivots at each pressure [kPa] that was reached."""
    sample, began = OpenSpecimen(specimen(SPECIMENS[name], level, section)), time.process_time()
    row: dict[str, Any] = {"specimen": name, "section": section, "level": level}
    row |= {"extension_mm": [], "peak_strain": [], "negative_pivots": []}
    for pressure in sorted({*STEPS_KPA, *pressures}):
        if pressure > max(pressures):
            break
        try:
            here = sample.load_to(1e3 * pressure)
        except ConvergenceError as error:
            row["failed"] = f"{pressure:g} kPa: {error}"
            break
        if pressure in pressures:
            strain = stiffener_strain(sample.body, here.state.positions)
            row["extension_mm"].append(1e3 * sample.extension_m)
            row["peak_strain"].append(None if strain is None else strain.peak)
            row["negative_pivots"].append(negative_pivots(sample.newton, here))
    return row | {"iterations": sample.iterations, "cpu_s": time.process_time() - began}


def frame(section: str) -> list[str]:
    """Return the cells of a frame's row; see the table in docs/stiffeners.md."""
    plastic, width, height = _section(section)
    modulus, strength = PLASTICS[plastic]
    stored_m = height + 2.0 * FILM_m
    cores = [study("three squares", level, section, (10.0, 40.0)) for level in (0, 1)]
    core_m = 0.006 + 1e-3 * cores[1]["extension_mm"][0]
    shares = [core["peak_strain"][-1] / strength for core in cores]
    scenario = load_scenario("ur5e_hexagon_arm")
    phases = to_table(scenario)["phase"][: [phase.name for phase in scenario.phases].index("lift")]
    stiffener = {"width_m": width, "height_m": height, "young_modulus_Pa": modulus}
    changes: dict[str, Any] = {f"soft_robot.stiffener.{key}": value for key, value in stiffener.items()}
    changes["soft_robot.stack.mesh"] = "drawn"
    changes |= {"mode": "quasistatic", "phase": [{**phase, "increments": 30} for phase in phases]}
    arms = [
        run("ur5e_hexagon_arm", overrides={**changes, "soft_robot.stack.refine": level}) for level in (0, 1)
    ]
    peaks = [max(row["stiffener"]["peak_strain"] for row in arm.summary["phases"]) for arm in arms]
    branchings = [len(arm.summary["branchings"]) for arm in arms]
    inflated, turned = (float(arms[1].tip_position[arms[1].phase == row][-1, 2]) for row in (1, 2))
    arm_m = scenario.start.flange.position_m[2] - inflated
    return [
        f"{core_m / (3.0 * stored_m):.1f}", f"{arm_m / (10.0 * stored_m):.1f}",
        " / ".join(f"{share:.2f}" for share in shares),
        " / ".join(f"{peak / strength:.2f}" for peak in peaks),
        " / ".join(str(count) for count in branchings), f"{1e3 * turned:.0f}",
    ]  # fmt: skip


def shipped() -> list[tuple[str, float]]:
    """Return lengths over stored ones of the square core and the hexagonal arm as they come."""
    core = load_scenario("three_unit_inflation", {"model.published": False})
    assert isinstance(core.soft_robot, SoftRobotTable)
    assert core.soft_robot.stored_m is not None
    sample = OpenSpecimen(build_soft_body(core.soft_robot, core.model))
    for pressure in STEPS_KPA[: STEPS_KPA.index(10.0) + 1]:
        sample.load_to(1e3 * pressure)
    drawn_m = np.linalg.norm(sample.body.tip_position(sample.body.positions))
    scenario = load_scenario("ur5e_hexagon_arm")
    assert isinstance(scenario.soft_robot, SoftRobotTable)
    assert scenario.soft_robot.stored_m is not None
    phases = [{**phase, "increments": 30} for phase in to_table(scenario)["phase"][:2]]
    arm = run("ur5e_hexagon_arm", overrides={"mode": "quasistatic", "phase": phases})
    arm_m = scenario.start.flange.position_m[2] - float(arm.tip_position[-1, 2])
    return [
        ("square_core, 10 kPa", float(drawn_m + sample.extension_m) / core.soft_robot.stored_m),
        ("ur5e_hexagon_arm, 30 kPa", arm_m / scenario.soft_robot.stored_m),
    ]


def tilts(level: int, section: str) -> list[float]:
    """Return the moment over the angle [N m/rad] at 10 and 30 kPa."""
    sample, found = OpenSpecimen(specimen(squares(1), level, section)), []
    for pressure in (0.1, 0.5, 1.0, 2.0, 3.5, 5.0, 7.0, 10.0, 14.0, 20.0, 30.0):
        sample.load_to(1e3 * pressure)
        if pressure in (10.0, 30.0):
            found.append(tilt_stiffness(sample))
    return found


def line(row: dict[str, Any]) -> str:
    """Return a row of a Markdown table."""
    strains = [share for share in row["peak_strain"] if share is not None]
    cells = [f"{value:.1f}" for value in row["extension_mm"]]
    cells += ["-"] * (len(PRESSURES_KPA) - len(cells))
    peaks = " / ".join(f"{100.0 * share:.1f}" for share in strains) or "-"
    return f"| {row['specimen']} | {row['section']} | {row['level']} | {' | '.join(cells)} | {peaks} |"


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sections", nargs="*")
    parser.add_argument("--specimen", choices=SPECIMENS, action="append", help="all if omitted")
    parser.add_argument("--levels", type=int, default=2, help="how many meshes, the drawn one first")
    parser.add_argument("--tilt", action="store_true")
    parser.add_argument("--frames", action="store_true")
    parser.add_argument("--shipped", action="store_true")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.shipped:
        for name, ratio in shipped():
            print(f"| {name} | {ratio:.2f} |", flush=True)
        return
    rows: list[dict[str, Any]] = []
    sections = options.sections or (FRAMES if options.frames else SECTIONS)
    for section in sections if options.frames else ():
        print(f"| {section} | {' | '.join(frame(section))} |", flush=True)
    for section in sections if options.tilt else ():
        values = [tilts(level, section) for level in range(options.levels)]
        cells = [" / ".join(f"{1e3 * value:.0f}" for value in pair) for pair in values]
        print(f"| {section} | {' | '.join(cells)} |", flush=True)
    for name in () if options.tilt or options.frames else options.specimen or SPECIMENS:
        for section in sections:
            for level in range(options.levels):
                rows.append(study(name, level, section))
                print(line(rows[-1]), rows[-1].get("failed", ""), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
