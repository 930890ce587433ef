"""Equilibria and steps of one chain of frames at known cable tensions; the pressure of sealed gas
follows by the secant method.
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
    """A task of the solver: an equilibrium, or a step in time.

    Args:
        clamp: frames held by the flange.
        scheme: length of the step, and tolerances.
        begin: state at the start of a step; None in statics.
        flange: (4, 3), its origin and axes at the end of a step.
        factor: which a step may reuse, and replaces; None for none.
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
        motion, (base, target) = self.begin.motion, np.empty((2, *self.clamp.offsets.shape))
        earlier = motion if self.begin.earlier is None else self.begin.earlier
        x, v, x_before, v_before, into, unused = (
            points.reshape(-1, 3) for points in (*motion, *earlier, base, target)
        )
        fill_inertia_target(x, v, x_before, v_before, v, self.scheme.coefficients, into, unused)
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
        """Find the equilibrium near `start`, at the tensions in `loads`.

        Args:
            start: (f, 4, 3), held frames at their poses in the solution.
            free: (f,) frames that can move.
            loads: active loads; nodal forces are divided between the two frames next to each node.
            tolerance_N: bound of the residual.
            iterations_max: bound of Newton's iterations.
            begin_Pa: gauge pressure at which the search for that of a sealed gas begins.
        """
        scheme = ChainScheme.of_statics(tolerance_N, self.lever_m, iterations_max)
        return self.find(ChainTask(FrameClamp(~free, start), scheme), loads, start, begin_Pa)

    def find(self, task: ChainTask, loads: Loads, start: int | Array, begin_Pa: float) -> ChainStep:
        """Return the solution at the tensions in `loads`.

        Args:
            task: options, clamp and scheme of the solution.
            loads: that act.
            start: a start of `chain_step`, such as STANDING, or frames (f, 4, 3).
            begin_Pa: gauge pressure to begin with, of sealed gas.
        """
        gas = self.section.gas(loads)
        if gas is None:
            return self._at_pressure(task, loads, start, self.section.pressure(loads))
        return self._with_gas(gas, task, loads, self._at_pressure(task, loads, start, begin_Pa))

    def _with_gas(self, gas: SealedGas, task: ChainTask, loads: Loads, solution: ChainStep) -> ChainStep:
        """Return the solution at the pressure that sealed gas has in it, by secants from another."""
        pressure, step, before = solution.pressure_Pa, 0.0, 0.0
        for _ in range(_ROUNDS_MAX - 1):
            if solution.outcome is not Outcome.CONVERGED:
                break
            difference = gas.gauge_pressure(float(self.section.volume(solution.frames)[0])) - pressure
            absolute = abs(pressure) + gas.ambient_Pa
            if abs(difference) <= _TOLERANCE * absolute:
                break
            slope = (difference - before) / step if step else -1.0
            # more pressure, more volume: the true slope is below -1
            step = min(max(-difference / min(slope, -1.0), -_STEP_MAX * absolute), _STEP_MAX * absolute)
            before, pressure = difference, pressure + step
            solution = self._at_pressure(task, loads, solution.frames, pressure)
        return solution

    def _at_pressure(
        self, task: ChainTask, loads: Loads, start: int | Array, pressure_Pa: float
    ) -> ChainStep:
        clamp, scheme, begin, flange, factor = task
        end_motion = np.empty((2, *clamp.offsets.shape))
        gradient, figures = np.empty((len(end_motion[0]), 6)), np.empty(FIGURES)
        motion = end_motion if begin is None else begin.motion
        earlier = None if begin is None else begin.earlier
        first_frames = motion[0]
        if not isinstance(start, int):
            end_motion[0] = start
            first_frames, start = end_motion[0], GIVEN
        elif self.loads.losses_follow_shape:
            first_frames = first_frames + scheme.h * motion[1]
        work = self.work if factor is None else factor.work
        side = ChainSide(self.loads.acting(loads, pressure_Pa, first_frames), clamp.free, clamp.offsets, work)
        ends = ChainEnds(
            motion, motion if earlier is None else earlier, flange, end_motion, gradient, figures
        )
        reused = factor is not None and factor.is_of(clamp, scheme.coefficients)
        outcome, iterations, residual, reusable, potential, shifted = unchecked(solve_chain)(
            side, scheme, ends, start, reused
        )
        if factor is not None:
            factor.keep(reusable, clamp, scheme.coefficients)
        return ChainStep(
            ChainState(end_motion, pressure_Pa, None if begin is None else motion), gradient, figures,
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
