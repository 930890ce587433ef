"""Tip heights that cable tensions reach: all of them have to be found.

30 designs of a tapered polygonal arm (sides, units, taper, radius, film, pressure and tilt of the flange
drawn at random) hang, are inflated and turned as in the reference scenario. Each height is that of an
equilibrium followed in small increments to random tensions of 2 to 15 N, every second time the same in both
cables: so it can be reached. The search starts without tension and knows nothing of those. "Held" counts the
heights at which the motion that a plan makes of it ends.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace

import numpy as np

from cosim.base.frames import Array, Pose, rotation_from_vector
from cosim.build.options import fidelity_body
from cosim.config.loading import load_scenario
from cosim.config.schema.phase import TipTargetTable
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.errors import ConvergenceError, UnreachableError
from cosim.plan.tip_targets import reach
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.step_scheme import StepOptions
from cosim.soft.solve.tension_search import find_tensions
from cosim.soft.solve.tip_target import TipTarget

DESIGNS, TARGETS = 30, 200
TENSION_N = (2.0, 15.0)
INCREMENTS = 30
TURN_PIECES = 6
HELD_MM = 0.1
HANGING = Pose(np.diag([1.0, -1.0, -1.0]), np.array([0.3, 0.0, 0.7]))


@dataclass(frozen=True)
class Design:
    """An arm and how it is held."""

    sides: int
    units: int
    taper: float
    corner_radius_m: float
    thickness_m: float
    pressure_Pa: float
    tilt_rad: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Design:
        """Draw one at random."""
        return cls(
            sides=int(rng.integers(5, 9)),
            units=int(rng.integers(5, 11)),
            taper=float(rng.uniform(0.94, 1.0)),
            corner_radius_m=float(rng.uniform(0.04, 0.06)),
            thickness_m=float(rng.uniform(0.08e-3, 0.15e-3)),
            pressure_Pa=float(rng.uniform(15e3, 40e3)),
            tilt_rad=float(rng.uniform(0.15, 0.5) * np.pi),
        )


@dataclass(frozen=True)
class Height:
    """A height that can be reached, and what the search made of it."""

    tension_N: tuple[float, ...]
    height_m: float
    found_N: tuple[float, ...] | None
    held_mm: float | None
    iterations: int
    message: str = ""


class Bench:
    """One design, inflated and turned, its cables slack."""

    def __init__(self, design: Design) -> None:
        cables = [
            {"name": f"c{k}", "corner": k, "units": [1, design.units], "capstan_factor": 0.8} for k in (0, 1)
        ]
        changes = {
            "model.published": True,
            "soft_robot.stack.sides": design.sides,
            "soft_robot.stack.units": design.units,
            "soft_robot.stack.taper": design.taper,
            "soft_robot.stack.corner_radius_m": design.corner_radius_m,
            "soft_robot.stack.first_corner_rad": -np.pi / design.sides,
            "soft_robot.film.thickness_m": design.thickness_m,
            "soft_robot.cable": cables,
        }
        scenario = load_scenario("ur5e_hexagon_arm", changes)
        body = fidelity_body(scenario)
        self.soft = FilmRobot(body, HANGING, NewtonOptions(iterations_max=100), StepOptions())
        here = self.soft.start(HANGING, Loads((design.pressure_Pa,), (0.0, 0.0)))
        for k in range(1, TURN_PIECES + 1):
            turn = rotation_from_vector(np.array([0.0, -design.tilt_rad * k / TURN_PIECES, 0.0]))
            here = self.soft.follow(here, Pose(turn @ HANGING.rotation, HANGING.translation), here.loads)
        self.slack = here

    def height(self, here: Equilibrium) -> float:
        """Return the tip's height [m]."""
        return float(self.soft.body.tip_position(here.state.positions)[2])

    def pulled(self, tension_N: tuple[float, ...], increments: int) -> Equilibrium:
        """Return the equilibrium followed to cable tensions."""
        here, end = self.slack, replace(self.slack.loads, cable_tension_N=tension_N)
        for k in range(1, increments + 1):
            here = self.soft.follow(
                here, here.world_from_flange, self.slack.loads.interpolated(end, k / increments)
            )
        return here

    def measured(self, tension_N: tuple[float, ...]) -> Height:
        """Return what the search makes of the height at given tensions.

        Raises:
            ConvergenceError: there is no equilibrium at these tensions.
        """
        height = self.height(self.pulled(tension_N, INCREMENTS))
        try:
            found = find_tensions(self.soft.equilibrium_solver, self.slack, TipTarget(height=height))
        except UnreachableError as error:
            return Height(tension_N, height, None, None, error.closest.iterations, str(error))
        tension = found.equilibrium.loads.cable_tension_N
        try:
            _, end = reach(
                self.soft, self.slack, self.slack.loads, TipTargetTable(height_m=height, reach_with="cables")
            )
        except UnreachableError as error:
            return Height(tension_N, height, tension, None, found.iterations, str(error))
        return Height(tension_N, height, tension, 1e3 * abs(self.height(end) - height), found.iterations)


def draws(rng: np.random.Generator) -> Iterator[tuple[float, ...]]:
    """Yield random tensions of the two cables, in turn the same and not."""
    while True:
        one: Array = rng.uniform(*TENSION_N, 2)
        yield float(one[0]), float(one[0])
        yield float(one[0]), float(one[1])


def measure(designs: int, targets: int, seed: int = 0) -> Iterator[tuple[Design, Height]]:
    """Yield the heights of all designs, as many of each as make up the wanted number."""
    rng = np.random.default_rng(seed)
    for index in range(designs):
        count = (index + 1) * targets // designs - index * targets // designs
        design = Design.drawn(rng)
        bench, tensions = Bench(design), draws(rng)
        while count:
            try:
                height = bench.measured(next(tensions))
            except ConvergenceError:
                continue
            count -= 1
            yield design, height


def main() -> None:
    """Print every height that was missed, and how many were found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--designs", type=int, default=DESIGNS)
    parser.add_argument("--targets", type=int, default=TARGETS)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    heights = []
    for design, height in measure(arguments.designs, arguments.targets, arguments.seed):
        heights.append(height)
        if height.held_mm is None or height.held_mm > HELD_MM:
            print(json.dumps({"design": asdict(design), **asdict(height)}), flush=True)
    held = [height.held_mm for height in heights if height.held_mm is not None]
    print(f"found: {sum(height.found_N is not None for height in heights)} of {len(heights)}")
    print(f"held: {sum(error <= HELD_MM for error in held)}, within {max(held):.4f} mm")
    print(f"iterations: at most {max(height.iterations for height in heights)}")


if __name__ == "__main__":
    main()
