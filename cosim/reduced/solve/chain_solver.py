"""Equilibria and steps of one chain of frames at given tensions; the pressure of sealed gas is found by
secants.
"""

from typing import NamedTuple, final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.base.kernels import unchecked
from cosim.reduced.section_model import SectionBody
from cosim.reduced.sections.assembly import assemble
from cosim.reduced.sections.chain_arrays import ChainWork, InertiaTerm
from cosim.reduced.sections.figures import FIGURES
from cosim.reduced.solve.chain_loads import ChainLoads
from cosim.reduced.solve.chain_step import (
    GIVEN,
    OUTCOMES,
    ChainEnds,
    ChainScheme,
    ChainSide,
    ChainState,
    ChainStep,
    solve_chain,
)
from cosim.reduced.solve.clamp import FrameClamp
from cosim.reduced.solve.reused_factor import ReusedFactor
from cosim.soft.body.loads import Loads
from cosim.soft.elements.gas import SealedGas
from cosim.soft.solve.newton_options import Outcome
from cosim.soft.solve.step_prediction import fill_inertia_target

_ROUNDS_MAX = 30
_TOLERANCE = 1e-9  # of the absolute pressure
_STEP_MAX = 0.02  # the same, in one round
_NOWHERE = np.zeros((4, 3))


class ChainTask(NamedTuple):
    """What is to be solved: an equilibrium, or a step in time.

    Args:
        clamp: frames held by the flange.
        scheme: in what step, and how closely.
        begin: where a step begins; None in statics.
        flange: (4, 3), its origin and axes at the end of a step.
        factor: that a step may reuse, and leaves; None for none.
    """

    clamp: FrameClamp
    scheme: ChainScheme
    begin: ChainState | None = None
    flange: Array = _NOWHERE
    factor: ReusedFactor | None = None

    @property
    def inertia(self) -> InertiaTerm:
        """Inertia of the step as an elastic term about the positions without velocity; none in statics."""
        if self.begin is None:
            return InertiaTerm(0.0, np.zeros_like(self.clamp.offsets))
        here, (base, target) = self.begin.motion, np.empty((2, *self.clamp.offsets.shape))
        earlier = here if self.begin.earlier is None else self.begin.earlier
        x, v, x_before, v_before, to, unused = (
            part.reshape(-1, 3) for part in (*here, *earlier, base, target)
        )
        fill_inertia_target(x, v, x_before, v_before, v, self.scheme.coefficients, to, unused)
        return InertiaTerm(self.scheme.inertia, base)


@final
class ChainSolver:
    """Solves one section body; owns the workspace.

    Args:
        section: body with its section model.
    """

    def __init__(self, section: SectionBody) -> None:
        self.section, self.loads = section, ChainLoads(section)
        self.work = ChainWork.room(len(section.frames))
        self.lever_m = float(
            np.mean([np.linalg.norm(shape, axis=1).mean() for shape in section.frames.shapes if len(shape)])
        )

    def solve(
        self,
        start: Array,
        free: Mask,
        loads: Loads,
        tolerance_N: float,
        iterations_max: int,
        begin_Pa: float = 0.0,
    ) -> ChainStep:
        """Find the equilibrium near `start`, at given tensions.

        Args:
            start: (f, 4, 3), held frames where they shall be.
            free: (f,) frames that can move.
            loads: that act; nodal forces go to the frames beside each node.
            tolerance_N: residual at which it is done.
            iterations_max: bound.
            begin_Pa: gauge pressure at which the search for that of a sealed gas begins.
        """
        scheme = ChainScheme.of_statics(tolerance_N, self.lever_m, iterations_max)
        return self.find(ChainTask(FrameClamp(~free, start), scheme), loads, start, begin_Pa)

    def find(self, task: ChainTask, loads: Loads, start: int | Array, begin_Pa: float) -> ChainStep:
        """Return the solution at given tensions.

        Args:
            task: options, clamp and scheme of the solution.
            loads: that act.
            start: one of the leaf's, or frames (f, 4, 3).
            begin_Pa: gauge pressure to begin with, of sealed gas.
        """
        gas = self.section.gas(loads)
        if gas is None:
            return self._at_pressure(task, loads, start, self.section.pressure(loads))
        return self._with_gas(gas, task, loads, self._at_pressure(task, loads, start, begin_Pa))

    def _with_gas(self, gas: SealedGas, task: ChainTask, loads: Loads, found: ChainStep) -> ChainStep:
        """Return the solution at the pressure that sealed gas has in it, by secants from a first one."""
        pressure, step, before = found.pressure_Pa, 0.0, 0.0
        for _ in range(_ROUNDS_MAX - 1):
            if found.outcome is not Outcome.CONVERGED:
                break
            off = gas.gauge_pressure(float(self.section.volume(found.frames)[0])) - pressure
            whole = abs(pressure) + gas.ambient_Pa
            if abs(off) <= _TOLERANCE * whole:
                break
            slope = (off - before) / step if step else -1.0
            # more pressure, more volume: the true slope is below -1
            step = min(max(-off / min(slope, -1.0), -_STEP_MAX * whole), _STEP_MAX * whole)
            before, pressure = off, pressure + step
            found = self._at_pressure(task, loads, found.frames, pressure)
        return found

    def _at_pressure(
        self, task: ChainTask, loads: Loads, start: int | Array, pressure_Pa: float
    ) -> ChainStep:
        clamp, scheme, begin, flange, factor = task
        there = np.empty((2, *clamp.offsets.shape))
        gradient, figures = np.empty((len(there[0]), 6)), np.empty(FIGURES)
        motion = there if begin is None else begin.motion
        earlier = None if begin is None else begin.earlier
        near = motion[0]
        if not isinstance(start, int):
            there[0] = start
            near, start = there[0], GIVEN
        elif self.loads.losses_follow_shape:
            near = near + scheme.h * motion[1]
        work = self.work if factor is None else factor.work
        side = ChainSide(self.loads.acting(loads, pressure_Pa, near), clamp.free, clamp.offsets, work)
        ends = ChainEnds(motion, motion if earlier is None else earlier, flange, there, gradient, figures)
        reused = factor is not None and factor.is_of(clamp, scheme.coefficients)
        outcome, iterations, residual, reusable, potential, shifted = unchecked(solve_chain)(
            side, scheme, ends, start, reused
        )
        if factor is not None:
            factor.keep(reusable, clamp, scheme.coefficients)
        return ChainStep(
            ChainState(there, pressure_Pa, None if begin is None else motion), gradient, figures,
            OUTCOMES[outcome], iterations, residual, potential, shifted,
        )  # fmt: skip

    def evaluate(
        self,
        frames: Array,
        loads: Loads,
        pressure_Pa: float,
        inertia: InertiaTerm | None = None,
        *,
        hessian: bool = False,
    ) -> Array:
        """Return the gradient (f, 6); with `hessian`, fill the tangent in `work` as well.

        Args:
            frames: (f, 4, 3).
            loads: that act.
            pressure_Pa: of the gas.
            inertia: of an implicit step; None in statics.
            hessian: whether to fill the blocks.
        """
        gradient, chain = np.empty((len(frames), 6)), self.loads.acting(loads, pressure_Pa, frames)
        assemble(frames, chain, inertia or InertiaTerm(0.0, frames), gradient, self.work, hessian)
        return gradient

    def volume(self, frames: Array, pressure_Pa: float) -> Array:
        """Return the volumes (copies,) [m^3] enclosed by frames (f, 4, 3) at a gauge pressure."""
        self.section.set_pressure(pressure_Pa)
        return self.section.volume(frames)
