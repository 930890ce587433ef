"""The error that a run works out of its figures, against the truth: mesh refined twice, quarter of the tick.

Runs are drawn with a seed: robots, films, frames, pressures, poses, cables; those of the calibration in part
with films and frames as they come with cosim, in part, as those held out, with others. From the calibration
alone the factors follow, by the rule of `fitted`. Every phase end is a state. Of the truth the mesh's part
is the difference to the state at rest on the mesh refined twice, the tick's part that to the same run with
a quarter of its tick; from where that branches on, nothing is compared. The table says how often the truth
lies within the bar, and the median of bar over truth. Fingers, whose mesh is the drawn one with refined
holes, have factors of their own.

python benchmarks/run_error.py  # factors and table of the rows that are stored in benchmarks/rows
python benchmarks/run_error.py shipped wide wide_too wide_three held_out --rows FOLDER  # what FOLDER lacks
python benchmarks/run_error.py held_out --cases 4 9 --rows FOLDER  # these cases alone
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np

from cosim.app.preparation import build_simulation
from cosim.bars.calibration import (
    DRAWN,
    FIGURES,
    GRADED,
    TICK_FACTOR,
    Calibration,
    bounded,
    bounded_tension,
    calibration_of,
    tension_difference,
)
from cosim.bars.finer_mesh import FinerMesh
from cosim.bars.resting import at_rest
from cosim.bars.shape_figures import differences, shape_figures
from cosim.bars.study import find_bars
from cosim.base.kept_parts import KeptParts
from cosim.build.soft_model import SoftModel
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.film_robot import FilmRobot, FilmRobotState
from cosim.errors import CosimError, UnreachableError
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tip_target import TipTarget
from cosim.telemetry.phase_ends import PhaseEnd, PhaseEnds
from cosim.telemetry.summary import SummaryBuilder

DRAWS = {
    "shipped": (71, 26), "wide": (2611, 20), "wide_too": (4711, 20), "wide_three": (8128, 20),
    "held_out": (20261126, 20),
}  # fmt: skip
"""Seed and number of runs. All but the last are the calibration: they were held out before, and looked at."""
ROWS = Path(__file__).parent / "rows"
IN_TIME = 3  # every so many runs
FIRST_ORDER = 1.5  # of the rule of `fitted`
RISE_M = (0.005, 0.03)  # of the tip, by its cables; where these cannot lift it, they shall lower it
ROBOTS = {
    "hexagon_arm": 2, "hexagon_arm_five": 3, "square_core_cables": 2, "square_core_ten": 4,
    "light_hexagon_arm": 2, "framed_hexagon_arm": 2, "gripper_finger": 2,
}  # fmt: skip
"""Robots and their cables."""


CALIBRATIONS: dict[str, Calibration] = {"graded": GRADED, "drawn": DRAWN}
Found: TypeAlias = list[tuple[FilmRobot, Equilibrium]]
"""A state at rest on the mesh of the run, on that refined once, and on that refined twice."""


@dataclass(frozen=True)
class Case:
    """A run.

    Args:
        number: in the draw.
        rise_m: by which its cables shall lift the tip at the end of the first phase.
        text: of its scenario.
        overrides: of its robot, film and frame.
    """

    number: int
    rise_m: float
    text: str
    overrides: dict[str, Any]


def drawn_cases(draw: str) -> Iterator[Case]:
    """Yield the runs of a draw, in order; each has a generator of its own."""
    seed, runs = DRAWS[draw]
    for number in range(runs):
        rng = np.random.default_rng([seed, number])
        robot = str(rng.choice(list(ROBOTS)))
        changes = _known(rng, robot) if draw == "shipped" else _wide(rng, robot)
        text = _scenario(rng, robot, dynamic=number % IN_TIME == IN_TIME - 1)
        yield Case(number, float(rng.uniform(*RISE_M)), text, changes)


def _known(rng: np.random.Generator, robot: str) -> dict[str, Any]:
    """Draw a film and frame as they come with cosim, or the paper's."""
    if robot == "framed_hexagon_arm" or rng.random() < 0.1:
        return {"model.published": robot != "framed_hexagon_arm"}
    if rng.random() < 0.5:
        return {}
    width_m, height_m = (float(side) for side in rng.uniform(2.4e-3, 4e-3, 2))
    return {"soft_robot.stiffener.width_m": width_m, "soft_robot.stiffener.height_m": height_m}


def _wide(rng: np.random.Generator, robot: str) -> dict[str, Any]:
    """Draw a film and frame whose thickness, sides and moduli no shipped robot has."""
    thickness_m = rng.choice([rng.uniform(0.06e-3, 0.1e-3), rng.uniform(0.12e-3, 0.2e-3)])
    modulus_Pa = rng.choice([rng.uniform(0.4e9, 1.2e9), rng.uniform(1.4e9, 4e9)])
    changes: dict[str, Any] = {
        "soft_robot.film.thickness_m": float(thickness_m),
        "soft_robot.film.young_modulus_Pa": float(modulus_Pa),
    }
    if robot == "framed_hexagon_arm":
        return changes
    if rng.random() < 0.5:
        changes["soft_robot.film.law"] = "plain"
    width_m, height_m = (float(side) for side in rng.uniform(4.1e-3, 6e-3, 2))
    modulus_Pa = rng.choice([rng.uniform(0.5e9, 1.5e9), rng.uniform(1.9e9, 3e9)])
    changes |= {"soft_robot.stiffener.width_m": width_m, "soft_robot.stiffener.height_m": height_m}
    return changes | {"soft_robot.stiffener.young_modulus_Pa": float(modulus_Pa)}


def _scenario(rng: np.random.Generator, robot: str, *, dynamic: bool) -> str:
    tilt, turn = float(rng.uniform(0.0, 2.4)), float(rng.uniform(-np.pi, np.pi))
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


def stepped(scenario: Scenario) -> tuple[FilmRobot, PhaseEnds]:
    """Return the soft robot of a run, and what is kept of its phase ends."""
    run = build_simulation(scenario)
    kept = SummaryBuilder(run.stage, 0.0, "")
    for batch in run.batches():
        kept.observe(batch)
    assert isinstance(run.soft, FilmRobot), "no section model is drawn"
    return run.soft, kept.state.ends


def film_of(end: PhaseEnd) -> FilmRobotState:
    """Return the film at the end of a phase."""
    assert isinstance(end.state, FilmRobotState), "no section model is drawn"
    return end.state


@dataclass(frozen=True)
class Meshes:
    """The soft robot of a run on its mesh, and on that refined once and twice."""

    run: FilmRobot
    once: FinerMesh
    twice: FinerMesh

    @classmethod
    def of(cls, scenario: Scenario, side: FilmRobot) -> Meshes:
        """Return those of a run."""
        model = SoftModel(scenario, KeptParts())
        once = FinerMesh(side.body, model.refined(1))
        return cls(side, once, FinerMesh(once.side.body, model.refined(2)))

    def at_rest(self, end: PhaseEnd) -> Found:
        """Return the state at rest at the end of a phase on each."""
        return self.near(at_rest(self.run, film_of(end)))

    def near(self, rest: Equilibrium) -> Found:
        """Return a state at rest of the run's mesh with those near it on the others."""
        finer = self.once.at_rest(self.once.clamp(self.run.clamp), rest)
        finest = self.twice.at_rest(self.twice.clamp(self.once.side.clamp), finer)
        return [(self.run, rest), (self.once.side, finer), (self.twice.side, finest)]


def states(case: Case) -> Iterator[dict[str, Any]]:
    """Yield a row for each phase end: bars and true errors, by figure."""
    scenario = loaded(case)
    side, kept = stepped(scenario)
    began = time.process_time()
    bars = find_bars(scenario, kept, lambda text: None, everywhere=True).phases
    spent_s = time.process_time() - began
    shapes = [film_of(end).soft.positions for end in kept.ends]
    finer, beyond = shapes, [""] * len(shapes)
    if scenario.mode == "dynamic":
        _, quarter = stepped(loaded(case, **{"clock.tick_s": scenario.clock.tick_s / 4.0}))
        finer = [film_of(end).soft.positions for end in quarter.ends]
        beyond = [_elsewhere(quarter.ends[: end.phase + 1]) for end in kept.ends]
    meshes = Meshes.of(scenario, side)
    for end, shape, closer, why_not in zip(kept.ends, shapes, finer, beyond, strict=True):
        row: dict[str, Any] = {
            "case": case.number, "phase": end.phase, "mode": scenario.mode,
            "overrides": case.overrides, "spent_s": spent_s,
            "bars": bars[end.phase], "beyond": why_not,
            "swing": {key: value / TICK_FACTOR for key, value in bars[end.phase].get("of_tick", {}).items()},
        }  # fmt: skip
        if bars[end.phase]["reason"] is None and not why_not:
            with suppress(CosimError):  # without a truth nothing is compared
                found = meshes.at_rest(end)
                row |= _true(found, end, shape, closer)
                if end.phase == 0 and side.body.cables:
                    row["tensions"] = _tensions(meshes, found[0][1], case.rise_m)
        yield row


def _elsewhere(ends: Sequence[PhaseEnd]) -> str:
    """Return why a run with other ticks may be on another branch at the last of some phase ends."""
    branched = [end.why_not for end in ends if "branches" in end.why_not or "snaps" in end.why_not]
    return branched[0] if branched else ends[-1].why_not


def _true(found: Found, end: PhaseEnd, shape: Any, closer: Any) -> dict[str, Any]:
    """Return the true errors of a phase end, and the differences that the bars are made of."""
    flange = end.state.flange
    rest, once, twice = (shape_figures(side, at.state.positions, flange) for side, at in found)
    here, there = (shape_figures(found[0][0], x, flange) for x in (shape, closer))
    truth = {key: None if rest[key] is None else there[key] + (twice[key] - rest[key]) for key in rest}
    return {
        "rest": {key: rest[key] for key in ("length_m", "volume_m3")},
        "truth": differences(here, truth), "once": differences(rest, once), "twice": differences(rest, twice),
        "tick": differences(here, there),
    }  # fmt: skip


def _tensions(meshes: Meshes, rest: Equilibrium, rise_m: float) -> dict[str, Any]:
    """Return how far tensions that move the tip by a height are apart, downwards where it is not lifted."""
    side, why_not = meshes.run, "neither way"
    height_m = float(side.shape_reader().figures([rest.state.positions]).tip_position[0, 2])
    for way_m in (rise_m, -rise_m):
        wanted = TipTarget(height=height_m + way_m)
        try:
            pulled = side.find_tensions(rest, wanted)
        except UnreachableError:
            continue
        try:  # as a run does that has reached it
            near = meshes.near(pulled)
            first, once, twice = (each.find_tensions(at, wanted).loads for each, at in near)
            slope = side.tension_slope(pulled, wanted)
        except CosimError as error:
            why_not = f"{type(error).__name__}: {error}"[:150]
            continue
        away = {"once": tension_difference(first, once), "twice": tension_difference(first, twice)}
        tips = [each.body.tip_position(at.state.positions) for each, at in near[:2]]
        away["of_tip"] = slope * float(np.linalg.norm(tips[1] - tips[0]))
        return away | {"way_m": way_m, "tension_N": list(first.cable_tension_N)}
    return {"why_not": why_not}


def compared(row: dict[str, Any], key: str) -> tuple[float, float, float] | None:
    """Return (difference of two meshes, true error of the mesh, true error) of a figure; None where unknown.

    The difference is what a factor is multiplied with.
    """
    if key == "cable_tension_N":
        pulled = row.get("tensions", {})
        if "once" not in pulled:
            return None
        found = bounded_tension(max(pulled["tension_N"]), pulled["once"], pulled["of_tip"])
        return found, pulled["twice"], pulled["twice"]
    if key not in row.get("truth", {}):
        return None
    away = bounded(row["once"], row["rest"], CALIBRATIONS[row["mesh"]])
    return away[key], row["twice"][key], row["truth"][key]


def factor(pairs: list[tuple[float, float]]) -> float:
    """Return the least number, in tenths, by which the first reaches the second in all pairs."""
    ratios = np.array(pairs)[:, 1] / np.array(pairs)[:, 0]
    return math.ceil(10.0 * float(ratios.max()) - 1e-9) / 10.0


def fitted(mesh: str, rows: list[dict[str, Any]]) -> str:
    """Return the factors that follow from the calibration of a mesh; in brackets those in use.

    The least, in tenths, that cover all of its states; no less than the 1.5 that differences of the first
    order ask for.
    """
    factors = CALIBRATIONS[mesh].factors
    found = {key: [pair[:2] for row in rows if (pair := compared(row, key))] for key in FIGURES}
    lines = [
        f"{mesh}, {key}: {max(FIRST_ORDER, factor(pairs)):.1f} of {len(pairs)} states ({factors[key]})"
        for key, pairs in found.items()
        if pairs
    ]
    return "\n".join(lines)


def fitted_ticks(rows: list[dict[str, Any]]) -> str:
    """Return the factors of ticks that follow from the calibration; in brackets the one in use."""
    lines = []
    for key in ("tip_m", "length_m"):
        swings = [(row["swing"][key], row["tick"][key]) for row in in_time(rows)]
        lines.append(f"{key} by ticks: {factor(swings):.1f} of {len(swings)} states ({TICK_FACTOR})")
    return "\n".join(lines)


def in_time(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return the states in time that have a bar and a truth."""
    return [row for row in rows if "tick" in row and row["mode"] == "dynamic"]


def table(draws: dict[str, list[dict[str, Any]]]) -> str:
    """Return the table of coverage as Markdown, with the factors in use."""
    head = [f"{draw}: states | within the bar | bar / error, median" for draw in draws]
    lines = ["| figure | " + " | ".join(head) + " |", "|---" * (3 * len(draws) + 1) + "|"]
    for key in FIGURES:
        pairs = {draw: [_with_bar(row, key) for row in rows] for draw, rows in draws.items()}
        cells = [_within([pair for pair in found if pair is not None]) for found in pairs.values()]
        lines.append(f"| {key} | " + " | ".join(cells) + " |")
    ticks = [
        _within([(TICK_FACTOR * row["swing"]["tip_m"], row["tick"]["tip_m"]) for row in in_time(rows)])
        for rows in draws.values()
    ]
    lines.append("| tip_m, by ticks alone | " + " | ".join(ticks) + " |")
    for draw, rows in draws.items():
        none = Counter(_why_not(row) for row in rows if "truth" not in row)
        lines += ["", f"{draw}: {len(rows)} states; not compared: {dict(none)}"]
    return "\n".join(lines)


def _why_not(row: dict[str, Any]) -> str:
    """Return why a state is not compared; where the run has seen nothing, what its quarter ticks see."""
    beyond = row.get("beyond")
    return row["bars"]["reason"] or (f"quarter of the tick: {beyond}" if beyond else "no truth")


def _with_bar(row: dict[str, Any], key: str) -> tuple[float, float] | None:
    """Return the bar and the true error of a figure of a row; None without either."""
    found = compared(row, key)
    if found is None:
        return None
    others = TICK_FACTOR * row["swing"].get(key, 0.0) + row["bars"]["of_solver"].get(key, 0.0)
    return CALIBRATIONS[row["mesh"]].factors[key] * found[0] + others, found[2]


def _within(pairs: list[tuple[float, float]]) -> str:
    if not pairs:
        return "0 | | "
    bars, errors = np.array(pairs).T
    return f"{len(pairs)} | {100.0 * (bars >= errors).mean():.0f} % | {np.median(bars / errors):.1f}"


def run(draw: str, path: Path, cases: Sequence[int] = ()) -> None:
    """Run what has not been run yet of a draw, or of these of its cases; rows are added to a file."""
    known = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    done = {json.loads(line)["case"] for line in known}
    for case in drawn_cases(draw):
        if case.number in done or (cases and case.number not in cases):
            continue
        began = time.process_time()
        try:
            found = list(states(case))
        except CosimError as error:
            print(f"{draw} {case.number}: {error}"[:200], flush=True)
            continue
        with path.open("a", encoding="utf-8") as file:
            file.writelines(json.dumps(row) + "\n" for row in found)
        print(f"{draw} {case.number}: {time.process_time() - began:.1f} s", flush=True)


def known_rows(draw: str, path: Path) -> list[dict[str, Any]]:
    """Return the rows of a draw that a file has, each with the name of its calibration as its mesh."""
    names = {id(each): name for name, each in CALIBRATIONS.items()}
    meshes = {case.number: names[id(calibration_of(loaded(case)))] for case in drawn_cases(draw)}
    rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [row | {"mesh": meshes[row["case"]]} for row in rows]


def main() -> None:
    """Run the draws that are named, and show factors and table of all that has been run."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    options.add_argument("draws", nargs="*", choices=[*DRAWS, []], help="what is run")
    options.add_argument("--rows", type=Path, default=ROWS, help="folder of their rows")
    options.add_argument("--cases", type=int, nargs="+", default=[], help="these numbers of a draw alone")
    given = options.parse_args()
    paths = {draw: given.rows / f"run_error_{draw}.jsonl" for draw in DRAWS}
    for draw in given.draws:
        run(draw, paths[draw], given.cases)
    rows = {draw: known_rows(draw, path) for draw, path in paths.items() if path.exists()}
    calibration = [row for draw, found in rows.items() if draw != "held_out" for row in found]
    for mesh in CALIBRATIONS:
        print(fitted(mesh, [row for row in calibration if row["mesh"] == mesh]) + "\n")
    print(fitted_ticks(calibration) + "\n")
    print(table({"calibration": calibration, "held out": rows.get("held_out", [])}))


if __name__ == "__main__":
    main()
