"""An optimal design as a mathematical problem: one quantity is minimised, others are limited. Variables are
fractions of the range between the bounds of each parameter, by logarithms if the bounds are positive.
Quantities are divided by their size at the start.
"""

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.bench.equilibria import Equilibria, LoadRow, bench_scenario
from cosim.bench.outputs import outputs_of
from cosim.config import benches, loading
from cosim.config.schema import pattern, soft_robot
from cosim.config.schema.scenario import Scenario
from cosim.errors import ConvergenceError, InputError

MET: Final = 1e-3  # of a quantity's size, by which a limit may be missed
WEIGHT: Final = 10.0  # of missed limits beside the goal
_BAD: Final = 10.0  # sizes of the goal, of a design without an equilibrium
Wanted = benches.GoalTable | benches.LimitTable


@final
@dataclass(frozen=True)
class DesignValues:
    """A design and its quantities.

    Args:
        values: (parameters,), of the design.
        reached: (1 + limits,), quantity of the goal, then those of the limits.
    """

    values: Array
    reached: Array


@final
class DesignProblem:
    """Goal and limits as functions of fractions (parameters,) of the range from low to high.

    Attributes: `equilibria`; `history`, all designs that were solved.

    Args:
        study: checked table, with one choice.
        refined: whether the mesh is refined: a stack twice, a pattern to half the edge length.

    Raises:
        InputError: a parameter, load or quantity does not exist.
    """

    def __init__(self, study: benches.DesignStudyTable, *, refined: bool = False) -> None:
        self.study, self._names = study, [case.name for case in study.case]
        scenario = bench_scenario(study.scenario, {**study.set, "fidelity": "lumped"})
        if refined:
            scenario = _refined(scenario)
        rows = [
            LoadRow(f"case.{case.name}.loads", f"case.{case.name}", case.name, case.loads)
            for case in study.case
        ]
        self.equilibria = Equilibria(scenario, study.parameter, rows)
        self.wanted: tuple[Wanted, ...] = (study.goal, *study.limit)
        self._quantities = list(dict.fromkeys(entry.quantity for entry in self.wanted))
        for name in self._quantities:
            if len(outputs_of([name], self.equilibria.model)) != 1:
                raise InputError(f"{name}: means several numbers; name one, such as by .z")
        ends = np.array([(each.low, each.high) for each in study.parameter])
        self._logs = ends[:, 0] > 0.0
        self._low, high = self._scaled(ends[:, 0]), self._scaled(ends[:, 1])
        self._span = high - self._low
        self.start = self.fractions(self.equilibria.start)
        self.history: list[DesignValues] = []
        self._last: Array | None = None
        self._bounds = np.array([entry.bound for entry in study.limit])
        ways = [1.0 if entry.at_least is None else -1.0 for entry in study.limit]
        self.signs = np.array([1.0 if study.goal.sense == "least" else -1.0, *ways])
        self.scale, self.shift = np.ones(len(self.wanted)), np.zeros(len(self.wanted))

    @property
    def scenario(self) -> Scenario:
        """Scenario of the robot."""
        return self.equilibria.scenario

    def _picked(self, table: Array) -> Array:
        """Return goal and limits (1 + limits, ...) from outputs (cases, quantities, ...)."""
        found = []
        for entry in self.wanted:
            column = self._quantities.index(entry.quantity)
            row = 0 if entry.case is None else self._names.index(entry.case)
            less = 0.0 if entry.minus is None else table[self._names.index(entry.minus), column]
            found.append(table[row, column] - less)
        return np.array(found)

    def reached(self, fractions: Array) -> Array:
        """Return goal and limits (1 + limits,) with their correction; NaN without an equilibrium."""
        if self.is_at(fractions):
            return self.history[-1].reached
        values = self.values(fractions)
        self._last = fractions.copy()
        try:
            reached = self.solved(values) + self.shift
        except ConvergenceError:
            reached = np.full(len(self.wanted), np.nan)
        self.history.append(DesignValues(values, reached))
        return reached

    def is_at(self, fractions: Array) -> bool:
        """Return whether the last solved design has these fractions."""
        return self._last is not None and np.array_equal(self._last, fractions)

    def solved(self, values: Array) -> Array:
        """Return goal and limits (1 + limits,) at values (parameters,).

        Raises:
            ConvergenceError: there is no equilibrium.
        """
        self.equilibria.solve(values)
        return self._picked(self.equilibria.read(self._quantities))

    def fractions(self, values: Array) -> Array:
        """Return values (parameters,) as fractions of the range, by logarithms if low is above 0."""
        return np.asarray((self._scaled(values) - self._low) / self._span)

    def values(self, fractions: Array) -> Array:
        """Return fractions (parameters,) as values."""
        scaled = self._low + self._span * fractions
        return np.where(self._logs, np.exp(np.where(self._logs, scaled, 0.0)), scaled)

    def _scaled(self, values: Array) -> Array:
        return np.where(self._logs, np.log(np.where(self._logs, values, 1.0)), values)

    def correct(self, shift: Array) -> None:
        """Set the correction of goal and limits (1 + limits,), the difference to another mesh."""
        more, self.shift = shift - self.shift, shift
        self.history = [replace(each, reached=each.reached + more) for each in self.history]

    def uncorrected(self, design: DesignValues) -> Array:
        """Return goal and limits of a design without the correction."""
        return design.reached - self.shift

    def slopes(self, fractions: Array) -> Array:
        """Return the derivatives (1 + limits, parameters) of goal and limits by the fractions."""
        if not np.isfinite(self.reached(fractions)).all():
            return np.zeros((len(self.wanted), len(fractions)))
        return (
            self._picked(self.equilibria.jacobian(self._quantities, kinks=True))
            * self._span
            * np.where(self._logs, self.values(fractions), 1.0)
        )

    def begin(self) -> None:
        """Solve the start, and set the size of each quantity to its value there, or to a larger bound.

        Raises:
            ConvergenceError: the start has no equilibrium.
        """
        if not np.isfinite(self.reached(self.start)).all():
            self.equilibria.solve(self.equilibria.start)  # raises again
        last = np.nan_to_num(np.abs(self.history[-1].reached))
        scale = np.maximum(last, np.abs([0.0, *self._bounds]))
        self.scale = np.where(scale > 0.0, scale, 1.0)

    def cost(self, reached: Array) -> float:
        """Return the goal over its size, which is minimised."""
        value = float(reached[0] / self.scale[0])
        return float(self.signs[0]) * value if np.isfinite(value) else _BAD

    def off(self, reached: Array) -> Array:
        """Return the signed violation (limits,) of limits over their size; below 0 within a limit."""
        return np.asarray(self.signs[1:] * (reached[1:] - self._bounds) / self.scale[1:])

    def missed(self, reached: Array) -> Array:
        """Return the violation (limits,) of limits over their size; infinite without an equilibrium."""
        off = self.off(reached)
        equal = np.array([entry.equal is not None for entry in self.study.limit], dtype=bool)
        return np.where(np.isfinite(off), np.maximum(np.where(equal, np.abs(off), off), 0.0), np.inf)

    def best(self) -> DesignValues:
        """Return the design of least cost that meets all limits; if none does, that of least violation."""

        def rank(design: DesignValues) -> tuple[float, float]:
            most = float(self.missed(design.reached).max(initial=0.0))
            bad = not np.isfinite(design.reached).all()
            return (np.inf if bad else max(most, MET), self.cost(design.reached))

        return min(self.history, key=rank)

    def merit(self, reached: Array) -> float:
        """Return the cost plus the weighted violation of limits, which a step must decrease."""
        return self.cost(reached) + WEIGHT * float(np.minimum(self.missed(reached), _BAD).sum())


def _refined(scenario: Scenario) -> Scenario:
    robot = scenario.soft_robot
    body = robot.body if isinstance(robot, soft_robot.SoftRobotTable) else None
    if not isinstance(body, pattern.PatternTable):
        return loading.load_scenario(scenario, {"fidelity": "refined"})
    if body.mesh_m is None:
        raise InputError("a pattern is verified on edges of half the length: set soft_robot.body.mesh_m")
    return loading.load_scenario(scenario, {"soft_robot.body.mesh_m": 0.5 * body.mesh_m})
