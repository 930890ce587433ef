"""Bounds of Newton's method and of searches that call it again and again, and how they end."""

import enum
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Final, final

from cosim.base.frames import Array
from cosim.errors import ConvergenceError, TickWorkError

_SILENT_S: Final = 5.0
"""Wall time until a search first says what it tries; from then on at twice the time."""


class Outcome(enum.Enum):
    """How Newton's method ended, as a sentence."""

    CONVERGED = "the residual is below its bound"
    ITERATION_LIMIT = "the iteration limit was reached above the residual's bound"
    NO_DESCENT = "no step along the Newton direction lowers the potential"
    INDEFINITE = "no shift up to its bound makes the tangent positive definite"
    NOT_FINITE = "positions or forces are not finite"


@final
@dataclass(frozen=True)
class NewtonOptions:
    """Bounds of Newton's method.

    Args:
        tolerance_N: largest free component of the out-of-balance force, and a hundredth of its resultant.
        start_tolerance_N: the same for a start that is taken as it is, without an iteration.
        iterations_max: iterations with a new tangent before giving up.
        shift_start_N_m: first mu tried on an indefinite tangent.
        shift_max_N_m: largest mu tried.
        halvings_max: how often a step is halved before giving up.
        reuse_max: iterations per solution with a factorisation that is kept; 0 for Newton's method proper.
        reuse_below_N: residual from which on such iterations are tried: near several equilibria, those
            with new tangents decide.
        reuse_rate: such an iteration must bring the residual below this share of the last one.
        step_max_m: longest nodal displacement in one iteration.
        search_iterations_max: iterations of all solutions of one search, see `SearchEffort`.
        leaves_saddles: whether equilibria that are not stable are left for stable ones.
        sees_saddles: whether an equilibrium is checked for stability where the iterations do not show it.
    """

    tolerance_N: float = 1e-6
    start_tolerance_N: float = 1e-6
    iterations_max: int = 60
    shift_start_N_m: float = 0.05
    shift_max_N_m: float = 1e8
    halvings_max: int = 30
    step_max_m: float = 0.05
    reuse_max: int = 0
    reuse_rate: float = 0.5
    reuse_below_N: float = math.inf
    search_iterations_max: int = 3000
    leaves_saddles: bool = False
    sees_saddles: bool = True


@final
@dataclass(frozen=True)
class NewtonResult:
    """Where Newton's method ended.

    Args:
        positions: (n, 3) [m].
        memory: (values,), what the elements remember there.
        outcome: how it ended.
        residual_N: largest free out-of-balance component.
        iterations: linear solves, those with a kept factorisation included.
        factorisations: of new tangents, attempts included.
        potential_J: there, inertia included.
        shifted: iterations in which the tangent was indefinite.
        negative_pivots: 0 where the last tangent, one step before the end, was positive definite; None where
            that is not known.
        failed: factorisations of them that found a tangent indefinite.
    """

    positions: Array
    memory: Array
    outcome: Outcome
    residual_N: float
    iterations: int
    factorisations: int
    potential_J: float
    shifted: int
    negative_pivots: int | None = None
    failed: int = 0

    @property
    def converged(self) -> bool:
        """Whether the residual is below its bound."""
        return self.outcome is Outcome.CONVERGED


TICK_ITERATIONS_MAX: Final = 1000
"""New tangents of one tick, further attempts to factorise one counted, before it is given up.

One that contact ties together counts by its multiplications over those of the film alone.
"""
TICK_DIVISIONS_MAX: Final = 64


@final
class TickWork:
    """Bounds the work on one tick, whatever repeats or divides its steps; by counts, which repeat."""

    def __init__(self) -> None:
        self.iterations, self.divisions = 0.0, 0
        self._depth = 0

    def __enter__(self) -> None:
        """Begin one tick, or a part of the one in progress."""
        if not self._depth:
            self.iterations, self.divisions = 0.0, 0
        self._depth += 1

    def __exit__(self, *_raised: object) -> None:
        """End what was begun last."""
        self._depth -= 1

    def spend(self, iterations: float, residual_N: float) -> None:
        """Count iterations with a new tangent, and further attempts to factorise one.

        Args:
            iterations: since the last call, in factorisations of a film that nothing touches.
            residual_N: largest out-of-balance component that is left.

        Raises:
            TickWorkError: no more are left.
        """
        self.iterations += iterations
        if self._depth and self.iterations > TICK_ITERATIONS_MAX:
            what = f"{TICK_ITERATIONS_MAX} new tangents (those of films in contact count for more)"
            raise self._used_up(what, residual_N)

    def divide(self, residual_N: float) -> None:
        """Count a division of a step.

        Args:
            residual_N: see `spend`.

        Raises:
            TickWorkError: no more are left.
        """
        self.divisions += 1
        if self._depth and self.divisions > TICK_DIVISIONS_MAX:
            raise self._used_up(f"{TICK_DIVISIONS_MAX} divisions of its steps", residual_N)

    def _used_up(self, what: str, residual_N: float) -> TickWorkError:
        return TickWorkError(
            f"the soft step reached the bound of a tick, {what}, with {residual_N:.3g} N out of balance: the "
            "motion or the loads change too fast for it. Spread the command over more time (a ramp, not a "
            "jump), take a shorter tick (clock.tick_s; the timestep of an attached model), or raise "
            "solver.damping_per_s",
            residual_N,
            round(self.iterations),
        )


def say_nothing(_what: object) -> None:
    """Do nothing."""


def _do_nothing() -> None:
    """Do nothing."""


@final
class SearchEffort:
    """Counts the Newton iterations of a search, ends it at a bound, and says what it tries while it lasts.

    A search is whatever solves for one result: an equilibrium that is followed, or all that is tried for a
    target. Searches within a search count as part of it.

    Attributes: `work`, iterations and failed factorisations of all searches; `patience`, iterations within
    which a slide halves what is out of balance, or is given up; `check`, called at every new tangent, which
    ends whatever is searched by what it raises.

    Args:
        most: iterations that one search may take.
    """

    def __init__(self, most: int) -> None:
        self.most, self.spent, self._left, self._residual_N = most, 0, "", math.inf
        self.place, self.trying, self._bound = "", "", most
        self.tell: Callable[[str], None] = say_nothing
        self.check: Callable[[], None] = _do_nothing
        self.work, self.patience = 0, math.inf
        self._within: list[str] = []
        self._began = self._next = 0.0

    @contextmanager
    def at(self, place: str) -> Iterator[None]:
        """Let searches within say where they are.

        Args:
            place: put before what they say, such as the key of a phase.
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
            what: is looked for.
        """
        if not self._within:
            self.spent, self._bound, self.trying, self._began = 0, self.most, "", time.monotonic()
            self._next = self._began + _SILENT_S
        self._within.append(what)
        try:
            yield
        finally:
            self._within.pop()

    @contextmanager
    def within(self, most: int, patience: float = math.inf) -> Iterator[None]:
        """Let searches within take fewer iterations.

        Args:
            most: that each of them may take.
            patience: iterations within which a slide halves what is out of balance.
        """
        before = self.most, self.patience
        self.most, self.patience = min(self.most, most), min(self.patience, patience)
        try:
            yield
        finally:
            self.most, self.patience = before

    @contextmanager
    def search_apart(self, what: str) -> Iterator[None]:
        """Begin a search with its own bound, also within one whose result is there already.

        Args:
            what: is looked for.
        """
        begin, bound = self.spent, self._bound
        self._bound = begin + self.most
        try:
            with self.search(what):
                yield
        finally:
            self._bound = bound + self.spent - begin

    def tries(self, tensions_N: Sequence[float], done: float, wanted: float) -> None:
        """Note which piece of a way is tried next.

        Args:
            tensions_N: of the cables, at its end [N].
            done: share of the way at its begin.
            wanted: share of the way at its end.
        """
        way = f"{100.0 * done:.3g} to {100.0 * wanted:.3g} % of the way"
        tensions = [round(tension, 2) for tension in tensions_N]
        self.trying = f"cable tensions {tensions} N, {way}" if any(tensions) else way

    def bounded(self, options: NewtonOptions) -> NewtonOptions:
        """Return the bounds of the next solution, so that it does not take more than what is left.

        Args:
            options: bounds of a solution by itself.

        Raises:
            ConvergenceError: nothing is left.
        """
        left = self._bound - self.spent if self._within else options.iterations_max
        if left <= 0:
            raise ConvergenceError(
                f"the search for {self._within[0]} reached its bound of {self.most} Newton "
                f"iterations{self._left}: ask for less at a time, take a coarser mesh "
                "(soft_robot.stack.refine), or raise solver.search_iterations_max",
                self._residual_N,
                0,
            )
        return options if left >= options.iterations_max else replace(options, iterations_max=left)

    def spend(self, found: NewtonResult) -> None:
        """Count the iterations of a solution.

        Args:
            found: by the solution.
        """
        self.spent, self._residual_N = self.spent + found.iterations, found.residual_N
        self.work += found.iterations + found.failed
        self._left = "" if found.converged else f", with {found.residual_N:.3g} N out of balance at the last"
        self.watch(0)

    def watch(self, under_way: int) -> None:
        """Say what is tried where the search has lasted a while.

        Args:
            under_way: iterations of a solution that has not ended.
        """
        self.check()
        now = time.monotonic()
        if self._within and now >= self._next:
            self._next = now + (now - self._began)
            place = f"{self.place}: " if self.place else ""
            tried = f"{self._within[0]}, {self.trying}" if self.trying else self._within[0]
            count = self.spent + under_way
            self.tell(f"{place}{tried}: {count} of at most {self._bound} Newton iterations so far")
