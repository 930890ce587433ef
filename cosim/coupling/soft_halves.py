"""Soft halves of ticks that kernels take, of a section model and of a lumped film; others are left to Python.

The kernels take what most ticks are: given pressures and tensions, contact of a film, and a soft step whose
tangents are positive definite.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, final

import numpy as np

from cosim.base.frames import IntArray
from cosim.base.kernel_calls import nothing_of
from cosim.coupling.contact.contact_arrays import CONTACT, ContactArrays
from cosim.coupling.contact.contact_exchange import AHEAD_TICKS
from cosim.coupling.film_ticks import FilmCommands, FilmMotion, FilmSteps, advance_film, film_calls
from cosim.coupling.half_ticks import (
    RIGID_SIDE_WARNS,
    SOFT_HALF_LEFT,
    SOFT_STEP_BEGUN,
    RigidSide,
    take_rigid_half,
)
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.section_ticks import ChainCommands, ChainMotion, ChainSteps, advance_chain, chain_calls
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.soft_sides.section_arm import ChainShapes, SectionArm
from cosim.coupling.ticks import Servos, Ticks
from cosim.coupling.ticks_taken import TicksTaken
from cosim.reduced.sections.pressure_spline import TERMS
from cosim.reduced.solve.state import ChainState
from cosim.reduced.solve.time_step import ChainStep
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.state import BegunStep, SoftState
from cosim.soft.solve.time_step import LARGE_TURN_RAD


class SoftHalves:
    """Takes ticks in a row: of this one, the soft halves are left to Python.

    Args:
        interface: between the sides.
    """

    most: int = 64
    """Ticks in a row: fine meshes are large."""

    def __init__(self, interface: Interface) -> None:
        self.interface = interface
        self._motion: Any = None
        self._first = 0

    @final
    def take(
        self, rigid: RigidSide, servos: Servos, loads: Sequence[Loads], taken: TicksTaken
    ) -> tuple[int, int]:
        """Take ticks, or the rigid half of one; return how many are done, and how that ended.

        Args:
            rigid: side.
            servos: what they are asked for in n ticks.
            loads: on the soft body at their ends.
            taken: to be filled from its next row on.
        """
        first = taken.done
        ticks = taken.ticks.from_on(first)
        commands = self._commands(loads) if self._ready and _are_plain(loads) else None
        if commands is None:
            return 0, SOFT_HALF_LEFT if take_rigid_half(rigid, servos, ticks, 0) else RIGID_SIDE_WARNS
        if self._motion is None:
            self._motion, self._first = self._room(len(taken.trials) - first), first
        motion = self._motion.from_on(first - self._first)
        done, ending = self._row(rigid, servos, loads, commands, ticks, motion)
        taken.pressure_Pa[first : first + done] = commands.pressure.reshape(len(loads), -1)[:done]
        return done, ending

    @final
    def end(self, taken: TicksTaken) -> None:
        """Show the shapes of ticks that kernels have taken: what follows begins anew."""
        if self._motion is not None:
            done = taken.done - self._first
            if done:
                taken.parts.append(self._shapes(self._motion, taken.pressure_Pa[self._first : taken.done]))
            self._motion = None

    @property
    def _ready(self) -> bool:
        """Whether the next tick may be taken by a kernel."""
        return False

    def _commands(self, loads: Sequence[Loads]) -> Any:
        """Return what the soft side is asked for by plain loads."""

    def _room(self, count: int) -> Any:
        """Return rows of the soft side for n ticks, with what is there before the first of them."""

    def _row(
        self, rigid: RigidSide, servos: Servos, loads: Sequence[Loads], commands: Any, ticks: Ticks, way: Any
    ) -> tuple[int, int]:
        """Take ticks in one call; return how many are done, and how that ended."""
        raise NotImplementedError

    def _shapes(self, way: Any, pressure_Pa: Any) -> Sequence[Any]:
        """Return the shapes of ticks at pressures (done, chambers)."""
        raise NotImplementedError


def soft_halves(interface: Interface) -> SoftHalves:
    """Return what takes the ticks of an interface in a row."""
    soft = interface.soft
    if isinstance(soft, SectionArm) and interface.contact is None and not soft.stepper.losses_follow_shape:
        return _SectionHalves(interface)
    if isinstance(soft, SoftArm) and soft.steps_alone and soft.stepper.quick.sides.knows_body:
        return _FilmHalves(interface)
    return SoftHalves(interface)


@final
class _FilmHalves(SoftHalves):
    """Of a lumped film.

    Args:
        interface: between the sides.
    """

    @property
    def _soft(self) -> SoftArm:
        soft = self.interface.soft
        assert isinstance(soft, SoftArm), "soft_halves() has asked"
        return soft

    @property
    def _ready(self) -> bool:
        return self._soft.stepper.quick.sides.knows_factor

    def _commands(self, loads: Sequence[Loads]) -> FilmCommands:
        chambers = len(self._soft.body.gas_chambers)
        pressure = np.array([load.pressures(chambers) for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        return FilmCommands(pressure, tension, np.array([load.gravity for load in loads]))

    @cached_property
    def _calls(self) -> IntArray:
        return film_calls()

    @cached_property
    def _nothing(self) -> ContactArrays:
        nothing: ContactArrays = nothing_of(CONTACT)
        return nothing._replace(counts=np.zeros(6, np.int64))

    def _room(self, count: int) -> FilmMotion:
        state = self._soft.state
        x, velocity = (np.empty((count + 2, *state.positions.shape)) for _ in range(2))
        memory = np.empty((count + 1, len(state.memory)))
        x[0], velocity[0] = state.earlier or (state.positions, state.velocities)
        x[1], velocity[1], memory[0] = state.positions, state.velocities, state.memory
        return FilmMotion(x, velocity, memory)

    def _shapes(self, way: FilmMotion, pressure_Pa: Any) -> Sequence[Any]:
        return list(way.x[2 : len(pressure_Pa) + 2])

    def _row(
        self,
        rigid: RigidSide,
        servos: Servos,
        loads: Sequence[Loads],
        commands: FilmCommands,
        ticks: Ticks,
        way: FilmMotion,
    ) -> tuple[int, int]:
        soft, stepper, interface = self._soft, self._soft.stepper, self.interface
        contact, tick_s = interface.contact, interface.scene.tick_s
        if soft.state.earlier is None:  # a first step looks back over one only
            servos, commands = servos.some(0, 1), commands.some(0, 1)
        quick, scheme = stepper.quick, stepper.scheme_of(soft.state, tick_s)
        side = quick.sides.of(scheme, tick_s)
        assert side is not None, "of a body and a factorisation that it knows"
        steps = FilmSteps(
            side, quick.untouched, quick.begins(lenient=True), quick.begins(lenient=False),
            0.0 if contact is None else contact.rest_reach_m, AHEAD_TICKS * tick_s, self._calls,
            soft.body.node_mass.reshape(-1, 1, 1), LARGE_TURN_RAD,
            self._nothing if contact is None else contact.arrays,
        )  # fmt: skip
        done, ending = advance_film(rigid, servos, commands, steps, ticks, way)
        quick.sides.take_over(side, scheme)
        if done:
            x, velocity = way.x[done : done + 2].copy(), way.velocity[done : done + 2].copy()
            state = SoftState(x[1], velocity[1], way.memory[done].copy(), (x[0], velocity[0]))
            drive = ticks.flange(done), loads[done - 1]
            soft.go_to(state, float(ticks.residual[done - 1]), ticks.flange(done - 1), drive)
        if ending == SOFT_STEP_BEGUN:
            end = way.x[done + 2].copy(), way.velocity[done + 2].copy(), way.memory[done + 1].copy()
            quick.begun = BegunStep(
                soft.state, *end, int(ticks.iterations[done]), float(ticks.residual[done])
            )
        return done, ending


@final
class _SectionHalves(SoftHalves):
    """Of a section model that touches nothing.

    Args:
        interface: between the sides.
    """

    most = 512  # more cost no less each

    @property
    def _soft(self) -> SectionArm:
        soft = self.interface.soft
        assert isinstance(soft, SectionArm), "soft_halves() has asked"
        return soft

    @property
    def _ready(self) -> bool:
        return True

    def _commands(self, loads: Sequence[Loads]) -> ChainCommands:
        pressure = np.array([load.pressures(1)[0] for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        first, weights = np.empty(len(loads), np.int64), np.empty((len(loads), TERMS))
        spline, terms = self._soft.section.model.spline, None
        for k, value in enumerate(pressure.tolist()):
            if terms is None or value != pressure[k - 1]:
                terms = spline.terms(value)
            first[k], weights[k] = terms.first, terms.weights[0]
        return ChainCommands(pressure, first, weights, self._soft.stepper.segment_tensions(tension))

    @cached_property
    def _calls(self) -> IntArray:
        return chain_calls()

    def _room(self, count: int) -> ChainMotion:
        chain = self._soft.last.chain
        frames = len(chain.frames)
        rows = ChainMotion(np.empty((count + 2, 2, frames, 4, 3)), np.empty((count, frames, 6)))
        rows.motion[0] = chain.motion if chain.earlier is None else chain.earlier
        rows.motion[1] = chain.motion
        return rows

    def _shapes(self, way: ChainMotion, pressure_Pa: Any) -> ChainShapes:
        return ChainShapes(way.motion[2 : len(pressure_Pa) + 2, 0], pressure_Pa[:, 0])

    def _row(
        self,
        rigid: RigidSide,
        servos: Servos,
        loads: Sequence[Loads],
        commands: ChainCommands,
        ticks: Ticks,
        way: ChainMotion,
    ) -> tuple[int, int]:
        soft, stepper, tick_s = self._soft, self._soft.stepper, self.interface.scene.tick_s
        options, begin = stepper.options, soft.last.chain
        two_steps, earlier = options.integrator == "bdf2", begin.earlier is not None
        steps = ChainSteps(
            stepper.arrays(soft.clamp, loads[0], begin.frames), self._calls, tick_s, options.damping_per_s,
            two_steps, earlier, stepper.tangent.serves(soft.clamp, tick_s, two_steps and earlier),
            options.newton.iterations_max,
        )  # fmt: skip
        done, ending, kept = advance_chain(rigid, servos, commands, steps, ticks, way)
        last = done if ending == SOFT_HALF_LEFT else done - 1  # of which the soft step was tried
        stepper.tangent.keep(kept, soft.clamp, tick_s, two_steps and (earlier or last > 0))
        if done:
            motion, figures = way.motion[done : done + 2].copy(), ticks.figures[done].copy()
            step = ChainStep(
                ChainState(motion[1], motion[0]), way.gradient[done - 1].copy(), figures, Outcome.CONVERGED,
                int(ticks.iterations[done - 1]), float(ticks.residual[done - 1]),
                loads[done - 1].pressures(1)[0],
            )  # fmt: skip
            soft.go_to(step, ticks.flange(done), loads[done - 1])
        # what was computed for a pressure is kept with it
        stepper.arrays(soft.clamp, loads[max(last, 0)], soft.last.frames)
        return done, ending


def _are_plain(loads: Sequence[Loads]) -> bool:
    return all(load.plain for load in {id(load): load for load in loads}.values())
