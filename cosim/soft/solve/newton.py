"""Newton's method with exact tangents on the potential of a film: statics and implicit steps alike.

Each iteration solves (K + mu 1) d = -gradient. Iterations with the factorisation that is there come first:
they cost a tenth, and are undone where the residual does not fall. Then a new tangent is made at the last
point that serves; mu is zero while K is positive definite (inertia correction). The step along it is halved
until the potential falls, or, for loads without one, the work of the out-of-balance force along the step.
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
from cosim.soft.linear.factor import Factor, KeptFactor
from cosim.soft.linear.linear_solver import FactorState, LinearSolver, Tangent, by_component, negative_pivots
from cosim.soft.linear.pattern import BlockPattern, check_widened
from cosim.soft.linear.secant_pairs import FAR
from cosim.soft.linear.vectors import advance, largest_residual, work_along
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome, TickWork, say_nothing

_MUCH_LESS: Final = 0.1
"""Fraction of a residual to which a step has to bring it that does not lower the potential."""
_ARMIJO: Final = 1e-4
_ROUNDING: Final = 1e-13  # of a potential: what rounding can hide in a sum of terms of its size
_STRAIGHT: Final = np.eye(3)


class Evaluation(NamedTuple):
    """A point that was evaluated.

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
    """What is solved: a film under what acts on it, of which some components are free.

    Args:
        film: whose potential.
        acting: on it.
        free: (n, 3) bool, components that move.
        kind: tells apart tangents that cannot replace each other: statics, or the step's inertia.
        frame: (3, 3), rotation of the flange; a factorisation that is kept turns with it.
    """

    def __init__(self, film: FilmPotential, acting: FilmLoads, free: Mask, kind: float, frame: Array) -> None:
        self.film, self.acting, self.free, self.kind, self.frame = film, acting, free, kind, frame

    def evaluate(self, x: Array) -> Evaluation:
        """Fill the film's gradient at x (n, 3) [m]; return potential and residual."""
        film = self.film
        energy = film.sum_gradient(x, self.acting)
        return Evaluation(energy, unchecked(largest_residual)(x, film.gradient, self.free))

    def tangent(self, x: Array, serving: BlockPattern) -> Tangent:
        """Return the tangent at x (n, 3) [m], in a pattern that served before where that still fits."""
        self.film.serving = serving
        self.film.sum_tangent(x, self.acting)
        return self.film.tangent


@final
@dataclass
class NewtonProgress:
    """Where a solution is.

    Args:
        energy: [J].
        residual: [N].
        outcome: how it has ended.
        reused: iterations with a factorisation that was there.
        tangents: the same with a new one.
        failed: factorisations that found a tangent indefinite.
        shifted: tangents that were indefinite.
        run: iterations with the last factorisation.
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
        """Return itself, with an outcome."""
        self.outcome = outcome
        return self

    @property
    def iterations(self) -> int:
        """Of both kinds."""
        return self.reused + self.tangents

    def result(self, x: Array, memory: Array) -> NewtonResult:
        """Return how it has ended, at x (n, 3) [m] with the memory (values,) of the elements there."""
        return NewtonResult(
            x, memory, self.outcome, self.residual, self.iterations, self.tangents + self.failed, self.energy,
            self.shifted, failed=self.failed,
        )  # fmt: skip


def newton(
    problem: Problem,
    x: Array,
    factor: Factor,
    options: NewtonOptions,
    tell: Callable[[NewtonProgress], None] = say_nothing,
    began: Evaluation | None = None,
) -> NewtonProgress:
    """Bring x to a stationary point of the potential.

    Args:
        problem: what is solved.
        x: (n, 3) [m], where it starts; changed.
        factor: used, and made again where it does not serve.
        options: bounds.
        tell: told how far it is after each new tangent.
        began: at x, where that was evaluated last.
    """
    done = NewtonProgress(*(began or problem.evaluate(x)))
    if not (math.isfinite(done.energy) and math.isfinite(done.residual)):
        return done.ended(Outcome.NOT_FINITE)
    search = _NewtonSearch(problem, x, factor, options, done)
    if done.residual < options.start_tolerance_N:
        return done
    while not search.reuse_factor():
        search.go_back()
        if done.tangents >= options.iterations_max:
            return done.ended(Outcome.ITERATION_LIMIT)
        if not search.make_factor():  # shifted until positive definite
            return done.ended(Outcome.INDEFINITE)
        tried = search.line_search()
        if tried is None:
            search.go_back()
            return done.ended(Outcome.NO_DESCENT)
        done.tangents, done.run = done.tangents + 1, 0
        if search.accept(tried):
            return done
        tell(done)
    return done


@final
class _NewtonSearch:
    """The last point that serves, and the ways from there.

    Elements count from what they tracked at that point, `FilmPotential.before`.

    Args:
        problem: what is solved, evaluated at x.
        x: (n, 3) [m], the point that is tried.
        factor: of a tangent.
        options: bounds.
        done: where the solution is; kept up to date.
    """

    def __init__(
        self, problem: Problem, x: Array, factor: Factor, options: NewtonOptions, done: NewtonProgress
    ) -> None:
        self._problem, self._film, self._factor = problem, problem.film, factor
        self._x, self._options, self._done = x, options, done
        self._here, self._gradient, self._step = x.copy(), self._film.gradient.copy(), np.empty_like(x)
        np.copyto(self._film.before, self._film.memory)
        factor.begin()

    def accept(self, tried: Evaluation) -> bool:
        """Let the point that was tried be the one that serves; return whether that is all."""
        film, done = self._film, self._done
        done.energy, done.residual = tried
        np.copyto(self._here, self._x)
        np.copyto(self._gradient, film.gradient)
        np.copyto(film.before, film.memory)
        return done.residual < self._options.tolerance_N

    def go_back(self) -> None:
        """Return to the last point that serves."""
        np.copyto(self._x, self._here)
        np.copyto(self._film.memory, self._film.before)

    def reuse_factor(self) -> bool:
        """Iterate with the factorisation that is there, as long as it serves; return whether that is all."""
        again, factor, done = False, self._factor, self._done
        while self._may_reuse():
            unchecked(advance)(self._here, 1.0, self._step, self._x)
            tried = self._problem.evaluate(self._x)
            shows = self._shows(tried)
            if self._serves(tried):
                again, done.reused, done.run = False, done.reused + 1, done.run + 1
                if self.accept(tried):
                    factor.count_extra(done.run)
                    return True
            elif again or not shows:
                break
            else:
                again = True  # once more from there, by what the step has shown
        factor.count_extra(done.run)
        return False

    def _may_reuse(self) -> bool:
        """Return whether one more iteration with the factorisation may serve; fill its step."""
        options, problem, done = self._options, self._problem, self._done
        if not self._factor.serves(problem.kind) or done.reused >= options.reuse_max:
            return False
        if not done.residual < options.reuse_below_N:
            return False
        first = problem.acting.moving and not done.reused  # the rounding of further ones may add up
        return (
            self._factor.step(self._gradient, problem.frame, self._step, roughly=first) <= options.step_max_m
        )

    def _shows(self, tried: Evaluation) -> bool:
        """Take in what a step has shown of the tangent; return whether it has shown something."""
        near = tried.finite and tried.residual <= FAR * self._done.residual
        film = self._film
        return near and film.conservative and self._factor.show(self._step, self._gradient, film.gradient)

    def _serves(self, tried: Evaluation) -> bool:
        """Return whether the residual has fallen; rounding may keep it from that below its own bound."""
        options = self._options
        falls = tried.residual <= options.reuse_rate * self._done.residual
        return tried.finite and (falls or tried.residual < options.tolerance_N)

    def make_factor(self) -> bool:
        """Factorise the tangent at the last point that serves; return whether that is possible."""
        problem, options, done = self._problem, self._options, self._done
        tangent = problem.tangent(self._x, self._factor.pattern)
        shifts = options.shift_start_N_m, options.shift_max_N_m
        attempts = self._factor.make(tangent, problem.kind, problem.frame, shifts)
        done.failed += abs(attempts) - (attempts > 0)
        done.shifted += abs(attempts) > 1
        return attempts > 0

    def line_search(self) -> Evaluation | None:
        """Halve the step along a new tangent until it serves; None where no fraction of it does."""
        problem, film, options, step = self._problem, self._film, self._options, self._step
        longest = self._factor.step(film.gradient, problem.frame, step)
        slope = work_along(film.gradient, step)
        fraction = options.step_max_m / longest if longest > options.step_max_m else 1.0
        for _ in range(options.halvings_max):
            advance(self._here, fraction, step, self._x)
            tried = problem.evaluate(self._x)
            much_less = tried.residual < _MUCH_LESS * self._done.residual
            if self._descends(tried, fraction, slope) or (math.isfinite(tried.energy) and much_less):
                return tried
            fraction *= 0.5
        return None

    def _descends(self, tried: Evaluation, fraction: float, slope: float) -> bool:
        """Return whether a fraction of a step along which the potential falls by slope [J] serves.

        Without a potential the work of what is out of balance counts, of which a short step takes little
        away. Source: Crisfield, Int. J. Numer. Meth. Eng. 19 (1983) 1269.
        """
        if self._film.conservative:
            before = self._done.energy
            rounding = _ROUNDING * (1.0 + abs(before))
            return tried.energy <= before + _ARMIJO * fraction * slope + rounding
        left = abs(work_along(self._film.gradient, self._step))
        return left <= (1.0 - 0.1 * fraction) * abs(slope) and math.isfinite(tried.energy)


@final
@dataclass(frozen=True)
class NewtonState:
    """What a solver carries from one solution to the next: kept factors change the iterates.

    Args:
        kept: what the factorisation was made for; None where none is kept.
        factor: the factorisation; None where none is kept.
        gradient: (n, 3) [N], at the last solution.
        wide: pattern of the factorisation where films touched one another; None for the body's own.
        definite: last static tangent that was seen to be so; None for none.
    """

    kept: KeptFactor | None
    factor: FactorState | None
    gradient: Annotated[Array, ("nodes", 3)]
    wide: BlockPattern | None = None
    definite: DefiniteTangent | None = None


@final
class NewtonSolver:
    """Newton's method for one body with given clamped nodes or components; owns the factorisation.

    Args:
        film: what is solved.
        clamped: (n,) bool, nodes whose positions are given, or (n, 3) bool, world components that are
            given: a node on a plane of symmetry has one.
        symmetric: whether it takes the symmetric part of a tangent that is not, to see whether it is positive
            definite; solutions take the whole.
        like: one with the same body and clamp, whose order of elimination is taken over.
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
        self.watch: Callable[[int], None] = say_nothing  # told the iterations so far
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
        """Return the problem whose losses along cables are frozen at x; elements count from a memory.

        Args:
            x: (n, 3) [m].
            memory: (values,), what the elements remember of the last accepted state.
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
        """Bring x to where the gradient vanishes; see `newton`.

        Args:
            problem: what is solved.
            x: (n, 3) [m], where it starts; changed.
            options: bounds.
            began: at x, where that was evaluated last.

        Raises:
            TickWorkError: the tick has taken too many iterations.
        """
        counted, moving = 0, problem.acting.inertia is not None

        def tell(done: NewtonProgress) -> None:
            nonlocal counted
            self.watch(done.iterations)
            if self.tick_work is not None and moving:
                weight = max(1.0, self.linear.multiplications / self.factor.narrow.multiplications)
                spent, counted = done.tangents + done.failed - counted, done.tangents + done.failed
                self.tick_work.spend(weight * spent, done.residual)

        return newton(problem, x, self.factor, options, tell, began)

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

        In statics what elements find by themselves is looked for again: a ring of beams on a saddle would
        stay there otherwise; in motion it is left by itself.

        Args:
            start: (n, 3) [m], clamped nodes and components where they shall be.
            memory: (values,), what the elements remember of the last accepted state.
            loads: pressure, tension, gravity.
            options: bounds.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange; a factorisation that is kept turns with it.
        """
        film, x = self.film, np.array(start, order="C")
        moving = inertia is not None and inertia.step_s < math.inf and not inertia.closely
        problem = self.problem(x, memory if moving else film.fresh(memory), loads, inertia, frame)
        done = self.run(problem, x, options)
        if done.outcome in (Outcome.ITERATION_LIMIT, Outcome.NO_DESCENT):
            problem.evaluate(x)
        found = done.result(x, film.memory.copy())
        if (
            inertia is None
            and film.conservative
            and found.converged
            and self._stays_definite(problem, done, start, x)
        ):
            return replace(found, negative_pivots=0)
        return found

    def _stays_definite(self, problem: Problem, done: NewtonProgress, start: Array, end: Array) -> bool:
        """Return whether the tangent at the end of a static solution is seen to be positive definite.

        One that was made on the way was so. From there on pivots fall as they fell since the one before it;
        where that is not known, or by too much, the end has to be checked.

        Args:
            problem: which has converged.
            done: how.
            start: (n, 3) [m], where it began.
            end: (n, 3) [m].
        """
        if self.factor.kept is None:
            return False
        envelope, last = self.linear, _centred(end, problem.frame)
        if not isinstance(envelope, EnvelopeCholesky) or envelope.correction is not None:
            return done.tangents > 0 and not done.reused
        if not done.tangents:
            return self._definite is not None and self._definite.reaches(last)
        # the only one was made at the start unless a kept one served before; others somewhere beyond
        at_start = done.tangents == 1 and done.reused == done.run
        begin = _centred(start, problem.frame)
        made_by = last if not at_start else begin
        self._definite = made = DefiniteTangent.after(self._definite, envelope.pivots, begin, made_by)
        return made.reaches(last, begin)

    def negative_pivots(self, positions: Array, memory: Array, loads: Loads) -> int:
        """Return how many negative eigenvalues the tangent of the free components has in statics.

        Sealed gas and commanded lengths count as well; of loads without a potential the symmetric part does.
        The factorisation in store stays.

        Args:
            positions: (n, 3) [m].
            memory: (values,), what the elements remember there.
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
        """Factorise the tangent at a given shape into `linear`; False where it is indefinite.

        Args:
            positions: (n, 3) [m].
            memory: (values,), what the elements remember there.
            loads: that act.
            inertia: of an implicit step; None in statics.
            frame: (3, 3), rotation of the flange.
        """
        film, factor = self.film, self.factor
        gradient, losses = film.gradient.copy(), film.losses_at(positions, loads, memory)
        film.serving = factor.pattern
        film.evaluate(positions, loads, losses, memory, inertia=inertia)
        film.gradient[:] = gradient
        if self._symmetric:
            film.add_open_caps(positions)
        solver, tangent = factor.fit(film.tangent.pattern), film.tangent
        solver.extra = tangent.caps
        definite = solver.factor(tangent.blocks, low_rank=tangent.low_rank)
        kind = 0.0 if inertia is None else inertia.kind
        factor.keep(KeptFactor(kind, frame) if definite else None)
        if inertia is None and definite and isinstance(solver, EnvelopeCholesky):
            place = _centred(positions, frame)
            self._definite = DefiniteTangent.after(self._definite, solver.pivots, place, place)
        return definite

    def keep(self, kept: KeptFactor | None) -> None:
        """Remember for what the factorisation was made; None: the next solution makes its own."""
        self.factor.keep(kept)

    @property
    def state(self) -> NewtonState:
        """What the next solution depends on besides its arguments; that of the same clamp can be set."""
        factor = self.factor
        saved = None if factor.kept is None else factor.solver.state
        wide = None if factor.solver is factor.narrow else factor.pattern
        return NewtonState(factor.kept, saved, self.film.gradient.copy(), wide, self._definite)

    @state.setter
    def state(self, state: NewtonState) -> None:
        film, factor = self.film, self.factor
        if state.wide is not None:
            check_widened(film.pattern, state.wide)
        if (state.kept is None) is not (state.factor is None):
            raise InputError("the saved factorisation is not whole")
        factor.fit(film.pattern if state.wide is None else state.wide)
        if state.factor is not None:
            factor.solver.state = state.factor
        factor.keep(state.kept)
        film.gradient[:], self._definite = state.gradient, state.definite

    def _solver_for(self, pattern: BlockPattern, like: LinearSolver | None) -> LinearSolver:
        if self.film.conservative or self._symmetric:
            return cholesky(pattern, self.free, self.film.tied, like)
        return OpenCapSolver(pattern, self.free, self.film.tied, like)


def _centred(positions: Array, frame: Array) -> Array:
    """Return positions (n, 3) [m] as `DefiniteTangent` has them."""
    return np.asarray((positions - positions.mean(axis=0)) @ frame)
