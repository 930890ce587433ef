"""Extension of soft units against finite elements, by film law and refinement: error, volume, iterations.

    python benchmarks/film_extension.py [--levels 2] [--laws plain wrinkling] [--units NAME ...]
        [--json FILE] [--markdown FILE] [--plot FILE]

Specimens and bands of the finite elements are those of `cosim verify`; an error is from the nearer edge of
the band, with an exclamation mark where it is larger than the law shall have. Then three square units at
10 kPa are pulled and pushed along their axis by up to 10 N, newton by newton.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cosim.base.frames import Pose
from cosim.build.kernel_modules import compile_kernels
from cosim.errors import ConvergenceError
from cosim.soft.elements.material import FilmLaw
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.verification.stacks import (
    FILM,
    FIVE_HEXAGONS_BANDS,
    ONE_SQUARE_BANDS,
    TEN_SQUARES_BANDS,
    THREE_SQUARES_BANDS,
    Band,
    OpenSpecimen,
    film_stack,
    squares,
)

SPECIMENS: dict[str, tuple[PolygonalStack, tuple[Band, ...]]] = {
    "one_square": (squares(1), ONE_SQUARE_BANDS),
    "three_squares": (squares(3), THREE_SQUARES_BANDS),
    "five_hexagons": (PolygonalStack(6, 5, 0.05, 0.01, 0.002, 0.95), FIVE_HEXAGONS_BANDS),
    "ten_squares": (squares(10, 0.005), TEN_SQUARES_BANDS),
}
PATH_KPA = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
SHOWN_KPA = (0.5, 2.0, 5.0, 10.0, 20.0, 40.0)
PUSH_KPA = 10.0
PUSH_N = (*range(1, 11), *range(9, -11, -1), *range(-9, 1))
FOLDED, SNAPPING = 0.07, 0.15
"""Largest error from 10 kPa on, and below, where films snap."""


def inflated(name: str, law: FilmLaw, level: int) -> dict[str, Any]:
    """Return extensions, errors, volumes and Newton's iterations along the path of pressures."""
    stack, bands = SPECIMENS[name]
    at = {f"{1e-3 * band.pressure_Pa:g}": band for band in bands}
    began = time.process_time()
    sample = OpenSpecimen(film_stack(stack, level, replace(FILM, law=law)))
    row: dict[str, Any] = {"specimen": name, "law": law, "level": level}
    row |= {"extension_mm": {}, "error": {}, "volume_ml": {}}
    for pressure in PATH_KPA:
        try:
            sample.load_to(1e3 * pressure)
        except ConvergenceError as error:
            row["failed"] = f"{pressure:g} kPa: {error}"
            break
        key, extension = f"{pressure:g}", sample.extension_m
        row["extension_mm"][key] = 1e3 * extension
        row["volume_ml"][key] = 1e6 * sample.volume_m3
        if key in at:
            nearest = min(max(extension, at[key].low_m), at[key].high_m)
            row["error"][key] = extension / nearest - 1.0
    return {**row, "iterations": sample.iterations, "cpu_s": time.process_time() - began}


def pushed(law: FilmLaw, level: int) -> dict[str, Any]:
    """Return heights and Newton's iterations of a pull and a push along the axis."""
    sample = OpenSpecimen(film_stack(squares(3), level, replace(FILM, law=law)))
    for pressure in (p for p in PATH_KPA if p <= PUSH_KPA):
        sample.load_to(1e3 * pressure)
    assert sample.here is not None
    state, iterations, heights = sample.here.state, 0, []
    for force in PUSH_N:
        loads = sample.loads(1e3 * PUSH_KPA, state.positions)
        assert loads.nodal_force is not None
        nodal = loads.nodal_force.copy()
        nodal[sample.body.tip, 2] += force / len(sample.body.tip)
        try:
            found = sample.solver.solve(state, Pose(), replace(loads, nodal_force=nodal))
        except ConvergenceError as error:
            return {"law": law, "level": level, "failed": f"{force:g} N: {error}"}
        state, iterations = found.state, iterations + found.iterations
        heights.append(1e3 * float(sample.body.tip_position(state.positions)[2]))
    return {"law": law, "level": level, "iterations": iterations, "height_mm": heights}


def line(row: dict[str, Any]) -> str:
    """Return a row of the table."""
    cells = []
    for pressure in SHOWN_KPA:
        key = f"{pressure:g}"
        if key not in row["extension_mm"]:
            cells.append(f"{'no equilibrium':>16}")
            continue
        mark = ""
        if key in row["error"]:
            error = row["error"][key]
            large = abs(error) > (FOLDED if pressure >= 10.0 else SNAPPING)
            mark = f"{100.0 * error:+.1f}%{'!' if large else ''}"
        cells.append(f"{row['extension_mm'][key]:7.1f}{mark:>9}")
    volume = row["volume_ml"].get(f"{PUSH_KPA:g}", float("nan"))
    return (
        f"{row['specimen']:<15}{row['law']:<10} {row['level']}{''.join(cells)}{volume:9.1f}"
        f"{row['iterations']:>7}{row['cpu_s']:>7.1f}"
    )


def bands_line(name: str) -> str:
    """Return the row of the finite elements."""
    at = {1e-3 * band.pressure_Pa: band for band in SPECIMENS[name][1]}
    cells = []
    for pressure in SHOWN_KPA:
        band = at.get(pressure)
        cells.append(f"{f'{1e3 * band.low_m:.1f} to {1e3 * band.high_m:.1f}' if band else '':>16}")
    return f"{name:<15}{'FE':<12}{''.join(cells)}"


def _bands(name: str, pressures_kPa: Sequence[float]) -> list[Band | None]:
    """Return the bands of a specimen at pressures; None where there is none."""
    at = {round(1e-3 * band.pressure_Pa, 3): band for band in SPECIMENS[name][1]}
    return [at.get(pressure) for pressure in pressures_kPa]


def table(rows: list[dict[str, Any]]) -> str:
    """Return extensions [mm] and errors as Markdown."""
    heads = ["specimen", "film", "refine", *(f"{p:g} kPa" for p in SHOWN_KPA), "ml at 10 kPa", "iterations"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for name in dict.fromkeys(row["specimen"] for row in rows):
        texts = [f"{1e3 * b.low_m:.1f} to {1e3 * b.high_m:.1f}" if b else "" for b in _bands(name, SHOWN_KPA)]
        lines.append("| " + " | ".join([_words(name), "finite elements", "", *texts, "", ""]) + " |")
        for row in (row for row in rows if row["specimen"] == name):
            cells = []
            for key in (f"{p:g}" for p in SHOWN_KPA):
                error = row["error"].get(key)
                text = f"{row['extension_mm'][key]:.1f}" if key in row["extension_mm"] else "no equilibrium"
                cells.append(text if error is None else f"{text} ({100.0 * error:+.0f} %)")
            volume = f"{row['volume_ml'].get(f'{PUSH_KPA:g}', float('nan')):.1f}"
            first = ["", row["law"], str(row["level"])]
            lines.append("| " + " | ".join([*first, *cells, volume, str(row["iterations"])]) + " |")
    return "\n".join(lines) + "\n"


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw extension against pressure, one panel a specimen, with the bands of the finite elements."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    names = list(dict.fromkeys(row["specimen"] for row in rows))
    figure, axes = pyplot.subplots(1, len(names), figsize=(3.6 * len(names), 3.8), squeeze=False)
    for axis, name in zip(axes[0], names, strict=True):
        for row in (row for row in rows if row["specimen"] == name):
            pressures = [float(key) for key in row["extension_mm"]]
            style = {"plain": "--", "wrinkling": "-"}.get(row["law"], ":")
            axis.plot(
                pressures, list(row["extension_mm"].values()), style, marker="o", markersize=3,
                color=("#3b528b", "#21918c", "#d8b41f")[row["level"] % 3],
                label=f"{row['law']}, refine {row['level']}",
            )  # fmt: skip
        for band in SPECIMENS[name][1]:
            axis.plot(
                [1e-3 * band.pressure_Pa] * 2, [1e3 * band.low_m, 1e3 * band.high_m], "k_-", linewidth=2.5,
                label=None if band is not SPECIMENS[name][1][0] else "finite elements",
            )  # fmt: skip
        axis.set(title=_words(name), xlabel="pressure [kPa]", xscale="log", ylabel="extension [mm]")
        axis.grid(alpha=0.3)
    axes[0][0].legend(fontsize=6, loc="upper left")
    figure.tight_layout()
    figure.savefig(path, dpi=110)


def _words(name: str) -> str:
    return name.replace("_", " ")


def main() -> None:
    """Measure, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--levels", type=int, default=2, help="finest refinement")
    parser.add_argument("--laws", nargs="+", default=["plain", "wrinkling"])
    parser.add_argument("--units", nargs="+", default=list(SPECIMENS), choices=list(SPECIMENS))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--markdown", type=Path)
    parser.add_argument("--plot", type=Path)
    options = parser.parse_args()
    compile_kernels(print)
    head = "".join(f"{f'{p:g} kPa':>16}" for p in SHOWN_KPA)
    print(f"{'mm':<15}{'film, refine':<12}{head}  ml, 10 kPa, iterations, CPU s")
    rows = []
    for name in options.units:
        print(bands_line(name))
        for level in range(options.levels + 1):
            for law in options.laws:
                rows.append(inflated(name, law, level))
                print(line(rows[-1]), flush=True)
    if options.markdown:
        options.markdown.write_text(table(rows))
    if options.plot:
        plot(rows, options.plot)
    print("\niterations of a pull and a push by 10 N, three square units at 10 kPa")
    for level in range(min(options.levels, 1) + 1):
        for law in options.laws:
            rows.append(pushed(law, level))
            print(
                f"refine {level}  {law:<14}{rows[-1].get('iterations', rows[-1].get('failed'))}", flush=True
            )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
