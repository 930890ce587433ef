"""Static equilibrium of a soft body on a flange, by continuation from a known one."""

from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import describe_largest
from cosim.soft.elements.cable import losses_follow
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import branching, newton
from cosim.soft.solve.branch_switching import switch_branch
from cosim.soft.solve.branching import LowestMode
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.lowest_mode import describe_instability, lowest_mode
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome
from cosim.soft.solve.pseudo_time import slide
from cosim.soft.solve.search_effort import SearchEffort
from cosim.soft.solve.self_contact import SelfContact
from cosim.soft.solve.sensitivity import Sensitivity
from cosim.soft.solve.slack_film import is_slack, open_film
from cosim.soft.solve.state import Equilibrium, Obstacles, SoftState

_SPLITS_MAX = 8
_FAILED_MAX = 250  # iterations of failed load steps above which load steps are not halved any more
_WEIGHT_STEPS = 8  # load steps of the weight, for a body that is filled without weight
_FRICTION_ROUNDS_MAX = 30
CONTACT_ROUNDS_MAX = 40
_FOOT_SLACK = 0.02  # slack of feet on triangles, added in every round
_SHRINKS_BELOW = 0.99  # ratio of steps below which a sequence of shapes is extrapolated
_EXTRAPOLATED_M = 1e-3  # at most
_STRETCH_MAX = 10.0  # mean stretch of the film's edges; rubber tears earlier


@final
class EquilibriumSolver:
    """Follows equilibria of one body with a given clamp.

    `obstacles` returns the possible contacts; None to use those in the loads.

    Args:
        solver: Newton's method for the body with that clamp.
        clamp: nodes held by the flange.
        options: bounds of the iteration.
        self_contact: of the body's films; None if it is not modelled.
        effort: counts the iterations of searches; None to count those of this solver only.
        slides_max: number of slides to another branch in one continuation, see `follow`.
    """

    def __init__(
        self,
        solver: newton.NewtonSolver,
        clamp: Clamp,
        options: NewtonOptions,
        self_contact: SelfContact | None = None,
        effort: SearchEffort | None = None,
        slides_max: int = 4,
    ) -> None:
        self.solver = solver
        self.clamp = clamp
        self.options = options
        self.self_contact = self_contact
        self.slides_max = slides_max
        self.effort = SearchEffort(options.search_iterations_max) if effort is None else effort
        solver.watch = self.effort.watch
        self.obstacles: Obstacles | None = None
        self._stable: tuple[Array, Loads] | None = None  # last shape and loads found stable

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state without continuation.

        Args:
            state: initial guess; its memory must be of a nearby state.
            world_from_flange: pose of the flange.
            loads: that act.
            start: (n, 3) [m], better guess of the positions, or None.

        Raises:
            ConvergenceError: none was found.
        """
        guess = self.clamp.place(state.positions if start is None else start, world_from_flange)
        films, problem = self.self_contact, (guess, state.memory, world_from_flange, loads)
        if films is None or not films.is_deferred(state):
            return self._solve(films, *problem)
        without_films = self._solve(None, *problem)
        if not films.presses_at_rest(without_films.state.positions):
            return without_films
        with_films = self._solve(films, *problem)
        return replace(with_films, iterations=without_films.iterations + with_films.iterations)

    def out_of_balance(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> float:
        """Return the largest residual force [N] of a state, with self-contact.

        Args:
            state: any state; clamped components are moved to the flange first.
            world_from_flange: pose of the flange.
            loads: that act.
        """
        film, x = self.solver.film, self.clamp.place(state.positions, world_from_flange)
        loads, gradient = self._with_contacts(self.self_contact, x, loads), film.gradient.copy()
        tensions = film.losses_at(x, loads, state.memory)
        film.evaluate(x, loads, tensions, state.memory.copy(), hessian=False)
        residual_N = float(np.abs(film.gradient[self.solver.free]).max())
        film.gradient[:] = gradient
        return residual_N

    def _solve(
        self, films: SelfContact | None, guess: Array, memory: Array, world_from_flange: Pose, loads: Loads
    ) -> Equilibrium:
        """Find the equilibrium near a guess, with or without self-contact."""
        frame = world_from_flange.rotation
        solution, loads = self._solve_contacts(films, guess, memory, loads, frame)
        solution = self._solve_friction(solution, memory, loads, frame)
        if not solution.converged:
            film = self.solver.film
            raise ConvergenceError(
                f"no equilibrium found: {solution.outcome.value}; residual {solution.residual_N:.3g} N, "
                f"bound {self.options.tolerance_N:.3g} N, {solution.iterations} iterations, the largest "
                f"at {describe_largest(film.body, solution.positions, film.gradient, self.solver.free)}",
                solution.residual_N,
                solution.iterations,
            )
        pairs = loads.self_contact
        touching = None if pairs is None else pairs.memory(solution.positions, resting=True)
        wrench = self.clamp.wrench(self.solver.film.gradient, solution.positions, world_from_flange)
        memory = self.solver.film.advanced(solution.positions, solution.memory)
        return Equilibrium(
            SoftState.at_rest(solution.positions, memory, touching), world_from_flange, loads, wrench,
            solution.residual_N, solution.iterations, solution.potential_J, solution.shifted,
            negative_pivots=self._negative_pivots(solution, loads, frame),
        )  # fmt: skip

    def _negative_pivots(self, solution: NewtonResult, loads: Loads, frame: Array) -> int | None:
        """Return the number of unstable directions; None without a potential, or if checks are off."""
        solver, problem = self.solver, (solution.positions, solution.memory, loads)
        checks = self.options.checks_stability and solver.film.conservative
        if solution.negative_pivots is not None or not checks:
            return solution.negative_pivots
        x, last_stable = solution.positions, self._stable
        if last_stable is not None and last_stable[1] is loads and np.array_equal(last_stable[0], x):
            return 0
        # a reused factorisation may be of another shape; the next solution can reuse the new one
        if not solver.factorise(*problem, None, frame):
            return solver.negative_pivots(*problem)
        self._stable = x, loads
        return 0

    def hang(
        self, state: SoftState, world_from_flange: Pose, gravity: tuple[float, float, float]
    ) -> Equilibrium:
        """Find the first equilibrium, without pressure and tension.

        Args:
            state: initial guess, such as the drawn shape.
            world_from_flange: pose of the flange.
            gravity: (3,) [m/s^2], world.

        Raises:
            ConvergenceError: none was found.
        """
        hanging = Loads((), (0.0,) * len(self.solver.film.body.cables), gravity)
        with self.effort.search("the equilibrium without pressure and tension"):
            state = self.opened(state, world_from_flange, hanging)
            try:
                return self.switch_branch(None, self.solve(state, world_from_flange, hanging))
            except ConvergenceError:
                if not self.slides_max:
                    raise
                return self.switch_branch(None, self.slide(state, world_from_flange, hanging))

    def opened(self, state: SoftState, world_from_flange: Pose, hanging: Loads) -> SoftState:
        """Return where slack film opens to; the given state if it is not slack, or no way there is found.

        Args:
            state: drawn shape on the flange.
            world_from_flange: pose of the flange.
            hanging: loads without pressure and tension.
        """
        body = self.solver.film.body
        if not is_slack(body):
            return state
        try:
            return open_film(self._of_other, body, state, world_from_flange, hanging)
        except ConvergenceError:
            return state

    def _of_other(self, body: SoftBody) -> "EquilibriumSolver":
        """Return a solver of a body with other elements, held as this one; its iterations count here."""
        film = FilmPotential(body)
        newton_solver = newton.NewtonSolver(film, self.solver.clamped)
        other = EquilibriumSolver(newton_solver, self.clamp, self.options, self.self_contact, self.effort)
        other.obstacles = self.obstacles
        return other

    def load(self, hung: Equilibrium, loads: Loads) -> Equilibrium:
        """Find the equilibrium under the first loads.

        If the continuation fails, as for a slack body that has fallen over its base, the body is first filled
        without weight, which is then added in load steps.

        Args:
            hung: equilibrium without pressure and tension, see `hang`.
            loads: first loads.

        Raises:
            ConvergenceError: none was found.
        """
        try:
            loaded = self.follow(hung, hung.world_from_flange, loads)
        except ConvergenceError:
            if not (any(loads.pressure_Pa) and any(loads.gravity)):
                raise
            with self.effort.search_apart("an equilibrium of a body that is filled without weight first"):
                loaded = self._filled_first(hung.world_from_flange, loads)
        iterations, slides = hung.iterations + loaded.iterations, hung.slides + loaded.slides
        return replace(
            loaded, iterations=iterations, slides=slides, branchings=(*hung.branchings, *loaded.branchings)
        )

    def _filled_first(self, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Return the equilibrium under loads, with the weight added last."""
        weightless = replace(loads, gravity=(0.0, 0.0, 0.0))
        drawn = SoftState.drawn(self.solver.film.body, world_from_flange)
        equilibrium = self.hang(drawn, world_from_flange, weightless.gravity)
        equilibrium = self.follow(equilibrium, world_from_flange, weightless)
        for k in range(1, _WEIGHT_STEPS + 1):
            partial_loads = weightless.interpolated(loads, k / _WEIGHT_STEPS)
            next_equilibrium = self.follow(equilibrium, world_from_flange, partial_loads)
            equilibrium = replace(
                next_equilibrium,
                iterations=equilibrium.iterations + next_equilibrium.iterations,
                slides=equilibrium.slides + next_equilibrium.slides,
                branchings=(*equilibrium.branchings, *next_equilibrium.branchings),
            )
        return equilibrium

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads, in as few load steps as possible.

        In each load step the body is first moved rigidly with the flange. A load step that does not converge
        is halved. If the smallest one does not converge, or too many iterations have failed, the body slides
        to the next equilibrium, so that the work is bounded.

        Args:
            begin: start.
            world_from_flange: pose of the flange at the end.
            loads: at the end.

        Raises:
            ConvergenceError: neither the load step (of 1/256, or after too many failed iterations) nor the
                slide converged; or the search reached its bound of iterations.
        """
        with self.effort.search("an equilibrium"):
            return self._follow(begin, world_from_flange, loads)

    def _follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        equilibrium, reached, load_step, iterations, slides = begin, 0.0, 1.0, 0, 0
        failed = 0
        branchings: tuple[branching.Branching, ...] = ()
        while reached < 1.0:
            load_factor = min(1.0, reached + load_step)
            pose = begin.world_from_flange.interpolated(world_from_flange, load_factor)
            load = begin.loads.interpolated(loads, load_factor)
            state = equilibrium.state.carried(pose @ equilibrium.world_from_flange.inverse())
            self.effort.set_progress(load.cable_tension_N, reached, load_factor)
            try:
                next_equilibrium = self.switch_branch(equilibrium, self.solve(state, pose, load))
            except ConvergenceError as error:
                iterations += error.iterations
                failed += error.iterations
                if load_step > 0.5**_SPLITS_MAX and failed < _FAILED_MAX:
                    load_step = 0.5 * min(load_step, 1.0 - reached)
                    continue
                if slides == self.slides_max:
                    raise _with_progress(error, reached, iterations) from None
                try:
                    next_equilibrium = self.switch_branch(equilibrium, self.slide(state, pose, load))
                    slides, load_step = slides + 1, 1.0
                except ConvergenceError as last:
                    raise _with_progress(last, reached, iterations + last.iterations) from None
            branchings += tuple(
                replace(record, load_factor=reached + record.load_factor * (load_factor - reached))
                for record in next_equilibrium.branchings
            )
            equilibrium, reached = next_equilibrium, load_factor
            iterations += next_equilibrium.iterations
            self._check_stretch(equilibrium, iterations)
        return replace(equilibrium, iterations=iterations, slides=slides, branchings=branchings)

    def _check_stretch(self, equilibrium: Equilibrium, iterations: int) -> None:
        """Raise an error if the film is stretched more than any film can be, before the search continues."""
        (edges, drawn_length_m), x = self._drawn_edges, equilibrium.state.positions
        edge_vectors = x[edges[:, 1]] - x[edges[:, 0]]
        length_m = float(np.sqrt(np.einsum("er,er->e", edge_vectors, edge_vectors)).sum())
        if length_m > _STRETCH_MAX * drawn_length_m:
            raise ConvergenceError(
                f"the film is stretched to {length_m / drawn_length_m:.3g} times its drawn length (bound "
                f"{_STRETCH_MAX:g}); raise its young_modulus_Pa or thickness_m, or lower the pressure",
                equilibrium.residual_N,
                iterations,
            )

    @cached_property
    def _drawn_edges(self) -> tuple[IntArray, float]:
        """Two edges (e, 2) of every triangle, and their total length [m] as drawn."""
        triangles, drawn = self.body.triangles, self.body.positions
        edges = np.concatenate((triangles[:, :2], triangles[:, 1:]))
        return edges, float(np.linalg.norm(drawn[edges[:, 1]] - drawn[edges[:, 0]], axis=1).sum())

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium in place of an unstable one, see `branch_switching.switch_branch`."""
        return switch_branch(self, begin, found)

    @property
    def body(self) -> SoftBody:
        """The body."""
        return self.solver.film.body

    def sensitivity(self, equilibrium: Equilibrium) -> Sensitivity:
        """Return the sensitivity of the tip at an equilibrium, see `Sensitivity`."""
        return Sensitivity(self.solver, equilibrium)

    def lowest_mode(self, equilibrium: Equilibrium) -> LowestMode:
        """Return the lowest eigenvalue of the tangent stiffness at an equilibrium, and its mode."""
        frame = equilibrium.world_from_flange.rotation
        return lowest_mode(self.solver, equilibrium.state, equilibrium.loads, frame)

    def describe_instability(self, equilibrium: Equilibrium, lowest: LowestMode) -> branching.Branching:
        """Return the description of an unstable equilibrium, with its lowest mode."""
        unstable_directions = max(1, equilibrium.negative_pivots or 0)
        return describe_instability(
            self.solver, equilibrium.state, equilibrium.loads, lowest, unstable_directions
        )

    def slide(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Find the equilibrium that a damped body slides to, which may be far from the state.

        Args:
            state: start.
            world_from_flange: pose of the flange.
            loads: that act.

        Raises:
            ConvergenceError: the slide found no equilibrium.
        """
        films = self.self_contact
        if films is None or not films.is_deferred(state):
            return self._slide(films, state, world_from_flange, loads)
        try:
            without_films = self._slide(None, state, world_from_flange, loads)
            if not films.presses_at_rest(without_films.state.positions):
                return without_films
        except ConvergenceError:
            if films.static_pairs(state.positions) is None:
                raise
        return self._slide(films, state, world_from_flange, loads)

    def _slide(
        self, films: SelfContact | None, state: SoftState, world_from_flange: Pose, loads: Loads
    ) -> Equilibrium:
        """Slide with or without self-contact."""
        start = self.clamp.place(state.positions, world_from_flange)
        self.effort.activity = "sliding to where it comes to rest"
        slid = slide(
            self.solver, start, state.memory, lambda x: self._with_contacts(films, x, loads), self.options,
            self.effort,
        )  # fmt: skip
        try:
            placed = self.clamp.place(slid.positions, world_from_flange)
            rest = self._solve(films, placed, slid.memory, world_from_flange, loads)
        except ConvergenceError as error:
            error.iterations += slid.iterations
            raise
        return replace(rest, iterations=slid.iterations + rest.iterations, slides=1)

    def _with_contacts(self, films: SelfContact | None, positions: Array, loads: Loads) -> Loads:
        """Return the loads with the possible contacts near given positions."""
        obstacles = self.obstacles
        planes = loads.contact if obstacles is None else obstacles(positions)
        pairs = None if films is None else films.static_pairs(positions, None, 0.0)
        return replace(loads, contact=planes, self_contact=pairs)

    def _newton(self, start: Array, memory: Array, loads: Loads, frame: Array) -> NewtonResult:
        options = self.effort.bounded(self.options)
        solution = self.solver.solve(start, memory, loads, options, None, frame)
        self.effort.spend(solution)
        return solution

    def _solve_contacts(
        self, films: SelfContact | None, start: Array, memory: Array, loads: Loads, frame: Array
    ) -> tuple[NewtonResult, Loads]:
        """Solve, and repeat while the contacts at the solution differ from those it was solved with.

        Element data that is updated at the start of a solution is updated by these rounds as well.

        Returns:
            The solution, and the loads with its contacts.

        Raises:
            ConvergenceError: the contacts keep changing.
        """
        obstacles = self.obstacles
        if films is None and loads.self_contact is not None:  # of an earlier equilibrium
            loads = replace(loads, self_contact=None)
        if films is None and obstacles is None and not self.solver.film.freshens:
            return self._newton(start, memory, loads, frame), loads
        pairs, iterations, shifted, trail, negative_pivots = None, 0, 0, [], None
        for round_ in range(CONTACT_ROUNDS_MAX):
            if films is not None:
                # a foot at the edge of two triangles could change sides for ever, so its slack grows
                pairs = films.static_pairs(start, pairs, _FOOT_SLACK * round_)
            planes = loads.contact if obstacles is None else obstacles(start)
            loads = replace(loads, contact=planes, self_contact=pairs)
            solution = self._newton(start, memory, loads, frame)
            settled = round_ > 0 and solution.iterations == 0
            iterations, shifted = iterations + solution.iterations, shifted + solution.shifted
            if settled or not solution.converged:
                negative_pivots = negative_pivots if settled else solution.negative_pivots
                return replace(
                    solution, iterations=iterations, shifted=shifted, negative_pivots=negative_pivots
                ), loads
            start, negative_pivots = solution.positions, solution.negative_pivots
            memory = self.solver.film.unslid(solution.memory, memory)
            if obstacles is not None or self.solver.film.slides:
                trail.append(start)
                start = extrapolate(trail)
                negative_pivots = negative_pivots if start is solution.positions else None
        near_points = 0 if planes is None else len(planes.nodes)
        raise ConvergenceError(
            f"no equilibrium found: the contacts still change after {CONTACT_ROUNDS_MAX} rounds, "
            f"{len(pairs or ())} pairs of films, {near_points} points near obstacles; try smaller increments",
            solution.residual_N,
            iterations,
        )

    def _solve_friction(
        self, solution: NewtonResult, accepted: Array, loads: Loads, frame: Array
    ) -> NewtonResult:
        """Repeat the solution while losses along the cables change with the shape (no potential)."""
        film, cables = self.solver.film, self.solver.film.body.cables
        friction = any(cable.friction_coefficient for cable in cables) or film.slides
        if not friction and not losses_follow(cables, loads.cable_length_m):
            return solution
        for _ in range(_FRICTION_ROUNDS_MAX):
            memory = film.unslid(solution.memory, accepted)
            repeated = self._newton(solution.positions, memory, loads, frame)
            if not repeated.converged:
                return repeated
            settled = repeated.iterations == 0
            iterations = solution.iterations + repeated.iterations
            shifted = solution.shifted + repeated.shifted
            solution = replace(repeated, iterations=iterations, shifted=shifted)
            if settled:
                return solution
        # rounds may alternate between sticking and slipping; a smaller load step does not
        return replace(solution, outcome=Outcome.ITERATION_LIMIT) if film.slides else solution


def _with_progress(error: ConvergenceError, reached_factor: float, iterations: int) -> ConvergenceError:
    """Return an error with the load factor reached and the iterations spent, if any, in its message."""
    if not iterations:
        return error
    message = (
        f"{error}; followed over {100.0 * reached_factor:.3g} % of the way, given up after {iterations} "
        "iterations"
    )
    return ConvergenceError(message, error.residual_N, iterations)


def extrapolate(trail: list[Array]) -> Array:
    """Return the limit of a sequence of shapes whose steps shrink by r: x + d r / (1 - r) (Aitken).

    On a curved obstacle, whose tangent planes move with the film, the rounds converge linearly like that.

    Args:
        trail: the shapes (n, 3) [m] so far; emptied after an extrapolation.
    """
    if len(trail) < 3:
        return trail[-1]
    before, last = trail[-2] - trail[-3], trail[-1] - trail[-2]
    ratio = float(np.einsum("nr,nr->", before, last)) / max(float((before**2).sum()), 1e-300)
    if not 0.1 < ratio < _SHRINKS_BELOW:
        return trail[-1]
    step = ratio / (1.0 - ratio) * last
    end = trail[-1] + step * min(1.0, _EXTRAPOLATED_M / max(float(np.abs(step).max()), 1e-300))
    trail.clear()
    return end
