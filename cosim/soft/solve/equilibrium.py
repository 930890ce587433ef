"""Static equilibrium of a soft body on a flange, followed from a known one.

Pseudo-transient continuation: equilibria that Newton's method does not reach, by damped steps that grow.

Each step minimises potential + c |x - x_n|^2 / 2, an implicit step of a body without mass in a viscous bath:
c = drag / pseudo time. c falls while steps succeed, so that the shape slides from where a branch of
equilibria ends to the next stable one, where Newton's method proper takes over: what is found is an
equilibrium of the body alone.
Source: Kelley and Keyes, SIAM J. Numer. Anal. 35 (1998) 508.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import place_of_largest
from cosim.soft.elements.cable import losses_follow
from cosim.soft.film.inertia import Inertia
from cosim.soft.solve import branching, newton
from cosim.soft.solve.newton_options import NewtonOptions, NewtonResult, Outcome, SearchEffort
from cosim.soft.solve.self_contact import SelfContact
from cosim.soft.solve.stability import LowestMode, describe_instability, lowest_mode, switch_branch
from cosim.soft.solve.state import Clamp, Equilibrium, Obstacles, SoftState

_BED_N_m = 1e3  # c of the first step
_FALL, _RISE = 0.4, 6.0
_LEAST_BED_N_m, _LARGEST_BED_N_m = 1e-3, 1e7
_PROPER_BELOW_N_m = 10.0  # where Newton's method proper is tried
_ITERATIONS_MAX = 12  # of a step
_STEPS_MAX = 150
_UNMOVED_MAX = 400  # iterations that moved nothing, before a slide is given up
_LESS = 0.5  # of the force out of balance: gets a slide some more patience, see `SearchEffort`


def slide(
    solver: newton.NewtonSolver,
    start: Array,
    memory: Array,
    loads_at: Callable[[Array], Loads],
    options: NewtonOptions,
    effort: SearchEffort,
) -> NewtonResult:
    """Return the equilibrium that a damped body slides to, or how far it got.

    Args:
        solver: Newton's method for the body.
        start: (n, 3) [m], clamped components where they shall be.
        memory: (values,), what the elements remember of the last accepted state.
        loads_at: positions (n, 3) [m] -> loads, with what is touched near them.
        options: bounds of Newton's method.
        effort: counts the iterations.

    Raises:
        ConvergenceError: the search took all the iterations that it may.
    """
    options = replace(options, reuse_max=0)
    step = replace(options, iterations_max=min(_ITERATIONS_MAX, options.iterations_max))
    bed, x, spent, lost, shifted = _BED_N_m, start, 0, 0, 0
    moved, softer, rests = np.inf, False, False
    least_N, since = np.inf, 0
    found: NewtonResult | None = None
    for _ in range(_STEPS_MAX):
        loads, bounded = loads_at(x), effort.bounded(step)
        tried = solver.solve(x, memory, loads, bounded, Inertia(np.full(len(x), bed), x))
        effort.spend(tried)
        spent, shifted = spent + tried.iterations, shifted + tried.shifted
        if tried.outcome is Outcome.INDEFINITE and not tried.iterations:
            break  # shifts larger than any bed were tried here
        if tried.outcome is Outcome.NOT_FINITE or tried.outcome is Outcome.INDEFINITE:
            bed *= _RISE
            lost += tried.iterations
        else:
            before, moved = moved, float(np.abs(tried.positions - x).max())
            rests, softer = softer and moved <= before, tried.converged
            x, memory = tried.positions, tried.memory
            borne_N = bed * moved  # by the bed: out of balance without it
            if tried.converged and borne_N < _LESS * least_N:
                least_N, since = borne_N, spent
            bed *= _FALL if tried.converged else _RISE
        # beyond the end of a branch steps grow as the bed softens: no equilibrium is near yet
        if tried.converged and bed < _PROPER_BELOW_N_m and rests:
            found = solver.solve(x, memory, loads, effort.bounded(options))
            effort.spend(found)
            spent, shifted = spent + found.iterations, shifted + found.shifted
            if found.converged:
                break
            lost += found.iterations
        bed = max(bed, _LEAST_BED_N_m)
        if bed > _LARGEST_BED_N_m or lost >= _UNMOVED_MAX or spent - since >= effort.patience:
            break
    if found is None:
        found = solver.solve(x, memory, loads_at(x), effort.bounded(options))
        effort.spend(found)
        spent, shifted = spent + found.iterations, shifted + found.shifted
    return replace(found, iterations=spent, shifted=shifted)


_SPLITS_MAX = 8
_LOST_MAX = 250  # iterations that led nowhere, on one way, before its pieces are no longer halved
_WEIGHT_PIECES = 8  # in which a body that is filled without weight gets it
_FRICTION_ROUNDS_MAX = 30
CONTACT_ROUNDS_MAX = 40
_FOOT_SLACK = 0.02  # more in every round
_SHRINKS_BELOW = 0.99  # a sequence of shapes that is extrapolated
_EXTRAPOLATED_M = 1e-3  # at most
_STRETCH_MAX = 10.0  # of the film's edges, in the mean; rubber tears sooner


@final
class EquilibriumSolver:
    """Follows equilibria of one body with a given clamp.

    `obstacles` says what the film may touch; None for what the loads name.

    Args:
        solver: Newton's method for the body with that clamp.
        clamp: nodes held by the flange.
        options: bounds of the iteration.
        self_contact: of the body's films with one another; None where it is not modelled.
        effort: counts the iterations of searches; None: only those of this solver.
        slides_max: how often, on one way, the body may slide to another branch; see `follow`.
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
        self._stable: tuple[Array, Loads] | None = None  # the last shape that was seen to be so, under loads

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go.

        Args:
            state: where it starts; its memory is that of a state near it.
            world_from_flange: pose of the flange.
            loads: that act.
            start: (n, 3) [m], better guess of the positions, if there is one.

        Raises:
            ConvergenceError: none was found.
        """
        guess = self.clamp.place(state.positions if start is None else start, world_from_flange)
        films, here = self.self_contact, (guess, state.memory, world_from_flange, loads)
        if films is None or not films.waits(state):
            return self._solve(films, *here)
        found = self._solve(None, *here)
        if not films.press_at_rest(found.state.positions):
            return found
        again = self._solve(films, *here)
        return replace(again, iterations=found.iterations + again.iterations)

    def out_of_balance(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> float:
        """Return the largest force [N] that is out of balance in a state, that of films that press included.

        Args:
            state: any.
            world_from_flange: pose of the flange, which clamped components are moved to first.
            loads: that act.
        """
        film, x = self.solver.film, self.clamp.place(state.positions, world_from_flange)
        loads, gradient = self._touched(self.self_contact, x, loads), film.gradient.copy()
        share = film.losses_at(x, loads, state.memory)
        film.evaluate(x, loads, share, state.memory.copy(), hessian=False)
        found = float(np.abs(film.gradient[self.solver.free]).max())
        film.gradient[:] = gradient
        return found

    def _solve(
        self, films: SelfContact | None, guess: Array, memory: Array, world_from_flange: Pose, loads: Loads
    ) -> Equilibrium:
        """Find the equilibrium near a guess, with contact of films or without."""
        frame = world_from_flange.rotation
        result, loads = self._settle_contacts(films, guess, memory, loads, frame)
        result = self._settle_friction(result, memory, loads, frame)
        if not result.converged:
            film = self.solver.film
            raise ConvergenceError(
                f"no equilibrium found: {result.outcome.value}; residual {result.residual_N:.3g} N, bound "
                f"{self.options.tolerance_N:.3g} N, {result.iterations} iterations, the largest "
                f"at {place_of_largest(film.body, result.positions, film.gradient, self.solver.free)}",
                result.residual_N,
                result.iterations,
            )
        pairs = loads.self_contact
        touching = None if pairs is None else pairs.memory(result.positions, resting=True)
        wrench = self.clamp.wrench(self.solver.film.gradient, result.positions, world_from_flange)
        memory = self.solver.film.advanced(result.positions, result.memory)
        return Equilibrium(
            SoftState.at_rest(result.positions, memory, touching), world_from_flange, loads, wrench,
            result.residual_N, result.iterations, result.potential_J, result.shifted,
            negative_pivots=self._negative_pivots(result, loads, frame),
        )  # fmt: skip

    def _negative_pivots(self, result: NewtonResult, loads: Loads, frame: Array) -> int | None:
        """Return in how many directions the potential falls; None without a potential, or if not asked."""
        solver, here = self.solver, (result.positions, result.memory, loads)
        looks = self.options.sees_saddles and solver.film.conservative
        if result.negative_pivots is not None or not looks:
            return result.negative_pivots
        x, known = result.positions, self._stable
        if known is not None and known[1] is loads and np.array_equal(known[0], x):
            return 0
        # a factorisation that was kept may be of another shape; the new one serves the next solution
        if not solver.factorise(*here, None, frame):
            return solver.negative_pivots(*here)
        self._stable = x, loads
        return 0

    def hang(
        self, state: SoftState, world_from_flange: Pose, gravity: tuple[float, float, float]
    ) -> Equilibrium:
        """Find the first equilibrium of all: hung up without pressure and tension.

        Args:
            state: near it, such as the drawn shape.
            world_from_flange: pose of the flange.
            gravity: (3,) [m/s^2], world.

        Raises:
            ConvergenceError: none was found.
        """
        hanging = Loads((), (0.0,) * len(self.solver.film.body.cables), gravity)
        with self.effort.search("the equilibrium without pressure and tension"):
            try:
                return self.switch_branch(None, self.solve(state, world_from_flange, hanging))
            except ConvergenceError:
                if not self.slides_max:
                    raise
                return self.switch_branch(None, self.slide(state, world_from_flange, hanging))

    def load(self, hung: Equilibrium, loads: Loads) -> Equilibrium:
        """Find the equilibrium under the first loads.

        A body that cannot be followed there, as a slack one that has fallen over its own base, is filled
        without weight first, and then gets its weight piece by piece.

        Args:
            hung: up without pressure and tension, see `hang`.
            loads: that act in the end.

        Raises:
            ConvergenceError: none was found.
        """
        try:
            found = self.follow(hung, hung.world_from_flange, loads)
        except ConvergenceError:
            if not (any(loads.pressure_Pa) and any(loads.gravity)):
                raise
            with self.effort.search_apart("an equilibrium of a body that is filled without weight first"):
                found = self._filled_first(hung.world_from_flange, loads)
        spent, slides = hung.iterations + found.iterations, hung.slides + found.slides
        return replace(
            found, iterations=spent, slides=slides, branchings=(*hung.branchings, *found.branchings)
        )

    def _filled_first(self, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Return the equilibrium under loads, of the body that gets its weight last."""
        weightless = replace(loads, gravity=(0.0, 0.0, 0.0))
        drawn = SoftState.drawn(self.solver.film.body, world_from_flange)
        here = self.hang(drawn, world_from_flange, weightless.gravity)
        here = self.follow(here, world_from_flange, weightless)
        for k in range(1, _WEIGHT_PIECES + 1):
            part = weightless.interpolated(loads, k / _WEIGHT_PIECES)
            found = self.follow(here, world_from_flange, part)
            here = replace(
                found,
                iterations=here.iterations + found.iterations,
                slides=here.slides + found.slides,
                branchings=(*here.branchings, *found.branchings),
            )
        return here

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads, in as few pieces as it takes.

        The body is first carried rigidly with the flange. A piece that does not converge is halved. Where
        even the smallest does not, or too many iterations led nowhere, the body slides on to where it comes
        to rest: the work is bounded, and pieces that would never arrive are given up soon.

        Args:
            begin: where to start.
            world_from_flange: wanted pose of the flange.
            loads: wanted loads.

        Raises:
            ConvergenceError: a piece of 1/256 of the way, or what many iterations were lost on, did not
                converge, nor did the slide from there; or the search took all the iterations that it may.
        """
        with self.effort.search("an equilibrium"):
            return self._follow(begin, world_from_flange, loads)

    def _follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        here, done, piece, spent, slides, lost = begin, 0.0, 1.0, 0, 0, 0
        branchings: tuple[branching.Branching, ...] = ()
        while done < 1.0:
            load_factor = min(1.0, done + piece)
            pose = begin.world_from_flange.interpolated(world_from_flange, load_factor)
            load = begin.loads.interpolated(loads, load_factor)
            state = here.state.carried(pose @ here.world_from_flange.inverse())
            self.effort.tries(load.cable_tension_N, done, load_factor)
            try:
                found = self.switch_branch(here, self.solve(state, pose, load))
            except ConvergenceError as error:
                spent, lost = spent + error.iterations, lost + error.iterations
                if piece > 0.5**_SPLITS_MAX and lost < _LOST_MAX:
                    piece = 0.5 * min(piece, 1.0 - done)
                    continue
                if slides == self.slides_max:
                    raise _given_up(error, done, spent) from None
                try:
                    found = self.switch_branch(here, self.slide(state, pose, load))
                    slides, piece = slides + 1, 1.0
                except ConvergenceError as last:
                    raise _given_up(last, done, spent + last.iterations) from None
            branchings += tuple(
                replace(each, load_factor=done + each.load_factor * (load_factor - done))
                for each in found.branchings
            )
            here, done, spent = found, load_factor, spent + found.iterations
            self._check_stretch(here, spent)
        return replace(here, iterations=spent, slides=slides, branchings=branchings)

    def _check_stretch(self, here: Equilibrium, spent: int) -> None:
        """Refuse a film that is stretched as no film can be, before anything is searched for with it."""
        (edges, drawn), x = self._drawn_edges, here.state.positions
        along = x[edges[:, 1]] - x[edges[:, 0]]
        length = float(np.sqrt(np.einsum("er,er->e", along, along)).sum())
        if length > _STRETCH_MAX * drawn:
            raise ConvergenceError(
                f"the film is stretched to {length / drawn:.3g} times its drawn length (bound "
                f"{_STRETCH_MAX:g}); raise its young_modulus_Pa or thickness_m, or lower the pressure",
                here.residual_N,
                spent,
            )

    @cached_property
    def _drawn_edges(self) -> tuple[IntArray, float]:
        """Two edges (e, 2) of every triangle, and how long [m] all of them are together as drawn."""
        triangles, drawn = self.body.triangles, self.body.positions
        edges = np.concatenate((triangles[:, :2], triangles[:, 1:]))
        return edges, float(np.linalg.norm(drawn[edges[:, 1]] - drawn[edges[:, 0]], axis=1).sum())

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium in place of one that is not, see `stability.switch_branch`."""
        return switch_branch(self, begin, found)

    @property
    def body(self) -> SoftBody:
        """Whose equilibria they are."""
        return self.solver.film.body

    def lowest_mode(self, here: Equilibrium) -> LowestMode:
        """Return the lowest eigenvalue of the tangent stiffness at an equilibrium, and its mode."""
        return lowest_mode(self.solver, here.state, here.loads, here.world_from_flange.rotation)

    def describe_instability(self, here: Equilibrium, lowest: LowestMode) -> branching.Branching:
        """Return what is known of an equilibrium that gives way along a mode by itself."""
        return describe_instability(
            self.solver, here.state, here.loads, lowest, max(1, here.negative_pivots or 0)
        )

    def slide(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Find the equilibrium that a damped body slides to, however far from a state: the last resort.

        Args:
            state: where it starts.
            world_from_flange: pose of the flange.
            loads: that act.

        Raises:
            ConvergenceError: it comes to rest nowhere.
        """
        films = self.self_contact
        if films is None or not films.waits(state):
            return self._slide(films, state, world_from_flange, loads)
        try:
            found = self._slide(None, state, world_from_flange, loads)
            if not films.press_at_rest(found.state.positions):
                return found
        except ConvergenceError:
            if films.static_pairs(state.positions) is None:
                raise
        return self._slide(films, state, world_from_flange, loads)

    def _slide(
        self, films: SelfContact | None, state: SoftState, world_from_flange: Pose, loads: Loads
    ) -> Equilibrium:
        """Slide with contact of films or without."""
        start = self.clamp.place(state.positions, world_from_flange)
        self.effort.trying = "sliding to where it comes to rest"
        slid = slide(
            self.solver, start, state.memory, lambda x: self._touched(films, x, loads), self.options,
            self.effort,
        )  # fmt: skip
        try:
            placed = self.clamp.place(slid.positions, world_from_flange)
            rest = self._solve(films, placed, slid.memory, world_from_flange, loads)
        except ConvergenceError as error:
            error.iterations += slid.iterations
            raise
        return replace(rest, iterations=slid.iterations + rest.iterations, slides=1)

    def _touched(self, films: SelfContact | None, positions: Array, loads: Loads) -> Loads:
        """Return the loads with what is touched near given positions."""
        obstacles = self.obstacles
        planes = loads.contact if obstacles is None else obstacles(positions)
        pairs = None if films is None else films.static_pairs(positions, None, 0.0)
        return replace(loads, contact=planes, self_contact=pairs)

    def _newton(self, start: Array, memory: Array, loads: Loads, frame: Array) -> NewtonResult:
        options = self.effort.bounded(self.options)
        result = self.solver.solve(start, memory, loads, options, None, frame)
        self.effort.spend(result)
        return result

    def _settle_contacts(
        self, films: SelfContact | None, start: Array, memory: Array, loads: Loads, frame: Array
    ) -> tuple[NewtonResult, Loads]:
        """Solve, and repeat while something else is touched than what was found before the solution.

        What elements look at again as a solution begins is seen again at its end by that as well.

        Returns:
            The solution, and the loads with the contacts it was found with.

        Raises:
            ConvergenceError: the contacts keep changing.
        """
        obstacles = self.obstacles
        if films is None and loads.self_contact is not None:  # of an equilibrium before
            loads = replace(loads, self_contact=None)
        if films is None and obstacles is None and not self.solver.film.freshens:
            return self._newton(start, memory, loads, frame), loads
        pairs, spent, shifted, trail, ways = None, 0, 0, [], None
        for round_ in range(CONTACT_ROUNDS_MAX):
            if films is not None:
                # a foot at the edge of two triangles could change sides for ever: it sticks more and more
                pairs = films.static_pairs(start, pairs, _FOOT_SLACK * round_)
            planes = loads.contact if obstacles is None else obstacles(start)
            loads = replace(loads, contact=planes, self_contact=pairs)
            result = self._newton(start, memory, loads, frame)
            settled = round_ > 0 and result.iterations == 0
            spent, shifted = spent + result.iterations, shifted + result.shifted
            if settled or not result.converged:
                ways = ways if settled else result.negative_pivots
                return replace(result, iterations=spent, shifted=shifted, negative_pivots=ways), loads
            start, ways = result.positions, result.negative_pivots
            memory = self.solver.film.unslid(result.memory, memory)
            if obstacles is not None or self.solver.film.slides:
                trail.append(start)
                start = end_of(trail)
                ways = ways if start is result.positions else None
        near = 0 if planes is None else len(planes.nodes)
        raise ConvergenceError(
            f"no equilibrium found: the touched places still change after {CONTACT_ROUNDS_MAX} rounds, "
            f"{len(pairs or ())} pairs of films, {near} points near obstacles; try smaller increments",
            result.residual_N,
            spent,
        )

    def _settle_friction(
        self, result: NewtonResult, accepted: Array, loads: Loads, frame: Array
    ) -> NewtonResult:
        """Repeat while losses along the cables change with the shape: friction has no potential."""
        film, cables = self.solver.film, self.solver.film.body.cables
        friction = any(cable.friction_coefficient for cable in cables) or film.slides
        if not friction and not losses_follow(cables, loads.cable_length_m):
            return result
        for _ in range(_FRICTION_ROUNDS_MAX):
            memory = film.unslid(result.memory, accepted)
            again = self._newton(result.positions, memory, loads, frame)
            if not again.converged:
                return again
            settled = again.iterations == 0
            spent, shifted = result.iterations + again.iterations, result.shifted + again.shifted
            result = replace(again, iterations=spent, shifted=shifted)
            if settled:
                return result
        # between sticking and slipping rounds may go in circles: a smaller piece of the way does not
        return replace(result, outcome=Outcome.ITERATION_LIMIT) if film.slides else result


def _given_up(error: ConvergenceError, done: float, spent: int) -> ConvergenceError:
    """Return an error that also says how far a body was followed, and with how many iterations, if any."""
    if not spent:
        return error
    message = f"{error}; followed over {100.0 * done:.3g} % of the way, given up after {spent} iterations"
    return ConvergenceError(message, error.residual_N, spent)


def end_of(trail: list[Array]) -> Array:
    """Return where a sequence of shapes goes, whose steps shrink by one factor r: x + d r / (1 - r) (Aitken).

    On a curved obstacle, whose tangent planes move with the film, the rounds converge like that. A sequence
    that was extrapolated starts again.

    Args:
        trail: the shapes (n, 3) [m] so far; emptied when it is extrapolated.
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
