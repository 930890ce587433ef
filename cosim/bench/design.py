"""Finds values of a robot that minimise a quantity within limits, with exact derivatives of its equilibria.
Each step is the minimum of a local second-order model within a trust region, by SLSQP of scipy. If the robot
has no equilibrium at a design, the step is shortened. The difference between the refined mesh and the robot's
mesh is added to goal and limits as a constant, and is computed again at the end of the search.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.bench.design_problem import MET, WEIGHT, DesignProblem, DesignValues, Wanted
from cosim.config import benches
from cosim.config.toml.keys import unit_of, unit_text
from cosim.errors import ConvergenceError

_CLOSE: Final = 5e-4
_ROUNDS: Final = 4
_REACH, _LEAST_REACH = 0.25, 2e-3  # largest step and smallest trust region, in fractions
_GAINED: Final = 0.1  # smallest ratio of gain and predicted gain of an accepted step


@final
@dataclass(frozen=True)
class Designed:
    """Result of a study, for one choice.

    Args:
        study: table with the choice in `set`.
        choice: name of the choice, with the number of the start if there are several; may be empty.
        start: initial design.
        found: best design, on the robot's mesh.
        refined: goal and limits of both designs on the refined mesh; empty if it was not solved.
        missed: violation (limits,) of limits over the size of their quantity; on the refined mesh if that was
            solved.
        evaluations: number of designs that were solved.
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
        return bool((self.missed <= MET).all())

    @property
    def wanted(self) -> tuple[Wanted, ...]:
        """The goal, then the limits."""
        return (self.study.goal, *self.study.limit)


@final
class _Local:
    """A second-order model of goal and limits near a design, with exact slopes and quasi-Newton curvatures.

    Args:
        problem: goal and limits.
        here: fractions (parameters,) of the design.
    """

    def __init__(self, problem: DesignProblem, here: Array) -> None:
        self.problem, self.here = problem, here
        self.reached, self.slopes = problem.reached(here), problem.slopes(here)
        self._bends = np.zeros((len(self.reached), len(here), len(here)))

    def learn(self, step: Array, slopes: Array) -> None:
        """Update the curvatures from slopes (1 + limits, parameters) after a step (symmetric rank one)."""
        for bend, change in zip(self._bends, slopes - self.slopes, strict=True):
            left = change - bend @ step
            along = float(left @ step)
            if abs(along) > 1e-8 * float(np.linalg.norm(left) * np.linalg.norm(step)):
                bend += np.outer(left, left) / along

    def at(self, step: Array) -> Array:
        """Return goal and limits (1 + limits,) after a step."""
        return np.asarray(self.reached + self.slopes @ step + 0.5 * (self._bends @ step) @ step)

    def slopes_at(self, step: Array) -> Array:
        """Return the derivatives (1 + limits, parameters) of goal and limits after a step."""
        return np.asarray(self.slopes + self._bends @ step)

    def best(self, reach: float) -> tuple[Array, float]:
        """Return the best step within the trust region, and its predicted gain of merit.

        It is found by SLSQP, with a slack for each limit, so that a step exists if limits cannot be met yet.
        """
        from scipy.optimize import minimize  # here: it takes long to load

        problem, count, limits = self.problem, len(self.here), len(self.problem.study.limit)
        away = self.problem.off(self.reached)
        least, most = np.maximum(-reach, -self.here), np.minimum(reach, 1.0 - self.here)
        bounds = [*zip(least, most, strict=True), *[(0.0, None)] * limits]
        weights = np.full(limits, WEIGHT)

        def room(z: Array, way: float) -> Array:
            return np.asarray(z[count:] - way * problem.off(self.at(z[:count])))

        def room_slope(z: Array, way: float) -> Array:
            slopes = problem.signs[1:, None] * self.slopes_at(z[:count])[1:] / problem.scale[1:, None]
            return np.concatenate([-way * slopes, np.eye(limits)], axis=1)

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
    """Return the best design, once the local model predicts no more gain or all evaluations are used.

    Args:
        problem: goal and limits, with their sizes.
        start: initial fractions (parameters,).
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
        """Name for people."""
        return " ".join(
            filter(None, (self.choice, f"start {self.begin + 1}" if self.study.starts > 1 else ""))
        )

    def solved(self) -> Designed | ConvergenceError:
        """Return the result, or the error of a start without an equilibrium."""
        try:
            return solve_choice(self)
        except ConvergenceError as error:
            return error


def solve_choice(task: DesignTask) -> Designed:
    """Return the best design of one choice, from one start.

    With `verify`, a design that meets its limits is solved on the refined mesh as well. The difference is
    added to goal and limits, and the search continues, until the limits are met on the refined mesh.

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
    if task.verify and (problem.missed(found.reached) <= MET).all():
        fine = DesignProblem(study, refined=True)
        before, after = fine.solved(first.values), fine.solved(found.values)
        for _ in range(_ROUNDS):
            if (problem.missed(after) <= MET).all() or len(problem.history) >= study.evaluations:
                break
            problem.correct(after - problem.uncorrected(found))
            found = search(problem, problem.fractions(found.values))
            after = fine.solved(found.values)
        refined = before, after
    reached = refined[-1] if refined else found.reached
    on_mesh = DesignValues(found.values, problem.uncorrected(found))
    return Designed(study, task.name, first, on_mesh, refined, problem.missed(reached), len(problem.history))


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
        tell: called with messages of progress.

    Raises:
        InputError: a parameter, load or quantity does not exist.
        ConvergenceError: no choice has an equilibrium at its start.
    """
    kinds = [(replace(study, set={**study.set, **choice.set}), choice.name) for choice in study.choice]
    tasks = [
        DesignTask(of_choice, name, begin, verify)
        for of_choice, name in kinds or [(study, "")]
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
    """Return the unit of a parameter for people; for a load, that of the load."""
    loads = [load for case in study.case for load, value in case.loads.items() if value == key]
    name = loads[0].partition(".")[0] if loads else key
    while name.rpartition(".")[2].isdecimal():
        name = name.rpartition(".")[0]
    return unit_text(unit_of(name.rpartition(".")[2] or name)) or "1"


def design_lines(found: Designed) -> list[str]:
    """Return a line for each parameter and each quantity, with values before and after."""
    lines = []
    pairs = zip(found.study.parameter, found.start.values, found.found.values, strict=True)
    for entry, before, after in pairs:
        names = ", ".join((entry.key, *entry.also))
        end = "; at its bound" if _at_bound(entry, after) else ""
        lines.append(f"{names}: {before:.6g} -> {after:.6g} {unit_of_key(found.study, entry.key)}{end}")
    return [*lines, *_quantity_lines(found)]


def _at_bound(entry: benches.FreeTable, value: float) -> bool:
    return min(value - entry.low, entry.high - value) < MET * (entry.high - entry.low)


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
            met = "met" if found.missed[k - 1] <= MET else "NOT met"
            what = f"{where} {kind.replace('_', ' ')} {entry.bound:g} {unit} ({met})"
        line = f"{what}: {found.start.reached[k]:.5g} -> {found.found.reached[k]:.5g} {unit}"
        if found.refined:
            line += f"; refined mesh {found.refined[0][k]:.5g} -> {found.refined[1][k]:.5g}"
        lines.append(line)
    return lines
