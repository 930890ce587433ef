"""The error that a run works out of its figures, against the truth: mesh refined twice, quarter of the tick.

60 runs are drawn with a seed: robots, films, frames, pressures, poses, cables; a third of them with films and
frames that the calibration of the factors never saw. Every phase end is a state. Of the truth the mesh's part
is the difference to the state at rest on the mesh refined twice, the tick's part that to the same run with a
quarter of its tick. The table says how often the truth lies within the bar, and the median of bar over truth.

python benchmarks/run_error.py --rows rows.jsonl      # all 60, some 15 minutes of processor time
python benchmarks/run_error.py --table rows.jsonl     # the table of what has been run
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from cosim.app.driver import build_simulation
from cosim.base.kept_parts import KeptParts
from cosim.build.soft_model import SoftModel
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.soft_sides.finer_mesh import FinerMesh
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.errors import CosimError
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.soft.targets.tip_target import TipTarget
from cosim.stepping.run_error import (
    FIGURES,
    ErrorFinder,
    PhaseEnd,
    differences,
    frame_kind,
    mesh_bars,
    shape_figures,
    tension_difference,
)

RUNS, HELD_OUT, SEED = 60, 20, 43
RISE_M = 0.01  # of the tip, by its cables
ROBOTS = {
    "hexagon_arm": 2, "hexagon_arm_five": 3, "square_core_cables": 2, "square_core_ten": 4,
    "light_hexagon_arm": 2, "framed_hexagon_arm": 2, "gripper_finger": 2,
}  # fmt: skip
"""Robots and their cables."""


@dataclass(frozen=True)
class Case:
    """A run.

    Args:
        number: in the draw.
        held_out: whether its film or frame is none of those that the factors were fitted to.
        text: of its scenario.
        overrides: of its robot, film and frame.
    """

    number: int
    held_out: bool
    text: str
    overrides: dict[str, Any]


def drawn_cases() -> Iterator[Case]:
    """Yield the runs, in order; each has a generator of its own."""
    for number in range(RUNS):
        rng = np.random.default_rng([SEED, number])
        held_out = number % (RUNS // HELD_OUT) == 2
        robot = str(rng.choice(list(ROBOTS)))
        changes = _held_out(rng, robot) if held_out else _known(rng, robot)
        dynamic = number % 5 == 4
        yield Case(number, held_out, _scenario(rng, robot, dynamic=dynamic), changes)


def _known(rng: np.random.Generator, robot: str) -> dict[str, Any]:
    """Draw a film and frame as they come with cosim, or the paper's."""
    if robot == "framed_hexagon_arm" or rng.random() < 0.15:
        return {"model.published": robot != "framed_hexagon_arm"}
    width_m = float(rng.choice([2.5e-3, 3e-3, 4e-3]))
    return {"soft_robot.stiffener.width_m": width_m, "soft_robot.stiffener.height_m": width_m}


def _held_out(rng: np.random.Generator, robot: str) -> dict[str, Any]:
    """Draw another film, and another frame."""
    changes: dict[str, Any] = {
        "soft_robot.film.thickness_m": float(rng.uniform(0.06e-3, 0.2e-3)),
        "soft_robot.film.young_modulus_Pa": float(rng.uniform(0.4e9, 4e9)),
    }
    if robot == "framed_hexagon_arm":
        return changes
    if rng.random() < 0.5:
        changes["soft_robot.film.law"] = "plain"
    side_m = float(rng.uniform(3.5e-3, 6e-3))
    changes |= {"soft_robot.stiffener.width_m": side_m, "soft_robot.stiffener.height_m": side_m}
    return changes | {"soft_robot.stiffener.young_modulus_Pa": float(rng.uniform(0.5e9, 3e9))}


def _scenario(rng: np.random.Generator, robot: str, *, dynamic: bool) -> str:
    tilt, turn = float(rng.uniform(0.2, 2.4)), float(rng.uniform(-np.pi, np.pi))
    axis = [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)]
    tension = rng.uniform(0.0, 2.0, ROBOTS[robot]) * (rng.random(ROBOTS[robot]) < 0.6)
    tick_s, integrator = rng.choice([0.002, 0.005, 0.01]), rng.choice(["implicit_euler", "bdf2"])
    increments = "" if dynamic else "increments = 4\n"
    lines = [
        "schema = 2", f'title = "Drawn: {robot}"', 'robot = "none"', f'soft_robot = "{robot}"',
        f'mode = "{"dynamic" if dynamic else "quasistatic"}"',
        f"clock = {{ tick_s = {tick_s} }}", f'solver = {{ integrator = "{integrator}" }}',
        "[start]",
        f"flange = {{ position_m = [0.0, 0.0, 1.0], direction = {[round(float(x), 6) for x in axis]} }}",
        "[[phase]]", 'name = "inflate"', "duration_s = 0.3",
        increments + f"pressure_Pa = {float(rng.uniform(5e3, 30e3)):.0f}",
        "[[phase]]", 'name = "pull"', "duration_s = 0.3",
        increments + f"cable_tension_N = {[round(float(x), 3) for x in tension]}",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def loaded(case: Case, **more: Any) -> Scenario:
    """Return the scenario of a case."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drawn.toml"
        path.write_text(case.text, encoding="utf-8")
        return load_scenario(path, case.overrides | more)


def stepped(scenario: Scenario) -> ErrorFinder:
    """Return what has seen the phase ends of a run."""
    run = build_simulation(scenario)
    assert isinstance(run.errors, ErrorFinder)
    for batch in run.batches():
        run.errors.observe(batch)
    return run.errors


@dataclass(frozen=True)
class Meshes:
    """The soft robot of a run on its mesh, and on that refined once and twice."""

    run: SoftArm
    once: FinerMesh
    twice: FinerMesh

    @classmethod
    def of(cls, scenario: Scenario, side: SoftArm) -> Meshes:
        """Return those of a run."""
        model = SoftModel(scenario, KeptParts())
        once = FinerMesh(side.body, model.refined(1))
        return cls(side, once, FinerMesh(once.side.body, model.refined(2)))

    def at_rest(self, end: PhaseEnd) -> list[tuple[SoftArm, Equilibrium]]:
        """Return the state at rest at the end of a phase on each."""
        state = end.state
        self.run.restore_state(state)
        begin = SoftState.at_rest(state.soft.positions, state.soft.memory)
        rest = self.run.solve(begin, state.flange, state.loads)
        finer = self.once.at_rest(self.once.clamp(state.clamp), rest)
        finest = self.twice.at_rest(self.twice.clamp(self.once.side.clamp), finer)
        return [(self.run, rest), (self.once.side, finer), (self.twice.side, finest)]


def states(case: Case) -> Iterator[dict[str, Any]]:
    """Yield a row for each phase end: bars and true errors, by figure."""
    scenario = loaded(case)
    run = stepped(scenario)
    began = time.process_time()
    bars = run.find(0, lambda text: None, everywhere=True).phases
    spent_s = time.process_time() - began
    shapes = [end.state.soft.positions for end in run.ends]
    finer = shapes
    if scenario.mode == "dynamic":
        quarter = stepped(loaded(case, **{"clock.tick_s": scenario.clock.tick_s / 4.0}))
        finer = [end.state.soft.positions for end in quarter.ends]
    meshes = Meshes.of(scenario, run.side)
    for end, shape, closer in zip(run.ends, shapes, finer, strict=True):
        row: dict[str, Any] = {
            "case": case.number, "held_out": case.held_out, "phase": end.phase, "mode": scenario.mode,
            "frame": frame_kind(run.side.body), "overrides": case.overrides, "spent_s": spent_s,
            "bars": bars[end.phase],
        }  # fmt: skip
        if bars[end.phase]["reason"] is None:
            with suppress(CosimError):  # without a truth nothing is compared
                row |= _true(meshes, end, shape, closer)
        yield row


def _true(meshes: Meshes, end: PhaseEnd, shape: Any, closer: Any) -> dict[str, Any]:
    """Return the true errors of a phase end, and the differences that the bars were made of."""
    frame = (end.state.flange.translation, end.state.flange.rotation[:, 2])
    found = meshes.at_rest(end)
    rest, once, twice = (shape_figures(side, at.state.positions, frame) for side, at in found)
    here, there = (shape_figures(meshes.run, x, frame) for x in (shape, closer))
    truth = {key: None if rest[key] is None else there[key] + (twice[key] - rest[key]) for key in rest}
    row = {
        "truth": differences(here, truth),
        "once": differences(rest, once),
        "twice": differences(rest, twice),
    }
    row["tick"] = differences(here, there)
    if end.phase == 0 and meshes.run.body.cables:
        wanted = TipTarget(height=float(rest["tip_m"][2]) + RISE_M)
        try:
            pulled = [side.find_tensions(at, wanted).loads for side, at in found]
        except CosimError:
            return row
        row["once"]["cable_tension_N"] = tension_difference(pulled[0], pulled[1])
        row["truth"]["cable_tension_N"] = tension_difference(pulled[0], pulled[2])
    return row


def with_bar(row: dict[str, Any], key: str) -> tuple[float, float] | None:
    """Return the bar (present factors) and the true error of a figure of a row; None without a bar."""
    if "truth" not in row or row["truth"].get(key) is None:
        return None
    parts = row["bars"]["of_tick"], row["bars"]["of_solver"]
    bar = mesh_bars(row["once"], row["frame"])[key] + sum(part.get(key, 0.0) for part in parts)
    return bar, row["truth"][key]


def table(rows: list[dict[str, Any]]) -> str:
    """Return the table of coverage as Markdown."""
    lines = [
        "| figure | states | within the bar | held out | within the bar | bar / error, median | held out |",
        "|---|---|---|---|---|---|---|",
    ]
    for key in FIGURES:
        cells: list[list[str]] = [[], []]
        for held_out in (False, True):
            pairs = [with_bar(row, key) for row in rows if row["held_out"] is held_out]
            known = np.array([pair for pair in pairs if pair is not None]).reshape(-1, 2)
            within = 100.0 * float((known[:, 0] >= known[:, 1]).mean()) if len(known) else float("nan")
            ratio = float(np.median(known[:, 0] / known[:, 1])) if len(known) else float("nan")
            cells[0] += [str(len(known)), f"{within:.0f} %"]
            cells[1].append(f"{ratio:.1f}")
        lines.append(f"| {key} | " + " | ".join(cells[0] + cells[1]) + " |")
    without = sum(row["bars"]["reason"] is not None for row in rows)
    return "\n".join([*lines, "", f"{len(rows)} states, {without} without a bar"])


def main() -> None:
    """Run the cases, or show the table of those that have been run."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("--rows", type=Path, default=Path("run_error.jsonl"), help="goes on where it ended")
    options.add_argument("--cases", type=int, default=RUNS, help="how many at most")
    options.add_argument("--table", action="store_true", help="only the table of what has been run")
    given = options.parse_args()
    known = given.rows.read_text(encoding="utf-8").splitlines() if given.rows.exists() else []
    rows = [json.loads(line) for line in known]
    done = {row["case"] for row in rows}
    for case in [] if given.table else drawn_cases():
        if case.number in done or case.number >= given.cases:
            continue
        began = time.process_time()
        try:
            found = list(states(case))
        except CosimError as error:
            print(f"case {case.number}: {error}"[:200], flush=True)
            continue
        with given.rows.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in found)
        rows += found
        print(f"case {case.number}: {time.process_time() - began:.1f} s", flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
