"""Many ticks of arm and film in one kernel: what `StaggeredCoupling.tick` does, without Python in between.

Per tick: servos and the wrench of the tick before act while MuJoCo steps; the film then takes one step with
the flange's new pose (`film_step`) and returns the next wrench. A tick in which anything may be touched, the
flange turns far, or the factorisation that is kept does not serve, is left after its rigid half.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from cosim.base.frames import IntArray
from cosim.base.kernel_calls import address_of, caller
from cosim.base.kernels import VECTOR, device_function, kernel
from cosim.base.small_arrays import small_matrix, small_vector
from cosim.coupling.batch.batch_arrays import CARRIED, TICKS
from cosim.coupling.batch.film_rows import FILM_COMMANDS, FILM_MOTION, FILM_ROW
from cosim.coupling.batch.tick_halves import (
    ALL_DONE,
    RIGID_SIDE_WARNS,
    SOFT_STEP_LEFT,
    conclude_tick,
    fill_flange,
    take_rigid_half,
)
from cosim.reduced.sections.outputs import CENTER, fill_center_and_inertia
from cosim.rigid.distance.shapes import fill_near_box
from cosim.rigid.scene.native import NATIVE_SCENE
from cosim.soft.body.loads import PlainLoads
from cosim.soft.contact.point_kernels import span
from cosim.soft.elements.mass_terms import mass_moments
from cosim.soft.solve.film_step import film_step
from cosim.soft.solve.held_nodes import add_wrench
from cosim.soft.solve.step_arrays import StepMotion

_CALLED = (film_step, add_wrench, mass_moments, span, fill_near_box)
_STEP, _WRENCH, _MOMENTS, _SPAN, _NEAR = range(len(_CALLED))
_film_step, _add_wrench, _mass_moments, _span, _fill_near_box = map(caller, _CALLED)


def row_calls() -> IntArray:
    """Return the addresses (5,) of the kernels that a row of ticks calls."""
    return np.array([address_of(called) for called in _CALLED])


@device_function
def _may_touch(row, x, velocity):  # type: ignore[no-untyped-def]
    """Return whether a shape may come into the film's reach in a step, as `ContactExchange.find` asks."""
    bounds = row.reach.bounds
    for g in range(bounds.geoms.shape[0]):
        for r in range(3):
            bounds.position[g, r] = bounds.places[bounds.geoms[g], r]
            for c in range(3):
                bounds.rotation[g, r, c] = bounds.axes[bounds.geoms[g], 3 * r + c]
    if bounds.geoms.shape[0] == 0:
        return False
    low, high, fastest = small_vector(3), small_vector(3), small_vector(1)
    _span(row.calls[_SPAN], (x, velocity, low, high, fastest))
    reach = row.reach.rest_m + row.reach.ahead_s * math.sqrt(fastest[0])
    poses = bounds.kind, bounds.center, bounds.half, bounds.position, bounds.rotation
    return _fill_near_box(row.calls[_NEAR], (*poses, low, high, reach, bounds.near)) > 0


@device_function
def _turns_far(ticks, k, most):  # type: ignore[no-untyped-def]
    """Return whether the flange has turned by more than an angle [rad] in tick k."""
    trace = 0.0
    for r in range(3):
        for c in range(3):
            trace += ticks.axes[k, r, c] * ticks.axes[k + 1, r, c]
    return math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0)))) > most


@device_function
def _fill_figures(row, x, flange, moments, out):  # type: ignore[no-untyped-def]
    """Fill the figures (FIGURES,) of a film at the end of a step."""
    for r in range(CENTER):
        out[r] = 0.0
    side = row.side
    _add_wrench(row.calls[_WRENCH], (side.held, side.work.gradient, x, flange, out[:CENTER]))
    points = x.reshape((x.shape[0], 1, 3))
    total = _mass_moments(row.calls[_MOMENTS], (row.mass, points, moments))
    fill_center_and_inertia(total, moments, flange[0], out)


@kernel(
    types.Tuple((types.int64, types.int64))(
        types.int64, NATIVE_SCENE, CARRIED, VECTOR, FILM_COMMANDS, FILM_ROW, TICKS, FILM_MOTION
    )
)
def advance_film_ticks(  # type: ignore[no-untyped-def]
    count, scene, carried, mounted, commands, row, ticks, way
):
    """Advance by `count` ticks; return (ticks done, how it ended).

    carried: on the joints. mounted: (10,), parameters of a rigid mass on the flange, flange frame.
    """
    flange, moments = small_matrix(4, 3), small_vector(9)
    for k in range(count):
        if not take_rigid_half(scene, carried, mounted, row.total_kg, commands, ticks, k):
            return k, RIGID_SIDE_WARNS
        fill_flange(scene, flange)
        if _may_touch(row, way.x[k + 1], way.velocity[k + 1]) or _turns_far(ticks, k, row.largest_turn):
            return k, SOFT_STEP_LEFT
        loads = PlainLoads(commands.pressure[k], commands.tension[k], commands.gravity[k])
        motion = StepMotion(
            way.x[k + 1], way.velocity[k + 1], way.x[k], way.velocity[k], way.memory[k], flange,
            way.x[k + 2], way.velocity[k + 2], way.memory[k + 1],
        )  # fmt: skip
        converged, iterations, residual, _ = _film_step(
            row.calls[_STEP], (row.side, loads, row.untouched, motion, row.place)
        )
        if not converged:
            return k, SOFT_STEP_LEFT
        _fill_figures(row, way.x[k + 2], flange, moments, ticks.figures[k + 1])
        conclude_tick(scene, ticks, k, residual, iterations)
    return count, ALL_DONE
