"""Effort of a search for equilibria: its iterations, their bound, and reports of its progress."""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Final, final

from cosim.errors import ConvergenceError
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult

_SILENT_S: Final = 2.0
"""Wall time after which a search first reports its progress; then after twice the time, and so on."""
_FORESEEN: Final = 0.1
"""Share of the iterations that a search may take, from which on its longest time can be foretold."""


def say_nothing(_what: object) -> None:
    """Do nothing."""


def _do_nothing() -> None:
    """Do nothing."""


@final
class SearchEffort:
    """Counts the Newton iterations of a search, ends it at a bound, and reports its progress.

    A search is all solutions for one result, such as the continuation of an equilibrium, or the trials for a
    tip target. A search within a search counts as part of it. Attributes: `work`, iterations and failed
    factorisations of all searches; `patience`, iterations within which a slide must halve the residual;
    `check`, called at every new tangent, which ends the search by raising.

    Args:
        iterations_max: iterations that one search may take.
    """

    def __init__(self, iterations_max: int) -> None:
        self.iterations_max, self.spent, self._left, self._residual_N = iterations_max, 0, "", math.inf
        self.place, self.activity, self._bound = "", "", iterations_max
        self.report: Callable[[str], None] = say_nothing
        self.check: Callable[[], None] = _do_nothing
        self.work, self.patience = 0, math.inf
        self._within: list[str] = []
        self._began = self._next = 0.0

    @contextmanager
    def at(self, place: str) -> Iterator[None]:
        """Report searches in this context as being of `place`.

        Args:
            place: such as the key of a phase.
        """
        before, self.place = self.place, place
        try:
            yield
        finally:
            self.place = before

    @contextmanager
    def search(self, what: str) -> Iterator[None]:
        """Begin a search, unless this is within one.

        Args:
            what: the object of the search, for messages.
        """
        if not self._within:
            self.spent, self._bound, self.activity, self._began = 0, self.iterations_max, "", time.monotonic()
            self._next = self._began + _SILENT_S
        self._within.append(what)
        try:
            yield
        finally:
            self._within.pop()

    @contextmanager
    def within(self, iterations_max: int, patience: float = math.inf) -> Iterator[None]:
        """Bound the searches in this context by fewer iterations.

        Args:
            iterations_max: of each search.
            patience: iterations within which a slide must halve the residual.
        """
        before = self.iterations_max, self.patience
        self.iterations_max, self.patience = (
            min(self.iterations_max, iterations_max),
            min(self.patience, patience),
        )
        try:
            yield
        finally:
            self.iterations_max, self.patience = before

    @contextmanager
    def search_apart(self, what: str) -> Iterator[None]:
        """Begin a search with a separate bound, also within a search that has its result.

        Args:
            what: the object of the search, for messages.
        """
        begin, bound = self.spent, self._bound
        self._bound = begin + self.iterations_max
        try:
            with self.search(what):
                yield
        finally:
            self._bound = bound + self.spent - begin

    def set_progress(self, tensions_N: Sequence[float], reached_factor: float, load_factor: float) -> None:
        """Set the load step that is tried next, for reports.

        Args:
            tensions_N: of the cables, at its end [N].
            reached_factor: load factor at its start.
            load_factor: load factor at its end.
        """
        progress = f"{100.0 * reached_factor:.3g} to {100.0 * load_factor:.3g} % of the way"
        tensions = [round(tension, 2) for tension in tensions_N]
        self.activity = f"cable tensions {tensions} N, {progress}" if any(tensions) else progress

    def bounded(self, options: NewtonOptions) -> NewtonOptions:
        """Return the bounds of the next solution within the remaining iterations.

        Args:
            options: bounds of a solution by itself.

        Raises:
            ConvergenceError: no iterations remain.
        """
        remaining = self._bound - self.spent if self._within else options.iterations_max
        if remaining <= 0:
            raise ConvergenceError(
                f"the search for {self._within[0]} reached its bound of {self.iterations_max} Newton "
                f"iterations{self._left}: ask for less at a time, take a coarser mesh "
                "(soft_robot.stack.refine), or raise solver.search_iterations_max",
                self._residual_N,
                0,
            )
        return options if remaining >= options.iterations_max else replace(options, iterations_max=remaining)

    def spend(self, solution: NewtonResult) -> None:
        """Count the iterations of a solution.

        Args:
            solution: by Newton's method.
        """
        self.spent, self._residual_N = self.spent + solution.iterations, solution.residual_N
        self.work += solution.iterations + solution.failed
        self._left = (
            "" if solution.converged else f", with {solution.residual_N:.3g} N out of balance at the last"
        )
        self.watch(0)

    def watch(self, under_way: int) -> None:
        """Report the progress if the search has taken a while.

        Args:
            under_way: iterations of the present solution.
        """
        self.check()
        now = time.monotonic()
        if self._within and now >= self._next:
            self._next = now + (now - self._began)
            prefix = f"{self.place}: " if self.place else ""
            goal = f"{self._within[0]}, {self.activity}" if self.activity else self._within[0]
            passed_s, done = now - self._began, (self.spent + under_way) / self._bound
            end = f", given up after about {passed_s / done:.0f} s" if done > _FORESEEN else ""
            self.report(f"{prefix}looking for {goal}: {passed_s:.0f} s so far{end}")
