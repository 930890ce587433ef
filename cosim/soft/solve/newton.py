"""Newton's method with exact tangents on the potential of a film: statics and implicit steps alike.

Each iteration solves (K + mu 1) d = -gradient. Iterations that reuse the last factorisation come first: they
cost a tenth, and are undone if the residual does not fall. Then a new tangent is factorised at the last
accepted point; mu is zero while K is positive definite (inertia correction). The step is halved until the
potential falls, or, for loads without a potential, the work of the residual along the step.
Source: Nocedal and Wright, Numerical Optimization, 2nd ed., sections 3.4 and 3.5.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.base.kernels import unchecked
from cosim.errors import InputError
from cosim.soft.body.loads import Loads
from cosim.soft.elements.open_caps import OpenCapSolver
from cosim.soft.film.film import FilmLoads, FilmPotential
from cosim.soft.film.inertia import Inertia
from cosim.soft.linear.cholesky import EnvelopeCholesky, cholesky
from cosim.soft.linear.definite import DefiniteTangent
from cosim.soft.linear.factor import Factor, FactorKey
from cosim.soft.linear.linear_solver import FactorState, LinearSolver, Tangent, by_component, negative_pivots
from cosim.soft.linear.pattern import BlockPattern, check_widened
from cosim.soft.linear.secant_pairs import FAR
from cosim.soft.linear.vectors import advance, largest_residual, work_along
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome
from cosim.soft.solve.search_effort import say_nothing
from cosim.soft.solve.tick_work import TickWork

_MUCH_LESS: Final = 0.1
"""Fraction to which a step must reduce the residual if it does not lower the potential."""
_ARMIJO: Final = 1e-4
_ROUNDING: Final = 1e-13  # rounding error of a potential, relative to 1 J plus its size
_STRAIGHT: Final = np.eye(3)


class Evaluation(NamedTuple):
    """Potential and residual at a point.

    Args:
        energy: potential [J].
        residual: largest out-of-balance component [N].
    """

    energy: float
    residual: float

    @property
    def finite(self) -> bool:
        """Whether both are numbers."""
        return math.isfinite(self.energy) and math.isfinite(self.residual)


@final
class Problem:
    """A film's potential under loads, to be minimised over its free components.

    Args:
        film: potential of the film.
        acting: loads on it.
        free: (n, 3) bool, components that move.
        kind: a number that identifies tangents that can replace each other: 0 in statics, else of the step's
            inertia term.
        frame: (3, 3), rotation of the flange; a reused factorisation turns with it.
    """

    def __init__(self, film: FilmPotential, acting: FilmLoads, free: Mask, kind: float, frame: Array) -> None:
        self.film, self.acting, self.free, self.kind, self.frame = film, acting, free, kind, frame

    def evaluate(self, x: Array) -> Evaluation:
        """Fill the film's gradient at x (n, 3) [m]; return potential and residual."""
        film = self.film
        energy = film.sum_gradient(x, self.acting)
        return Evaluation(energy, unchecked(largest_residual)(x, film.gradient, self.free))

    def tangent(self, x: Array, last_pattern: BlockPattern) -> Tangent:
        """Return the tangent at x (n, 3) [m], in the last pattern if that still fits."""
        self.film.reusable_pattern = last_pattern
        self.film.sum_tangent(x, self.acting)
        return self.film.tangent


@final
@dataclass
class NewtonProgress:
    """State of a solution by Newton's method.

    Args:
        energy: [J].
        residual: [N].
        outcome: how it has ended.
        reused: iterations with a reused factorisation.
        tangents: iterations with a new one.
        failed: factorisations that found an indefinite tangent.
        shifted: tangents that were indefinite.
        run: consecutive iterations with the last factorisation.
    """

    energy: float
    residual: float
    outcome: Outcome = Outcome.CONVERGED
    reused: int = 0
    tangents: int = 0
    failed: int = 0
    shifted: int = 0
    run: int = 0

    def ended(self, outcome: Outcome) -> "NewtonProgress":
        """Set the outcome, and return itself."""
        self.outcome = outcome
        return self

    @property
    def iterations(self) -> int:
        """Number of iterations with reused and new factorisations."""
        return self.reused + self.tangents

    def result(self, x: Array, memory: Array) -> NewtonResult:
        """Return the result at x (n, 3) [m], with the memory (values,) of the elements there."""
        return NewtonResult(
            x, memory, self.outcome, self.residual, self.iterations, self.tangents + self.failed, self.energy,
            self.shifted, failed=self.failed,
        )  # fmt: skip


def newton(
    problem: Problem,
    x: Array,
    factor: Factor,
    options: NewtonOptions,
    watch: Callable[[NewtonProgress], None] = say_nothing,
    began: Evaluation | None = None,
) -> NewtonProgress:
    """Bring x to a stationary point of the potential.

    Args:
        problem: to solve.
        x: (n, 3) [m], initial guess; overwritten with the solution.
        factor: reused while it converges, then renewed.
        options: bounds.
        watch: called with the progress after each new tangent.
        began: evaluation at x, if x was evaluated last.
    """
    progress = NewtonProgress(*(began or problem.evaluate(x)))
    if not (math.isfinite(progress.energy) and math.isfinite(progress.residual)):
        return progress.ended(Outcome.NOT_FINITE)
    search = _NewtonSearch(problem, x, factor, options, progress)
    if progress.residual < options.start_tolerance_N:
        return progress
    while not search.reuse_factor():
        search.restore()
        if progress.tangents >= options.iterations_max:
            return progress.ended(Outcome.ITERATION_LIMIT)
        if not search.make_factor():  # shifted until positive definite
            return progress.ended(Outcome.INDEFINITE)
        trial = search.line_search()
        if trial is None:
            search.restore()
            return progress.ended(Outcome.NO_DESCENT)
        progress.tangents, progress.run = progress.tangents + 1, 0
        if search.accept(trial):
            return progress
        watch(progress)
    return progress


@final
class _NewtonSearch:
    """The last accepted point, and the trial steps from it.

    Internal variables of elements at that point are in `FilmPotential.before`.

    Args:
        problem: to solve, evaluated at x.
        x: (n, 3) [m], the trial point.
        factor: of a tangent.
        options: bounds.
        progress: of the solution, updated by the search.
    """

    def __init__(
        self, problem: Problem, x: Array, factor: Factor, options: NewtonOptions, progress: NewtonProgress
    ) -> None:
        self._problem, self._film, self._factor = problem, problem.film, factor
        self._x, self._options, self._progress = x, options, progress
        self._accepted_x, self._accepted_gradient, self._step = (
            x.copy(),
            self._film.gradient.copy(),
            np.empty_like(x),
        )
        np.copyto(self._film.before, self._film.memory)
        factor.begin()

    def accept(self, trial: Evaluation) -> bool:
        """Accept the trial point; return whether the solution has converged."""
        film, progress = self._film, self._progress
        progress.energy, progress.residual = trial
        np.copyto(self._accepted_x, self._x)
        np.copyto(self._accepted_gradient, film.gradient)
        np.copyto(film.before, film.memory)
        return progress.residual < self._options.tolerance_N

    def restore(self) -> None:
        """Return to the last accepted point."""
        np.copyto(self._x, self._accepted_x)
        np.copyto(self._film.memory, self._film.before)

    def reuse_factor(self) -> bool:
        """Iterate with the last factorisation while the residual falls; return whether it has converged."""
        repeated, factor, progress = False, self._factor, self._progress
        while self._may_reuse():
            unchecked(advance)(self._accepted_x, 1.0, self._step, self._x)
            trial = self._problem.evaluate(self._x)
            learnt = self._learn_secant(trial)
            if self._is_better(trial):
                repeated, progress.reused, progress.run = False, progress.reused + 1, progress.run + 1
                if self.accept(trial):
                    factor.count_extra(progress.run)
                    return True
            elif repeated or not learnt:
                break
            else:
                repeated = True  # once more from the same point, with the secant of the failed step
        factor.count_extra(progress.run)
        return False

    def _may_reuse(self) -> bool:
        """Return whether one more iteration with the factorisation is allowed; fill its step."""
        options, problem, progress = self._options, self._problem, self._progress
        if not self._factor.is_usable_for(problem.kind) or progress.reused >= options.reuse_max:
            return False
        if not progress.residual < options.reuse_below_N:
            return False
        first = problem.acting.moving and not progress.reused  # the rounding of further ones may add up
        return (
            self._factor.step(self._accepted_gradient, problem.frame, self._step, roughly=first)
            <= options.step_max_m
        )

    def _learn_secant(self, trial: Evaluation) -> bool:
        """Add the secant of a step to the factorisation; return whether it was usable."""
        is_near = trial.finite and trial.residual <= FAR * self._progress.residual
        film = self._film
        return (
            is_near
            and film.conservative
            and self._factor.add_secant(self._step, self._accepted_gradient, film.gradient)
        )

    def _is_better(self, trial: Evaluation) -> bool:
        """Return whether the residual has fallen enough, or is below its bound."""
        options = self._options
        falls = trial.residual <= options.reuse_rate * self._progress.residual
        return trial.finite and (falls or trial.residual < options.tolerance_N)

    def make_factor(self) -> bool:
        """Factorise the tangent at the last accepted point; return whether that is possible."""
        problem, options, progress = self._problem, self._options, self._progress
        tangent = problem.tangent(self._x, self._factor.pattern)
        shifts = options.shift_start_N_m, options.shift_max_N_m
        attempts = self._factor.make(tangent, problem.kind, problem.frame, shifts)
        progress.failed += abs(attempts) - (attempts > 0)
        progress.shifted += abs(attempts) > 1
        return attempts > 0

    def line_search(self) -> Evaluation | None:
        """Halve the step of a new tangent until the potential falls; None if it never does."""
        problem, film, options, step = self._problem, self._film, self._options, self._step
        longest = self._factor.step(film.gradient, problem.frame, step)
        slope = work_along(film.gradient, step)
        fraction = options.step_max_m / longest if longest > options.step_max_m else 1.0
        for _ in range(options.halvings_max):
            advance(self._accepted_x, fraction, step, self._x)
            trial = problem.evaluate(self._x)
            much_less = trial.residual < _MUCH_LESS * self._progress.residual
            if self._descends(trial, fraction, slope) or (math.isfinite(trial.energy) and much_less):
                return trial
            fraction *= 0.5
        return None

    def _descends(self, trial: Evaluation, fraction: float, slope: float) -> bool:
        """Return whether a fraction of a step with slope [J] lowers the potential sufficiently.

        Without a potential, the work of the residual along the step must fall; a short step reduces it
        little. Source: Crisfield, Int. J. Numer. Meth. Eng. 19 (1983) 1269.
        """
        if self._film.conservative:
            before = self._progress.energy
            rounding = _ROUNDING * (1.0 + abs(before))
            return trial.energy <= before + _ARMIJO * fraction * slope + rounding
        remaining_work = abs(work_along(self._film.gradient, self._step))
        return remaining_work <= (1.0 - 0.1 * fraction) * abs(slope) and math.isfinite(trial.energy)


@final
@dataclass(frozen=True)
class NewtonState:
    """State that a solver carries from one solution to the next: reused factors change the iterates.

    Args:
        key: problem of the factorisation; None without one.
        factor: the factorisation; None without one.
        gradient: (n, 3) [N], at the last solution.
        wide: pattern of the factorisation with self-contact; None for the body's pattern.
        definite: last static tangent that was positive definite; None for none.
    """

    key: FactorKey | None
    factor: FactorState | None
    gradient: Annotated[Array, ("nodes", 3)]
    wide: BlockPattern | None = None
    definite: DefiniteTangent | None = None


@final
class NewtonSolver:
    """Newton's method for one body with given clamped nodes or components; owns the factorisation.

    Args:
        film: potential of the body.
        clamped: (n,) bool, nodes with prescribed positions, or (n, 3) bool, prescribed world components: a
            node on a plane of symmetry has one.
        symmetric: whether to factorise the symmetric part of an unsymmetric tangent, to check whether it is
            positive definite; solutions need the whole tangent.
        like: solver with the same body and clamp, whose elimination order is reused.
    """

    def __init__(
        self,
        film: FilmPotential,
        clamped: Mask,
        *,
        symmetric: bool = False,
        like: "NewtonSolver | None" = None,
    ) -> None:
        self.film, self._symmetric = film, symmetric
        self.clamped = clamped
        self.free = np.ascontiguousarray(by_component(~clamped))
        self.factor: Factor = Factor(
            self._solver_for, film.pattern, self.free, None if like is None else like.factor
        )
        self._definite: DefiniteTangent | None = None
        self.watch: Callable[[int], None] = say_nothing  # called with the number of iterations
        self.tick_work: TickWork | None = None  # counts the iterations of time steps

    @property
    def linear(self) -> LinearSolver:
        """Solves with the last factorisation."""
        return self.factor.solver

    def problem(
        self,
        x: Array,
        memory: Array,
        loads: Loads,
        inertia: Inertia | None = None,
        frame: Array | None = None,
    ) -> Problem:
        """Return the problem with losses along cables frozen at x.

        Args:
            x: (n, 3) [m].
            memory: (values,), internal variables of the elements at the last accepted state.
            loads: that act.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange.
        """
        film = self.film
        np.copyto(film.before, memory)
        acting = film.acting(loads, film.losses_at(x, loads, memory), inertia)
        kind = 0.0 if inertia is None else inertia.kind
        return Problem(film, acting, self.free, kind, _STRAIGHT if frame is None else frame)

    def run(
        self, problem: Problem, x: Array, options: NewtonOptions, began: Evaluation | None = None
    ) -> NewtonProgress:
        """Solve a problem, see `newton`.

        Args:
            problem: to solve.
            x: (n, 3) [m], initial guess; overwritten with the solution.
            options: bounds.
            began: evaluation at x, if x was evaluated last.

        Raises:
            TickWorkError: the tick has taken too many iterations.
        """
        counted, moving = 0, problem.acting.inertia is not None

        def watch(progress: NewtonProgress) -> None:
            nonlocal counted
            self.watch(progress.iterations)
            if self.tick_work is not None and moving:
                weight = max(1.0, self.linear.multiplications / self.factor.narrow.multiplications)
                new_attempts = progress.tangents + progress.failed - counted
                counted = progress.tangents + progress.failed
                self.tick_work.spend(weight * new_attempts, progress.residual)

        return newton(problem, x, self.factor, options, watch, began)

    def solve(
        self,
        start: Array,
        memory: Array,
        loads: Loads,
        options: NewtonOptions,
        inertia: Inertia | None = None,
        frame: Array | None = None,
    ) -> NewtonResult:
        """Find the stationary point of the potential near `start`.

        In statics internal solutions of elements restart: a ring of beams on a saddle would stay there
        otherwise; in motion it leaves the saddle.

        Args:
            start: (n, 3) [m], with clamped nodes and components at their prescribed positions.
            memory: (values,), internal variables of the elements at the last accepted state.
            loads: pressure, tension, gravity.
            options: bounds.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange; a reused factorisation turns with it.
        """
        film, x = self.film, np.array(start, order="C")
        moving = inertia is not None and inertia.step_s < math.inf and not inertia.closely
        problem = self.problem(x, memory if moving else film.fresh(memory), loads, inertia, frame)
        progress = self.run(problem, x, options)
        if progress.outcome in (Outcome.ITERATION_LIMIT, Outcome.NO_DESCENT):
            problem.evaluate(x)
        result = progress.result(x, film.memory.copy())
        if (
            inertia is None
            and film.conservative
            and result.converged
            and self._stays_definite(problem, progress, start, x)
        ):
            return replace(result, negative_pivots=0)
        return result

    def _stays_definite(self, problem: Problem, progress: NewtonProgress, start: Array, end: Array) -> bool:
        """Return whether the tangent at the end of a static solution is known to be positive definite.

        The last factorised tangent was. Its pivots are extrapolated to the end with the rate since the
        tangent before it; if the rate is not known or too large, the end must be checked.

        Args:
            problem: converged.
            progress: of its solution.
            start: (n, 3) [m], initial guess.
            end: (n, 3) [m], solution.
        """
        if self.factor.key is None:
            return False
        envelope, end_shape = self.linear, _centred(end, problem.frame)
        if not isinstance(envelope, EnvelopeCholesky) or envelope.correction is not None:
            return progress.tangents > 0 and not progress.reused
        if not progress.tangents:
            return self._definite is not None and self._definite.reaches(end_shape)
        # the only tangent is that at the start, unless a reused factorisation came first
        at_start = progress.tangents == 1 and progress.reused == progress.run
        start_shape = _centred(start, problem.frame)
        shape_of_tangent = end_shape if not at_start else start_shape
        self._definite = definite_tangent = DefiniteTangent.after(
            self._definite, envelope.pivots, start_shape, shape_of_tangent
        )
        return definite_tangent.reaches(end_shape, start_shape)

    def negative_pivots(self, positions: Array, memory: Array, loads: Loads) -> int:
        """Return the number of negative eigenvalues of the static tangent of the free components.

        The tangent includes sealed gas and commanded lengths; for loads without a potential it is the
        symmetric part. The stored factorisation is not changed.

        Args:
            positions: (n, 3) [m].
            memory: (values,), internal variables of the elements there.
            loads: that act.
        """
        film = self.film
        gradient, tracked = film.gradient.copy(), film.memory.copy()
        film.evaluate(positions, loads, film.losses_at(positions, loads, memory), memory)
        film.gradient[:], film.memory[:] = gradient, tracked
        film.add_open_caps(positions)
        tangent = film.tangent
        return negative_pivots(tangent.pattern, self.free, tangent.blocks, tangent.low_rank)

    def factorise(
        self, positions: Array, memory: Array, loads: Loads, inertia: Inertia | None, frame: Array
    ) -> bool:
        """Factorise the tangent at a given shape into `linear`; return False if it is indefinite.

        Args:
            positions: (n, 3) [m].
            memory: (values,), internal variables of the elements there.
            loads: that act.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange.
        """
        film, factor = self.film, self.factor
        gradient, losses = film.gradient.copy(), film.losses_at(positions, loads, memory)
        film.reusable_pattern = factor.pattern
        film.evaluate(positions, loads, losses, memory, inertia=inertia)
        film.gradient[:] = gradient
        if self._symmetric:
            film.add_open_caps(positions)
        solver, tangent = factor.fit(film.tangent.pattern), film.tangent
        solver.extra = tangent.caps
        definite = solver.factor(tangent.blocks, low_rank=tangent.low_rank)
        kind = 0.0 if inertia is None else inertia.kind
        factor.set_key(FactorKey(kind, frame) if definite else None)
        if inertia is None and definite and isinstance(solver, EnvelopeCholesky):
            centred_shape = _centred(positions, frame)
            self._definite = DefiniteTangent.after(
                self._definite, solver.pivots, centred_shape, centred_shape
            )
        return definite

    def set_factor_key(self, key: FactorKey | None) -> None:
        """Set the problem of the stored factorisation; None: the next solution does not reuse it."""
        self.factor.set_key(key)

    @property
    def state(self) -> NewtonState:
        """State of the solver; a state with the same clamp can be set."""
        factor = self.factor
        saved = None if factor.key is None else factor.solver.state
        wide = None if factor.solver is factor.narrow else factor.pattern
        return NewtonState(factor.key, saved, self.film.gradient.copy(), wide, self._definite)

    @state.setter
    def state(self, state: NewtonState) -> None:
        film, factor = self.film, self.factor
        if state.wide is not None:
            check_widened(film.pattern, state.wide)
        if (state.key is None) is not (state.factor is None):
            raise InputError("the saved factorisation is not whole")
        factor.fit(film.pattern if state.wide is None else state.wide)
        if state.factor is not None:
            factor.solver.state = state.factor
        factor.set_key(state.key)
        film.gradient[:], self._definite = state.gradient, state.definite

    def _solver_for(self, pattern: BlockPattern, like: LinearSolver | None) -> LinearSolver:
        if self.film.conservative or self._symmetric:
            return cholesky(pattern, self.free, self.film.tied, like)
        return OpenCapSolver(pattern, self.free, self.film.tied, like)


def _centred(positions: Array, frame: Array) -> Array:
    """Return positions (n, 3) [m] about their mean, in flange axes, see `DefiniteTangent`."""
    return np.asarray((positions - positions.mean(axis=0)) @ frame)
