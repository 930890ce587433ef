"""Many ticks of arm and film in one kernel: what `StaggeredCoupling.tick` does, without Python in between.

Per tick: servos and the wrench of the tick before act while MuJoCo steps; the film then takes one step with
the flange's new pose (`film_step`) and what it may touch, and returns the next wrench, and loads on bodies. A
tick is left after its rigid half in which the lists of what is near do not serve, or the flange turns far,
and in its soft step where a tangent is indefinite; a row ends after one with which bodies are to be weighed.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types

from cosim.base.frames import IntArray
from cosim.base.kernel_calls import address_of, caller
from cosim.base.kernels import VECTOR, allocating, device_function, kernel
from cosim.base.small_arrays import small_matrix, small_vector
from cosim.coupling.batch.batch_arrays import CARRIED, TICKS
from cosim.coupling.batch.contact_halves import (
    find_touched,
    momentum_error_of_bodies,
    settle_touched,
    touched_planes,
)
from cosim.coupling.batch.contact_rows import ASKS
from cosim.coupling.batch.film_rows import FILM_COMMANDS, FILM_MOTION, FILM_ROW
from cosim.coupling.batch.tick_halves import (
    ALL_DONE,
    RIGID_SIDE_WARNS,
    SOFT_STEP_BEGUN,
    SOFT_STEP_LEFT,
    conclude_tick,
    fill_flange,
    take_rigid_half,
)
from cosim.reduced.sections.outputs import CENTER, fill_center_and_inertia
from cosim.rigid.distance.shapes import fill_near_box
from cosim.rigid.scene.native import NATIVE_SCENE
from cosim.soft.body.loads import PlainLoads, Touching
from cosim.soft.contact.point_kernels import span
from cosim.soft.elements.mass_terms import mass_moments
from cosim.soft.film.step_arrays import StepMotion
from cosim.soft.solve.film_step import film_step
from cosim.soft.solve.held_nodes import add_wrench

_CALLED = (film_step, add_wrench, mass_moments, span, fill_near_box)
_STEP, _WRENCH, _MOMENTS, _SPAN, _NEAR = range(len(_CALLED))
_film_step, _add_wrench, _mass_moments, _span, _fill_near_box = map(caller, _CALLED)


def row_calls() -> IntArray:
    """Return the addresses (5,) of the kernels that a row of ticks calls."""
    return np.array([address_of(called) for called in _CALLED])


@allocating
def _find(row, x, velocity):  # type: ignore[no-untyped-def]
    """Fill what the film may touch in a step, as `ContactExchange.find` does; see `find_touched`."""
    bounds = row.reach.bounds
    for g in range(bounds.geoms.shape[0]):
        for r in range(3):
            bounds.position[g, r] = bounds.places[bounds.geoms[g], r]
            for c in range(3):
                bounds.rotation[g, r, c] = bounds.axes[bounds.geoms[g], 3 * r + c]
    if bounds.geoms.shape[0] == 0:
        return 0
    low, high, fastest = small_vector(3), small_vector(3), small_vector(1)
    _span(row.calls[_SPAN], (x, velocity, low, high, fastest))
    row.contact.speed[0] = math.sqrt(fastest[0])
    reach = row.reach.rest_m + row.reach.ahead_s * row.contact.speed[0]
    poses = bounds.kind, bounds.center, bounds.half, bounds.position, bounds.rotation
    near = _fill_near_box(row.calls[_NEAR], (*poses, low, high, reach, bounds.near))
    return find_touched(row.contact, x, low, high, bounds.near[:near], reach)


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
    ),
    allocates=True,
)
def advance_film_ticks(  # type: ignore[no-untyped-def]
    count, scene, carried, mounted, commands, row, ticks, way
):
    """Advance by `count` ticks; return (ticks done, how it ended).

    carried: on the joints. mounted: (10,), parameters of a rigid mass on the flange, flange frame.
    """
    flange, moments = small_matrix(4, 3), small_vector(9)
    contact, nothing = row.contact, row.untouched
    for k in range(count):
        on_bodies = momentum_error_of_bodies(contact)
        if not take_rigid_half(scene, carried, mounted, row.total_kg, commands, ticks, k):
            return k, RIGID_SIDE_WARNS
        ticks.momentum_error[k] = max(ticks.momentum_error[k], on_bodies)
        fill_flange(scene, flange)
        found = _find(row, way.x[k + 1], way.velocity[k + 1])
        if found < 0 or _turns_far(ticks, k, row.largest_turn):
            return k, SOFT_STEP_LEFT
        touching = Touching(touched_planes(contact.touched, found), nothing.call, nothing.pairs)
        loads = PlainLoads(commands.pressure[k], commands.tension[k], commands.gravity[k])
        motion = StepMotion(
            way.x[k + 1], way.velocity[k + 1], way.x[k], way.velocity[k], way.memory[k], flange,
            way.x[k + 2], way.velocity[k + 2], way.memory[k + 1],
        )  # fmt: skip
        place = row.place if found == 0 else row.touching_place
        converged, iterations, tangents, residual, _ = _film_step(
            row.calls[_STEP], (row.side, loads, touching, motion, place)
        )
        if not converged:
            ticks.residual[k], ticks.iterations[k] = residual, iterations
            return k, SOFT_STEP_BEGUN
        iterations += tangents
        _fill_figures(row, way.x[k + 2], flange, moments, ticks.figures[k + 1])
        conclude_tick(scene, ticks, k, residual, iterations)
        if found > 0:
            settle_touched(contact, found, way.x[k + 2], ticks, k)
            if contact.counts[ASKS]:
                return k + 1, ALL_DONE
    return count, ALL_DONE
