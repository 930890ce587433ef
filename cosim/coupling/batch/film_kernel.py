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
from cosim.base.kernels import VECTOR, address_of, device_function, kernel, small_matrix, small_vector
from cosim.base.numba_insides import caller
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


@device_function
def _find(reach, contact, calls, x, velocity):  # type: ignore[no-untyped-def]
    """Fill what the film may touch in a step, as `ContactExchange.find` does; see `find_touched`."""
    bounds = reach.bounds
    for g in range(bounds.geoms.shape[0]):
        for r in range(3):
            bounds.position[g, r] = bounds.places[bounds.geoms[g], r]
            for c in range(3):
                bounds.rotation[g, r, c] = bounds.axes[bounds.geoms[g], 3 * r + c]
    if bounds.geoms.shape[0] == 0:
        return 0
    low, high, fastest = small_vector(3), small_vector(3), small_vector(1)
    _span(calls[_SPAN], (x, velocity, low, high, fastest))
    contact.speed[0] = math.sqrt(fastest[0])
    distance = reach.rest_m + reach.ahead_s * contact.speed[0]
    poses = bounds.kind, bounds.center, bounds.half, bounds.position, bounds.rotation
    near = _fill_near_box(calls[_NEAR], (*poses, low, high, distance, bounds.near))
    return find_touched(contact, x, low, high, bounds.near[:near], distance)


@device_function
def _turns_far(ticks, k, most):  # type: ignore[no-untyped-def]
    """Return whether the flange has turned by more than an angle [rad] in tick k."""
    trace = 0.0
    for r in range(3):
        for c in range(3):
            trace += ticks.axes[k, r, c] * ticks.axes[k + 1, r, c]
    return math.acos(min(1.0, max(-1.0, 0.5 * (trace - 1.0)))) > most


@device_function
def _fill_figures(held, gradient, calls, mass, x, flange, moments, out):  # type: ignore[no-untyped-def]
    """Fill the figures (FIGURES,) of a film at the end of a step."""
    for r in range(CENTER):
        out[r] = 0.0
    _add_wrench(calls[_WRENCH], (held, gradient, x, flange, out[:CENTER]))
    points = x.reshape((x.shape[0], 1, 3))
    total = _mass_moments(calls[_MOMENTS], (mass, points, moments))
    fill_center_and_inertia(total, moments, flange[0], out)


@device_function
def _take_soft_step(found, commands, row, ticks, way, k, flange):  # type: ignore[no-untyped-def]
    """Take the film's step of tick k; return whether it has converged."""
    touched = touched_planes(row.contact.touched, found)
    touching = Touching(touched, row.untouched.call, row.untouched.pairs)
    loads = PlainLoads(commands.pressure[k], commands.tension[k], commands.gravity[k])
    motion = StepMotion(
        way.x[k + 1], way.velocity[k + 1], way.x[k], way.velocity[k], way.memory[k], flange,
        way.x[k + 2], way.velocity[k + 2], way.memory[k + 1],
    )  # fmt: skip
    place = row.place if found == 0 else row.touching_place
    given = row.side, loads, touching, motion, place
    converged, iterations, tangents, residual, _ = _film_step(row.calls[_STEP], given)
    ticks.residual[k], ticks.iterations[k] = residual, iterations + (tangents if converged else 0)
    return converged


@device_function
def _take_tick(scene, carried, mounted, commands, row, ticks, way, k, flange, moments):  # type: ignore[no-untyped-def]
    """Take tick k; return how it ended, -1 if the next one may follow."""
    on_bodies = momentum_error_of_bodies(
        row.contact.applied, row.contact.centers, row.contact.loaded, row.contact.handed
    )
    if not take_rigid_half(scene, carried, mounted, row.total_kg, commands, ticks, k):
        return RIGID_SIDE_WARNS
    ticks.momentum_error[k] = max(ticks.momentum_error[k], on_bodies)
    fill_flange(scene, flange)
    found = _find(row.reach, row.contact, row.calls, way.x[k + 1], way.velocity[k + 1])
    if found < 0 or _turns_far(ticks, k, row.largest_turn):
        return SOFT_STEP_LEFT
    if not _take_soft_step(found, commands, row, ticks, way, k, flange):
        return SOFT_STEP_BEGUN
    acting = row.side.held, row.side.work.gradient
    _fill_figures(*acting, row.calls, row.mass, way.x[k + 2], flange, moments, ticks.figures[k + 1])
    conclude_tick(scene, ticks, k, ticks.residual[k], ticks.iterations[k])
    if found > 0:
        settle_touched(row.contact, found, way.x[k + 2], ticks, k)
        if row.contact.counts[ASKS]:
            return ALL_DONE
    return -1


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
        ended = _take_tick(scene, carried, mounted, commands, row, ticks, way, k, flange, moments)
        if ended >= 0:
            return k + (ended == ALL_DONE), ended
    return count, ALL_DONE
