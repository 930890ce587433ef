"""The soft robot as a reduced beam model: a chain of rigid frames with condensed sections between them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, cross
from cosim.coupling.robots import (
    chain_equilibria,
    mass_properties,
    shape_reader,
    soft_robot,
    soft_step,
    stability_ratio,
)
from cosim.coupling.shape_figures import ShapeFigures
from cosim.errors import ConvergenceError, InputError, TickWorkError
from cosim.reduced.section_model import SectionBody, carried
from cosim.reduced.sections.figures import CENTER, center_and_inertia, figures_of, supplied_wrench
from cosim.reduced.solve import tangent
from cosim.reduced.solve.chain_film import chain_of, film_of
from cosim.reduced.solve.chain_solver import ChainSolver
from cosim.reduced.solve.chain_step import ChainState, ChainStep
from cosim.reduced.solve.clamp import FrameClamp, rates_from_nodes, rigid_motion, twists
from cosim.reduced.solve.commanded_cables import point_of
from cosim.reduced.solve.linear_chain import linear_step
from cosim.reduced.solve.reused_factor import SavedFactor
from cosim.reduced.solve.stability import RestingChain
from cosim.reduced.solve.time_step import ChainStepper
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import center_rings
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes
from cosim.soft.film.film import FilmPotential
from cosim.soft.solve import flange_search, tension_search
from cosim.soft.solve.branch_switching import switch_branch
from cosim.soft.solve.branching import Branching, LowestMode, StabilityReport
from cosim.soft.solve.linear_step import LinearStep
from cosim.soft.solve.newton_options import NewtonOptions, Outcome
from cosim.soft.solve.search_effort import SearchEffort
from cosim.soft.solve.state import Equilibrium, Obstacles, SoftState
from cosim.soft.solve.step_scheme import StepAccuracy, StepOptions, inertia_weight
from cosim.soft.solve.tip_target import TargetOptions, TipTarget

_SWITCHES_MAX = 50  # of branches: a leaning stack is nearly neutral about its axis, and may buckle repeatedly


@final
@dataclass(frozen=True)
class BeamRobotState:
    """State of a `BeamRobot`.

    Args:
        last: result of the last step.
        clamp: frames held by the flange.
        flange: world_from_flange.
        loads: that act.
        factor: factorisation that the next step may reuse; None for none, or one that the robot holds.
    """

    last: ChainStep
    clamp: FrameClamp
    flange: Pose
    loads: Loads
    factor: SavedFactor | None = None

    def check(self, frames: int) -> None:
        """Check that the state is of a chain with this number of frames.

        Raises:
            InputError: it is not.
        """
        if len(self.clamp.held) != frames:
            raise InputError(f"the saved soft robot has {len(self.clamp.held)} frames, this one {frames}")


@final
class ChainReader(shape_reader.ShapeReader):
    """Reads shapes of chains; figures compute only the tip's nodes and the centres of the hole rings.

    Args:
        section: the chain's model.
    """

    def __init__(self, section: SectionBody) -> None:
        nodes, before, tip = section.model.nodes, section.frames.before, section.body.tip
        rings = center_rings(section.body)
        self._section, self._tip = section, len(tip)
        # all nodes of a ring are between the same two frames
        weights = np.concatenate([nodes[:, tip], nodes[:, rings].mean(axis=2)], axis=1)
        self._weights = np.ascontiguousarray(weights.reshape(len(weights), -1))
        self._before = before[[*tip, *rings[:, 0]]]
        tip_weights = np.ascontiguousarray(weights[:, : len(tip)].reshape(len(weights), -1))
        self._tip_points = tip_weights, self._before[: len(tip)]

    def positions(self, shape: ChainStep) -> Array:
        """Return the film's nodes (n, 3) [m] on the frames."""
        return self._section.positions(shape.frames, shape.pressure_Pa)

    def films(self, shapes: Sequence[ChainStep]) -> Array:
        """Return the film's nodes (k, n, 3) [m] of k shapes."""
        return self._section.films(*_stacked(shapes))

    def figures(self, shapes: Sequence[ChainStep]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        frames, pressure_Pa = _stacked(shapes)
        points = self._section.points(frames, pressure_Pa, self._weights, self._before)
        volumes = self._section.volumes(frames, pressure_Pa)
        return shape_reader.figures_at(points, self._tip, volumes)

    def tips(self, shapes: Sequence[ChainStep]) -> Array:
        """Return the tips; see `ShapeReader.tips`."""
        return shape_reader.centers_of(self._section.points(*_stacked(shapes), *self._tip_points))


def _stacked(shapes: Sequence[ChainStep]) -> tuple[Array, Array]:
    """Return frames (k, f, 4, 3) and pressures (k,) of k shapes."""
    frames = np.concatenate([shape.frames for shape in shapes]).reshape(len(shapes), -1, 4, 3)
    return frames, np.array([shape.pressure_Pa for shape in shapes])


@final
class BeamRobot(soft_robot.SoftRobot):
    """A chain of frames held by the flange; owns solver and state.

    The film's nodes are computed from the frames on demand. `final` is a kind of error after which a step is
    not halved.

    Args:
        section: the chain's model.
        world_from_flange: first pose of the flange; the frames start as drawn.
        statics: bounds of equilibrium solutions.
        dynamics: options of time steps.
    """

    def __init__(
        self, section: SectionBody, world_from_flange: Pose, statics: NewtonOptions, dynamics: StepOptions
    ) -> None:
        self.section, self.body = section, section.body
        self._solver = ChainSolver(section)
        self._dynamics, self._stepper = dynamics, ChainStepper(self._solver, dynamics)
        self._equilibria = chain_equilibria.ChainEquilibria(section, self._solver, statics)
        self.options = statics
        self.effort: SearchEffort = SearchEffort(statics.search_iterations_max)
        self.final: type[ConvergenceError] = TickWorkError
        self._switches = 0  # branch switches in progress, one within another
        clamp = FrameClamp.of_base(section)
        loads = Loads((), (0.0,) * len(self.body.cables), (0.0, 0.0, 0.0))
        drawn = ChainState.at_rest(carried(section.frames.drawn, world_from_flange), 0.0)
        last = self._resting_step(drawn, np.zeros((len(drawn.frames), 6)), clamp)
        self._now = BeamRobotState(last, clamp, world_from_flange, loads)
        self._film: SoftState | None = None
        # start of the last step, and end of the one that was undone
        self._begin = self._now
        self._reached: Array = drawn.frames

    @property
    def clamp(self) -> FrameClamp:
        """Frames held by the flange."""
        return self._now.clamp

    @property
    def state(self) -> SoftState:
        """The film's nodes, computed from the frames."""
        if self._film is None:
            self._film = film_of(self.section, self._now.last.chain)
        return self._film

    @state.setter
    def state(self, film: SoftState) -> None:
        chain = self.chain_of(film, self._now.flange)
        last = self._resting_step(chain, self._now.last.gradient, self.clamp)
        self._now, self._film = replace(self._now, last=last), film

    def chain_of(self, film: SoftState, flange: Pose) -> ChainState:
        """Return the chain of a film with the flange at a pose.

        Args:
            film: computed by such a robot, or any other, to which frames are fitted.
            flange: pose of the first frame.
        """
        return chain_of(self.section, film, flange, self._now.last.pressure_Pa)

    def _resting_step(self, chain: ChainState, gradient: Array, clamp: FrameClamp) -> ChainStep:
        """Return the result of a step that ends in this chain."""
        figures = figures_of(chain.frames, clamp.free, self.section.mass, gradient)
        return ChainStep(chain, gradient, figures, Outcome.CONVERGED, 0, 0.0)

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> soft_step.SoftReply:
        """Advance by one step, with the flange at its new pose."""
        return self._advance(world_from_flange, loads, step_s, None)

    def advance_accurately(
        self, world_from_flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy
    ) -> soft_step.SoftReply:
        """Advance by one step to a given accuracy."""
        start = None if accuracy.start is None else self._reached
        return self._advance(world_from_flange, loads, step_s, StepAccuracy(accuracy.tolerance_N, start))

    def restore(self, before: SoftState) -> None:
        """Undo the last step; its end is an initial guess for the next one."""
        self._reached = self._now.last.frames
        self._now, self._film = self._begin, before

    def _advance(
        self, flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy | None
    ) -> soft_step.SoftReply:
        begin = self._begin = self._now
        stepper, drives = (
            (self._step, self.restart, self.work),
            ((begin.flange, begin.loads), (flange, loads)),
        )
        self._film = None
        try:
            with self.work:
                iterations = soft_step.step_with_halving(stepper, *drives, step_s, accuracy, self.final)
        except BaseException:
            self._now = begin
            raise
        last = self._now.last
        return soft_step.SoftReply(supplied_wrench(last.figures), last.residual_N, iterations)

    def _step(
        self,
        _begin: soft_step.StepInput,
        end: soft_step.StepInput,
        step_s: float,
        accuracy: StepAccuracy | None,
    ) -> int:
        present, (flange, loads) = self._now, end
        task = self._stepper.task(present.last.chain, present.clamp, step_s, flange)
        try:
            last = self._stepper.step(task, loads, accuracy)
        except ConvergenceError as error:
            self.work.spend(error.iterations, error.residual_N)
            raise
        self.work.iterations += last.iterations
        self._now = BeamRobotState(last, present.clamp, flange, loads)
        return last.iterations

    def restart(self) -> None:
        """Restart a two-step integrator with the next step."""
        last = self._now.last
        self._now = replace(self._now, last=replace(last, chain=replace(last.chain, earlier=None)))

    @property
    def reaction_weights(self) -> tuple[float, ...]:
        """Weights of the flange's last accelerations in the reaction, see `stability_ratio`."""
        return stability_ratio.reaction_weights(self._dynamics.integrator)

    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the equilibrium before the first phase: first without pressure, then loaded."""
        return self._equilibria.start(self.clamp, world_from_flange, loads)

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state without continuation; the present state is not changed."""
        begin = state if start is None else SoftState.at_rest(start, state.memory)
        chain = self.chain_of(begin, world_from_flange)
        return self._equilibria.solve(chain.frames, self.clamp, world_from_flange, loads, chain.pressure_Pa)

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state is not changed."""
        pressure = self._now.last.pressure_Pa
        equilibrium = self._equilibria.follow(begin, self.clamp, world_from_flange, loads, pressure)
        return self.switch_branch(begin, equilibrium)

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium in place of an unstable one, see `stability.switch_branch`."""
        if self._switches >= _SWITCHES_MAX:
            return found
        self._switches += 1
        try:
            return switch_branch(self, begin, found)
        finally:
            self._switches -= 1

    def slide(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Find the equilibrium of lower energy near a state, by Newton's method with inertia correction."""
        return self.solve(state, world_from_flange, loads)

    def lowest_mode(self, equilibrium: Equilibrium) -> LowestMode:
        """Return the lowest eigenvalue of the tangent stiffness at an equilibrium, and its mode."""
        return self._resting_at(equilibrium).lowest_mode

    def describe_instability(self, equilibrium: Equilibrium, lowest: LowestMode) -> Branching:
        """Return the description of an unstable equilibrium, with its lowest mode."""
        return self._resting_at(equilibrium).describe_instability(
            lowest, max(1, equilibrium.negative_pivots or 0)
        )

    def _resting_at(self, equilibrium: Equilibrium) -> RestingChain:
        return self._resting(
            self.chain_of(equilibrium.state, equilibrium.world_from_flange), equilibrium.loads
        )

    def find_instability(self, shape: ChainStep, world_from_flange: Pose, loads: Loads) -> Branching | None:
        """Return the instability of a shape as if it was at rest; None if it is stable."""
        resting = self._resting(shape.chain, loads)
        return resting.unstable if resting.negative_pivots else None

    def assess_stability(self, shape: ChainStep, world_from_flange: Pose, loads: Loads) -> StabilityReport:
        """Return the stability of a shape as if it was at rest."""
        return self._resting(shape.chain, loads).assess_stability(self._system)

    @cached_property
    def _system(self) -> FilmPotential:
        return FilmPotential(self.body)

    def _resting(self, chain: ChainState, loads: Loads) -> RestingChain:
        return RestingChain(self._solver, self.clamp, chain.frames, loads, chain.pressure_Pa)

    def sensitivity(self, equilibrium: Equilibrium) -> tangent.ChainSensitivity:
        """Return the tip's sensitivity at an equilibrium."""
        chain = self.chain_of(equilibrium.state, equilibrium.world_from_flange)
        at = point_of(self._solver, chain.frames, equilibrium.loads, chain.pressure_Pa)
        return tangent.ChainSensitivity(self._solver, at, self.clamp.free)

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose cable tensions bring the tip to a target; the flange stays."""
        return tension_search.find_tensions(self, begin, target).equilibrium

    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay."""
        return flange_search.find_flange_pose(self, begin, target, options).equilibrium

    def commit(self, found: Equilibrium) -> None:
        """Make an equilibrium the present state."""
        chain = self.chain_of(found.state, found.world_from_flange)
        gradient = self._resting(chain, found.loads).gradient
        # each step finds its contacts
        loads = replace(found.loads, contact=None)
        last = self._resting_step(chain, gradient, self.clamp)
        self._now, self._film = BeamRobotState(last, self.clamp, found.world_from_flange, loads), found.state

    def set_obstacles(self, obstacles: Obstacles | None) -> None:
        """Set the contacts of equilibria from now on."""
        self.obstacles = self._equilibria.obstacles = obstacles

    def hold_components(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold whole rings where they are now; they move with the flange."""
        present = self._now
        clamp = present.clamp.holding(self.section, held, present.last.frames, world_from_flange)
        self._now = replace(present, clamp=clamp)

    def release(self, nodes: IntArray) -> None:
        """Release the rings of the given nodes (m,)."""
        self._now = replace(self._now, clamp=self.clamp.without(self.section, nodes))

    def linear_step(self, step_s: float) -> LinearStep:
        """Return a linearised step of length step_s [s] about the present shape, as if it was at rest."""
        resting = self._resting(self._now.last.chain, self._now.loads)
        return linear_step(resting, self._dynamics.coefficients(step_s))

    @property
    def full_state(self) -> BeamRobotState:
        """The whole state."""
        return replace(self._now, factor=self._stepper.factor.save_state(self.clamp))

    @full_state.setter
    def full_state(self, state: BeamRobotState) -> None:
        state.check(len(self.section.frames))
        self._now, self._film = replace(state, factor=None), None
        self._stepper.factor.restore_state(state.factor, state.clamp)

    @property
    def end_state(self) -> BeamRobotState:
        """Shape, clamp and loads."""
        return self._now

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2], the inertia of nodes in a step: c m X for a motion X."""
        coefficients = self._dynamics.coefficients(step_s, first=self._now.last.chain.earlier is None)
        return inertia_weight(coefficients.span, self._dynamics.air_drag_per_s)

    def contact_surface(self) -> ContactSurface:
        """Return where the body can be touched."""
        return ContactSurface.of(self.body, self._system.pattern)

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return the displacements of the nodes by small forces within the last step."""
        last, solver = self._now.last, self._solver
        frames, pressure = last.frames, last.pressure_Pa
        inertia = self._stepper.task(last.chain, self.clamp, step_s).inertia
        at = point_of(solver, frames, replace(self._now.loads, contact=contact), pressure)
        try:
            chain_tangent = tangent.ChainTangent(solver, at, self.clamp.free, inertia)
        except tangent.TangentError:
            return None
        weights, before = self.section.node_weights(pressure), self.section.frames.before
        # nodes depend on the frames on both sides; few have forces, all move
        pressed, pushed = np.flatnonzero(forces.any(axis=(0, 2))), np.zeros((len(frames), len(forces), 6))
        force = forces[:, pressed].swapaxes(0, 1)
        for side in (0, 1):
            w, frame = weights[pressed, side], before[pressed] + side
            arm = np.einsum("na,nar->nr", w[:, 1:], frames[frame, 1:])
            torque = cross(np.broadcast_to(arm[:, None], force.shape), force)
            np.add.at(pushed, frame, np.concatenate([w[:, :1, None] * force, torque], axis=2))
        step, rates = chain_tangent.solve(pushed.swapaxes(0, 1)), np.empty((len(forces), *frames.shape))
        axes = np.broadcast_to(frames[:, 1:], rates[:, :, 1:].shape)
        rates[:, :, 0] = step[:, :, :3]
        rates[:, :, 1:] = cross(np.broadcast_to(step[:, :, None, 3:], axes.shape), axes)
        return self.section.films(rates, np.full(len(rates), pressure))

    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of the flange's reactions at the last solution over a displacement."""
        rates = rates_from_nodes(self.section.frames, self._now.last.frames, displacement)
        frames, bases = self._now.last.frames, self.section.frames.bases
        moved = twists(frames, rates)
        flange = rigid_motion(
            self.body.positions[self.body.base] @ self._now.flange.rotation.T, displacement[self.body.base]
        )
        moved[bases, :3] = flange[:3] + np.cross(flange[3:], frames[bases, 0] - frames[0, 0])
        moved[bases, 3:] = flange[3:]
        return float(np.einsum("fi,fi->", self._now.last.gradient[self.clamp.held], moved[self.clamp.held]))

    def current_shape(self) -> ChainStep:
        """Return the result of the last step: frames, and the pressure that nodes depend on."""
        return self._now.last

    def shape_reader(self) -> ChainReader:
        """Return a reader of frames."""
        return ChainReader(self.section)

    @property
    def touching(self) -> None:
        """None: self-contact is not modelled between frames."""

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each copy at the present shape."""
        return tuple(self._solver.volume(self._now.last.frames, self._now.last.pressure_Pa).tolist())

    @property
    def reach_m(self) -> float:
        """A distance from the flange's origin that no node exceeds within the model's range."""
        return self.section.reach_m

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in the chambers: commanded, or that of the sealed gas at the present volume."""
        return (self._now.last.pressure_Pa,) * self.section.copies

    @property
    def mass_kg(self) -> float:
        """Mass of the chain."""
        return self.section.mass_kg

    def fill_mass(self, figures: Array) -> None:
        figures[CENTER:] = self._now.last.figures[CENTER:]

    def mass_properties(self) -> mass_properties.MassProperties:
        """Return mass, centre and inertia at the present shape."""
        return mass_properties.MassProperties(
            self.section.mass_kg, *center_and_inertia(self._now.last.figures)
        )
