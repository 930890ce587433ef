"""The soft side as a chain of rigid frames with condensed sections between them: stepped, solved, read."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, cross
from cosim.coupling.robots import chain_equilibria, shape_reader, soft_robot
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
from cosim.soft.solve import tip_search
from cosim.soft.solve.branching import Branching, StabilityReport
from cosim.soft.solve.linear_step import LinearStep
from cosim.soft.solve.newton_options import NewtonOptions, Outcome, SearchEffort
from cosim.soft.solve.stability import LowestMode, switch_branch
from cosim.soft.solve.state import (
    Equilibrium,
    Obstacles,
    SoftState,
    StepAccuracy,
    StepOptions,
    inertia_weight,
)
from cosim.soft.solve.tip_target import TargetOptions, TipTarget

_LEAVES_MAX = 50  # a stack that leans is nearly neutral about its axis: it may give way again and again


@final
@dataclass(frozen=True)
class BeamRobotState:
    """What the next step of a section arm depends on.

    Args:
        last: where the last step ended.
        clamp: frames held by the flange.
        flange: world_from_flange.
        loads: that act.
        factor: that the next step may reuse; None for none, or one that the arm holds.
    """

    last: ChainStep
    clamp: FrameClamp
    flange: Pose
    loads: Loads
    factor: SavedFactor | None = None

    def check(self, frames: int) -> None:
        """Check that it is of an arm with so many frames.

        Raises:
            InputError: it is not.
        """
        if len(self.clamp.held) != frames:
            raise InputError(f"the saved soft robot has {len(self.clamp.held)} frames, this one {frames}")


@final
class ChainReader(shape_reader.ShapeReader):
    """Reads chains; figures need the nodes of the tip and the centres of the hole rings, and no others.

    Args:
        section: whose chains.
    """

    def __init__(self, section: SectionBody) -> None:
        nodes, before, tip = section.model.nodes, section.frames.before, section.body.tip
        rings = center_rings(section.body)
        self._section, self._tip = section, len(tip)
        # all nodes of a ring are beside the same two frames
        weights = np.concatenate([nodes[:, tip], nodes[:, rings].mean(axis=2)], axis=1)
        self._weights = np.ascontiguousarray(weights.reshape(len(weights), -1))
        self._before = before[[*tip, *rings[:, 0]]]
        own = np.ascontiguousarray(weights[:, : len(tip)].reshape(len(weights), -1))
        self._of_tip = own, self._before[: len(tip)]

    def positions(self, shape: ChainStep) -> Array:
        """Return the film's nodes (n, 3) [m] on the frames."""
        return self._section.positions(shape.frames, shape.pressure_Pa)

    def films(self, shapes: Sequence[ChainStep]) -> Array:
        """Return the film's nodes (k, n, 3) [m] of some shapes."""
        return self._section.films(*_stacked(shapes))

    def figures(self, shapes: Sequence[ChainStep]) -> ShapeFigures:
        """Return the figures; see `ShapeReader.figures`."""
        frames, pressure_Pa = _stacked(shapes)
        found = self._section.points(frames, pressure_Pa, self._weights, self._before)
        volumes = self._section.volumes(frames, pressure_Pa)
        return shape_reader.figures_at(found, self._tip, volumes)

    def tips(self, shapes: Sequence[ChainStep]) -> Array:
        """Return the tips; see `ShapeReader.tips`."""
        return shape_reader.centers_of(self._section.points(*_stacked(shapes), *self._of_tip))


def _stacked(shapes: Sequence[ChainStep]) -> tuple[Array, Array]:
    """Return frames (k, f, 4, 3) and pressures (k,) of some shapes."""
    frames = np.concatenate([shape.frames for shape in shapes]).reshape(len(shapes), -1, 4, 3)
    return frames, np.array([shape.pressure_Pa for shape in shapes])


@final
class BeamRobot(soft_robot.SoftRobot):
    """A chain of frames held by the flange; owns solver and state.

    The film's own nodes are made from the frames when somebody asks. `final` is a kind of error after which a
    tick is not tried in halves.

    Args:
        section: what it is.
        world_from_flange: where the flange is at first; the frames start as drawn.
        statics: bounds of equilibrium solutions.
        dynamics: how time steps are solved.
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
        self._leaves = 0  # of unstable equilibria, one on the way on from another
        clamp = FrameClamp.of_base(section)
        loads = Loads((), (0.0,) * len(self.body.cables), (0.0, 0.0, 0.0))
        drawn = ChainState.at_rest(carried(section.frames.drawn, world_from_flange), 0.0)
        last = self._standing(drawn, np.zeros((len(drawn.frames), 6)), clamp)
        self._now = BeamRobotState(last, clamp, world_from_flange, loads)
        self._film: SoftState | None = None
        # where the last step began, and where the one that was undone had ended
        self._begin = self._now
        self._reached: Array = drawn.frames

    @property
    def clamp(self) -> FrameClamp:
        """Frames held by the flange."""
        return self._now.clamp

    @property
    def state(self) -> SoftState:
        """The film's nodes on the frames."""
        if self._film is None:
            self._film = film_of(self.section, self._now.last.chain)
        return self._film

    @state.setter
    def state(self, film: SoftState) -> None:
        chain = self.chain_of(film, self._now.flange)
        last = self._standing(chain, self._now.last.gradient, self.clamp)
        self._now, self._film = replace(self._now, last=last), film

    def chain_of(self, film: SoftState, flange: Pose) -> ChainState:
        """Return the chain of a film with the flange at a pose.

        Args:
            film: that such an arm has made, or any other, whose frames are then fitted.
            flange: pose of the first frame.
        """
        return chain_of(self.section, film, flange, self._now.last.pressure_Pa)

    def _standing(self, chain: ChainState, gradient: Array, clamp: FrameClamp) -> ChainStep:
        """Return a chain as if a step had ended there."""
        figures = figures_of(chain.frames, clamp.free, self.section.mass, gradient)
        return ChainStep(chain, gradient, figures, Outcome.CONVERGED, 0, 0.0)

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> soft_robot.SoftReply:
        """Advance by one step, with the flange at its new pose."""
        return self._advance(world_from_flange, loads, step_s, None)

    def advance_accurately(
        self, world_from_flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy
    ) -> soft_robot.SoftReply:
        """Advance by one step, as closely as asked for."""
        start = None if accuracy.start is None else self._reached
        return self._advance(world_from_flange, loads, step_s, StepAccuracy(accuracy.tolerance_N, start))

    def restore(self, before: SoftState) -> None:
        """Undo the last step; where it ended is a start for the next one."""
        self._reached = self._now.last.frames
        self._now, self._film = self._begin, before

    def _advance(
        self, flange: Pose, loads: Loads, step_s: float, accuracy: StepAccuracy | None
    ) -> soft_robot.SoftReply:
        begin = self._begin = self._now
        stepper, drives = (
            (self._step, self.restart, self.work),
            ((begin.flange, begin.loads), (flange, loads)),
        )
        self._film = None
        try:
            with self.work:
                iterations = soft_robot.step_with_halving(stepper, *drives, step_s, accuracy, self.final)
        except BaseException:
            self._now = begin
            raise
        last = self._now.last
        return soft_robot.SoftReply(supplied_wrench(last.figures), last.residual_N, iterations)

    def _step(
        self, _begin: soft_robot.Drive, end: soft_robot.Drive, step_s: float, accuracy: StepAccuracy | None
    ) -> int:
        now, (flange, loads) = self._now, end
        task = self._stepper.task(now.last.chain, now.clamp, step_s, flange)
        try:
            last = self._stepper.step(task, loads, accuracy)
        except ConvergenceError as error:
            self.work.spend(error.iterations, error.residual_N)
            raise
        self.work.iterations += last.iterations
        self._now = BeamRobotState(last, now.clamp, flange, loads)
        return last.iterations

    def restart(self) -> None:
        """Let the next step be the first one of a two-step integrator."""
        last = self._now.last
        self._now = replace(self._now, last=replace(last, chain=replace(last.chain, earlier=None)))

    @property
    def reaction_weights(self) -> tuple[float, ...]:
        """How the flange's last accelerations count in the answer of inertia, see `reaction_weights`."""
        return soft_robot.reaction_weights(self._dynamics.integrator)

    def start(self, world_from_flange: Pose, loads: Loads, hung: Equilibrium | None = None) -> Equilibrium:
        """Return the equilibrium before the first phase: hung up without pressure, then loaded."""
        return self._equilibria.start(self.clamp, world_from_flange, loads)

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go; the present state stays."""
        begin = state if start is None else SoftState.at_rest(start, state.memory)
        chain = self.chain_of(begin, world_from_flange)
        return self._equilibria.solve(chain.frames, self.clamp, world_from_flange, loads, chain.pressure_Pa)

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state stays."""
        pressure = self._now.last.pressure_Pa
        found = self._equilibria.follow(begin, self.clamp, world_from_flange, loads, pressure)
        return self.switch_branch(begin, found)

    def switch_branch(self, begin: Equilibrium | None, found: Equilibrium) -> Equilibrium:
        """Return a stable equilibrium in place of one that is not, see `stability.switch_branch`."""
        if self._leaves >= _LEAVES_MAX:
            return found
        self._leaves += 1
        try:
            return switch_branch(self, begin, found)
        finally:
            self._leaves -= 1

    def slide(self, state: SoftState, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Find the equilibrium below a state: Newton's method with inertia correction goes there."""
        return self.solve(state, world_from_flange, loads)

    def lowest_mode(self, here: Equilibrium) -> LowestMode:
        """Return the lowest eigenvalue of the tangent stiffness at an equilibrium, and its mode."""
        return self._resting_at(here).lowest_mode

    def describe_instability(self, here: Equilibrium, lowest: LowestMode) -> Branching:
        """Return what is known of an equilibrium that gives way along a mode by itself."""
        return self._resting_at(here).describe_instability(lowest, max(1, here.negative_pivots or 0))

    def _resting_at(self, here: Equilibrium) -> RestingChain:
        return self._resting(self.chain_of(here.state, here.world_from_flange), here.loads)

    def find_instability(self, shape: ChainStep, world_from_flange: Pose, loads: Loads) -> Branching | None:
        """Return in which direction a shape would give way if it was at rest; None: in none."""
        resting = self._resting(shape.chain, loads)
        return resting.unstable if resting.negative_pivots else None

    def assess_stability(self, shape: ChainStep, world_from_flange: Pose, loads: Loads) -> StabilityReport:
        """Return how firmly a shape stands, as if it was at rest."""
        return self._resting(shape.chain, loads).assess_stability(self._system)

    @cached_property
    def _system(self) -> FilmPotential:
        return FilmPotential(self.body)

    def _resting(self, chain: ChainState, loads: Loads) -> RestingChain:
        return RestingChain(self._solver, self.clamp, chain.frames, loads, chain.pressure_Pa)

    def sensitivity(self, here: Equilibrium) -> tangent.ChainSensitivity:
        """Return how the tip moves at an equilibrium."""
        chain = self.chain_of(here.state, here.world_from_flange)
        at = point_of(self._solver, chain.frames, here.loads, chain.pressure_Pa)
        return tangent.ChainSensitivity(self._solver, at, self.clamp.free)

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose cable tensions bring the tip to a target; the flange stays."""
        return tip_search.find_tensions(self, begin, target).equilibrium

    def find_flange_pose(
        self, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
    ) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay."""
        return tip_search.find_flange_pose(self, begin, target, options).equilibrium

    def commit(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state."""
        chain = self.chain_of(found.state, found.world_from_flange)
        gradient = self._resting(chain, found.loads).gradient
        # what touches is found again in every step
        loads = replace(found.loads, contact=None)
        last = self._standing(chain, gradient, self.clamp)
        self._now, self._film = BeamRobotState(last, self.clamp, found.world_from_flange, loads), found.state

    def set_obstacles(self, obstacles: Obstacles | None) -> None:
        """Let equilibria from now on take in what the film touches."""
        self.obstacles = self._equilibria.obstacles = obstacles

    def hold_components(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold whole rings where they are now; they go with the flange."""
        now = self._now
        clamp = now.clamp.holding(self.section, held, now.last.frames, world_from_flange)
        self._now = replace(now, clamp=clamp)

    def release(self, nodes: IntArray) -> None:
        """Hold the rings of the given nodes (m,) no longer."""
        self._now = replace(self._now, clamp=self.clamp.without(self.section, nodes))

    def linear_step(self, step_s: float) -> LinearStep:
        """Return a step of some length [s] as a matrix, about the present shape as if it was at rest."""
        resting = self._resting(self._now.last.chain, self._now.loads)
        return linear_step(resting, self._dynamics.bed(step_s))

    @property
    def full_state(self) -> BeamRobotState:
        """All that the next step depends on."""
        return replace(self._now, factor=self._stepper.factor.save_state(self.clamp))

    @full_state.setter
    def full_state(self, state: BeamRobotState) -> None:
        state.check(len(self.section.frames))
        self._now, self._film = replace(state, factor=None), None
        self._stepper.factor.restore_state(state.factor, state.clamp)

    @property
    def end_state(self) -> BeamRobotState:
        """Where it is, how it is held, and what acts on it."""
        return self._now

    def inertia_weight(self, step_s: float) -> float:
        """Return c [1/s^2]: a motion X of the nodes in a step meets the inertia c m X."""
        bed = self._dynamics.bed(step_s, first=self._now.last.chain.earlier is None)
        return inertia_weight(bed.span, self._dynamics.air_drag_per_s)

    def contact_surface(self) -> ContactSurface:
        """Return where the body can be touched."""
        return ContactSurface.of(self.body, self._system.pattern)

    def response(self, forces: Array, contact: ContactPlanes | None, step_s: float) -> Array | None:
        """Return how far small forces would have moved the nodes within the last step."""
        last, solver = self._now.last, self._solver
        frames, pressure = last.frames, last.pressure_Pa
        inertia = self._stepper.task(last.chain, self.clamp, step_s).inertia
        at = point_of(solver, frames, replace(self._now.loads, contact=contact), pressure)
        try:
            answer = tangent.ChainTangent(solver, at, self.clamp.free, inertia)
        except tangent.TangentError:
            return None
        weights, before = self.section.node_weights(pressure), self.section.frames.before
        # nodes are on the frames on both sides of them; few bear forces, all move
        pressed, pushed = np.flatnonzero(forces.any(axis=(0, 2))), np.zeros((len(frames), len(forces), 6))
        force = forces[:, pressed].swapaxes(0, 1)
        for side in (0, 1):
            w, frame = weights[pressed, side], before[pressed] + side
            arm = np.einsum("na,nar->nr", w[:, 1:], frames[frame, 1:])
            torque = cross(np.broadcast_to(arm[:, None], force.shape), force)
            np.add.at(pushed, frame, np.concatenate([w[:, :1, None] * force, torque], axis=2))
        step, rates = answer.solve(pushed.swapaxes(0, 1)), np.empty((len(forces), *frames.shape))
        axes = np.broadcast_to(frames[:, 1:], rates[:, :, 1:].shape)
        rates[:, :, 0] = step[:, :, :3]
        rates[:, :, 1:] = cross(np.broadcast_to(step[:, :, None, 3:], axes.shape), axes)
        return self.section.films(rates, np.full(len(rates), pressure))

    def supplied_work(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement."""
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
        """Return where the last step ended: its frames, and the pressure that the nodes on them depend on."""
        return self._now.last

    def shape_reader(self) -> ChainReader:
        """Return what reads frames."""
        return ChainReader(self.section)

    @property
    def touching(self) -> None:
        """Nothing: films between frames do not touch one another."""

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps of each copy at the present shape."""
        return tuple(self._solver.volume(self._now.last.frames, self._now.last.pressure_Pa).tolist())

    @property
    def reach_m(self) -> float:
        """A distance from the flange's origin that no node exceeds: its model ends before."""
        return self.section.reach_m

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in the chambers: the given one, or that of the sealed gas at the present volume."""
        return (self._now.last.pressure_Pa,) * self.section.copies

    @property
    def mass_kg(self) -> float:
        """Of the chain."""
        return self.section.mass_kg

    def fill_mass(self, figures: Array) -> None:
        figures[CENTER:] = self._now.last.figures[CENTER:]

    def mass_properties(self) -> soft_robot.MassProperties:
        """Return mass, centre and inertia at the present shape."""
        return soft_robot.MassProperties(self.section.mass_kg, *center_and_inertia(self._now.last.figures))
