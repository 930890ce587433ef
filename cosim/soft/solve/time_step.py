"""Implicit time steps of a film: each is the minimum of an incremental potential.

The formulas are in `step_scheme` and `step_prediction`. Most steps start from free flight, and end after one
or two iterations with a reused factorisation.
"""

import math
from dataclasses import replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Pose, Wrench
from cosim.base.kernels import unchecked
from cosim.errors import ConvergenceError, InputError
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import describe_largest
from cosim.soft.elements.cable import losses_follow
from cosim.soft.film.inertia import Inertia
from cosim.soft.film.strain_rates import StrainRates
from cosim.soft.solve.clamp import (
    Clamp,
    DampedNodes,
    fill_flange_velocity,
    flange_axes,
    place_flight,
    place_held,
)
from cosim.soft.solve.newton import Evaluation, NewtonProgress, NewtonSolver, Problem
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome
from cosim.soft.solve.self_contact import SelfContact
from cosim.soft.solve.state import SoftState
from cosim.soft.solve.step_prediction import FOLD_SWEEPS, fill_flight, fill_inertia_target, keep_folds_open
from cosim.soft.solve.step_scheme import StepAccuracy, StepOptions, StepScheme

LARGE_TURN_RAD: Final = 0.01
"""Rotation of the flange in a step above which another initial guess is worth its cost."""
_LOSS_ROUNDS_MAX: Final = 8


@final
class Stepper:
    """Steps one body with a given clamp: predicts, solves, and computes the wrench on the flange.

    Args:
        solver: Newton's method for the body with that clamp.
        clamp: nodes held by the flange.
        options: of the steps.
        self_contact: of the body's films; None if it is not modelled.
    """

    def __init__(
        self,
        solver: NewtonSolver,
        clamp: Clamp,
        options: StepOptions,
        self_contact: SelfContact | None = None,
    ) -> None:
        self.solver, self.clamp, self.options, self.self_contact = solver, clamp, options, self_contact
        film = solver.film
        self._whole, self._bound_N = options.whole, options.bound_N(film.mass)
        self._first = replace(self._whole, iterations_max=min(options.iterations, self._whole.iterations_max))
        self.rates = StrainRates.of(film.body)
        """Viscous losses of the materials in the last step; None without such materials."""
        self._target, self._base = np.empty_like(film.gradient), np.empty_like(film.gradient)
        self._along = np.zeros_like(film.gradient)  # [m/s], of nodes that move with the flange
        self._scheme: StepScheme | None = None
        self._inertia: Inertia | None = None
        self._rubs = any(cable.friction_coefficient for cable in film.body.cables)
        folds = film.body.hinges
        hinge_slice = film.body.memory_slices[film.body.elements.index(film.body.hinges)]
        self._angles = slice(hinge_slice.start, hinge_slice.start + len(folds.coupled))
        self._folds = folds.arrays.nodes[: len(folds.coupled)]

    def step(
        self,
        state: SoftState,
        world_from_flange: Pose,
        loads: Loads,
        step_s: float,
        before: Pose | None = None,
        accuracy: StepAccuracy | None = None,
    ) -> tuple[SoftState, NewtonResult]:
        """Return the state after a step, with the flange at its new pose, and the solver's result.

        Args:
            state: at the start.
            world_from_flange: pose of the flange at the end.
            loads: at the end.
            step_s: h [s].
            before: pose of the flange at the start, for a better initial guess after a large rotation.
            accuracy: None for an ordinary step.

        Raises:
            InputError: the step is not positive, or not finite.
            ConvergenceError: no acceptable solution; the caller still holds `state`.
        """
        if not 0.0 < step_s < math.inf:
            raise InputError(f"step {step_s} s must be positive and finite")
        films = self.self_contact
        if films is None:
            return self._step(state, world_from_flange, loads, step_s, before, accuracy)
        is_deferred, films.work_J = films.is_deferred(state), 0.0
        acting = loads if is_deferred else loads.with_films(films.step_pairs(state, step_s))
        end, solution = self._step(state, world_from_flange, acting, step_s, before, accuracy)
        if is_deferred and films.presses(end, step_s):
            pairs = films.step_pairs(state, step_s)
            if pairs is not None:
                acting = loads.with_films(pairs)
                end, solution = self._step(state, world_from_flange, acting, step_s, before, accuracy)
        return end, solution

    def _step(
        self,
        state: SoftState,
        world_from_flange: Pose,
        loads: Loads,
        step_s: float,
        before: Pose | None,
        accuracy: StepAccuracy | None,
    ) -> tuple[SoftState, NewtonResult]:
        """Return the state after a step with given pairs of films, see `step`.

        The initial guess is free flight; if that fails, because films move too far, the state at the start.
        """
        scheme, flange = self.scheme_of(state, step_s), flange_axes(world_from_flange)
        first_guess = None if accuracy is None else accuracy.start
        if accuracy is not None and accuracy.tolerance_N >= self.options.tolerance_N:
            accuracy = None
        inertia = self._predict(state, flange, scheme, step_s, accuracy)
        flight, jumps = self._flight(state, flange, step_s)
        starts = [flight, state.positions]
        if before is not None and _turn(before, world_from_flange) > LARGE_TURN_RAD:
            motion = world_from_flange @ before.inverse()
            starts = self._ranked(starts, state, motion, flange, loads, inertia)
        if first_guess is not None:
            starts = [first_guess, *starts]
        iterations = 0
        for start in starts:
            x = start.copy()
            unchecked(place_held)(self.clamp.held, flange, x)
            problem = self._problem(state, x, flange, loads, inertia)
            began = self._open_folds(problem, state, flange, x) if start is flight else None
            solution = self._solve(problem, state, x, accuracy, jumps, began)
            iterations += solution.iterations
            if solution.converged or self._acceptable(solution, accuracy):
                if iterations != solution.iterations:  # a guess before has failed
                    solution = replace(solution, iterations=iterations)
                return self._end(state, solution, scheme, loads), solution
        body, gradient = self.solver.film.body, self.solver.film.gradient
        largest_at = describe_largest(body, solution.positions, gradient, self.solver.free)
        raise ConvergenceError(
            f"the soft step did not converge: {solution.outcome.value}; residual {solution.residual_N:.3g} N "
            f"after {iterations} iterations, the largest at {largest_at}",
            solution.residual_N,
            iterations,
        )

    def _predict(
        self,
        state: SoftState,
        flange: Array,
        scheme: StepScheme,
        step_s: float,
        accuracy: StepAccuracy | None,
    ) -> Inertia:
        """Return the inertia term of a step; fill the base of its velocities."""
        x, v, coefficients = state.positions, state.velocities, scheme.coefficients
        earlier_x, earlier_v = state.earlier or (x, v)
        if coefficients.alpha_s > 0.0:
            unchecked(fill_flange_velocity)(self.clamp.held, flange, x, earlier_x, coefficients, self._along)
        unchecked(fill_inertia_target)(
            x, v, earlier_x, earlier_v, self._along, coefficients, self._base, self._target
        )
        self.fill_rates(state, scheme)
        closely, last = self.options.closely or accuracy is not None, self._inertia
        if last is None or last.coefficient is not scheme.inertia or last.closely is not closely:
            last = self._inertia = Inertia(scheme.inertia, self._target, step_s, closely, self.rates)
        return last

    def fill_rates(self, state: SoftState, scheme: StepScheme) -> None:
        """Prepare the viscous losses of a step from a state; see `StrainRates.fill`."""
        if self.rates is not None:
            earlier = None if state.earlier is None or not scheme.coefficients.two_steps else state.earlier[0]
            self.rates.fill(state.positions, earlier, state.memory, scheme.coefficients.span)

    def _flight(self, state: SoftState, flange: Array, step_s: float) -> tuple[Array, bool]:
        """Return the nodes (n, 3) [m] after free flight, and whether the flange has jumped."""
        flight = np.empty_like(state.positions)
        before = state.velocities if state.earlier is None else state.earlier[1]
        unchecked(fill_flight)(state.positions, state.velocities, before, step_s, self.options.gain, flight)
        return flight, unchecked(place_flight)(self.clamp.held, flange, flight)

    def _problem(self, state: SoftState, x: Array, flange: Array, loads: Loads, inertia: Inertia) -> Problem:
        """Return the problem from an initial guess x (n, 3) [m], where shape-dependent losses are frozen."""
        follows = self._rubs or losses_follow(self.solver.film.body.cables, loads.cable_length_m)
        frozen_at, frame = x if follows else state.positions, np.ascontiguousarray(flange[1:].T)
        memory = self.solver.film.fresh(state.memory) if inertia.closely else state.memory
        return self.solver.problem(frozen_at, memory, loads, inertia, frame)

    def _open_folds(self, problem: Problem, state: SoftState, flange: Array, x: Array) -> Evaluation:
        """Correct folds that close in free flight; return potential and residual after that."""
        film, barrier = problem.film, problem.film.body.hinges.fold_barrier_rad
        began = problem.evaluate(x)
        for _ in range(FOLD_SWEEPS if barrier else 0):
            angles = state.memory[self._angles], film.memory[self._angles]
            if not unchecked(keep_folds_open)(state.positions, self._folds, barrier, *angles, x):
                break
            unchecked(place_held)(self.clamp.held, flange, x)
            began = problem.evaluate(x)
        return began

    def _solve(
        self,
        problem: Problem,
        state: SoftState,
        x: Array,
        accuracy: StepAccuracy | None,
        jumps: bool,
        began: Evaluation | None,
    ) -> NewtonResult:
        """Solve a step; first with few iterations, if it may end above its tolerance.

        Steps with contact, or after a jump of the flange, are always solved to the tolerance, as a residual
        would be a spurious contact force.

        Args:
            problem: of the step.
            state: at the start.
            x: (n, 3) [m], initial guess; overwritten with the solution.
            accuracy: None for an ordinary step.
            jumps: whether the flange has jumped.
            began: evaluation at x, if x was evaluated last.
        """
        loads, film = problem.acting.loads, problem.film
        if accuracy is not None:
            bounds: tuple[NewtonOptions, ...] = accuracy.newton(self.options)
        elif jumps or loads.contact is not None or loads.self_contact is not None:
            bounds = (self._whole,)
        else:
            bounds = self._first, self._whole
        iterations = factorisations = 0
        for bound in bounds:
            progress = self.solver.run(problem, x, bound, began)
            iterations += progress.iterations
            factorisations += progress.tangents + progress.failed
            solution = self._result(problem, x, progress)
            if bound is not bounds[0]:
                solution = replace(solution, iterations=iterations, factorisations=factorisations)
            if self._ends(solution, accuracy, bound is bounds[-1]):
                break
            memory = (
                film.unslid(solution.memory, state.memory) if accuracy is None else film.fresh(state.memory)
            )
            np.copyto(film.before, memory)
            began = None
        return self._with_losses(problem, state, x, solution, accuracy)

    def _ends(self, solution: NewtonResult, accuracy: StepAccuracy | None, last: bool) -> bool:
        """Return whether the solution is final."""
        if accuracy is not None:
            return not solution.converged or solution.residual_N < accuracy.tolerance_N
        return last or solution.outcome is not Outcome.ITERATION_LIMIT or self._acceptable(solution)

    def _result(self, problem: Problem, x: Array, progress: NewtonProgress) -> NewtonResult:
        if progress.outcome in (Outcome.ITERATION_LIMIT, Outcome.NO_DESCENT):
            problem.evaluate(x)
        return progress.result(x, problem.film.memory.copy())

    def _with_losses(
        self,
        problem: Problem,
        state: SoftState,
        x: Array,
        solution: NewtonResult,
        accuracy: StepAccuracy | None,
    ) -> NewtonResult:
        """Repeat while the shape changes the losses of cables of commanded length, which are stiff."""
        film, acting = self.solver.film, problem.acting
        if not losses_follow(film.body.cables, acting.loads.cable_length_m):
            return solution
        tolerance_N = self.options.tolerance_N if accuracy is None else accuracy.tolerance_N
        options = replace(self.options.newton, tolerance_N=tolerance_N, start_tolerance_N=tolerance_N)
        for _ in range(_LOSS_ROUNDS_MAX):
            if not (solution.converged or self._acceptable(solution, accuracy)):
                break
            memory, x = film.unslid(solution.memory, state.memory), x.copy()
            repeated_problem = self.solver.problem(x, memory, acting.loads, acting.inertia, problem.frame)
            progress = self.solver.run(repeated_problem, x, options)
            if progress.outcome is not Outcome.CONVERGED:
                break
            iterations, factorisations = solution.iterations + progress.iterations, solution.factorisations
            solution = replace(
                self._result(repeated_problem, x, progress),
                iterations=iterations,
                factorisations=factorisations + progress.tangents + progress.failed,
            )
            if progress.iterations == 0:
                break
        return solution

    def _acceptable(self, solution: NewtonResult, accuracy: StepAccuracy | None = None) -> bool:
        """Return whether a step may end above its tolerance: all iterations spent, residual in bounds."""
        if accuracy is not None:
            # below an ordinary step's tolerance rounding may leave no descent
            return solution.residual_N <= self.options.tolerance_N
        return solution.outcome is Outcome.ITERATION_LIMIT and solution.residual_N <= self._bound_N

    def _end(self, state: SoftState, solution: NewtonResult, scheme: StepScheme, loads: Loads) -> SoftState:
        """Return the state at the end of a step."""
        x, pairs = solution.positions, loads.self_contact
        velocities = (x - self._base) / scheme.coefficients.span
        touching = None
        if pairs is not None and self.self_contact is not None:
            touching, self.self_contact.work_J = pairs.end(state.positions, x)
        memory = self.solver.film.advanced(x, solution.memory)
        return SoftState(x, velocities, memory, (state.positions, state.velocities), touching)

    def _ranked(
        self,
        starts: list[Array],
        state: SoftState,
        motion: Pose,
        flange: Array,
        loads: Loads,
        inertia: Inertia,
    ) -> list[Array]:
        """Return the initial guesses and the state moved with the flange, in order of their potential.

        Free flight follows tangents; after a large rotation of the flange it would stretch the film.
        """
        film, held = self.solver.film, self.clamp.held
        carried = np.ascontiguousarray(motion.apply(state.positions))
        losses = film.losses_at(state.positions, loads, state.memory)

        def potential(start: Array) -> float:
            placed = start.copy()
            unchecked(place_held)(held, flange, placed)
            value = film.evaluate(placed, loads, losses, state.memory, inertia=inertia, hessian=False)
            return value if math.isfinite(value) else math.inf

        return sorted([*starts, carried], key=potential)

    def factorise(self, state: SoftState, world_from_flange: Pose, loads: Loads, step_s: float) -> bool:
        """Factorise the tangent of a step that ends at a state; return False if it is indefinite.

        Args:
            state: at the end of a step.
            world_from_flange: pose of the flange there.
            loads: that act there.
            step_s: h [s].
        """
        scheme = self.scheme_of(state, step_s)  # the target of inertia does not enter the tangent
        self.fill_rates(state, scheme)
        inertia = Inertia(scheme.inertia, state.positions, step_s, self.options.closely, self.rates)
        films = self.self_contact
        if films is not None and not films.is_deferred(state):
            loads = loads.with_films(films.step_pairs(state, step_s))
        return self.solver.factorise(
            state.positions, state.memory, loads, inertia, world_from_flange.rotation
        )

    def wrench(self, end: SoftState, world_from_flange: Pose) -> Wrench:
        """Return the body's wrench on the flange, at its origin, world axes, at the end of a step."""
        film, damped = self.solver.film, None
        if self._scheme is not None and self._scheme.coefficients.alpha_s > 0.0:
            coefficients = self._scheme.coefficients  # of the last step
            damped = (
                DampedNodes(film.mass, coefficients.alpha_s, coefficients.span, self._along),
                end.velocities,
            )
        return self.clamp.wrench(film.gradient, end.positions, world_from_flange, damped)

    def scheme_of(self, state: SoftState, step_s: float) -> StepScheme:
        """Return the scheme of a step; the same object for the same kind of step."""
        coefficients, last = self.options.coefficients(step_s, first=state.earlier is None), self._scheme
        if last is None or last.coefficients != coefficients:
            last = self._scheme = StepScheme.of(coefficients, self.options, self.solver.film.mass)
        return last


def _turn(before: Pose, after: Pose) -> float:
    """Return the angle [rad] between two poses."""
    cosine = 0.5 * (float(before.rotation.ravel().dot(after.rotation.ravel())) - 1.0)
    return math.acos(min(1.0, max(-1.0, cosine)))
