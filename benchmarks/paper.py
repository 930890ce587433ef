"""Every figure of the paper: its code's output, its model, and the default robots, as tables and pictures.

    python benchmarks/paper.py [--pictures DIR] [--markdown FILE] [--causes | --frames] [FIGURE ...]

Two minutes on one core. One PNG per figure goes to docs/paper/. With --causes each figure is run with plain
film on the paper's mesh, and with one part of the default robot after another added, which shows what makes
which difference (four minutes); with --frames, with frames of other widths.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from benchmarks.paper_figures import FIGURES, Row, Runs
from cosim.build.soft_body import published_robot
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable, StiffenerTable
from cosim.errors import SolverError
from cosim.soft.elements.material import FilmLaw

ROOT: Final = Path(__file__).resolve().parents[1]
COLUMNS: Final = ("code", "solved", "published", "default")


def _robot(scenario: Scenario) -> SoftRobotTable:
    assert isinstance(scenario.soft_robot, SoftRobotTable)
    return scenario.soft_robot


def _bare(scenario: Scenario, law: FilmLaw, graded: bool) -> Scenario:
    """Return a scenario with bare film of a law on the paper's mesh, or on the robot's."""
    own = _robot(scenario)
    robot = published_robot(own)
    if graded:
        assert own.stack is not None
        robot = replace(robot, stack=replace(own.stack, neck=None))
    robot = replace(robot, film=replace(own.film, law=law), hinge=own.hinge)
    apart = replace(scenario.contact, self_contact=False)
    return replace(scenario, soft_robot=robot, contact=apart)


def _framed(scenario: Scenario) -> Scenario:
    """Return a scenario whose units have frames, and do not press on one another."""
    bare = _bare(scenario, _robot(scenario).film.law, graded=True)
    return replace(bare, soft_robot=replace(_robot(bare), stiffener=_robot(scenario).stiffener))


def _necked(scenario: Scenario) -> Scenario:
    return replace(scenario, contact=replace(scenario.contact, self_contact=False))


def _unframed(scenario: Scenario) -> Scenario:
    """Return a scenario whose robot is the default one without its frames."""
    return replace(scenario, soft_robot=replace(_robot(scenario), stiffener=StiffenerTable()))


STEPS: Final[dict[str, Callable[[Scenario], Scenario] | None]] = {
    "plain film, paper's mesh": lambda scenario: _bare(scenario, "plain", graded=False),
    "film that wrinkles": lambda scenario: _bare(scenario, _robot(scenario).film.law, graded=False),
    "finer mesh": lambda scenario: _bare(scenario, _robot(scenario).film.law, graded=True),
    "frames": _framed,
    "fused necks": _necked,
    "contact of units (default)": None,
    "default without frames": _unframed,
}


def cell(value: float | None) -> str:
    """Return a number in a table; empty for none."""
    return "" if value is None else f"{value:.2f}" if abs(value) < 100.0 else f"{value:.1f}"


def table(rows: Sequence[Row]) -> str:
    """Return the rows of a figure as Markdown."""
    compared = any("published" in row.values for row in rows)
    columns = COLUMNS if compared else tuple(rows[0].values)
    lines = [f"| | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
    if compared:
        lines = [f"{lines[0]} default / published |", f"{lines[1]}---|"]
    for row in rows:
        cells = [cell(row.values.get(column)) for column in columns]
        if compared:
            both = row.values.get("default"), row.values.get("published")
            cells.append("" if None in both else f"{row.values['default'] / row.values['published']:.2f}")
        lines.append(f"| {row.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _with_width(width_mm: float) -> Callable[[Scenario], Scenario]:
    """Return what gives a scenario's robot frames of another width."""

    def changed(scenario: Scenario) -> Scenario:
        robot = _robot(scenario)
        frame = replace(robot.stiffener, width_m=1e-3 * width_mm)
        return replace(scenario, soft_robot=replace(robot, stiffener=frame))

    return changed


FRAMES: Final = {f"{width_mm:g} mm wide": _with_width(width_mm) for width_mm in (1.5, 2.0, 2.5, 3.0, 3.5)}


def variants(name: str, steps: Mapping[str, Callable[[Scenario], Scenario] | None]) -> str:
    """Return as Markdown what changes of the default robot do to a figure's numbers."""
    heads = list(steps)
    found: dict[str, list[str]] = {}
    for step in heads:
        try:
            rows = FIGURES[name](plt.figure().gca(), Runs(steps[step], ("default",)))
        except SolverError as error:
            print(f"    {name}, {step}: {error}", file=sys.stderr)
            continue
        finally:
            plt.close()
        for row in (row for row in rows if row.values):
            found.setdefault(row.name, [""] * len(heads))[heads.index(step)] = cell(row.values.get("default"))
    lines = [f"| {name} | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    lines += [f"| {row} | {' | '.join(cells)} |" for row, cells in found.items()]
    return "\n".join(lines)


def drawn(name: str, runs: Runs, folder: Path) -> list[Row]:
    """Return the rows of a figure, and leave its picture."""
    figure, axes = plt.subplots(figsize=(6.4, 4.4), layout="constrained")
    rows = FIGURES[name](axes, runs)
    axes.set_title(load_scenario(name).title, fontsize=10)
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
    figure.savefig(folder / f"{name}.png", dpi=110)
    plt.close(figure)
    return rows


def main() -> int:
    """Run, draw, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("figures", nargs="*", metavar="FIGURE", help=f"of {', '.join(FIGURES)}")
    parser.add_argument("--pictures", type=Path, default=ROOT / "docs" / "paper", help="folder of the PNGs")
    parser.add_argument("--markdown", type=Path, help="file that gets the tables as well")
    parser.add_argument("--causes", action="store_true", help="which part makes which difference")
    parser.add_argument("--frames", action="store_true", help="the same for the width of the frames")
    options = parser.parse_args()
    options.pictures.mkdir(parents=True, exist_ok=True)
    texts = []
    for name in options.figures or FIGURES:
        runs = Runs()
        if options.causes or options.frames:
            text = variants(name, STEPS if options.causes else FRAMES)
        else:
            text = table(drawn(name, runs, options.pictures))
        seconds = ", ".join(f"{scenario} {model} {s:.1f}" for (scenario, model), s in runs.seconds.items())
        texts.append(f"## {name}\n\n{text}\n" + (f"\nCPU seconds: {seconds}\n" if seconds else ""))
        print(texts[-1], flush=True)
    if options.markdown:
        options.markdown.write_text("\n".join(texts))
    return 0


if __name__ == "__main__":
    sys.exit(main())
