"""Frames of the square core, identified on half of the paper's figures; the other half is predicted.

    python benchmarks/paper_identified.py # fit, then intervals and table: 8 minutes
    python benchmarks/paper_identified.py --values 0.01 3.1e-3 7e-3 # intervals and table of given values
    python benchmarks/paper_identified.py --values .. --refine 1 # the table on the mesh refined once
    python benchmarks/paper_identified.py --values .. --terms # one term of the model changed at a time

FITTED and PREDICTED are the halves. The paper's code is no equilibrium of its own model, so each figure has
two targets: the code's output, and the paper's model solved ("solved" of paper_figures.py). Both count alike
in the fit. Three values are fitted by least squares: how much smaller frames are than the film's rim, their
width, and the radius to which necks are fused. Intervals are linearised, and widened by the residuals where
SD is too small to explain them. Height and modulus of the frames are assumed; the check of what the data
determine has all five. `cosim identify` holds a robot at its base alone, so it cannot run these tests; its
checks and statistics are used.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import least_squares

from benchmarks.paper_figures import FIGURES, Runs
from cosim.base.frames import Array
from cosim.bench.fitting import spread_of
from cosim.bench.identifiability import identifiability
from cosim.config.benches import UnknownTable
from cosim.config.schema.phase import PhaseTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.schema.stack import NeckTable
from cosim.errors import SolverError

FITTED: Final = ("ten_unit_extension", "three_point_bending")
"""Lengths of ten units, and their bending without cables: declared before any fit, kept since."""
PREDICTED: Final = (
    "three_unit_inflation", "three_point_bending_cables", "bending_angle", "bending_angle_tip_load",
)  # fmt: skip
"""All other figures of the square core: three units, and everything with cables."""
NOT_THE_PAPER_S: Final = ("over stored length", "strain of frames")
SD: Final = 0.05
"""Relative standard deviation of a target; in the fitted half the code is up to 17 % off its equilibrium."""
UNKNOWNS: Final = (
    UnknownTable("1 - side_ratio", 5e-4, 0.02, start=0.01),
    UnknownTable("width_m", 1.5e-3, 5e-3, start=3.5e-3),
    UnknownTable("fused_radius_m", 3.8e-3, 15e-3, start=5e-3),
    UnknownTable("height_m", 1.5e-3, 4e-3, start=2.4e-3),
    UnknownTable("young_modulus_Pa", 1e9, 3e9, start=1.7e9),
)
"""The first FREE are fitted; bounds are what can be built."""
FREE: Final = 3
FITTING: Final = np.array([0.0, 3.5e-3, 5e-3])
"""Frames as large as the film's rim, chosen by the paper's two bounds on extension: for comparison."""
TERMS: Final[dict[str, Callable[[Scenario], Scenario]]] = {
    "as identified": lambda scenario: scenario,
    "no contact of units": lambda s: replace(s, contact=replace(s.contact, self_contact=False)),
    "plain film": lambda s: _with_film(s, law="plain"),
    "open ends": lambda s: replace(s, model=replace(s.model, closed=False)),
    "film of 1.0 GPa": lambda s: _with_film(s, young_modulus_Pa=1e9),
}
"""Terms of the model that the fit leaves alone, changed one at a time."""
STEP: Final = 0.02  # of the logarithm of a value, in differences
NOT_FOUND: Final = 10.0  # residual of a figure without an equilibrium


def framed(scenario: Scenario, values: Mapping[str, float], refine: int = 0) -> Scenario:
    """Return a scenario whose robot has frames and necks by the keys of UNKNOWNS."""
    robot = scenario.soft_robot
    assert isinstance(robot, SoftRobotTable)
    assert robot.stack is not None
    frame = replace(
        robot.stiffener,
        side_ratio=1.0 - values["1 - side_ratio"],
        width_m=values["width_m"],
        height_m=values["height_m"],
        young_modulus_Pa=values["young_modulus_Pa"],
    )
    stack = replace(robot.stack, neck=NeckTable(values["fused_radius_m"]), refine=refine)
    phases = scenario.phases
    if refine:  # few steps: slack film of a finer mesh has many near equilibria below 0.2 kPa
        phases = tuple(replace(phase, increments=_few(phase)) for phase in phases)
    return replace(scenario, soft_robot=replace(robot, stiffener=frame, stack=stack), phases=phases)


def _with_film(scenario: Scenario, **changes: Any) -> Scenario:
    robot = scenario.soft_robot
    assert isinstance(robot, SoftRobotTable)
    return replace(scenario, soft_robot=replace(robot, film=replace(robot.film, **changes)))


def _few(phase: PhaseTable) -> int:
    """Return the number of increments of a phase on a finer mesh."""
    return max(1, phase.increments // (20 if phase.pressure_Pa is not None else 4))


def named(values: Array) -> dict[str, float]:
    """Return values by the keys of UNKNOWNS; those that are left out are assumed."""
    assumed = [entry.start for entry in UNKNOWNS[len(values) :]]
    pairs = zip(UNKNOWNS, [*values.tolist(), *assumed], strict=True)
    return {entry.key: float(value) for entry, value in pairs}


def numbers(name: str, runs: Runs) -> dict[str, dict[str, float]]:
    """Return the numbers of a figure by "figure: number" and model; none where no equilibrium was found."""
    axes = plt.figure().gca()
    try:
        rows = FIGURES[name](axes, runs)
    except SolverError as error:
        print(f"    {name}: {error}", file=sys.stderr)
        return {}
    finally:
        plt.close()
    kept = (row for row in rows if not any(text in row.name for text in NOT_THE_PAPER_S))
    return {f"`{name}`: {row.name}": row.values for row in kept}


def _targets(name: str) -> dict[str, dict[str, float]]:
    return numbers(name, Runs(models=("solved", "published")))


def _ours(work: tuple[str, dict[str, float], int, str]) -> dict[str, float]:
    name, values, refine, term = work
    runs = Runs(lambda scenario: TERMS[term](framed(scenario, values, refine)), ("default",))
    return {key: row["default"] for key, row in numbers(name, runs).items() if "default" in row}


class Figures:
    """Numbers of the square core's figures, by values of UNKNOWNS.

    Args:
        pool: runs figures.
    """

    def __init__(self, pool: ProcessPoolExecutor) -> None:
        self._pool = pool
        found = list(pool.map(_targets, (*FITTED, *PREDICTED)))
        self.targets = {key: row for rows in found for key, row in rows.items()}
        for key, value in self.at(FITTING, (*FITTED, *PREDICTED)).items():
            self.targets[key]["fit"] = value

    def at(
        self, values: Array, names: Sequence[str], refine: int = 0, term: str = "as identified"
    ) -> dict[str, float]:
        """Return the numbers of figures by name, with a term of TERMS changed."""
        work = [(name, named(values), refine, term) for name in names]
        return {key: value for rows in self._pool.map(_ours, work) for key, value in rows.items()}

    def residuals(self, found: Mapping[str, float], names: Sequence[str]) -> Array:
        """Return the logarithms of numbers over the code's, and over the solved model's, over SD."""
        rows = []
        for key, target in self.targets.items():
            if any(f"`{name}`" in key for name in names):
                aims = [target[model] for model in ("code", "solved") if model in target]
                ratios = [found[key] / aim if key in found else np.exp(NOT_FOUND * SD) for aim in aims]
                rows += [np.log(ratio) / SD for ratio in ratios]
        return np.array(rows)

    def slopes(self, values: Array, names: Sequence[str]) -> tuple[dict[str, float], dict[str, Array]]:
        """Return the numbers, and their relative derivatives by the logarithms of the values."""
        here, found = self.at(values, names), dict[str, list[float]]()
        for step in STEP * np.eye(len(values)):
            there, back = (self.at(values * np.exp(sign * step), names) for sign in (1.0, -1.0))
            for key in here:
                ratio = there.get(key, np.nan) / back.get(key, np.nan)
                found.setdefault(key, []).append(np.log(ratio) / (2.0 * STEP))
        return here, {key: np.array(row) for key, row in found.items()}


def fit(figures: Figures) -> Array:
    """Return the fitted values (FREE,)."""
    entries = UNKNOWNS[:FREE]
    low, high, start = (np.log([getattr(e, end) for e in entries]) for end in ("low", "high", "start"))

    def residuals(logs: Array) -> Array:
        found = figures.residuals(figures.at(np.exp(logs), FITTED), FITTED)
        print(f"    {named(np.exp(logs))}: {SD * np.sqrt((found**2).mean()):.4f}", file=sys.stderr)
        return found

    def slopes(logs: Array) -> Array:
        columns = [residuals(logs + step) - residuals(logs - step) for step in STEP * np.eye(FREE)]
        return np.stack(columns, axis=1) / (2.0 * STEP)

    best = least_squares(residuals, start, slopes, bounds=(low, high), ftol=2e-3, xtol=2e-3)
    return np.asarray(np.exp(best.x))


def report(figures: Figures, values: Array) -> list[str]:
    """Return values with 95 % intervals, what the data cannot tell, and the table, as lines."""
    every = np.concatenate([values, [entry.start for entry in UNKNOWNS[FREE:]]])
    here, slopes = figures.slopes(every, (*FITTED, *PREDICTED))
    scaled = np.array([
        slopes[key] / SD
        for key, target in figures.targets.items()
        for model in ("code", "solved")
        if model in target and any(f"`{name}`" in key for name in FITTED)
    ])  # fmt: skip
    left = figures.residuals(here, FITTED)
    spread = spread_of(float(left @ left), len(left) - FREE)
    covariance = spread * np.linalg.inv(scaled[:, :FREE].T @ scaled[:, :FREE])
    lines = []
    for entry, value, half in zip(UNKNOWNS, values, 1.96 * np.sqrt(np.diag(covariance)), strict=False):
        low, high = value * np.exp(-half), value * np.exp(half)
        lines.append(f"{entry.key} = {value:.4g}, 95 % in {low:.4g} to {high:.4g}")
    lines += ["What the fitted half determines of all five values:"]
    widths = np.log([entry.high / entry.low for entry in UNKNOWNS])
    lines += identifiability(scaled / np.sqrt(spread), widths, UNKNOWNS, {}).lines()
    bands = {key: 196.0 * float(np.sqrt(row[:FREE] @ covariance @ row[:FREE])) for key, row in slopes.items()}
    return [*lines, "", *table(figures.targets, here, bands)]


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}" if abs(value) < 100.0 else f"{value:.1f}"


def _over(value: float | None, aim: float | None) -> str:
    return "" if value is None or aim is None else f"{100.0 * (value / aim - 1.0):+.1f}"


def table(
    targets: Mapping[str, Mapping[str, float]], found: Mapping[str, float], bands: Mapping[str, float]
) -> list[str]:
    """Return rows of Markdown: both targets, our models, errors, and the interval of the prediction."""
    head = "code | solved | published | frames fit | identified | half | % of code | % of solved | 95 % [%]"
    lines = [f"| | {head} |", "|---" * 11 + "|"]
    for key, target in targets.items():
        half = "fitted" if any(f"`{name}`" in key for name in FITTED) else "predicted"
        ours, code, solved = found.get(key), target.get("code"), target.get("solved")
        cells = [_cell(target.get(model)) for model in ("code", "solved", "published", "fit")]
        band = "" if key not in bands else f"{bands[key]:.1f}"
        cells += [_cell(ours), half, _over(ours, code), _over(ours, solved), band]
        lines.append(f"| {key} | {' | '.join(cells)} |")
    return lines


def terms_table(figures: Figures, values: Array) -> list[str]:
    """Return rows of Markdown: the numbers with one term of the model changed, beside both targets."""
    names = (*FITTED, *PREDICTED)
    columns = {term: figures.at(values, names, term=term) for term in TERMS}
    lines = [f"| | code | solved | {' | '.join(TERMS)} |", "|---" * (len(TERMS) + 3) + "|"]
    for key, target in figures.targets.items():
        cells = [_cell(target.get(model)) for model in ("code", "solved")]
        cells += [_cell(found.get(key)) for found in columns.values()]
        lines.append(f"| {key} | {' | '.join(cells)} |")
    return lines


def main() -> None:
    """Fit, and print values and table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--values", type=float, nargs=FREE, help="of 1 - side_ratio, width_m, fused_radius_m")
    parser.add_argument("--refine", type=int, default=0, help="of the mesh; other than 0: the table alone")
    parser.add_argument("--terms", action="store_true", help="change one term of the model at a time")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.workers) as pool:
        figures = Figures(pool)
        values = fit(figures) if options.values is None else np.array(options.values)
        if options.terms:
            print(*terms_table(figures, values), sep="\n")
        elif options.refine:
            found = figures.at(values, (*FITTED, *PREDICTED), options.refine)
            print(*table(figures.targets, found, {}), sep="\n")
        else:
            print(*report(figures, values), sep="\n")


if __name__ == "__main__":
    main()
