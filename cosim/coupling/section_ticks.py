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

from cosim.base.kernels import Blocks, Indices, Matrix, Vector, kernel, small_matrix
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
from cosim.reduced.solve.chain_step import FREE_FLIGHT, ChainEnds, ChainScheme, ChainSide, solve_chain


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


class ChainTables(NamedTuple):
    """What changes with the pressure, over its spline.

    Args:
        energies: (size, s c).
        lengths: (size, s).
        eyelets: (size, 6 k).
    """

    energies: Matrix
    lengths: Matrix
    eyelets: Matrix


class ChainSteps(NamedTuple):
    """What all ticks in a row have in common.

    Args:
        side: the chain in the first of them.
        tables: over the spline of pressure.
        solve: address of the kernel of a step.
        hand_over: address of that kernel.
        scheme: of the steps.
        two_steps: whether steps look back over two.
        earlier: whether the first row of the motion holds the step before the last.
        kept: whether the factor is used for the first of them.
    """

    side: ChainSide
    tables: ChainTables
    solve: int
    hand_over: int
    scheme: ChainScheme
    two_steps: bool
    earlier: bool
    kept: bool


_hand_over, _solve_chain = caller(hand_over), caller(solve_chain)


@kernel
def advance_chain(
    rigid: RigidSide, servos: Servos, commands: ChainCommands, row: ChainSteps, ticks: Ticks, way: ChainMotion
) -> tuple[int, int, bool]:
    """Advance by as many ticks as the servos are asked for, or fewer.

    Returns:
        Ticks done, how it ended, whether the factor is kept.
    """
    flange, kept, chain, tables = small_matrix(4, 3), row.kept, row.side.chain, row.tables
    count = servos.position.shape[0]
    for k in range(count):
        if not rigid_half(rigid, servos, ticks, k):  # by its address it costs 1 % of a tick
            return k, RIGID_SIDE_WARNS, kept
        for i in range(chain.tension.shape[0]):
            chain.tension[i] = commands.tension[k, i]
        if k > 0 and commands.pressure[k] != commands.pressure[k - 1]:
            first, weights = commands.first[k], commands.weights[k]
            weighted_rows(tables.energies, first, weights, chain.coefficients.reshape(-1))
            weighted_rows(tables.eyelets, first, weights, chain.eyelets.reshape(-1))
            weighted_rows(tables.lengths, first, weights, chain.inverse_length)
            for s in range(chain.inverse_length.shape[0]):
                chain.inverse_length[s] = 1.0 / chain.inverse_length[s]
        fill_flange(ticks, k, flange)
        both = row.two_steps and (row.earlier or k > 0)
        if k == 1 and not row.earlier:  # the factor is of a step that looked back over one only
            kept = kept and not row.two_steps
        ends = ChainEnds(
            way.motion[k + 1], way.motion[k], flange, way.motion[k + 2], way.gradient[k], ticks.figures[k + 1]
        )
        outcome, ticks.iterations[k], ticks.residual[k], kept, _, _ = _solve_chain(
            row.solve, (row.side, row.scheme, ends, FREE_FLIGHT, both, kept)
        )
        if outcome != 0:
            return k, SOFT_HALF_LEFT, kept
        _hand_over(row.hand_over, (rigid.scene.applied, ticks, k))
    return count, ALL_DONE, kept
