"""How far is each mesh from the truth: extension, potential and stability against refinement and film law.

    python benchmarks/mesh_study.py [--json FILE] [--plot FILE] [--markdown FILE] [--levels 3] [--quick]

Specimens as in the finite-element reference: open end holes, first hole ring held, nodes on the two vertical
planes of symmetry free to slide in them, all others free, no weight, seam without hinge, film bending as a
discrete shell. Reference values:
tests/reference/finite_elements.json.
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

import numpy as np

from benchmarks.measure.stability import PerturbationOptions, find_lower_state, negative_pivots
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.frame_ring import FrameRings
from cosim.soft.elements.material import Film
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.soft.solve.compilation import compile_kernels
from cosim.verification.support.open_specimen import OpenSpecimen, film_stack

REFERENCE = Path(__file__).resolve().parents[1] / "tests/reference/finite_elements.json"
PRESSURES_KPA = (2.0, 5.0, 10.0, 20.0, 40.0)
SPECIMENS = {
    "three square units": PolygonalStack(
        4, 3, 0.03 * 2**0.5, 0.002 * 2**0.5, 0.002, ring_heights=(0.2, 0.5, 0.8)
    ),
    "one hexagonal unit": PolygonalStack(6, 1, 0.05, 0.01, 0.002),
}
VARIANTS = (("plain", False), ("tension_field", False), ("plain", True))
FRAME_STIFFNESS_N_M = 1e6
FRACTIONS = (0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4)  # the last one keeps slack triangles from collapsing
STEPS_KPA = (0.1, 0.25, 0.5, 1.0, *PRESSURES_KPA)


def specimen(stack: PolygonalStack, level: int, fraction: float, framed: bool) -> SoftBody:
    """Return the body of a specimen; fraction 1 is the plain law, 0 the tension field."""
    body = film_stack(stack, level, Film(1.3e9, 0.2, 0.11e-3, "tension_field", fraction))
    if not framed:
        return body
    rims = np.stack([ring for name, ring in body.rings.items() if name.endswith(".outer")])
    return body.with_elements(FrameRings.from_shape(body.positions, rims, FRAME_STIFFNESS_N_M))


def study(name: str, level: int, law: str, framed: bool, lower: bool) -> list[dict[str, Any]]:
    """Return the rows of one specimen, level and law."""
    stack, rows = SPECIMENS[name], []
    key = {"specimen": name, "level": level, "law": law, "framed": framed}
    began = time.process_time()
    sample = OpenSpecimen(specimen(stack, level, 1.0, framed))
    for pressure in STEPS_KPA:
        try:
            if law == "tension_field" and pressure == PRESSURES_KPA[0]:
                sample = _softened(sample, stack, level, framed, 1e3 * pressure)
            here = sample.load_to(1e3 * pressure)
        except ConvergenceError as error:
            rows.append({**key, "pressure_kPa": pressure, "failed": str(error)})
            print(f"{name:<18} {law:<14} refine {level} {pressure:>5g} kPa  {error}", flush=True)
            break
        if pressure not in PRESSURES_KPA:
            continue
        row = {
            **key, "pressure_kPa": pressure,
            "triangles": len(sample.body.triangles),
            "extension_mm": 1e3 * sample.extension_m, "potential_mJ": 1e3 * here.potential_J,
            "negative_pivots": negative_pivots(sample.newton, here),
            "iterations": sample.iterations, "cpu_s": time.process_time() - began,
        }  # fmt: skip
        if lower:
            found = find_lower_state(sample.solver, here, PerturbationOptions(5e-4, 3))
            kept, sample.here = sample.here, found
            row |= {
                "lower_extension_mm": 1e3 * sample.extension_m,
                "lower_potential_mJ": 1e3 * found.potential_J,
            }
            sample.here = kept
        rows.append(row)
        print(_line(row), flush=True)
    return rows


def _softened(
    sample: OpenSpecimen, stack: PolygonalStack, level: int, framed: bool, pressure_Pa: float
) -> OpenSpecimen:
    """Return the specimen with the tension-field law, led there by taking compressive stiffness away."""
    for fraction in FRACTIONS:
        here = sample.load_to(pressure_Pa)
        sample, spent = OpenSpecimen(specimen(stack, level, fraction, framed)), sample.iterations
        sample.here, sample.iterations = here, spent
    return sample


def _line(row: dict[str, Any]) -> str:
    frame = "framed" if row["framed"] else ""
    text = (
        f"{row['specimen']:<18} {frame:<6} {row['law']:<13} refine {row['level']} "
        f"{row['pressure_kPa']:>5g} kPa  {row['extension_mm']:7.2f} mm  {row['potential_mJ']:10.2f} mJ  "
        f"{row['negative_pivots']:>3} negative  {row['iterations']:>5} iterations  {row['cpu_s']:7.1f} s"
    )
    if "lower_extension_mm" in row:
        text += f"   lower state {row['lower_extension_mm']:.2f} mm {row['lower_potential_mJ']:.2f} mJ"
    return text


def _label(law: str, framed: bool, level: int) -> str:
    return f"{'framed, ' if framed else ''}{law.replace('_', ' ')}, refine {level}"


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw extension against pressure, one panel a specimen, with the finite-element values."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    reference = json.loads(REFERENCE.read_text())
    names = list(dict.fromkeys(row["specimen"] for row in rows))
    figure, axes = pyplot.subplots(1, len(names), figsize=(5.0 * len(names), 4.2), squeeze=False)
    colours = ("#3b528b", "#21918c", "#5ec962", "#d8b41f")
    for axis, name in zip(axes[0], names, strict=True):
        for (law, framed), style in zip(VARIANTS, ("-", "--", ":"), strict=True):
            for level in range(4):
                key = (name, law, framed, level)
                mine = [r for r in rows if (r["specimen"], r["law"], r["framed"], r["level"]) == key]
                mine = [r for r in mine if "extension_mm" in r]
                if mine:
                    axis.plot(
                        [r["pressure_kPa"] for r in mine], [r["extension_mm"] for r in mine], style,
                        color=colours[level], marker="o", markersize=3, label=_label(law, framed, level),
                    )  # fmt: skip
        for point in reference.get(name, []):
            axis.errorbar(
                point["pressure_kPa"], point["extension_mm"], point["uncertainty_mm"], fmt="ks", capsize=4,
                label=None if point is not reference[name][0] else "finite elements",
            )  # fmt: skip
        axis.set(title=name, xlabel="pressure [kPa]", ylabel="extension [mm]")
        axis.grid(alpha=0.3)
    axes[0][0].legend(fontsize=7, loc="upper left", bbox_to_anchor=(2.35, 1.0))
    figure.tight_layout()
    figure.savefig(path, dpi=130, bbox_inches="tight")


def table(rows: list[dict[str, Any]]) -> str:
    """Return the extensions [mm] as Markdown, one row a specimen, variant and refinement."""
    head = "| specimen | film | refine | triangles | " + " | ".join(f"{p:g} kPa" for p in PRESSURES_KPA)
    lines = [head + " | CPU s |", "|---" * (5 + len(PRESSURES_KPA)) + "|"]
    groups = dict.fromkeys((r["specimen"], r["law"], r["framed"], r["level"]) for r in rows)
    for name, law, framed, level in groups:
        mine = [
            r
            for r in rows
            if (r["specimen"], r["law"], r["framed"], r["level"]) == (name, law, framed, level)
        ]
        mine = [r for r in mine if "extension_mm" in r]
        if not mine:
            continue
        values = {r["pressure_kPa"]: _cell(r) for r in mine}
        cells = " | ".join(values.get(p, "no equilibrium") for p in PRESSURES_KPA)
        film = f"{'framed, ' if framed else ''}{law.replace('_', ' ')}"
        lines.append(
            f"| {name} | {film} | {level} | {mine[0]['triangles']} | {cells} | {mine[-1]['cpu_s']:.1f} |"
        )
    return "\n".join(lines) + "\n"


def _cell(row: dict[str, Any]) -> str:
    text = f"{row['extension_mm']:.1f}"
    lower = row.get("lower_potential_mJ", row["potential_mJ"])
    if lower < row["potential_mJ"] - 0.05:
        text += f" ({row['lower_extension_mm']:.1f} at {lower - row['potential_mJ']:+.0f} mJ)"
    if row["negative_pivots"]:
        text += f" [{row['negative_pivots']} negative]"
    return text


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--levels", type=int, default=3, help="finest refinement")
    parser.add_argument("--quick", action="store_true", help="no search for lower states")
    options = parser.parse_args()
    compile_kernels(print)
    rows: list[dict[str, Any]] = []
    for name in SPECIMENS:
        for law, framed in VARIANTS:
            for level in range(options.levels + 1):
                rows += study(name, level, law, framed, lower=level < 3 and not options.quick)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    if options.markdown:
        options.markdown.write_text(table(rows))
    if options.plot:
        plot(rows, options.plot)


if __name__ == "__main__":
    main()
