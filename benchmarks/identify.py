"""How well values are found again: without noise, and how often 95 % intervals hold the truth with noise.

    python benchmarks/identify.py [--repeats 1000] [--whole 5] [--json FILE]

Four curves of three square units are made by the model itself at known values: length and volume over
pressure, deflection over load, bending angle over tension. Looked for are the moduli of film and frames, and
the tension that a cable keeps at an eyelet. Noise is 1 % of each range, seeded. The repeats are of the
fit linearised at the truth, by its exact Jacobian: 1 % of noise moves it little. Some are repeated as a whole
`cosim identify`, with its outliers and profile likelihood, and compared. A second set of curves is made on
a mesh that is refined twice (16 times the triangles), every fourth row held out.
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

from cosim.bench.curves import Curves
from cosim.bench.fitting import Fit, identify
from cosim.bench.page import series_lines, value_lines
from cosim.config.benches import BenchTable, Series, load_bench

TRUE = {
    "soft_robot.film.young_modulus_Pa": (1.3e9, 0.9e9),
    "soft_robot.stiffener.young_modulus_Pa": (1.7e9, 2.2e9),
    "soft_robot.cable.corner_0.capstan_factor": (0.86, 0.75),
}
"""By key: the truth, and where the search begins."""
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
        spread = max(1.0, float(((noise - jacobian @ step) ** 2).sum()) / (len(noise) - len(step)))
        steps.append(step)
        inside.append(np.abs(step) <= np.sqrt(3.841458820694124 * spread * np.diag(known)))
    return np.array(steps), np.array(inside)


def main() -> None:
    """Print what is found without noise, and how often intervals hold the truth."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--whole", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    target = None if options.json is None else options.json.resolve()
    truth, report = np.array([true for true, _ in TRUE.values()]), dict[str, Any]()
    with TemporaryDirectory() as folder, chdir(folder):
        bench, series = made(Path(folder))
        began = time.process_time()
        exact = identify(bench, series)
        off = np.array([each.value for each in exact.found]) / truth - 1.0
        report["without_noise"] = dict(zip(TRUE, off.tolist(), strict=True))
        print(f"without noise, relative: {report['without_noise']}")
        step, inside = linearised(Fit(bench, series), truth, options.repeats)
        report["held"], report["repeats"] = (
            dict(zip(TRUE, inside.sum(axis=0).tolist(), strict=True)),
            len(step),
        )
        print(f"the truth is inside, of {len(step)}: {report['held']}", flush=True)
        off, agree = [], 0
        for seed in range(min(options.whole, options.repeats)):
            found = identify(bench, noisy(series, seed))
            holds = [each.low <= true <= each.high for each, true in zip(found.found, truth, strict=True)]
            agree += int((inside[seed] == holds).sum())
            off.append(np.log([each.value for each in found.found] / truth) - step[seed])
        spread = step.std(axis=0)
        report["whole"] = {
            "off_over_sd": float(np.abs(np.reshape(off, (-1, len(TRUE))) / spread).max(initial=0.0)),
            "agree": agree,
        }
        print(f"{len(off)} whole fits: {agree} of {3 * len(off)} intervals say the same", flush=True)
        print(
            f"values differ by {report['whole']['off_over_sd']:.3g} standard deviations at most", flush=True
        )
        bench, series = made(Path(folder), 8, 2, 4)
        changes = tuple(
            replace(each, table=replace(each.table, relative=True)) if each.table.name == "volume" else each
            for each in series
        )
        for words, given in (("", series), (", volume by its changes", changes)):
            fine = identify(bench, given, force=True)
            lines = report[f"refined_twice{words}"] = [
                *fine.check.lines(), *value_lines(fine), *series_lines(fine)
            ]  # fmt: skip
            print("\n".join([f"curves of the film refined twice{words}:", *lines]), flush=True)
        print(f"CPU time {time.process_time() - began:.0f} s")
    if target is not None:
        target.write_text(json.dumps(report, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
