"""How well values are found again: without noise, and how often 95 % intervals hold the truth with noise.

    python benchmarks/identify.py [exact] [linearised] [whole] [refined] [--repeats 1000] [--whole 100]

Parts that are not named are left out; without a name all are run, some 6 minutes of one core.

Four curves of three square units are made by the model itself at known values: length and volume over
pressure, deflection over load, bending angle over tension. Looked for are the moduli of film and frames, and
the tension that a cable keeps at an eyelet. Noise is 1 % of each range, seeds from 0 on. `linearised` repeats
the fit linearised at the truth, by its exact Jacobian: 1 % of noise moves it little. `whole` repeats all of
`cosim identify` with the same noise, with its outliers and profile likelihood, and compares. `refined`: a
second set of curves is made on a mesh that is refined twice (16 times the triangles), every fourth row held
out; it is fitted with volumes as they are, and with their changes, which fits an offset of the volume.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Sequence
from contextlib import chdir
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from cosim.bench.equilibria import Curves
from cosim.bench.fitting import Fit, identify, spread_of
from cosim.bench.page import series_lines, value_lines
from cosim.config.benches import BenchTable, Series, load_bench

TRUE = {
    "soft_robot.film.young_modulus_Pa": (1.3e9, 0.9e9),
    "soft_robot.stiffener.young_modulus_Pa": (1.7e9, 2.2e9),
    "soft_robot.cable.corner_0.capstan_factor": (0.86, 0.75),
}
"""By key: the truth, and where the search begins."""
TRUTH = np.array([true for true, _ in TRUE.values()])
PARTS = ("exact", "linearised", "whole", "refined")
NOISE = 0.01  # of a curve's range
HEAD = """
scenario = "bending_angle"
[set]
model.published = false
contact.self_contact = false
"""
DRAWN = 'soft_robot.stack.mesh = "drawn"\n'  # the paper's coarse mesh: a fit is made a hundred times
CURVES = {
    "extension": ("length_m", "length_m", 'loads.pressure_Pa = "load_Pa"', (3e3, 12e3), "Pa"),
    "volume": ("volume_m3", "volume_m3", 'loads.pressure_Pa = "load_Pa"', (3e3, 12e3), "Pa"),
    "deflection": (
        "tip_position_m.x", "tip_m", 'loads = { pressure_Pa = 8e3, "force_N.unit_3.outer.x" = "load_N" }',
        (0.1, 0.4), "N",
    ),
    "angle": (
        "bending_angle_rad", "angle_rad",
        'loads = { pressure_Pa = 8e3, "cable_tension_N.corner_0" = "load_N" }', (0.2, 0.8), "N",
    ),
}  # fmt: skip


def made(
    folder: Path, rows: int = 4, refine: int = 0, hold_out: int = 0
) -> tuple[BenchTable, tuple[Series, ...]]:
    """Return the bench with curves of its model at the true values.

    Args:
        folder: that files are written to.
        rows: of each curve.
        refine: how often each triangle is divided into four where curves are made, not where they are fitted.
        hold_out: see `SeriesTable`.
    """
    text = [HEAD if refine else HEAD + DRAWN]
    for key, (true, start) in TRUE.items():
        high = min(3.0 * true, 1.0) if true < 1.0 else 3.0 * true
        also = '\nalso = ["soft_robot.cable.corner_1.capstan_factor"]' if "cable" in key else ""
        text.append(
            f'[[parameter]]\nkey = "{key}"{also}\nlow = {0.3 * true}\nhigh = {high}\nstart = {start}\n'
        )
    for name, (quantity, column, loads, ends, unit) in CURVES.items():
        lines = "\n".join(f"{load!r},{k + 1.0}" for k, load in enumerate(np.linspace(*ends, rows).tolist()))
        (folder / f"{name}.csv").write_text(f"load_{unit},{column}\n{lines}\n")
        text.append(
            f'[[series]]\nname = "{name}"\nfile = "{name}.csv"\nquantity = "{quantity}"\n'
            f'measured = "{column}"\n{loads}\nnoise = 1.0\nhold_out = {hold_out}\n'
        )
    (folder / "bench.toml").write_text("\n".join(text))
    bench, series = load_bench(folder / "bench.toml")
    maker = replace(bench, set={**bench.set, "soft_robot.stack.refine": refine}) if refine else bench
    values = Curves(maker, series).at(np.array([true for true, _ in TRUE.values()]))
    parts = np.split(values, np.cumsum([len(entry.values) for entry in series])[:-1])
    return bench, tuple(
        replace(entry, values=tuple(own.tolist()), noise=NOISE * float(np.ptp(own)))
        for entry, own in zip(series, parts, strict=True)
    )


def noisy(series: Sequence[Series], seed: int) -> tuple[Series, ...]:
    """Return the curves with noise."""
    random = np.random.default_rng(seed)
    return tuple(
        replace(
            entry,
            values=tuple(
                (np.array(entry.values) + random.normal(0.0, entry.noise, len(entry.values))).tolist()
            ),
        )
        for entry in series
    )


def linearised(fit: Fit, truth: np.ndarray, repeats: int) -> tuple[np.ndarray, np.ndarray]:
    """Return steps off the truth (repeats, values), by logarithms, and whether intervals hold it, the same.

    Args:
        fit: of curves without noise.
        truth: (values,).
        repeats: seeds from 0.
    """
    best = fit.fitted(truth)
    fit.predicted(best)
    jacobian = fit.jacobian(best)
    known = np.linalg.inv(jacobian.T @ jacobian)
    steps, inside = [], []
    for seed in range(repeats):
        noise = np.random.default_rng(seed).normal(size=len(jacobian))
        step = known @ jacobian.T @ noise
        spread = spread_of(float(((noise - jacobian @ step) ** 2).sum()), len(noise) - len(step))
        steps.append(step)
        inside.append(np.abs(step) <= np.sqrt(3.841458820694124 * spread * np.diag(known)))
    return np.array(steps), np.array(inside)


def without_noise(folder: Path) -> dict[str, Any]:
    """Print how far values without noise are off."""
    found = identify(*made(folder)).found
    off = {
        key: float(each.value / true - 1.0)
        for (key, (true, _)), each in zip(TRUE.items(), found, strict=True)
    }
    print(f"without noise, relative: {off}", flush=True)
    return off


def counted(inside: np.ndarray, what: str) -> dict[str, Any]:
    """Print how often intervals hold the truth, of all and of each hundred."""
    held = dict(zip(TRUE, inside.sum(axis=0).tolist(), strict=True))
    print(f"{what}: the truth is inside, of {len(inside)}: {held}", flush=True)
    hundreds = inside[: len(inside) // 100 * 100].reshape(-1, 100, len(TRUE)).sum(axis=1)
    if len(hundreds) > 1:
        good = int(((hundreds >= 90) & (hundreds <= 98)).sum())
        print(f"  by hundreds: {hundreds.T.tolist()}; {good} of {hundreds.size} from 90 to 98", flush=True)
    return {"held": held, "repeats": len(inside), "by_hundreds": hundreds.tolist()}


def whole(bench: BenchTable, series: tuple[Series, ...], repeats: int) -> dict[str, Any]:
    """Print how often the intervals of whole fits hold the truth, and how near the linearised fit is."""
    step, linear = linearised(Fit(bench, series), TRUTH, repeats)
    inside, off = [], []
    for seed in range(repeats):
        found = identify(bench, noisy(series, seed)).found
        inside.append([each.low <= true <= each.high for each, true in zip(found, TRUTH, strict=True)])
        off.append(np.log([each.value for each in found] / TRUTH) - step[seed])
        if seed % 10 == 9:
            print(f"  {seed + 1} whole fits, inside {np.sum(inside, axis=0).tolist()}", flush=True)
    away = float(np.abs(np.array(off) / step.std(axis=0)).max())
    agree = int((linear == np.array(inside)).sum())
    print(f"{agree} of {linear.size} intervals say the same as the linearised fit's", flush=True)
    print(f"values differ by {away:.3g} standard deviations at most", flush=True)
    return {**counted(np.array(inside), "whole fits"), "agree": agree, "off_over_sd": away}


def of_finer_film(folder: Path) -> dict[str, Any]:
    """Print how well curves of a finer film are met, and what the report says of them."""
    report, (bench, series) = dict[str, Any](), made(folder, 8, 2, 4)
    for changes in ((), ("volume",)):
        given = tuple(
            replace(each, table=replace(each.table, relative=each.table.name in changes)) for each in series
        )
        fine = identify(bench, given, force=True)
        lines = [*fine.check.lines(), *value_lines(fine), *series_lines(fine)]
        words = f"changes of {' and '.join(changes)}" if changes else "all as they are"
        print("\n".join([f"curves of the film refined twice, {words}:", *lines]), flush=True)
        report[words] = lines
    return report


def main() -> None:
    """Print the parts that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=[], metavar="part")
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--whole", type=int, default=100)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    target = None if options.json is None else options.json.resolve()
    report, parts = dict[str, Any](), options.parts or PARTS
    with TemporaryDirectory() as name, chdir(name):
        folder, began = Path(name), time.process_time()
        if "exact" in parts:
            report["exact"] = without_noise(folder)
        bench, series = made(folder)
        if "linearised" in parts:
            _, inside = linearised(Fit(bench, series), TRUTH, options.repeats)
            report["linearised"] = counted(inside, "linearised fits")
        if "whole" in parts:
            report["whole"] = whole(bench, series, options.whole)
        if "refined" in parts:
            report["refined"] = of_finer_film(folder)
        print(f"CPU time {time.process_time() - began:.0f} s")
    if target is not None:
        target.write_text(json.dumps(report, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
