"""The soft side as a chain of rigid frames with condensed sections between them."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np
from scipy.linalg import LinAlgError

from cosim.coupling.mass import MassProperties
from cosim.coupling.soft_side import SoftReply, SoftSide
from cosim.errors import ConvergenceError, InputError
from cosim.frames import Array, IntArray, Mask, Pose, Wrench, cross
from cosim.soft.body import Loads
from cosim.soft.contact import ContactPlanes
from cosim.soft.contact_surface import ContactSurface
from cosim.soft.dynamics import StepOptions, difference_scheme
from cosim.soft.equilibrium import Equilibrium
from cosim.soft.newton import NewtonOptions, Outcome
from cosim.soft.section.model import SectionBody
from cosim.soft.section.ring_frames import points_of
from cosim.soft.section.sensitivity import ChainSensitivity, ChainTangent
from cosim.soft.section.solver import Bed, ChainResult, ChainSolver
from cosim.soft.section.stepping import (
    carried,
    changed,
    node_motion,
    rates_from_nodes,
    rigid_motion,
    twists,
)
from cosim.soft.state import SoftState
from cosim.soft.system import SoftSystem
from cosim.soft.tip_target import TipTarget, find_flange_pose, find_tensions

_HALVINGS_MAX = 5
_SPLITS_MAX = 8
_REMEMBERED = 8
_NO_ANGLES = np.zeros(0)

_Drive: TypeAlias = tuple[Pose, Loads]


@final
@dataclass(frozen=True)
class SectionArmState:
    """What the next step of a section arm depends on.

    Args:
        chain: points of the frames and their velocities, in place of nodes.
        offsets: (f, 4, 3), held frames in the flange frame.
        held: (f,) which they are.
        flange: world_from_flange.
        loads: that act.
        pressure_Pa: of the gas.
        gradient: (f, 6) [N, N m] at the last solution.
        residual_N: of the last step.
    """

    chain: SoftState
    offsets: Array
    held: Mask
    flange: Pose
    loads: Loads
    pressure_Pa: float
    gradient: Array
    residual_N: float


@final
class SectionArm(SoftSide):
    """A chain of frames held by the flange; owns solver and state.

    The frames' points stand for nodes: (f, 4, 3) positions and velocities in a `SoftState`. The film's own nodes
    are made from them when somebody asks.

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
        self._statics, self._dynamics = statics, dynamics
        drawn = section.frames.drawn
        self._chain = SoftState.at_rest(carried(drawn, world_from_flange), _NO_ANGLES)
        self._film: SoftState | None = None
        # frames of the latest films, so that a state handed back is taken up exactly
        self._known: deque[tuple[SoftState, SoftState, float]] = deque(maxlen=_REMEMBERED)
        self._held = np.zeros(len(drawn), dtype=bool)
        self._held[0] = True
        self._offsets = drawn.copy()
        self._flange, self._pressure = world_from_flange, 0.0
        self._loads = Loads(0.0, (0.0,) * len(self.body.cables), (0.0, 0.0, 0.0))
        self._gradient = np.zeros((len(drawn), 6))
        self._residual = 0.0

    @property
    def state(self) -> SoftState:  # type: ignore[override]
        """The film's nodes on the frames."""
        if self._film is None:
            self._film = self._film_of(self._chain, self._pressure)
        return self._film

    @state.setter
    def state(self, film: SoftState) -> None:
        self._chain, self._pressure = self._chain_of(film, self._flange)
        self._film = film

    def _film_of(self, chain: SoftState, pressure: float) -> SoftState:
        film = SoftState(
            self.section.positions(chain.positions, pressure),
            self.section.positions(chain.velocities, pressure),
            _NO_ANGLES,
        )
        self._known.append((film, chain, pressure))
        return film

    def _chain_of(self, film: SoftState, flange: Pose) -> tuple[SoftState, float]:
        """Return the chain of a film, and the gas pressure that it was made with, or else the present one."""
        for known, chain, pressure in self._known:
            if known is film:
                return chain, pressure
        frames = self.section.frames.fit(film.positions, flange)
        rates = rates_from_nodes(self.section.frames, frames, film.velocities)
        return SoftState(frames, rates, _NO_ANGLES), self._pressure

    def advance(self, world_from_flange: Pose, loads: Loads, step_s: float) -> SoftReply:
        """Advance by one step, with the flange at its new pose."""
        before = (self._chain, self._pressure)
        try:
            iterations = self._step(
                (self._flange, self._loads), (world_from_flange, loads), step_s, _HALVINGS_MAX
            )
        except ConvergenceError:
            self._chain, self._pressure = before
            raise
        finally:
            self._film = None
        self._flange, self._loads = world_from_flange, loads
        moved = twists(self._chain.positions[self._held], self._chain.velocities[self._held])
        power = float(np.einsum("fi,fi->", self._gradient[self._held], moved))
        return SoftReply(self._wrench(), power, self._residual, iterations)

    def _wrench(self) -> Wrench:
        supplied = self._gradient[self._held]
        arm = self._chain.positions[self._held, 0] - self._chain.positions[0, 0]
        torque = supplied[:, 3:] + cross(arm, np.ascontiguousarray(supplied[:, :3]))
        return Wrench(-supplied[:, :3].sum(axis=0), -torque.sum(axis=0))

    def _step(self, begin: _Drive, end: _Drive, step_s: float, halvings: int) -> int:
        """Take one step, or two halves where it does not converge; return the Newton iterations."""
        try:
            found = self._try_step(*end, step_s)
        except ConvergenceError as error:
            if halvings == 0:
                raise
            middle = (begin[0].interpolated(end[0], 0.5), begin[1].interpolated(end[1], 0.5))
            self._chain = replace(self._chain, earlier=None)
            spent = error.iterations + self._step(begin, middle, 0.5 * step_s, halvings - 1)
            spent += self._step(middle, end, 0.5 * step_s, halvings - 1)
            self._chain = replace(self._chain, earlier=None)
            return spent
        return found.iterations

    def _try_step(self, flange: Pose, loads: Loads, step_s: float) -> ChainResult:
        options, chain = self._dynamics, self._chain
        base, span, speed = difference_scheme(options.integrator, chain, step_s)
        damped = 1.0 + options.damping_per_s * span
        bed = Bed(damped / span**2, base + span / damped * speed)
        for flight in (step_s, 0.0):
            start = self._place(
                changed(chain.positions, twists(chain.positions, chain.velocities), flight), flange
            )
            found = self._solver.solve(
                start, ~self._held, loads, options.tolerance_N, options.newton.iterations_max, bed
            )
            if found.outcome is not Outcome.NOT_FINITE:
                break
        if found.outcome is not Outcome.CONVERGED:
            raise ConvergenceError(
                f"the soft step did not converge: {found.outcome.value}; residual {found.residual_N:.3g} N after "
                f"{found.iterations} iterations; try a shorter tick or a gentler ramp",
                found.residual_N,
                found.iterations,
            )
        velocities = (found.frames - base) / span
        self._chain = SoftState(found.frames, velocities, _NO_ANGLES, (chain.positions, chain.velocities))
        self._take(found)
        return found

    def _take(self, found: ChainResult) -> None:
        self._pressure, self._gradient, self._residual = found.pressure_Pa, found.gradient, found.residual_N

    def _place(self, frames: Array, flange: Pose) -> Array:
        """Put the held frames where the flange has them."""
        frames[self._held] = carried(self._offsets[self._held], flange)
        return frames

    def start(self, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Return the equilibrium before the first phase: hung up without pressure, then loaded."""
        hanging = Loads(0.0, (0.0,) * len(self.body.cables), loads.gravity)
        # as drawn, the films lie on each other, where a section has no stiffness to start from
        straight = carried(self.section.straight(0.0), world_from_flange)
        return self.follow(
            self._equilibrium(straight, world_from_flange, hanging), world_from_flange, loads
        )

    def solve(
        self, state: SoftState, world_from_flange: Pose, loads: Loads, start: Array | None = None
    ) -> Equilibrium:
        """Find the equilibrium near a state in one go; the present state stays."""
        begin = state if start is None else SoftState.at_rest(start, _NO_ANGLES)
        frames = self._chain_of(begin, world_from_flange)[0].positions
        return self._equilibrium(frames, world_from_flange, loads)

    def _equilibrium(self, frames: Array, flange: Pose, loads: Loads) -> Equilibrium:
        options = self._statics
        found = self._solver.solve(
            self._place(frames.copy(), flange), ~self._held, loads, options.tolerance_N, options.iterations_max
        )
        if found.outcome is not Outcome.CONVERGED:
            raise ConvergenceError(
                f"no equilibrium found: {found.outcome.value}; residual {found.residual_N:.3g} N, bound "
                f"{options.tolerance_N:.3g} N, {found.iterations} iterations",
                found.residual_N,
                found.iterations,
            )
        before = self._chain, self._gradient
        self._chain, self._gradient = SoftState.at_rest(found.frames, _NO_ANGLES), found.gradient
        wrench, film = self._wrench(), self._film_of(self._chain, found.pressure_Pa)
        self._chain, self._gradient = before
        return Equilibrium(
            film, flange, loads, wrench, found.residual_N, found.iterations, found.potential_J, found.shifted
        )

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads; the present state stays."""
        here, done, piece, spent = begin, 0.0, 1.0, 0
        while done < 1.0:
            share = min(1.0, done + piece)
            pose = begin.world_from_flange.interpolated(world_from_flange, share)
            motion = pose @ here.world_from_flange.inverse()
            frames = self._chain_of(here.state, here.world_from_flange)[0].positions
            try:
                found = self._equilibrium(
                    carried(frames, motion), pose, begin.loads.interpolated(loads, share)
                )
            except ConvergenceError as error:
                spent, piece = spent + error.iterations, 0.5 * piece
                if piece < 0.5**_SPLITS_MAX:
                    raise
                continue
            here, done, spent = found, share, spent + found.iterations
        return replace(here, iterations=spent)

    def sensitivity(self, here: Equilibrium) -> ChainSensitivity:
        """Return how the tip moves at an equilibrium."""
        chain, pressure = self._chain_of(here.state, here.world_from_flange)
        return ChainSensitivity(self._solver, chain.positions, ~self._held, here.loads, pressure)

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
        self._flange, self._loads = found.world_from_flange, found.loads
        self._gradient = self._solver.evaluate(self._chain.positions, found.loads, self._pressure)

    def hold_also(self, held: Mask, world_from_flange: Pose) -> None:
        """Hold whole rings where they are now; they go with the flange.

        Raises:
            InputError: less than a whole ring, or nodes between rings, are to be held.
        """
        wanted, covered = self._held.copy(), np.zeros_like(held)
        covered[self.body.base] = True
        for f, ring in enumerate(self.section.frames.rings, start=1):
            if held[ring].all():
                wanted[f], covered[ring] = True, True
        if (held & ~covered).any():
            raise InputError("section models hold whole outer rings or the tip ring; use fidelity = 'lumped'")
        new = wanted & ~self._held
        self._offsets[new] = carried(self._chain.positions[new], world_from_flange.inverse())
        self._held = wanted

    def let_go(self, nodes: IntArray) -> None:
        """Hold the rings of the given nodes (m,) no longer.

        Raises:
            InputError: the base is to be let go.
        """
        if np.isin(self.body.base, nodes).any():
            raise InputError("section models cannot let go of their base; use fidelity = 'lumped'")
        for f, ring in enumerate(self.section.frames.rings, start=1):
            if np.isin(ring, nodes).any():
                self._held[f] = False

    def save_state(self) -> SectionArmState:
        """Return what the next step depends on."""
        return SectionArmState(
            self._chain, self._offsets.copy(), self._held.copy(), self._flange, self._loads, self._pressure,
            self._gradient, self._residual,
        )  # fmt: skip

    def restore_state(self, state: SectionArmState) -> None:
        """Return to a state of `save_state`, of this arm or of one with the same frames.

        Raises:
            InputError: the state is of an arm with another number of frames.
        """
        if len(state.held) != len(self._held):
            raise InputError(
                f"the saved soft robot has {len(state.held)} frames, this one {len(self._held)}"
            )
        self._chain, self._film = state.chain, None
        self._offsets, self._held = state.offsets.copy(), state.held.copy()
        self._flange, self._loads, self._pressure = state.flange, state.loads, state.pressure_Pa
        self._gradient, self._residual = state.gradient, state.residual_N

    def contact_surface(self) -> ContactSurface:
        """Return where the body can be touched."""
        return ContactSurface.of(self.body, SoftSystem(self.body).pattern)

    def response(self, forces: Array, contact: ContactPlanes, step_s: float) -> Array | None:
        """Return how far small forces would have moved the nodes within the last step."""
        base, span, _ = difference_scheme(self._dynamics.integrator, self._chain, step_s)
        bed = Bed((1.0 + self._dynamics.damping_per_s * span) / span**2, base)
        frames, pressure = self._chain.positions, self._pressure
        try:
            tangent = ChainTangent(self._solver, frames, ~self._held, self._loads, pressure, bed)
        except LinAlgError:
            return None
        motion = node_motion(self.section, frames, pressure)
        loads = np.einsum("nrfi,knr->kfi", motion, forces)
        return np.einsum("nrfi,kfi->knr", motion, tangent.solve(loads))

    def work_taken_in(self, displacement: Array) -> float:
        """Return the work [J] of what the flange supplies at the last solution, over a displacement."""
        rates = rates_from_nodes(self.section.frames, self._chain.positions, displacement)
        moved = twists(self._chain.positions, rates)
        moved[0] = rigid_motion(
            self.body.positions[self.body.base] @ self._flange.rotation.T, displacement[self.body.base]
        )
        return float(np.einsum("fi,fi->", self._gradient[self._held], moved[self._held]))

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
        mass, frames = self.section.mass, self._chain.positions
        total = float(mass[:, 0, 0].sum())
        first = np.einsum("fa,far->r", mass[:, 0], frames)
        center = first / total if total > 0.0 else frames[:, 0].mean(axis=0)
        second = np.einsum("fab,far,fbs->rs", mass, frames, frames) - total * np.outer(center, center)
        return MassProperties(total, center, np.trace(second) * np.eye(3) - second)
