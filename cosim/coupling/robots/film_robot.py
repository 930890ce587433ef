"""The soft side of the coupling: a body on the flange, stepped or solved for equilibrium. A tick that
does not converge is taken in halves.
"""

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
from cosim.coupling.robots import shape_reader, soft_robot
from cosim.errors import ConvergenceError, InputError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.contact import contact_points, film_look
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import branching, newton_options, resting_film, time_step, tip_search
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.linear_step import LinearStep
from cosim.soft.solve.newton import NewtonSolver, NewtonState
from cosim.soft.solve.self_contact import FilmContactLaw, SelfContact
from cosim.soft.solve.stability import assess_stability, find_instability
from cosim.soft.solve.state import (
    Clamp,
    Equilibrium,
    Obstacles,
    SoftState,
    StepAccuracy,
    StepOptions,
    inertia_weight,
)
from cosim.soft.solve.tip_target import TargetOptions, TipTarget

Found = TypeVar("Found")


@final
@dataclass(frozen=True)
class FilmRobotState:
    """What the next step of a soft arm depends on.

    Args:
        soft: shape and motion.
        clamp: what is held.
        flange: pose of the flange at the end of the last step.
        loads: there.
        residual_N: of the last step.
        newton: what its solver has kept; None where it is not asked for.
    """

    soft: SoftState
    clamp: Clamp
    flange: Pose
    loads: Loads
    residual_N: float = 0.0
    newton: NewtonState | None = None

    def check(self, nodes: int) -> None:
        """Check that it is of a body with so many nodes.

        Raises:
            InputError: it is not.
        """
        if len(self.soft.positions) != nodes:
            raise InputError(f"the saved soft robot has {len(self.soft.positions)} nodes, this one {nodes}")
        check_indices(self.clamp.nodes, nodes, "nodes")
        for given in (self.loads.cable_length_m, self.loads.cable_stiffening):
            if len(given) not in (0, len(self.loads.cable_tension_N)):
                raise InputError(f"the saved loads have {len(given)} cables with a length")


_WAY = 8  # pieces of the way from the drawn shape, so that folded hinges are followed


@final
class FilmRobot(soft_robot.SoftRobot):
    """A soft body held by the flange; owns solver and state.

    `films` finds where its films touch one another; None where that is not modelled, or none can meet.

    Args:
        body: what it is.
        world_from_flange: where the flange is at first; the body starts in its drawn shape.
        statics: bounds of equilibrium solutions.
        dynamics: how time steps are solved.
        self_contact: law of the films' contact with one another; None where it is not modelled.
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
        self.effort: newton_options.SearchEffort = newton_options.SearchEffort(statics.search_iterations_max)
        self._film = FilmPotential(body)
        self._statics, self.dynamics = statics, dynamics
        films = None if self_contact is None else SelfContact(body, self_contact)
        self.films = films if films is not None and films.can_touch else None
        drawn, loads = SoftState.drawn(body, world_from_flange), Loads((), (0.0,) * len(body.cables))
        self._now = FilmRobotState(drawn, Clamp.of_base(body), world_from_flange, loads)
        self._work = [0.0, 0.0]
        self._begin: soft_robot.Drive = (world_from_flange, loads)  # of the last step
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
        """Be held as a clamp has it."""
        self._now = replace(self._now, clamp=clamp)
        newton = NewtonSolver(self._film, clamp.mask(self.body.nodes))
        newton.tick_work = self.work
        self.equilibrium_solver = EquilibriumSolver(newton, clamp, self._statics, self.films, self.effort)
        self.equilibrium_solver.obstacles = self.obstacles
        self._stepper = time_step.Stepper(newton, clamp, self.dynamics, self.films)
        self._tester: NewtonSolver | None = None

    def hold_components(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold further components where they are now; what is held as a whole goes with the flange.

        Args:
            held: (n, 3) bool, world components.
            world_from_flange: present pose of the flange.
        """
        self.hold(self.clamp.holding(held, self.state.positions, world_from_flange))

    def release(self, nodes: IntArray) -> None:
        """Hold the given nodes (m,) no longer."""
        self.hold(self.clamp.without(nodes))

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> soft_robot.SoftReply:
        """Advance by one step, with the flange at its new pose."""
        return self._advance((world_from_flange, loads), step_s, None)

    def advance_accurately(
        self, world_from_flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy
    ) -> soft_robot.SoftReply:
        """Advance by one step, as closely as asked for."""
        return self._advance((world_from_flange, loads), step_s, accuracy)

    def restore(self, before: SoftState) -> None:
        """Undo the last step; the factorisation stays."""
        flange, loads = self._begin
        self._now = replace(self._now, soft=before, flange=flange, loads=loads)

    def _advance(
        self, end: soft_robot.Drive, step_s: float, accuracy: StepAccuracy | None
    ) -> soft_robot.SoftReply:
        before = self._now
        self._begin = begin = before.flange, before.loads
        self._work = [0.0, 0.0]
        try:
            with self.work:
                iterations = soft_robot.step_with_halving(self._stepping, begin, end, step_s, accuracy)
        except BaseException:
            self._now = before
            raise
        now = self._now
        wrench = self._stepper.wrench(now.soft, now.flange)
        return soft_robot.SoftReply(wrench, now.residual_N, iterations, *self._work)

    @property
    def stepper(self) -> time_step.Stepper:
        """Takes its steps."""
        return self._stepper

    @property
    def loads(self) -> Loads:
        """Loads at the end of the last step, contacts not counted."""
        return self._now.loads

    def fill_mass(self, figures: Array) -> None:
        unchecked(fill_mass)(self._film.mass, self._now.soft.positions, figures)

    def set_obstacles(self, obstacles: Obstacles | None) -> None:
        """Let equilibria from now on take in what the film touches."""
        self.obstacles = self.equilibrium_solver.obstacles = obstacles

    @property
    def reaction_weights(self) -> tuple[float, ...]:
        """How the flange's last accelerations count in the answer of inertia, see `reaction_weights`."""
        return soft_robot.reaction_weights(self.dynamics.integrator)

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2]: a motion X of the nodes in a step meets the inertia c m X."""
        span = self.dynamics.bed(step_s, first=self.state.earlier is None).span
        return inertia_weight(span, self.dynamics.air_drag_per_s)

    def contact_surface(self) -> contact_points.ContactSurface:
        """Return where the body can be touched."""
        return contact_points.ContactSurface.of(self.body, self._film.pattern)

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return how far small forces would have moved the nodes within the last step.

        Args:
            forces: (k, n, 3) [N], k cases.
            contact: with the body; None for none.
            step_s: length of the step [s].

        Returns:
            (k, n, 3) [m]; None where the tangent is indefinite.
        """
        loads = self._now.loads.touching(contact)
        if not self._stepper.factorise(self.state, self._now.flange, loads, step_s):
            return None
        return self._stepper.solver.linear.solve_all(forces)

    @property
    def _stepping(self) -> tuple[soft_robot.StepTaken, Callable[[], None], newton_options.TickWork]:
        return self._step, self.restart, self.work

    def _step(
        self, begin: soft_robot.Drive, end: soft_robot.Drive, step_s: float, accuracy: StepAccuracy | None
    ) -> int:
        before = self.state
        soft, result = self._stepper.step(before, *end, step_s, begin[0], accuracy)
        self._now = FilmRobotState(soft, self.clamp, *end, result.residual_N)
        if self.films is not None:
            self._work[0] += self.films.work_J
        after = self.state
        self._work[1] += self._film.lost_at_eyelets(after.positions, before.memory, after.memory)
        return result.iterations

    def hang(self, world_from_flange: Pose, gravity: tuple[float, float, float]) -> Equilibrium:
        """Return the equilibrium hung up without pressure and tension."""
        drawn = SoftState.drawn(self.body, world_from_flange)  # an arm may have turned the flange as it could
        return self.equilibrium_solver.hang(drawn, world_from_flange, gravity)

    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the equilibrium before the first phase: hung up without pressure, then loaded."""
        first = self.hang(world_from_flange, loads.gravity) if hung is None else hung
        return self.equilibrium_solver.load(first, loads)

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go; the present state stays."""
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
        """Find the equilibrium near a state; where Newton's method finds none, that to which it slides.

        Args:
            state: where it starts.
            world_from_flange: pose of the flange.
            loads: that act.
            iterations_max: of each of both; then it is given up.
            patience: iterations within which a slide halves what is out of balance, or is given up.

        Raises:
            ConvergenceError: it comes to rest nowhere.
        """
        with self.effort.within(iterations_max, patience):
            try:
                return self.solve(state, world_from_flange, loads)
            except ConvergenceError as error:
                spent = error.iterations
            with self.effort.search("where it comes to rest"):
                found = self.equilibrium_solver.slide(state, world_from_flange, loads)
        return replace(found, iterations=spent + found.iterations)

    def state_at_rest(self, positions: Array, world_from_flange: Pose) -> SoftState:
        """Return a shape (n, 3) [m] as a state at rest, whose hinges have followed it from the drawn one."""
        drawn = SoftState.drawn(self.body, world_from_flange)
        memory, film = drawn.memory, self.equilibrium_solver.solver.film
        slack = Loads((), (0.0,) * len(self.body.cables))
        for k in range(1, _WAY + 1):
            between = drawn.positions + k / _WAY * (positions - drawn.positions)
            share = film.losses_at(between, slack)
            film.evaluate(between, slack, share, memory, hessian=False)
            memory = film.advanced(between, film.memory)
        return SoftState.at_rest(np.ascontiguousarray(positions), memory.copy())

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium beside one that is not; one that is stable as it is."""
        return self.equilibrium_solver.switch_branch(begin, found)

    def find_instability(
        self, shape: Array, world_from_flange: Pose, loads: Loads
    ) -> branching.Branching | None:
        """Return in which direction a shape would give way if it was at rest; None: in none."""
        return self._looked(find_instability, shape, world_from_flange, loads)

    def assess_stability(
        self, shape: Array, world_from_flange: Pose, loads: Loads
    ) -> branching.StabilityReport | None:
        """Return how firmly a shape stands, as if it was at rest; None: not known."""
        return self._looked(assess_stability, shape, world_from_flange, loads)

    def find_rest_tip(
        self, shape: Array, world_from_flange: Pose, loads: Loads
    ) -> tuple[float, float, float] | None:
        """Return the tip [m] of the stable equilibrium that a shape slides to; None where it is not known.

        Where it slides to an unstable one, as a straight shape does, it is one of those beside that.
        """

        def slid(newton: NewtonSolver, state: SoftState, loads: Loads, _: Array) -> Equilibrium | None:
            follower = EquilibriumSolver(newton, self.clamp, self._statics, self.films)
            try:
                return follower.switch_branch(None, follower.slide(state, world_from_flange, loads))
            except ConvergenceError:
                return None

        if not self._film.conservative or not len(self.body.tip):
            return None
        found = self._looked(slid, shape, world_from_flange, loads)
        if found is None or found.negative_pivots:
            return None
        x, y, z = self.body.tip_position(found.state.positions).tolist()
        return x, y, z

    def _looked(
        self,
        look: Callable[[NewtonSolver, SoftState, Loads, Array], Found],
        shape: Array,
        world_from_flange: Pose,
        loads: Loads,
    ) -> Found:
        """Return what is seen of a shape; the next step does not depend on whether somebody has looked."""
        film, state = self._film, SoftState.at_rest(shape, self.state.memory, self.state.touching)
        serving, memory = film.serving, film.memory.copy()
        films = self.films
        pairs = None if films is None or films.waits(state) else films.static_pairs(shape)
        found = look(self._tested, state, loads.with_films(pairs), world_from_flange.rotation)
        film.serving, film.memory[:] = serving, memory
        return found

    def overlap(self, shape: Array) -> branching.FilmOverlap | None:
        return None if self.films is not None else self._look.overlap(shape)

    @cached_property
    def _look(self) -> film_look.FilmLook:
        return film_look.FilmLook(self.body)

    def linear_step(self, step_s: float, motions: int) -> LinearStep:
        """Return a step of some length [s] as a matrix, about the present shape as if it was at rest.

        Args:
            step_s: h [s].
            motions: how many of the slowest the film has in it, see `RestingFilm`.

        Raises:
            InputError: nodes have no mass, ends are open, or films press on one another.
        """
        if self.state.touching is not None:
            raise InputError("a linear model has no contact; films press on one another here")

        def seen(newton: NewtonSolver, state: SoftState, loads: Loads, _: Array) -> LinearStep:
            resting = resting_film.RestingFilm(newton, self.clamp, self._now.flange, state, loads)
            return resting.linear_step(self.dynamics.bed(step_s), motions)

        return self._looked(seen, self.state.positions, self._now.flange, self._now.loads)

    @property
    def _tested(self) -> NewtonSolver:
        """Newton's method apart from that of the steps, which keeps a factorisation."""
        if self._tester is None:
            steps = self.equilibrium_solver.solver
            self._tester = NewtonSolver(self._film, steps.clamped, symmetric=True, like=steps)
        return self._tester

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state stays."""
        return self.equilibrium_solver.follow(begin, world_from_flange, loads)

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose cable tensions bring the tip to a target; the flange stays."""
        with self.effort.search("cable tensions for a tip target"):
            return tip_search.find_tensions(self.equilibrium_solver, begin, target).equilibrium

    def tension_slope(self, here: Equilibrium, target: TipTarget) -> float:
        """Return by how much tensions change as the tip is off a target [N/m], see `tip_search`."""
        return tip_search.tension_slope(self.equilibrium_solver, here, target)

    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay."""
        with self.effort.search("a flange pose for a tip target"):
            return tip_search.find_flange_pose(self.equilibrium_solver, begin, target, options).equilibrium

    def commit(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state."""
        loads = replace(found.loads, contact=None, self_contact=None)  # found again in every step
        self._now = replace(self._now, soft=found.state, flange=found.world_from_flange, loads=loads)

    @property
    def full_state(self) -> FilmRobotState:
        """All that the next step depends on; costs no copy but one of the nodal forces."""
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
        """Where it is, how it is held, and what acts on it."""
        here = self._now.soft
        return replace(self._now, soft=SoftState.at_rest(here.positions, here.memory, here.touching))

    @property
    def reaction(self) -> Array:
        """Force (k, 3) [N] that the flange supplies to each held node, at the last solution."""
        return self.clamp.reaction(self._film.gradient)

    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement."""
        return float(np.einsum("kr,kr->", self.reaction, displacement[self.clamp.nodes]))

    def shape_reader(self) -> shape_reader.MeshReader:
        """Return what reads nodes."""
        return shape_reader.MeshReader(self.body, self._film.gas.enclosed_volumes)

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each chamber at the present shape."""
        return tuple(self._film.gas.enclosed_volumes(self.state.positions[None])[0].tolist())

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in each chamber: the given one, or that of the sealed gas at the present volume."""
        loads, count = self._now.loads, self._film.gas.count
        return loads.pressures(count) if not any(loads.gas) else loads.pressures_at(self.volumes_m3)
