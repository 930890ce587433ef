"""The soft robot as a film: stepped, solved for equilibrium, and assessed for stability."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar, final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose
from cosim.base.kernels import unchecked
from cosim.base.state_checks import check_indices
from cosim.coupling.payload import fill_mass
from cosim.coupling.robots import shape_reader, soft_robot, soft_step, stability_ratio
from cosim.errors import ConvergenceError, InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact import contact_points, overlap_check
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import (
    branching,
    flange_search,
    newton_options,
    resting_film,
    search_effort,
    tension_search,
    tick_work,
    time_step,
)
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.linear_step import LinearStep
from cosim.soft.solve.newton import NewtonSolver, NewtonState
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.stability import assess_stability, find_instability
from cosim.soft.solve.state import Equilibrium, Obstacles, SoftState
from cosim.soft.solve.step_scheme import StepAccuracy, StepOptions, inertia_weight
from cosim.soft.solve.tip_target import TargetOptions, TipTarget

Result = TypeVar("Result")

_UNFOLDING_STEPS = 8  # from the drawn shape, so that folded hinges are tracked


@final
@dataclass(frozen=True)
class FilmRobotState:
    """State of a `FilmRobot`.

    Args:
        soft: shape and motion.
        clamp: held nodes.
        flange: pose of the flange at the end of the last step.
        loads: at the end of the last step.
        residual_N: of the last step.
        newton: state of the solver; None if it is left out.
    """

    soft: SoftState
    clamp: Clamp
    flange: Pose
    loads: Loads
    residual_N: float = 0.0
    newton: NewtonState | None = None

    def check(self, nodes: int) -> None:
        """Check that the state is of a body with this number of nodes.

        Raises:
            InputError: it is not.
        """
        if len(self.soft.positions) != nodes:
            raise InputError(f"the saved soft robot has {len(self.soft.positions)} nodes, this one {nodes}")
        check_indices(self.clamp.nodes, nodes, "nodes")
        for values in (self.loads.cable_length_m, self.loads.cable_stiffening):
            if len(values) not in (0, len(self.loads.cable_tension_N)):
                raise InputError(f"the saved loads have {len(values)} cables with a length")


@final
class FilmRobot(soft_robot.SoftRobot):
    """A film held by the flange; owns solver and state.

    `films` finds self-contact; None if it is not modelled, or no films can meet.

    Args:
        body: mesh and elements.
        world_from_flange: first pose of the flange; the body starts in its drawn shape.
        statics: bounds of equilibrium solutions.
        dynamics: options of time steps.
        self_contact: law of self-contact; None if it is not modelled.
    """

    supports_substeps = True

    def __init__(
        self,
        body: SoftBody,
        world_from_flange: Pose,
        statics: newton_options.NewtonOptions,
        dynamics: StepOptions,
        self_contact: FilmContactLaw | None = None,
    ) -> None:
        self.body = body
        self.effort: search_effort.SearchEffort = search_effort.SearchEffort(statics.search_iterations_max)
        self._film = FilmPotential(body)
        self._statics, self.dynamics = statics, dynamics
        films = None if self_contact is None else SelfContact(body, self_contact)
        self.films = films if films is not None and films.can_touch else None
        drawn, loads = SoftState.drawn(body, world_from_flange), Loads((), (0.0,) * len(body.cables))
        self._now = FilmRobotState(drawn, Clamp.of_base(body), world_from_flange, loads)
        self._work = [0.0, 0.0]
        self._begin: soft_step.StepInput = (world_from_flange, loads)  # of the last step
        self.hold(self.clamp)

    @property
    def state(self) -> SoftState:
        """Shape and motion of the film."""
        return self._now.soft

    @state.setter
    def state(self, state: SoftState) -> None:
        self._now = replace(self._now, soft=state)

    @property
    def clamp(self) -> Clamp:
        """Nodes held by the flange."""
        return self._now.clamp

    def hold(self, clamp: Clamp) -> None:
        """Set the clamp."""
        self._now = replace(self._now, clamp=clamp)
        newton = NewtonSolver(self._film, clamp.mask(self.body.nodes))
        newton.tick_work = self.work
        self.equilibrium_solver = EquilibriumSolver(newton, clamp, self._statics, self.films, self.effort)
        self.equilibrium_solver.obstacles = self.obstacles
        self._stepper = time_step.Stepper(newton, clamp, self.dynamics, self.films)
        self._second_solver: NewtonSolver | None = None

    def hold_components(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold further components where they are now; wholly held nodes move with the flange.

        Args:
            held: (n, 3) bool, world components.
            world_from_flange: present pose of the flange.
        """
        self.hold(self.clamp.holding(held, self.state.positions, world_from_flange))

    def release(self, nodes: IntArray) -> None:
        """Release the given nodes (m,)."""
        self.hold(self.clamp.without(nodes))

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> soft_step.SoftReply:
        """Advance by one step, with the flange at its new pose."""
        return self._advance((world_from_flange, loads), step_s, None)

    def advance_accurately(
        self, world_from_flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy
    ) -> soft_step.SoftReply:
        """Advance by one step to a given accuracy."""
        return self._advance((world_from_flange, loads), step_s, accuracy)

    def restore(self, before: SoftState) -> None:
        """Undo the last step; the factorisation stays."""
        flange, loads = self._begin
        self._now = replace(self._now, soft=before, flange=flange, loads=loads)

    def _advance(
        self, end: soft_step.StepInput, step_s: float, accuracy: StepAccuracy | None
    ) -> soft_step.SoftReply:
        before = self._now
        self._begin = begin = before.flange, before.loads
        self._work = [0.0, 0.0]
        try:
            with self.work:
                iterations = soft_step.step_with_halving(self._stepping, begin, end, step_s, accuracy)
        except BaseException:
            self._now = before
            raise
        after = self._now
        wrench = self._stepper.wrench(after.soft, after.flange)
        return soft_step.SoftReply(wrench, after.residual_N, iterations, *self._work)

    @property
    def loads(self) -> Loads:
        """Loads at the end of the last step, without contacts."""
        return self._now.loads

    def fill_mass(self, figures: Array) -> None:
        unchecked(fill_mass)(self._film.mass, self._now.soft.positions, figures)

    def set_obstacles(self, obstacles: Obstacles | None) -> None:
        """Set the contacts of equilibria from now on."""
        self.obstacles = self.equilibrium_solver.obstacles = obstacles

    @property
    def reaction_weights(self) -> tuple[float, ...]:
        """Weights of the flange's last accelerations in the reaction, see `stability_ratio`."""
        return stability_ratio.reaction_weights(self.dynamics.integrator)

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2], the inertia of nodes in a step: c m X for a motion X."""
        span = self.dynamics.coefficients(step_s, first=self.state.earlier is None).span
        return inertia_weight(span, self.dynamics.air_drag_per_s)

    def contact_surface(self) -> contact_points.ContactSurface:
        """Return where the body can be touched."""
        return contact_points.ContactSurface.of(self.body, self._film.pattern)

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return the displacements of the nodes by small forces within the last step.

        Args:
            forces: (k, n, 3) [N], k cases.
            contact: contacts with the body; None for none.
            step_s: length of the step [s].

        Returns:
            (k, n, 3) [m]; None where the tangent is indefinite.
        """
        loads = self._now.loads.touching(contact)
        if not self._stepper.factorise(self.state, self._now.flange, loads, step_s):
            return None
        return self._stepper.solver.linear.solve_all(forces)

    @property
    def _stepping(self) -> tuple[soft_step.StepFunction, Callable[[], None], tick_work.TickWork]:
        return self._step, self.restart, self.work

    def _step(
        self,
        begin: soft_step.StepInput,
        end: soft_step.StepInput,
        step_s: float,
        accuracy: StepAccuracy | None,
    ) -> int:
        before = self.state
        soft, solution = self._stepper.step(before, *end, step_s, begin[0], accuracy)
        self._now = FilmRobotState(soft, self.clamp, *end, solution.residual_N)
        if self.films is not None:
            self._work[0] += self.films.work_J
        after = self.state
        self._work[1] += self._film.lost_at_eyelets(after.positions, before.memory, after.memory)
        return solution.iterations

    def hang(self, world_from_flange: Pose, gravity: tuple[float, float, float]) -> Equilibrium:
        """Return the equilibrium without pressure and tension."""
        drawn = SoftState.drawn(self.body, world_from_flange)  # an arm may have turned the flange as it could
        return self.equilibrium_solver.hang(drawn, world_from_flange, gravity)

    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the equilibrium before the first phase: first without pressure, then loaded."""
        first = self.hang(world_from_flange, loads.gravity) if hung is None else hung
        return self.equilibrium_solver.load(first, loads)

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state without continuation; the present state is not changed."""
        with self.effort.search("an equilibrium"):
            return self.equilibrium_solver.solve(state, world_from_flange, loads, start)

    def find_rest(
        self,
        state: SoftState,
        world_from_flange: Pose,
        loads: Loads,
        iterations_max: int,
        patience: float = math.inf,
    ) -> Equilibrium:
        """Find the equilibrium near a state; if Newton's method finds none, the one to which the film slides.

        Args:
            state: initial guess.
            world_from_flange: pose of the flange.
            loads: that act.
            iterations_max: bound of Newton's method, and of the slide.
            patience: iterations within which a slide must halve the residual.

        Raises:
            ConvergenceError: no equilibrium was found.
        """
        with self.effort.within(iterations_max, patience):
            try:
                return self.solve(state, world_from_flange, loads)
            except ConvergenceError as error:
                newton_iterations = error.iterations
            with self.effort.search("where it comes to rest"):
                equilibrium = self.equilibrium_solver.slide(state, world_from_flange, loads)
        return replace(equilibrium, iterations=newton_iterations + equilibrium.iterations)

    def state_at_rest(self, positions: Array, world_from_flange: Pose) -> SoftState:
        """Return a shape (n, 3) [m] as a state at rest, with hinge angles tracked from the drawn shape."""
        drawn = SoftState.drawn(self.body, world_from_flange)
        memory, film = drawn.memory, self.equilibrium_solver.solver.film
        slack = Loads((), (0.0,) * len(self.body.cables))
        for k in range(1, _UNFOLDING_STEPS + 1):
            between = drawn.positions + k / _UNFOLDING_STEPS * (positions - drawn.positions)
            tensions = film.losses_at(between, slack)
            film.evaluate(between, slack, tensions, memory, hessian=False)
            memory = film.advanced(between, film.memory)
        return SoftState.at_rest(np.ascontiguousarray(positions), memory.copy())

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium in place of an unstable one, see `stability.switch_branch`."""
        return self.equilibrium_solver.switch_branch(begin, found)

    def find_instability(
        self, shape: Array, world_from_flange: Pose, loads: Loads
    ) -> branching.Branching | None:
        """Return the instability of a shape as if it was at rest; None if it is stable or unknown."""
        return self._evaluate_at(find_instability, shape, world_from_flange, loads)

    def assess_stability(
        self, shape: Array, world_from_flange: Pose, loads: Loads
    ) -> branching.StabilityReport | None:
        """Return the stability of a shape as if it was at rest."""
        return self._evaluate_at(assess_stability, shape, world_from_flange, loads)

    def find_rest_tip(
        self, shape: Array, world_from_flange: Pose, loads: Loads
    ) -> tuple[float, float, float] | None:
        """Return the tip [m] of the stable equilibrium that a shape slides to; None if it is not known.

        If it slides to an unstable one, as a straight shape does, a stable branch next to that is taken.
        """

        def relax(newton: NewtonSolver, state: SoftState, loads: Loads, _: Array) -> Equilibrium | None:
            follower = EquilibriumSolver(newton, self.clamp, self._statics, self.films)
            try:
                return follower.switch_branch(None, follower.slide(state, world_from_flange, loads))
            except ConvergenceError:
                return None

        if not self._film.conservative or not len(self.body.tip):
            return None
        rest = self._evaluate_at(relax, shape, world_from_flange, loads)
        if rest is None or rest.negative_pivots:
            return None
        x, y, z = self.body.tip_position(rest.state.positions).tolist()
        return x, y, z

    def _evaluate_at(
        self,
        function: Callable[[NewtonSolver, SoftState, Loads, Array], Result],
        shape: Array,
        world_from_flange: Pose,
        loads: Loads,
    ) -> Result:
        """Return a function of a shape at rest; the film and the solver of steps are not changed."""
        film, state = self._film, SoftState.at_rest(shape, self.state.memory, self.state.touching)
        pattern, memory = film.reusable_pattern, film.memory.copy()
        films = self.films
        pairs = None if films is None or films.is_deferred(state) else films.static_pairs(shape)
        value = function(self._tester, state, loads.with_films(pairs), world_from_flange.rotation)
        film.reusable_pattern, film.memory[:] = pattern, memory
        return value

    def overlap(self, shape: Array) -> branching.FilmOverlap | None:
        return None if self.films is not None else self._overlap_check.overlap(shape)

    @cached_property
    def _overlap_check(self) -> overlap_check.OverlapCheck:
        return overlap_check.OverlapCheck(self.body)

    def linear_step(self, step_s: float, motions: int) -> LinearStep:
        """Return a linearised step about the present shape, as if it was at rest.

        Args:
            step_s: h [s].
            motions: number of the slowest modes in it, see `RestingFilm`.

        Raises:
            InputError: nodes have no mass, ends are open, or films press on one another.
        """
        if self.state.touching is not None:
            raise InputError("a linear model has no contact; films press on one another here")

        def linearise(newton: NewtonSolver, state: SoftState, loads: Loads, _: Array) -> LinearStep:
            resting = resting_film.RestingFilm(newton, self.clamp, self._now.flange, state, loads)
            return resting.linear_step(self.dynamics.coefficients(step_s), motions)

        return self._evaluate_at(linearise, self.state.positions, self._now.flange, self._now.loads)

    @property
    def _tester(self) -> NewtonSolver:
        """A second Newton solver, so that the factorisation of the steps' solver stays."""
        if self._second_solver is None:
            steps = self.equilibrium_solver.solver
            self._second_solver = NewtonSolver(self._film, steps.clamped, symmetric=True, like=steps)
        return self._second_solver

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state is not changed."""
        return self.equilibrium_solver.follow(begin, world_from_flange, loads)

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose cable tensions bring the tip to a target; the flange stays."""
        with self.effort.search("cable tensions for a tip target"):
            return tension_search.find_tensions(self.equilibrium_solver, begin, target).equilibrium

    def tension_slope(self, equilibrium: Equilibrium, target: TipTarget) -> float:
        """Return the change of tensions per error of the tip [N/m], see `tension_search`."""
        return tension_search.tension_slope(self.equilibrium_solver, equilibrium, target)

    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay."""
        with self.effort.search("a flange pose for a tip target"):
            return flange_search.find_flange_pose(self.equilibrium_solver, begin, target, options).equilibrium

    def commit(self, found: Equilibrium) -> None:
        """Make an equilibrium the present state."""
        loads = replace(found.loads, contact=None, self_contact=None)  # each step finds its contacts
        self._now = replace(self._now, soft=found.state, flange=found.world_from_flange, loads=loads)

    @property
    def full_state(self) -> FilmRobotState:
        """The whole state; only the nodal forces are copied."""
        return replace(self._now, newton=self.equilibrium_solver.solver.state)

    @full_state.setter
    def full_state(self, state: FilmRobotState) -> None:
        state.check(self.body.nodes)
        if state.loads.contact is not None:
            self.contact_surface().check_planes(state.loads.contact)
        if not state.clamp.holds_as(self.clamp):
            self.hold(state.clamp)
        if state.newton is None:
            raise InputError("the saved soft robot has no factorisation")
        self._now = replace(state, newton=None)
        self.equilibrium_solver.solver.state = state.newton

    @property
    def end_state(self) -> FilmRobotState:
        """Shape, clamp and loads, without velocities and solver."""
        soft = self._now.soft
        return replace(self._now, soft=SoftState.at_rest(soft.positions, soft.memory, soft.touching))

    @property
    def reaction(self) -> Array:
        """Force (k, 3) [N] that the flange supplies to each held node, at the last solution."""
        return self.clamp.reaction(self._film.gradient)

    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of the flange's reactions at the last solution over a displacement."""
        return float(np.einsum("kr,kr->", self.reaction, displacement[self.clamp.nodes]))

    def shape_reader(self) -> shape_reader.MeshReader:
        """Return a reader of nodal positions."""
        return shape_reader.MeshReader(self.body, self._film.gas.enclosed_volumes)

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each chamber at the present shape."""
        return tuple(self._film.gas.enclosed_volumes(self.state.positions[None])[0].tolist())

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in each chamber: commanded, or that of the sealed gas at the present volume."""
        loads, count = self._now.loads, self._film.gas.count
        return loads.pressures(count) if not any(loads.gas) else loads.pressures_at(self.volumes_m3)
