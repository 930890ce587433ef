"""Every figure of the paper: its code's output, its model, and the default robots, as tables and pictures.

    python benchmarks/paper.py [--pictures DIR] [--markdown FILE] [--causes | --frames] [FIGURE ...]
    python benchmarks/paper.py --seconds

Three minutes on one core. One PNG per figure goes to docs/paper/. With --causes each figure is run with plain
film on the paper's mesh, that with contact of units, and with one part of the default robot after another
added. The last column names the parts that change a number by more than a tenth of the published one, where
the default is that far from it (ten minutes of CPU time). With --frames, frames have other widths. With
--seconds it prints the paper's wall times and the CPU seconds of the runs that come nearest to its work.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Final

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt

from benchmarks.paper_figures import FIGURES, Row, Runs
from cosim.build.paper_model import published_robot
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable, StiffenerTable
from cosim.errors import SolverError
from cosim.soft.elements.material import FilmLaw

ROOT: Final = Path(__file__).resolve().parents[1]
FUTURE: Final = ("hexagon_arm_torsion", "hexagon_arm_deploys", "tip_path_control")
"""Figures of work that the paper leaves to the future: there is no published model beside the default."""
PAPER_S: Final = {
    "three_point_bending_cables": "one pressure | 48 | ",
    "bending_angle_tip_load": "5G | 16 | ",
    "three_unit_inflation": "5H-I | 6 | ",
    "gripper_finger_closing": "here one finger of three | 91 | 80",
    "hexagon_arm_bending": "7, here six directions | 73 | 50",
    "paper_figure_9": "9 | 146 | ",
}
"""Figure, wall time of the paper's script [s] and time of its hardware [s], by scenario."""
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


def _published_touching(scenario: Scenario) -> Scenario:
    bare = _bare(scenario, "plain", graded=False)
    return replace(bare, contact=replace(bare.contact, self_contact=True))


PUBLISHED: Final = "plain film, paper's mesh"
DEFAULT: Final = "contact of units (default)"
STEPS: Final[dict[str, Callable[[Scenario], Scenario] | None]] = {
    "plain film with contact of units": _published_touching,
    PUBLISHED: lambda scenario: _bare(scenario, "plain", graded=False),
    "film that wrinkles": lambda scenario: _bare(scenario, _robot(scenario).film.law, graded=False),
    "finer mesh": lambda scenario: _bare(scenario, _robot(scenario).film.law, graded=True),
    "frames": _framed,
    "fused necks": _necked,
    DEFAULT: None,
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


WIDTHS_mm: Final = (1.5, 2.0, 2.5, 2.75, 3.0, 3.5)
FRAMES: Final = {f"{width:g} mm": _with_width(width) for width in WIDTHS_mm} | {PUBLISHED: STEPS[PUBLISHED]}
NEAR: Final = 0.15
"""Share of the code's number, or of the published model's, within which a frame's is marked."""


def variants(name: str, steps: Mapping[str, Callable[[Scenario], Scenario] | None]) -> str:
    """Return rows of Markdown: what changes of the default robot do to a figure's numbers.

    Of STEPS the last column has the causes of large differences. Of FRAMES it has the code's number, and what
    is within NEAR of that is bold. Without a number of the code, the published model's counts.
    """
    found: dict[str, dict[str, float]] = {}
    for step, change in steps.items():
        try:
            rows = FIGURES[name](plt.figure().gca(), Runs(change, ("default",)))
        except SolverError as error:
            print(f"    {name}, {step}: {error}", file=sys.stderr)
            continue
        finally:
            plt.close()
        for row in (row for row in rows if "default" in row.values):
            found.setdefault(row.name, {})[step] = row.values["default"]
            if steps is FRAMES and "code" in row.values:
                found[row.name]["code"] = row.values["code"]
    lines = []
    for row_name, values in found.items():
        if len(values) == 1:  # held by the controller: of the default alone
            continue
        aim = values.get("code", values.get(PUBLISHED))
        cells = [_marked(values.get(step), aim if steps is FRAMES else None) for step in steps]
        cells.append(causes(values) if steps is STEPS else cell(values.get("code")))
        lines.append(f"| `{name}`: {row_name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def head(steps: Mapping[str, Callable[[Scenario], Scenario] | None]) -> str:
    """Return the head of the table whose rows `variants` returns."""
    last = "why the default differs" if steps is STEPS else "code"
    return f"| | {' | '.join(steps)} | {last} |\n{'|---' * (len(steps) + 2)}|"


def _marked(value: float | None, aim: float | None) -> str:
    near = value is not None and aim is not None and abs(value - aim) <= NEAR * abs(aim)
    return f"**{cell(value)}**" if near else cell(value)


def causes(values: Mapping[str, float]) -> str:
    """Return the parts that change a number by more than a tenth of the published one, with their changes.

    Args:
        values: the number by the names of STEPS, without those that failed.
    """
    if PUBLISHED not in values or DEFAULT not in values:
        return ""
    own = values[PUBLISHED]
    if abs(values[DEFAULT] - own) <= 0.1 * abs(own):
        return "within 10 %"
    heads = list(STEPS)
    chain = [step for step in heads[heads.index(PUBLISHED) : heads.index(DEFAULT) + 1] if step in values]
    shares = {b: (values[b] - values[a]) / abs(own) for a, b in pairwise(chain)}
    large = (f"{step} {100.0 * share:+.0f} %" for step, share in shares.items() if abs(share) > 0.1)
    return ", ".join(large)


def seconds_table() -> str:
    """Return the paper's wall times, and static solutions and CPU seconds of our runs, as Markdown.

    A run is loaded and its kernels are compiled before its time counts.
    """
    lines = [
        "| work | figure, share | paper [s] | hardware [s] | solutions | published [s] | default [s] |",
        "|---" * 7 + "|",
    ]
    for name, paper in PAPER_S.items():
        cells = []
        for model in ("published", "default"):
            runs = Runs()
            runs.run(name, model, {}, phases=1)
            runs.seconds.clear()
            result = runs.run(name, model, {})
            cells.append(f"{runs.seconds[name, model]:.1f}")
        lines.append(f"| `{name}` | {paper} | {len(result.time_s)} | {' | '.join(cells)} |")
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
    parser.add_argument(
        "--seconds", action="store_true", help="wall times of the paper and CPU seconds of ours"
    )
    options = parser.parse_args()
    if options.seconds:
        print(seconds_table())
        return 0
    options.pictures.mkdir(parents=True, exist_ok=True)
    steps = STEPS if options.causes else FRAMES if options.frames else None
    texts = [] if steps is None else [head(steps)]
    print(*texts, sep="\n")
    for name in options.figures or [name for name in FIGURES if not (steps and name in FUTURE)]:
        if steps is not None:
            texts.append(variants(name, steps))
        else:
            runs = Runs()
            text = table(drawn(name, runs, options.pictures))
            seconds = ", ".join(f"{run} {model} {s:.1f}" for (run, model), s in runs.seconds.items())
            texts.append(f"## {name}\n\n{text}\n\nCPU seconds: {seconds}\n")
        print(texts[-1], flush=True)
    if options.markdown:
        options.markdown.write_text("\n".join(texts))
    return 0


if __name__ == "__main__":
    sys.exit(main())
