"""Many ticks of arm and chain in one kernel: what `StaggeredCoupling.tick` does, without Python in between.

Per tick: servos and the wrench of the tick before act while MuJoCo steps; the chain then takes one implicit
step with the flange's new pose and returns the next wrench.
"""

from __future__ import annotations

from numba import types

from cosim.base.kernels import BOOLEAN, REAL, VECTOR, device_function, kernel, small_matrix
from cosim.base.numba_insides import caller
from cosim.coupling.batch.batch_arrays import CARRIED, CHAIN_MOTION, COMMANDS, TICKS
from cosim.coupling.batch.tick_halves import (
    ALL_DONE,
    RIGID_SIDE_WARNS,
    SOFT_STEP_LEFT,
    conclude_tick,
    fill_flange,
    take_rigid_half,
)
from cosim.reduced.sections.pressure_spline import weighted_rows
from cosim.reduced.solve.arrays import CHAIN_ARRAYS
from cosim.reduced.solve.implicit_step import FREE_FLIGHT, implicit_step
from cosim.rigid.scene.native import NATIVE_SCENE

_implicit_step = caller(implicit_step)


@device_function
def _set_pressure(chain, commands, k):  # type: ignore[no-untyped-def]
    """Bring sections and eyelets to the pressure of tick k."""
    first, weights = commands.first[k], commands.weights[k]
    weighted_rows(chain.energies, first, weights, chain.coefficients.reshape(chain.coefficients.size))
    weighted_rows(chain.eyelet_table, first, weights, chain.eyelets.reshape(chain.eyelets.size))
    weighted_rows(chain.lengths, first, weights, chain.inverse_length)
    for s in range(chain.inverse_length.shape[0]):
        chain.inverse_length[s] = 1.0 / chain.inverse_length[s]


@kernel(
    types.Tuple((types.int64, types.int64, types.boolean))(
        types.int64, NATIVE_SCENE, CARRIED, VECTOR, REAL, COMMANDS, CHAIN_ARRAYS, TICKS, CHAIN_MOTION, REAL,
        REAL, BOOLEAN, BOOLEAN, BOOLEAN, types.int64,
    )
)  # fmt: skip
def advance_ticks(  # type: ignore[no-untyped-def]
    count, scene, carried, mounted, mass, commands, chain, ticks, way, h, damping, two_steps, earlier, kept,
    iterations_max,
):  # fmt: skip
    """Advance by `count` ticks of h [s]; return (ticks done, how it ended, whether the factor is kept).

    carried: on the joints. mounted: (10,), parameters of a rigid mass on the flange, flange frame. mass [kg]:
    of the chain. earlier: whether the first row
    of the motion holds the step before the last. A soft step that does not converge in one go is left.
    """
    flange = small_matrix(4, 3)
    for k in range(count):
        if not take_rigid_half(scene, carried, mounted, mass, commands, ticks, k):
            return k, RIGID_SIDE_WARNS, kept
        if k > 0 and commands.pressure[k] != commands.pressure[k - 1]:
            _set_pressure(chain, commands, k)
        fill_flange(scene, flange)
        both = two_steps and (earlier or k > 0)
        if k == 1 and not earlier:  # the factor is of a step that looked back over one only
            kept = kept and not two_steps
        outcome, iterations, residual, kept = _implicit_step(
            chain.call,
            (
                way.motion[k + 1], way.motion[k], both, h, damping, FREE_FLIGHT, flange, chain.free,
                chain.offsets, chain.coefficients, chain.inverse_length, chain.mass, chain.load, chain.far,
                chain.eyelets, commands.tension[k], chain.touching, chain.rows, chain.widths, chain.target,
                chain.diagonal, chain.off, chain.low, chain.side, kept, chain.bounds, iterations_max,
                way.motion[k + 2], way.gradient[k], ticks.figures[k + 1],
            ),
        )  # fmt: skip
        if outcome != 0:
            return k, SOFT_STEP_LEFT, kept
        conclude_tick(scene, ticks, k, residual, iterations)
    return count, ALL_DONE, kept
