"""Values of a robot that make a quantity least within limits, by exact derivatives of its equilibria.

scipy's SLSQP: variables are shares of the way between their bounds, quantities are divided by their size at
the start. A design whose robot has no equilibrium is as bad as can be, so the step to it is shortened. What a
refined mesh changes is added to goal and limits as a constant, and found again where the search ends.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.bench.equilibria import Equilibria, LoadRow, bench_scenario, outputs_of
from cosim.config import benches, loading
from cosim.config.schema import pattern, soft_robot
from cosim.config.schema.scenario import Scenario
from cosim.config.toml.keys import unit_of, unit_text
from cosim.errors import ConvergenceError, InputError

_MET: Final = 1e-3  # of a quantity's size, by which a limit may be missed
_CLOSE: Final = 5e-4
_ROUNDS: Final = 4
_REACH, _LEAST_REACH = 0.25, 2e-3  # shares that a value moves in a step
_GAINED: Final = 0.1  # of the predicted gain, with which a step is taken
_WEIGHT: Final = 10.0  # of missed limits beside the goal
_BAD: Final = 10.0  # sizes of the goal, of a design without an equilibrium

Wanted = benches.GoalTable | benches.LimitTable


@final
@dataclass(frozen=True)
class DesignValues:
    """A design, and what it reaches.

    Args:
        values: (parameters,).
        reached: (1 + limits,), of the goal, then of the limits.
    """

    values: Array
    reached: Array


@final
@dataclass(frozen=True)
class Designed:
    """What a study has led to, for one choice.

    Args:
        study: with the choice in `set`.
        choice: its name, and that of the start where there are several; "" with neither.
        start: where the search began; without what it reaches where it has no equilibrium.
        found: the best design, on its own mesh.
        refined: what both reach on the refined mesh; empty if it was not asked for.
        missed: by how much (limits,) limits are missed, over their quantity's size; on the refined mesh if
            that was solved.
        evaluations: designs that were solved.
    """

    study: benches.DesignStudyTable
    choice: str
    start: DesignValues
    found: DesignValues
    refined: tuple[Array, ...]
    missed: Array
    evaluations: int

    @property
    def feasible(self) -> bool:
        """Whether all limits are met."""
        return bool((self.missed <= _MET).all())

    @property
    def wanted(self) -> tuple[Wanted, ...]:
        """The goal, then the limits."""
        return (self.study.goal, *self.study.limit)


@final
class DesignProblem:
    """Goal and limits as functions of shares (parameters,) of the way from low to high.

    Attributes: `equilibria`; `history`, all designs that were solved.

    Args:
        study: checked, of one choice.
        refined: whether the mesh is refined: a stack's twice, a pattern's to edges of half the length.

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
        self.start = self.shares(self.equilibria.start)
        self.history: list[DesignValues] = []
        self._last: Array | None = None
        self._bounds = np.array([entry.bound for entry in study.limit])
        ways = [1.0 if entry.at_least is None else -1.0 for entry in study.limit]
        self.signs = np.array([1.0 if study.goal.sense == "least" else -1.0, *ways])
        self.scale, self.shift = np.ones(len(self.wanted)), np.zeros(len(self.wanted))

    @property
    def scenario(self) -> Scenario:
        """Whose robot it is."""
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

    def reached(self, shares: Array) -> Array:
        """Return goal and limits (1 + limits,), corrected; not numbers where there is no equilibrium."""
        if self.is_at(shares):
            return self.history[-1].reached
        values = self.values(shares)
        self._last = shares.copy()
        try:
            found = self.solved(values) + self.shift
        except ConvergenceError:
            found = np.full(len(self.wanted), np.nan)
        self.history.append(DesignValues(values, found))
        return found

    def is_at(self, shares: Array) -> bool:
        """Whether the last design that was solved is at these shares."""
        return self._last is not None and np.array_equal(self._last, shares)

    def solved(self, values: Array) -> Array:
        """Return goal and limits (1 + limits,) at values (parameters,).

        Raises:
            ConvergenceError: there is no equilibrium.
        """
        self.equilibria.solve(values)
        return self._picked(self.equilibria.read(self._quantities))

    def shares(self, values: Array) -> Array:
        """Return values (parameters,) as shares of the way to high, by logarithms if low is above 0."""
        return np.asarray((self._scaled(values) - self._low) / self._span)

    def values(self, shares: Array) -> Array:
        """Return shares (parameters,) as values."""
        scaled = self._low + self._span * shares
        return np.where(self._logs, np.exp(np.where(self._logs, scaled, 0.0)), scaled)

    def _scaled(self, values: Array) -> Array:
        return np.where(self._logs, np.log(np.where(self._logs, values, 1.0)), values)

    def correct(self, shift: Array) -> None:
        """Add to goal and limits (1 + limits,) from now on what another mesh changes of them."""
        more, self.shift = shift - self.shift, shift
        self.history = [replace(each, reached=each.reached + more) for each in self.history]

    def plain(self, design: DesignValues) -> Array:
        """Return what a design reaches without correction."""
        return design.reached - self.shift

    def slopes(self, shares: Array) -> Array:
        """Return their derivatives (1 + limits, parameters)."""
        if not np.isfinite(self.reached(shares)).all():
            return np.zeros((len(self.wanted), len(shares)))
        return (
            self._picked(self.equilibria.jacobian(self._quantities, kinks=True))
            * self._span
            * np.where(self._logs, self.values(shares), 1.0)
        )

    def begin(self) -> None:
        """Solve the start, and divide by sizes there: of what a limit gives, or what is reached.

        Raises:
            ConvergenceError: it has no equilibrium.
        """
        if not np.isfinite(self.reached(self.start)).all():
            self.equilibria.solve(self.equilibria.start)  # raises again
        last = np.nan_to_num(np.abs(self.history[-1].reached))
        scale = np.maximum(last, np.abs([0.0, *self._bounds]))
        self.scale = np.where(scale > 0.0, scale, 1.0)

    def cost(self, reached: Array) -> float:
        """Return the goal over its size, to be made least."""
        value = float(reached[0] / self.scale[0])
        return float(self.signs[0]) * value if np.isfinite(value) else _BAD

    def off(self, reached: Array) -> Array:
        """Return by how much (limits,) limits are passed, over their size; below 0 what is left to them."""
        return np.asarray(self.signs[1:] * (reached[1:] - self._bounds) / self.scale[1:])

    def missed(self, reached: Array) -> Array:
        """Return by how much (limits,) limits are missed, over their size; infinite without equilibrium."""
        off = self.off(reached)
        equal = np.array([entry.equal is not None for entry in self.study.limit], dtype=bool)
        return np.where(np.isfinite(off), np.maximum(np.where(equal, np.abs(off), off), 0.0), np.inf)

    def best(self) -> DesignValues:
        """Return the design that meets all limits at least cost, or misses them least."""

        def rank(design: DesignValues) -> tuple[float, float]:
            most = float(self.missed(design.reached).max(initial=0.0))
            bad = not np.isfinite(design.reached).all()
            return (np.inf if bad else max(most, _MET), self.cost(design.reached))

        return min(self.history, key=rank)

    def merit(self, reached: Array) -> float:
        """Return the cost with what limits are missed by, by which steps are judged."""
        return self.cost(reached) + _WEIGHT * float(np.minimum(self.missed(reached), _BAD).sum())


def _refined(scenario: Scenario) -> Scenario:
    robot = scenario.soft_robot
    body = robot.body if isinstance(robot, soft_robot.SoftRobotTable) else None
    if not isinstance(body, pattern.PatternTable):
        return loading.load_scenario(scenario, {"fidelity": "refined"})
    if body.mesh_m is None:
        raise InputError("a pattern is verified on edges of half the length: set soft_robot.body.mesh_m")
    return loading.load_scenario(scenario, {"soft_robot.body.mesh_m": 0.5 * body.mesh_m})


@final
class _Local:
    """Goal and limits near a design, to second order: exact slopes, and what they have changed by so far.

    Args:
        problem: whose.
        here: shares (parameters,).
    """

    def __init__(self, problem: DesignProblem, here: Array) -> None:
        self.problem, self.here = problem, here
        self.reached, self.slopes = problem.reached(here), problem.slopes(here)
        self._bends = np.zeros((len(self.reached), len(here), len(here)))

    def learn(self, step: Array, slopes: Array) -> None:
        """Take in the slopes (1 + limits, parameters) a step away (symmetric rank-one update)."""
        for bend, change in zip(self._bends, slopes - self.slopes, strict=True):
            left = change - bend @ step
            along = float(left @ step)
            if abs(along) > 1e-8 * float(np.linalg.norm(left) * np.linalg.norm(step)):
                bend += np.outer(left, left) / along

    def at(self, step: Array) -> Array:
        """Return goal and limits (1 + limits,) a step away."""
        return np.asarray(self.reached + self.slopes @ step + 0.5 * (self._bends @ step) @ step)

    def slopes_at(self, step: Array) -> Array:
        """Return their derivatives (1 + limits, parameters) there."""
        return np.asarray(self.slopes + self._bends @ step)

    def best(self, reach: float) -> tuple[Array, float]:
        """Return the step within reach of which most is expected, and the gain of merit that is.

        By SLSQP, with a slack for each limit, so that steps exist where limits cannot be met yet.
        """
        from scipy.optimize import minimize  # here: it takes long to load

        problem, count, limits = self.problem, len(self.here), len(self.problem.study.limit)
        away = self.problem.off(self.reached)
        least, most = np.maximum(-reach, -self.here), np.minimum(reach, 1.0 - self.here)
        bounds = [*zip(least, most, strict=True), *[(0.0, None)] * limits]
        weights = np.full(limits, _WEIGHT)

        def room(z: Array, way: float) -> Array:
            return np.asarray(z[count:] - way * problem.off(self.at(z[:count])))

        def room_slope(z: Array, way: float) -> Array:
            own = problem.signs[1:, None] * self.slopes_at(z[:count])[1:] / problem.scale[1:, None]
            return np.concatenate([-way * own, np.eye(limits)], axis=1)

        both = np.array([entry.equal is not None for entry in problem.study.limit], dtype=bool)
        held = [{"type": "ineq", "fun": lambda z: room(z, 1.0), "jac": lambda z: room_slope(z, 1.0)}]
        if both.any():
            held.append({
                "type": "ineq", "fun": lambda z: room(z, -1.0)[both],
                "jac": lambda z: room_slope(z, -1.0)[both],
            })  # fmt: skip
        begin = np.concatenate([np.zeros(count), np.where(both, np.abs(away), np.maximum(away, 0.0))])
        found = minimize(
            lambda z: problem.cost(self.at(z[:count])) + float(weights @ z[count:]), begin, method="SLSQP",
            jac=lambda z: np.concatenate([
                problem.signs[0] * self.slopes_at(z[:count])[0] / problem.scale[0], weights
            ]), bounds=bounds, constraints=held if limits else (), options={"ftol": 1e-8, "maxiter": 100},
        )  # fmt: skip
        step = np.clip(found.x[:count], least, most)
        return step, problem.merit(self.reached) - problem.merit(self.at(step))


def search(problem: DesignProblem, start: Array) -> DesignValues:
    """Return where the local model expects no more gain, or the best design once evaluations are spent.

    Args:
        problem: whose present sizes it takes.
        start: shares (parameters,) where it begins.
    """
    local, reach, most = _Local(problem, np.clip(start, 0.0, 1.0)), _REACH, problem.study.evaluations
    while reach > _LEAST_REACH and len(problem.history) < most:
        step, expected = local.best(reach)
        if expected < _CLOSE:
            break
        ahead, size = problem.reached(local.here + step), float(np.abs(step).max())
        gain, slopes = problem.merit(local.reached) - problem.merit(ahead), problem.slopes(local.here + step)
        if np.isfinite(ahead).all():
            local.learn(step, slopes)
        if gain > _GAINED * expected:
            local.here, local.reached, local.slopes = local.here + step, ahead, slopes
            reach = min(2.0 * reach, _REACH) if gain > 0.7 * expected else reach
        else:
            reach = 0.4 * size
    return problem.best()


@final
@dataclass(frozen=True)
class DesignTask:
    """A search for a worker.

    Args:
        study: with the choice in `set`.
        choice: its name; "" without choices.
        begin: number of the start; 0 is that of the file.
        verify: whether the design is verified on the refined mesh, see `solve_choice`.
    """

    study: benches.DesignStudyTable
    choice: str = ""
    begin: int = 0
    verify: bool = True

    @property
    def name(self) -> str:
        """As people read it."""
        return " ".join(
            filter(None, (self.choice, f"start {self.begin + 1}" if self.study.starts > 1 else ""))
        )

    def solved(self) -> Designed | ConvergenceError:
        """Return what it leads to, or why there is nothing."""
        try:
            return solve_choice(self)
        except ConvergenceError as error:
            return error


def solve_choice(task: DesignTask) -> Designed:
    """Return the best design of one choice, from one start.

    With `verify`, one that meets its limits is solved on the refined mesh. What that mesh changes is then
    added to goal and limits, and the search goes on from there, until the refined mesh meets the limits.

    Args:
        task: choice and start.

    Raises:
        InputError: a parameter, load or quantity does not exist.
        ConvergenceError: the robot has no equilibrium at the start, or on the refined mesh.
    """
    study = task.study
    problem = DesignProblem(study)
    if task.begin:
        random = np.random.default_rng((study.seed, task.begin))
        problem.start = random.random(len(study.parameter))
    problem.begin()
    first, found = problem.history[0], search(problem, problem.start)
    refined: tuple[Array, ...] = ()
    if task.verify and (problem.missed(found.reached) <= _MET).all():
        fine = DesignProblem(study, refined=True)
        before, after = fine.solved(first.values), fine.solved(found.values)
        for _ in range(_ROUNDS):
            if (problem.missed(after) <= _MET).all() or len(problem.history) >= study.evaluations:
                break
            problem.correct(after - problem.plain(found))
            found = search(problem, problem.shares(found.values))
            after = fine.solved(found.values)
        refined = before, after
    reached = refined[-1] if refined else found.reached
    plain = DesignValues(found.values, problem.plain(found))
    return Designed(study, task.name, first, plain, refined, problem.missed(reached), len(problem.history))


def design(
    study: benches.DesignStudyTable,
    *,
    verify: bool = True,
    each: Callable[..., Iterable[Designed | ConvergenceError]] = map,
    tell: Callable[[str], None] = lambda _text: None,
) -> list[Designed]:
    """Return the best design of every choice and start, the best one first.

    Args:
        study: see `load_design_study`.
        verify: whether designs are verified on the refined mesh, see `solve_choice`.
        each: calls a function with each of some tasks, such as the `map` of an executor.
        tell: told what is done.

    Raises:
        InputError: a parameter, load or quantity does not exist.
        ConvergenceError: no choice has an equilibrium at its start.
    """
    kinds = [(replace(study, set={**study.set, **choice.set}), choice.name) for choice in study.choice]
    tasks = [
        DesignTask(own, name, begin, verify)
        for own, name in kinds or [(study, "")]
        for begin in range(study.starts)
    ]
    results, failed = list[tuple[bool, float, Designed]](), None
    for task, found in zip(tasks, each(DesignTask.solved, tasks), strict=True):
        if isinstance(found, ConvergenceError):
            failed = found
            tell(f"{task.name or 'start'}: {found}")
            continue
        results.append((not found.feasible, _goal(found), found))
        tell(f"{found.choice or 'designed'}: {found.evaluations} designs solved")
    if not results:
        assert failed is not None, "a study has a choice, or is one"
        raise failed
    return [found for *_, found in sorted(results, key=lambda entry: entry[:2])]


def _goal(found: Designed) -> float:
    value = float((found.refined[-1] if found.refined else found.found.reached)[0])
    return value if found.study.goal.sense == "least" else -value


def unit_of_key(study: benches.DesignStudyTable, key: str) -> str:
    """Return the unit of a parameter as people write it: that of the load that has its name, if any."""
    loads = [load for case in study.case for load, value in case.loads.items() if value == key]
    name = loads[0].partition(".")[0] if loads else key
    while name.rpartition(".")[2].isdecimal():
        name = name.rpartition(".")[0]
    return unit_text(unit_of(name.rpartition(".")[2] or name)) or "1"


def design_lines(found: Designed) -> list[str]:
    """Return a line for each value and for each quantity, before and after."""
    lines = []
    pairs = zip(found.study.parameter, found.start.values, found.found.values, strict=True)
    for entry, before, after in pairs:
        names = ", ".join((entry.key, *entry.also))
        end = "; at its bound" if _at_bound(entry, after) else ""
        lines.append(f"{names}: {before:.6g} -> {after:.6g} {unit_of_key(found.study, entry.key)}{end}")
    return [*lines, *_quantity_lines(found)]


def _at_bound(entry: benches.FreeTable, value: float) -> bool:
    return min(value - entry.low, entry.high - value) < _MET * (entry.high - entry.low)


def _quantity_lines(found: Designed) -> Sequence[str]:
    lines = []
    for k, entry in enumerate(found.wanted):
        unit = unit_text(unit_of(entry.quantity.partition(".")[0])) or "1"
        where = f"{entry.quantity} in {entry.case or found.study.case[0].name}"
        where += f" less that in {entry.minus}" if entry.minus else ""
        if isinstance(entry, benches.GoalTable):
            what = f"{entry.sense} {where}"
        else:
            kind = next(key for key in ("at_least", "at_most", "equal") if getattr(entry, key) is not None)
            met = "met" if found.missed[k - 1] <= _MET else "NOT met"
            what = f"{where} {kind.replace('_', ' ')} {entry.bound:g} {unit} ({met})"
        line = f"{what}: {found.start.reached[k]:.5g} -> {found.found.reached[k]:.5g} {unit}"
        if found.refined:
            line += f"; refined mesh {found.refined[0][k]:.5g} -> {found.refined[1][k]:.5g}"
        lines.append(line)
    return lines
