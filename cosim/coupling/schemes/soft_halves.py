"""Ticks in a row whose soft halves kernels take or leave to Python: what sides share; section models."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, final

import numpy as np

from cosim.base.kernels import address_of
from cosim.coupling.half_ticks import RIGID_SIDE_WARNS, SOFT_HALF_LEFT, RigidSide, hand_over
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.section_ticks import ChainCommands, ChainMotion, ChainSteps, ChainTables, advance_chain
from cosim.coupling.soft_sides.section_arm import ChainShapes, SectionArm
from cosim.coupling.ticks import Servos, Ticks
from cosim.coupling.ticks_taken import TicksTaken
from cosim.reduced.sections.section_energy import TERMS
from cosim.reduced.solve.chain_step import ChainState, ChainStep, solve_chain
from cosim.soft.body.loads import Loads
from cosim.soft.solve.newton_options import Outcome


class SoftHalves:
    """Takes ticks in a row: of this one, the soft halves are left to Python.

    Args:
        interface: between the sides.
    """

    fast_m_s: float = np.inf
    most: int = 64
    """Ticks in a row: fine meshes are large."""

    def __init__(self, interface: Interface) -> None:
        self.interface = interface
        self._plain: Any = None
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
        if self._plain is None or not self._ready:
            taken_well = self.interface.rigid_half(rigid, servos, ticks, 0)
            return 0, SOFT_HALF_LEFT if taken_well else RIGID_SIDE_WARNS
        if self._motion is None:
            self._motion, self._first = self._room(len(taken.trials) - first), first
        commands = self._plain.some(first, first + len(loads))
        motion = self._motion.from_on(first - self._first)
        done, ending = self._row(rigid, servos, loads, commands, ticks, motion)
        taken.pressure_Pa[first : first + done] = commands.pressure.reshape(len(loads), -1)[:done]
        return done, ending

    @final
    def begin(self, loads: Sequence[Loads]) -> None:
        """Begin ticks in a row, with all loads of theirs."""
        plain = all(load.plain for load in {id(load): load for load in loads}.values())
        self._plain = self._commands(loads) if plain else None

    @property
    def plain(self) -> bool:
        """Whether kernels know such soft halves."""
        return self._plain is not None

    @final
    def end(self, taken: TicksTaken) -> None:
        """Show the shapes of ticks that kernels have taken: what follows begins again."""
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


@final
class SectionHalves(SoftHalves):
    """Of a section model that touches nothing.

    Args:
        interface: between the sides.
    """

    most = 512  # more cost no less each

    @property
    def _soft(self) -> SectionArm:
        soft = self.interface.soft.rowing
        assert isinstance(soft, SectionArm), "soft_halves() has asked"
        return soft

    @property
    def _ready(self) -> bool:
        return True

    def _commands(self, loads: Sequence[Loads]) -> ChainCommands:
        distinct, section = {id(load): load for load in loads}, self._soft.section
        known = {key: section.pressure(load) for key, load in distinct.items()}
        pressure = np.array([known[id(load)] for load in loads])
        tension = np.array([load.cable_tension_N for load in loads]).reshape(len(loads), -1)
        first, weights = np.empty(len(loads), np.int64), np.empty((len(loads), TERMS))
        spline, terms = section.model.spline, None
        for k, value in enumerate(pressure.tolist()):
            if terms is None or value != pressure[k - 1]:
                terms = spline.terms(value)
            first[k], weights[k] = terms.first, terms.weights[0]
        return ChainCommands(pressure, first, weights, self._soft.stepper.segment_tensions(tension))

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
            stepper.side(soft.clamp, loads[0], begin.frames), ChainTables(*stepper.tables),
            address_of(solve_chain), address_of(hand_over), stepper.scheme(tick_s),
            two_steps, earlier, stepper.tangent.serves(soft.clamp, tick_s, two_steps and earlier),
        )  # fmt: skip
        done, ending, kept = advance_chain(rigid, servos, commands, steps, ticks, way)
        last = done if ending == SOFT_HALF_LEFT else done - 1  # of which the soft step was tried
        stepper.tangent.keep(kept, soft.clamp, tick_s, two_steps and (earlier or last > 0))
        if done:
            motion, figures = way.motion[done : done + 2].copy(), ticks.figures[done].copy()
            step = ChainStep(
                ChainState(motion[1], motion[0]), way.gradient[done - 1].copy(), figures, Outcome.CONVERGED,
                int(ticks.iterations[done - 1]), float(ticks.residual[done - 1]),
                float(commands.pressure[done - 1]),
            )  # fmt: skip
            soft.go_to(step, ticks.flange(done), loads[done - 1])
        # what was computed for a pressure is kept with it
        stepper.side(soft.clamp, loads[max(last, 0)], soft.last.frames)
        return done, ending
