"""Tip targets reached with sag compensation: statically, and held in the coupled dynamic run.

Each target is the tip's position and direction of an equilibrium that was followed to a random flange pose
(tilted by up to 90 degrees, within the UR5e's reach by its inverse kinematics) with random cable tensions:
so it can be reached. The search starts from the arm hanging straight down and knows nothing of that pose.
"Rigid guess" puts the flange where a straight arm of the present length would meet the target. The dynamic
run moves the arm from hanging to the found pose in 2 s and lets it settle; its error is the largest distance
of the tip over the last 0.5 s.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.arms import find_arm
from cosim.build.options import fidelity_body
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.config.schema.phase import FlangePoseTable, PhaseTable, StartTable, TipTargetTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import ConvergenceError, ScenarioError, UnreachableError
from cosim.kinematics.arm import Arm
from cosim.kinematics.inverse_kinematics import solve
from cosim.plan.flange_motion import FlangeMotion, pose_of
from cosim.plan.static_plan import start_equilibrium
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame, center_line_length, center_rings
from cosim.soft.solve import tip_target as search
from cosim.soft.solve.flange_search import find_flange_pose
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.step_scheme import StepOptions

START = FlangePoseTable((0.4, 0.0, 0.7), (0.0, 0.0, -1.0))
BOX = np.array([[0.3, 0.5], [-0.2, 0.2], [0.6, 0.8]])
PRESSURE_Pa = 30e3
TENSION_MAX_N = 5.0
TILT_MAX_RAD = 0.5 * np.pi
PIECES = 20
RAMP_S, SETTLE_S, WINDOW_S = 2.0, 4.0, 0.5
BOUNDS = {"tip_mm": 0.1, "tip_degrees": 0.1, "iterations": 8, "dynamic_tip_mm": 1.0}


@dataclass(frozen=True)
class Target:
    """A target that can be reached.

    Args:
        tilt_degrees: of the flange from hanging, where the target comes from.
        tension_N: of the cables.
        position: (3,) [m], of the tip.
        direction: (3,), of the tip.
    """

    tilt_degrees: float
    tension_N: tuple[float, ...]
    position: tuple[float, float, float]
    direction: tuple[float, float, float]


@dataclass(frozen=True)
class Figures:
    """What one target gave; errors of the tip in mm and degrees."""

    target: Target
    iterations: int
    tip_mm: float
    tip_degrees: float
    rigid_guess_mm: float
    rigid_guess_degrees: float
    arm_follows: bool
    dynamic_tip_mm: float | None = None
    dynamic_tip_degrees: float | None = None


class Bench:
    """The reference arm's static model and the scenario that its targets are run in."""

    def __init__(self) -> None:
        self.scenario = load_scenario("ur5e_hexagon_arm", {"model.published": True})
        self.arm = Arm(find_arm(self.scenario.robot))
        body = fidelity_body(self.scenario)
        self.soft = FilmRobot(body, pose_of(START), NewtonOptions(iterations_max=100), StepOptions())
        self.hanging = pose_of(START)

    def at_start(self, tension: tuple[float, ...]) -> Equilibrium:
        """Return the inflated arm hanging with its cables pulled."""
        return start_equilibrium(self.soft, self.hanging, Loads((PRESSURE_Pa,), tension))

    def walked(self, begin: Equilibrium, pose: Pose) -> Equilibrium:
        """Return the equilibrium followed to a flange pose in small pieces."""
        here, way = begin, FlangeMotion.to(begin.world_from_flange, pose)
        for k in range(1, PIECES + 1):
            here = self.soft.equilibrium_solver.follow(here, way.at(k / PIECES), begin.loads)
        return here

    def targets(self, seed: int = 0) -> Iterator[Target]:
        """Yield targets whose flange pose the arm can take."""
        rng = np.random.default_rng(seed)
        while True:
            tilt, azimuth = rng.uniform(0.0, TILT_MAX_RAD), rng.uniform(-np.pi, np.pi)
            position, tension = rng.uniform(*BOX.T), tuple(rng.uniform(0.0, TENSION_MAX_N, 2).tolist())
            turn = rotation_from_vector(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]))
            pose = Pose(turn @ self.hanging.rotation, position)
            try:
                solve(self.arm, pose, self.arm.home)
                there = self.walked(self.at_start(tension), pose)
            except (UnreachableError, ConvergenceError):
                continue
            tip = TipFrame.of(self.soft.body, there.state.positions)
            yield Target(float(np.degrees(tilt)), tension, _triple(tip.position), _triple(tip.direction))

    def measured(self, target: Target, *, dynamic: bool) -> Figures:
        """Return the figures of one target."""
        begin = self.at_start(target.tension_N)
        wanted = search.TipTarget(np.array(target.position), np.array(target.direction))
        found = find_flange_pose(self.soft.equilibrium_solver, begin, wanted)
        rigid = self.walked(begin, self._rigid_guess(begin, target))
        rigid_m, rigid_rad = wanted.distance(TipFrame.of(self.soft.body, rigid.state.positions))
        figures = Figures(
            target, found.iterations, 1e3 * found.position_error_m, float(np.degrees(found.angle_error_rad)),
            1e3 * rigid_m, float(np.degrees(rigid_rad)), arm_follows=True,
        )  # fmt: skip
        if not dynamic:
            return figures
        try:
            error_m, error_rad = held_in_motion(self.reaching(target), wanted)
        except ScenarioError:
            return replace(figures, arm_follows=False)
        return replace(
            figures, dynamic_tip_mm=1e3 * error_m, dynamic_tip_degrees=float(np.degrees(error_rad))
        )

    def _rigid_guess(self, begin: Equilibrium, target: Target) -> Pose:
        """Return the flange pose that would meet the target if the arm were straight along its axis."""
        turn = search.shortest_turn(self.hanging.rotation[:, 2], np.array(target.direction))
        length = center_line_length(center_rings(self.soft.body), begin.state.positions)
        origin = np.array(target.position) - length * np.array(target.direction)
        return Pose(rotation_from_vector(turn) @ self.hanging.rotation, origin)

    def reaching(self, target: Target) -> Scenario:
        """Return the scenario that goes from hanging to the target."""
        phase = PhaseTable(
            "reach", RAMP_S, SETTLE_S, tip_target=TipTargetTable(target.position, target.direction)
        )
        start = StartTable(START, PRESSURE_Pa, target.tension_N)
        return replace(self.scenario, start=start, phases=(phase,), mode="dynamic")


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = vector.tolist()
    return x, y, z


def held_in_motion(scenario: Scenario, wanted: search.TipTarget) -> tuple[float, float]:
    """Return the largest tip error (m, rad) in the last window of a dynamic run.

    Raises:
        ScenarioError: the arm cannot follow the way to the target.
    """
    simulation = build(scenario)
    last = simulation.stage.ticks - round(WINDOW_S / simulation.stage.tick_s)
    position = angle = 0.0
    for snapshot in simulation.steps():
        if snapshot.tick > last:
            assert wanted.position is not None
            assert wanted.direction is not None
            position = max(position, float(np.linalg.norm(snapshot.tip_position - wanted.position)))
            turn = search.shortest_turn(snapshot.tip_direction, wanted.direction)
            angle = max(angle, float(np.linalg.norm(turn)))
    return position, angle


def measure(count: int, *, dynamic: bool = True, seed: int = 0) -> list[Figures]:
    """Return the figures of the first targets.

    Args:
        count: of targets whose way the arm can follow; those it cannot are listed besides.
        dynamic: whether to run each in the coupled dynamic simulation.
        seed: of the random targets.
    """
    bench = Bench()
    found: list[Figures] = []
    targets = bench.targets(seed)
    while sum(entry.arm_follows for entry in found) < count:
        found.append(bench.measured(next(targets), dynamic=dynamic))
    return found


def summary(found: list[Figures], seconds: float) -> dict[str, Any]:
    """Return the largest and mean figures over all targets."""
    result: dict[str, Any] = {
        "targets": len(found),
        "arm_cannot_follow": sum(not entry.arm_follows for entry in found),
        "seconds": round(seconds, 1),
    }
    names = ("iterations", "tip_mm", "tip_degrees", "rigid_guess_mm", "rigid_guess_degrees")
    for name in (*names, "dynamic_tip_mm", "dynamic_tip_degrees"):
        values = [value for entry in found if (value := getattr(entry, name)) is not None]
        if values:
            result[name] = {"max": max(values), "mean": float(np.mean(values))}
        if values and name in BOUNDS:
            result[name]["within_bound"] = sum(value <= BOUNDS[name] for value in values)
    return result


def print_table(found: list[Figures], totals: dict[str, Any]) -> None:
    """Print a line per target and the totals."""
    print("  tilt  cables [N]   iterations  static [mm  deg]  rigid guess [mm  deg]  dynamic [mm  deg]")
    for entry in found:
        left, right = entry.target.tension_N
        motion = "the arm cannot follow the way"
        if entry.dynamic_tip_mm is not None and entry.dynamic_tip_degrees is not None:
            motion = f"{entry.dynamic_tip_mm:9.3f} {entry.dynamic_tip_degrees:5.3f}"
        elif entry.arm_follows:
            motion = ""
        print(
            f"{entry.target.tilt_degrees:6.1f}  {left:4.1f} {right:4.1f}  {entry.iterations:8d}    "
            f"{entry.tip_mm:9.1e} {entry.tip_degrees:8.1e}  {entry.rigid_guess_mm:9.1f} "
            f"{entry.rigid_guess_degrees:6.1f}    {motion}"
        )
    print(json.dumps(totals, indent=2))


def main() -> None:
    """Print the figures, as a table or as JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50, help="number of targets")
    parser.add_argument("--static", action="store_true", help="leave out the dynamic runs")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    arguments = parser.parse_args()
    began = time.perf_counter()
    found = measure(arguments.count, dynamic=not arguments.static)
    totals = summary(found, time.perf_counter() - began)
    if arguments.json:
        print(json.dumps({**totals, "bounds": BOUNDS, "each": [asdict(entry) for entry in found]}, indent=2))
    else:
        print_table(found, totals)


if __name__ == "__main__":
    main()
