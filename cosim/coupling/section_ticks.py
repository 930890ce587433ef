"""Many ticks of arm and chain of frames in one kernel, without Python in between.

After the rigid half of a tick the chain takes one implicit step with the flange's new pose and returns the
next wrench. A soft step that does not converge in one go is left.
"""

from __future__ import annotations

from operator import itemgetter
from typing import Annotated, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from cosim.base.kernels import (
    Blocks,
    Indices,
    Matrix,
    Vector,
    device_function,
    kernel,
    small_matrix,
)
from cosim.base.numba_insides import caller
from cosim.coupling.half_ticks import (
    ALL_DONE,
    RIGID_SIDE_WARNS,
    SOFT_HALF_LEFT,
    RigidSide,
    fill_flange,
    hand_over,
    rigid_half,
)
from cosim.coupling.ticks import Servos, Ticks
from cosim.reduced.sections.section_energy import weighted_rows
from cosim.reduced.solve.time_step import FREE_FLIGHT, ChainArrays, implicit_step


class ChainCommands(NamedTuple):
    """What the chain is asked for in each of n ticks.

    Args:
        pressure: (n,) [Pa].
        first: (n,), first of the spline's functions that are not zero at that pressure.
        weights: (n, TERMS), their values.
        tension: (n, k) [N], of all cable segments.
    """

    pressure: Vector
    first: Indices
    weights: Matrix
    tension: Matrix

    def some(self, first: int, end: int) -> ChainCommands:
        """Return what is asked for in some of the ticks."""
        return ChainCommands._make(map(itemgetter(slice(first, end)), self))


class ChainMotion(NamedTuple):
    """How a chain moves in n ticks.

    Args:
        motion: (n + 2, 2, f, 4, 3), from the step before the last one on.
        gradient: (n, f, 6).
    """

    motion: Annotated[NDArray[np.float64], numba.float64[:, :, :, :, ::1]]
    gradient: Blocks

    def from_on(self, first: int) -> ChainMotion:
        """Return the rows of a tick and all after it."""
        return ChainMotion._make(map(itemgetter(slice(first, None)), self))


class ChainSteps(NamedTuple):
    """What all ticks in a row have in common.

    Args:
        chain: in the first of them.
        hand_over: address of that kernel.
        step_s: length of a step [s].
        damping: [1/s].
        two_steps: whether steps look back over two.
        earlier: whether the first row of the motion holds the step before the last.
        kept: whether the factor serves the first of them.
        iterations_max: of a step.
    """

    chain: ChainArrays
    hand_over: int
    step_s: float
    damping: float
    two_steps: bool
    earlier: bool
    kept: bool
    iterations_max: int


_hand_over, _implicit_step = caller(hand_over), caller(implicit_step)


@device_function
def _set_pressure(chain: ChainArrays, commands: ChainCommands, k: int) -> None:
    """Bring sections and eyelets to the pressure of tick k."""
    first, weights = commands.first[k], commands.weights[k]
    weighted_rows(chain.energies, first, weights, chain.coefficients.reshape(chain.coefficients.size))
    weighted_rows(chain.eyelet_table, first, weights, chain.eyelets.reshape(chain.eyelets.size))
    weighted_rows(chain.lengths, first, weights, chain.inverse_length)
    for s in range(chain.inverse_length.shape[0]):
        chain.inverse_length[s] = 1.0 / chain.inverse_length[s]


@kernel
def advance_chain(
    rigid: RigidSide, servos: Servos, commands: ChainCommands, row: ChainSteps, ticks: Ticks, way: ChainMotion
) -> tuple[int, int, bool]:
    """Advance by as many ticks as the servos are asked for, or fewer.

    Returns:
        Ticks done, how it ended, whether the factor is kept.
    """
    flange, chain, kept = small_matrix(4, 3), row.chain, row.kept
    count = servos.position.shape[0]
    for k in range(count):
        if not rigid_half(rigid, servos, ticks, k):  # by its address it costs 1 % of a tick
            return k, RIGID_SIDE_WARNS, kept
        if k > 0 and commands.pressure[k] != commands.pressure[k - 1]:
            _set_pressure(chain, commands, k)
        fill_flange(ticks, k, flange)
        both = row.two_steps and (row.earlier or k > 0)
        if k == 1 and not row.earlier:  # the factor is of a step that looked back over one only
            kept = kept and not row.two_steps
        outcome, ticks.iterations[k], ticks.residual[k], kept = _implicit_step(
            chain.call,
            (
                way.motion[k + 1], way.motion[k], both, row.step_s, row.damping, FREE_FLIGHT, flange,
                chain.free, chain.offsets, chain.coefficients, chain.inverse_length, chain.mass, chain.load,
                chain.far, chain.eyelets, commands.tension[k], chain.touching, chain.rows, chain.widths,
                chain.target, chain.diagonal, chain.off, chain.low, chain.side, kept, chain.bounds,
                row.iterations_max, way.motion[k + 2], way.gradient[k], ticks.figures[k + 1],
            ),
        )  # fmt: skip
        if outcome != 0:
            return k, SOFT_HALF_LEFT, kept
        _hand_over(row.hand_over, (rigid.scene.applied, ticks, k))
    return count, ALL_DONE, kept
