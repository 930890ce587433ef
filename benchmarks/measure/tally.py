"""Counts of what a run does that do not depend on the machine."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, final


@final
@dataclass
class Counts:
    """What solvers have done.

    Args:
        tangents: assembled; of one of several bodies side by side a share.
        gradients: evaluated without one; of several bodies as many as of that which took most.
        shifted: tangents that were not positive definite as they were.
    """

    tangents: float = 0.0
    gradients: int = 0
    shifted: int = 0


@final
@dataclass
class Tally:
    """Counts what all solvers of the process do.

    Args:
        now: where it is counted; whoever takes another piece of work puts other counts here.
        calls: of Python and C functions from Python, within `counting_calls`.
    """

    now: Counts = field(default_factory=Counts)
    calls: int = 0

    def watch(self) -> None:
        """Count from now on what every solver evaluates."""
        from cosim.coupling.schemes import soft_halves
        from cosim.coupling.ticks import Ticks
        from cosim.soft.solve import newton
        from cosim.soft.solve.newton import NewtonSolver

        solver: Any = NewtonSolver
        factor, with_tangent, take_over = solver._factor, solver._with_tangent, solver.take_over
        factorise = solver.factorise
        film_step: Any = vars(newton)["film_step"]
        row: Any = vars(soft_halves.FilmHalves)["_row"]

        def counted_tangent(solver: Any, solution: Any, side: Any, part: int) -> int:
            self.now.tangents += 1.0 / (len(side.film.parts) - 1)
            return int(with_tangent(solver, solution, side, part))

        def counted_tangents(solver: Any, kept: Any, kind: float) -> None:
            self.now.tangents += kept.made.sum() / max(len(kept.made), 1)
            take_over(solver, kept, kind)

        def counted_test(solver: NewtonSolver, *given: Any) -> bool:
            self.now.tangents += 1.0
            return bool(factorise(solver, *given))

        def counted_factor(solver: NewtonSolver, *given: Any) -> Any:
            attempts = factor(solver, *given)
            self.now.shifted += abs(attempts) > 1
            return attempts

        def counted_step(*given: Any) -> Any:
            converged, iterations, *rest = film_step(*given)
            # at the start, then after every iteration
            self.now.gradients += bool(given[-1].begins) + iterations
            return converged, iterations, *rest

        def counted_row(halves: Any, *given: Any) -> Any:
            done, ending = row(halves, *given)
            ticks = next(part for part in given if isinstance(part, Ticks))
            self.now.gradients += int(ticks.iterations[:done].sum()) + done
            return done, ending

        for owner, name, counted in (
            (NewtonSolver, "take_over", counted_tangents),
            (NewtonSolver, "_with_tangent", counted_tangent),
            (NewtonSolver, "_factor", counted_factor),
            (NewtonSolver, "factorise", counted_test),
            (newton, "film_step", counted_step),
            (soft_halves.FilmHalves, "_row", counted_row),
        ):
            setattr(owner, name, counted)

    @contextmanager
    def counting_calls(self) -> Iterator[None]:
        """Count calls as well, which costs time."""
        sys.setprofile(self._event)
        try:
            yield
        finally:
            sys.setprofile(None)

    def _event(self, _frame: object, event: str, _what: object) -> None:
        self.calls += event in ("call", "c_call")
