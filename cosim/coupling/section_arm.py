"""The soft side as a chain of rigid frames with condensed sections between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np
from scipy.linalg import LinAlgError

from cosim.coupling.chain_equilibria import ChainEquilibria
from cosim.coupling.chain_films import NO_ANGLES, ChainFilms
from cosim.coupling.chain_reader import ChainReader, ChainShape
from cosim.coupling.exchange_gain import exchange_gain
from cosim.coupling.mass import MassProperties
from cosim.coupling.soft_side import SoftReply, SoftSide
from cosim.errors import ConvergenceError, InputError
from cosim.frames import Array, IntArray, Mask, Pose
from cosim.soft.body import Loads
from cosim.soft.contact import ContactPlanes
from cosim.soft.contact_surface import ContactSurface
from cosim.soft.dynamics import StepAim, StepOptions
from cosim.soft.equilibrium import Equilibrium, Obstacles
from cosim.soft.newton import NewtonOptions
from cosim.soft.section.frame_clamp import FrameClamp
from cosim.soft.section.model import SectionBody
from cosim.soft.section.sensitivity import ChainSensitivity, ChainTangent
from cosim.soft.section.solver import ChainResult, ChainSolver
from cosim.soft.section.stepper import ChainStepper
from cosim.soft.section.stepping import (
    carried,
    node_motion,
    rates_from_nodes,
    rigid_motion,
    supplied_wrench,
    twists,
)
from cosim.soft.state import SoftState
from cosim.soft.system import SoftSystem
from cosim.soft.tip_target import TipTarget, find_flange_pose, find_tensions

_HALVINGS_MAX = 5

_Drive: TypeAlias = tuple[Pose, Loads]


@final
@dataclass(frozen=True)
class SectionArmState:
    """What the next step of a section arm depends on.

    Args:
        chain: points of the frames and their velocities, in place of nodes.
        clamp: frames held by the flange.
        flange: world_from_flange.
        loads: that act.
        pressure_Pa: of the gas.
        gradient: (f, 6) [N, N m] at the last solution.
        residual_N: of the last step.
    """

    chain: SoftState
    clamp: FrameClamp
    flange: Pose
    loads: Loads
    pressure_Pa: float
    gradient: Array
    residual_N: float


@final
class SectionArm(SoftSide):
    """A chain of frames held by the flange; owns solver and state.

    The frames' points stand for nodes: (f, 4, 3) positions and velocities in a `SoftState`. The film's own
    nodes are made from them when somebody asks.

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
        drawn = section.frames.drawn
        self._chain = SoftState.at_rest(carried(drawn, world_from_flange), NO_ANGLES)
        self._film: SoftState | None = None
        self._films = ChainFilms(section)
        self._equilibria = ChainEquilibria(section, self._solver, self._films, statics)
        self.clamp = FrameClamp.of_base(section)
        self._flange, self._pressure = world_from_flange, 0.0
        self._loads = Loads(0.0, (0.0,) * len(self.body.cables), (0.0, 0.0, 0.0))
        self._gradient = np.zeros((len(drawn), 6))
        self._residual = 0.0
        # of the last step: where it began; and where the one that was taken back had ended
        self._begin = (self._chain, self._pressure, self._flange, self._loads)
        self._reached: Array = self._chain.positions

    @property
    def state(self) -> SoftState:
        """The film's nodes on the frames."""
        if self._film is None:
            self._film = self._films.film(self._chain, self._pressure)
        return self._film

    @state.setter
    def state(self, film: SoftState) -> None:
        self._chain, self._pressure = self._chain_of(film, self._flange)
        self._film = film

    def _chain_of(self, film: SoftState, flange: Pose) -> tuple[SoftState, float]:
        return self._films.chain(film, flange, self._pressure)

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step, with the flange at its new pose."""
        return self._advance(world_from_flange, loads, step_s, None)

    def advance_closely(
        self, world_from_flange: Pose, loads: Loads, step_s: float, aim: StepAim
    ) -> SoftReply:
        """Advance by one step, as closely as asked for."""
        start = None if aim.start is None else self._reached
        return self._advance(world_from_flange, loads, step_s, StepAim(aim.tolerance_N, start))

    def take_back(self, before: SoftState) -> None:
        """Undo the last step; where it ended is a start for the next one."""
        self._reached = self._chain.positions
        self._chain, self._pressure, self._flange, self._loads = self._begin
        self._film = before

    @property
    def exchange_gain(self) -> float:
        """How many times less mass an exchange that is one tick late bears than with implicit Euler."""
        return exchange_gain(self._dynamics.integrator)

    def _advance(self, flange: Pose, loads: Loads, step_s: float, aim: StepAim | None) -> SoftReply:
        begin = self._begin = (self._chain, self._pressure, self._flange, self._loads)
        try:
            iterations = self._step(begin[2:], (flange, loads), step_s, _HALVINGS_MAX, aim)
        except ConvergenceError:
            self._chain, self._pressure = begin[:2]
            raise
        finally:
            self._film = None
        self._flange, self._loads = flange, loads
        return SoftReply(
            supplied_wrench(self._gradient, self._chain.positions, self.clamp.held),
            self._residual,
            iterations,
        )

    def _step(
        self, begin: _Drive, end: _Drive, step_s: float, halvings: int, aim: StepAim | None = None
    ) -> int:
        """Take one step, or two halves where it does not converge; return the Newton iterations."""
        try:
            self._chain, found = self._stepper.step(self._chain, self.clamp, *end, step_s, aim)
        except ConvergenceError as error:
            if halvings == 0:
                raise
            middle = (begin[0].interpolated(end[0], 0.5), begin[1].interpolated(end[1], 0.5))
            self._chain = replace(self._chain, earlier=None)
            part = None if aim is None else StepAim(aim.tolerance_N)
            spent = error.iterations + self._step(begin, middle, 0.5 * step_s, halvings - 1, part)
            spent += self._step(middle, end, 0.5 * step_s, halvings - 1, part)
            self._chain = replace(self._chain, earlier=None)
            return spent
        self._take(found)
        return found.iterations

    def _take(self, found: ChainResult) -> None:
        self._pressure, self._gradient, self._residual = found.pressure_Pa, found.gradient, found.residual_N

    def start(self, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Return the equilibrium before the first phase: hung up without pressure, then loaded."""
        return self._equilibria.start(self.clamp, world_from_flange, loads)

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go; the present state stays."""
        begin = state if start is None else SoftState.at_rest(start, NO_ANGLES)
        frames = self._chain_of(begin, world_from_flange)[0].positions
        return self._equilibria.solve(frames, self.clamp, world_from_flange, loads)

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state stays."""
        return self._equilibria.follow(begin, self.clamp, world_from_flange, loads, self._pressure)

    def sensitivity(self, here: Equilibrium) -> ChainSensitivity:
        """Return how the tip moves at an equilibrium."""
        chain, pressure = self._chain_of(here.state, here.world_from_flange)
        return ChainSensitivity(self._solver, chain.positions, self.clamp.free, here.loads, pressure)

    def find_tensions(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose cable tensions bring the tip to a target; the flange stays."""
        return find_tensions(self, begin, target).equilibrium

    def find_flange_pose(self, begin: Equilibrium, target: TipTarget) -> Equilibrium:
        """Return the equilibrium whose flange pose brings the tip to a target; the loads stay."""
        return find_flange_pose(self, begin, target).equilibrium

    def settle(self, found: Equilibrium) -> None:
        """Take over an equilibrium as the present state."""
        self._chain, self._pressure = self._chain_of(found.state, found.world_from_flange)
        self._film = found.state
        # what touches is found anew in every step
        self._flange, self._loads = found.world_from_flange, replace(found.loads, contact=None)
        self._gradient = self._solver.evaluate(self._chain.positions, found.loads, self._pressure)

    def stand_against(self, obstacles: Obstacles | None) -> None:
        """Let equilibria from now on take in what the film touches."""
        self.obstacles = self._equilibria.obstacles = obstacles

    def hold_also(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold whole rings where they are now; they go with the flange."""
        frames = self._chain.positions
        self.clamp = self.clamp.holding(self.section, held, frames, world_from_flange)

    def let_go(self, nodes: IntArray) -> None:
        """Hold the rings of the given nodes (m,) no longer."""
        self.clamp = self.clamp.without(self.section, nodes)

    def save_state(self) -> SectionArmState:
        """Return what the next step depends on."""
        return SectionArmState(
            self._chain, self.clamp, self._flange, self._loads, self._pressure, self._gradient,
            self._residual,
        )  # fmt: skip

    def restore_state(self, state: SectionArmState) -> None:
        """Return to a state of `save_state`, of this arm or of one with the same frames.

        Raises:
            InputError: the state is of an arm with another number of frames.
        """
        here, there = len(self.section.frames), len(state.clamp.held)
        if here != there:
            raise InputError(f"the saved soft robot has {there} frames, this one {here}")
        self._chain, self._film, self.clamp = state.chain, None, state.clamp
        self._flange, self._loads, self._pressure = state.flange, state.loads, state.pressure_Pa
        self._gradient, self._residual = state.gradient, state.residual_N

    def contact_surface(self) -> ContactSurface:
        """Return where the body can be touched."""
        return ContactSurface.of(self.body, SoftSystem(self.body).pattern)

    def response(self, forces: Array, contact: ContactPlanes, step_s: float) -> Array | None:
        """Return how far small forces would have moved the nodes within the last step."""
        bed = self._stepper.bed(self._chain, step_s)
        frames, pressure, loads = self._chain.positions, self._pressure, replace(self._loads, contact=contact)
        try:
            tangent = ChainTangent(self._solver, frames, self.clamp.free, loads, pressure, bed)
        except LinAlgError:
            return None
        motion = node_motion(self.section, frames, pressure)
        pushed = np.einsum("nrfi,knr->kfi", motion, forces)
        return np.asarray(np.einsum("nrfi,kfi->knr", motion, tangent.solve(pushed)))

    def work_taken_in(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement."""
        rates = rates_from_nodes(self.section.frames, self._chain.positions, displacement)
        moved = twists(self._chain.positions, rates)
        moved[0] = rigid_motion(
            self.body.positions[self.body.base] @ self._flange.rotation.T, displacement[self.body.base]
        )
        return float(np.einsum("fi,fi->", self._gradient[self.clamp.held], moved[self.clamp.held]))

    def shape_now(self) -> ChainShape:
        """Return the present frames, and the pressure that the nodes on them depend on."""
        return ChainShape(self._chain.positions, self._pressure)

    def shape_reader(self) -> ChainReader:
        """Return what reads frames."""
        return ChainReader(self.section)

    @property
    def touching(self) -> None:
        """Nothing: films between frames do not touch one another."""

    @property
    def volumes_m3(self) -> tuple[float, ...]:
        """Volume inside film and caps at the present shape."""
        return (self._solver.volume(self._chain.positions, self._pressure),)

    @property
    def pressures_Pa(self) -> tuple[float, ...]:
        """Gauge pressure in the chamber: the given one, or that of the sealed gas at the present volume."""
        return (self._pressure,)

    def mass_properties(self) -> MassProperties:
        """Return mass, centre and inertia at the present shape."""
        return MassProperties.of_blocks(self.section.mass, self._chain.positions)
