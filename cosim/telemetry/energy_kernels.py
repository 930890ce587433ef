"""Compiled sums of the energy balance: motion of the masses, works of gas, cables and flange."""

from typing import Any, NamedTuple

import numpy as np

from cosim.base.kernel_types import Blocks, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel
from cosim.telemetry.energy_figures import KINETIC

DONE, DAMPED, DRAGGED, FALLING, RESISTED, COLUMNS = range(KINETIC + 1, KINETIC + 7)
"""Indices of the sums of a tick after the kinetic energy, and their number."""
_THIRD, _FOUR_THIRDS = 1.0 / 3.0, 4.0 / 3.0


class Pace(NamedTuple):
    """Steps of the integrator.

    Args:
        two_steps: whether it uses the last two steps.
        h: their length [s].
        before: number of steps before.
        gravity: (3,) [m/s^2].
    """

    two_steps: bool
    h: float
    before: int
    gravity: Vector


@kernel(reorder_sums=True)
def fill_motion(
    x: Blocks, mass: Vector, twist: Matrix, origin: Matrix, pace: Pace, motion: Blocks, out: Matrix
) -> None:
    """Fill the sums of k ticks, and update the motion to the end of the last tick.

    Args:
        x: (k, n, 3) [m].
        mass: (n,) [kg].
        twist: (k, 6), of the flange, linear and angular, world axes.
        origin: (k, 3) [m], of the flange.
        pace: of the ticks.
        motion: (6, n, 3), positions one and two ticks before, velocities one and two ticks before,
            accelerations and velocities of points fixed to the flange one tick before.
        out: (k, COLUMNS), filled except the last: kinetic energy [J], work of all forces in the tick [J],
            work against the velocities relative to the flange, and against the velocities, of forces of
            1 N s/m per kilogram [J s], work of the weight in the tick [J], power lost in materials [W].
    """
    for t in range(x.shape[0]):
        both = pace.two_steps and pace.before + t > 0
        per_s = (1.5 if both else 1.0) / pace.h  # divisions would take half of the time
        kinetic = done = damped = dragged = falling = 0.0
        for i in range(x.shape[1]):
            for r in range(3):
                j, k = (r + 1) % 3, (r + 2) % 3
                base, speed = motion[0, i, r], motion[2, i, r]
                if both:
                    base = _FOUR_THIRDS * base - _THIRD * motion[1, i, r]
                    speed = _FOUR_THIRDS * speed - _THIRD * motion[3, i, r]
                v = (x[t, i, r] - base) * per_s
                a = (v - speed) * per_s
                u = twist[t, r] + twist[t, 3 + j] * (x[t, i, k] - origin[t, k])
                u -= twist[t, 3 + k] * (x[t, i, j] - origin[t, j])
                went, along = x[t, i, r] - motion[0, i, r], motion[5, i, r]
                kinetic += 0.5 * mass[i] * v * v
                done += 0.5 * mass[i] * (a + motion[4, i, r]) * went
                # mean of both ends, as for all other forces: in a hit velocities jump from tick to tick
                mean = 0.5 * (v + motion[2, i, r])
                damped += mass[i] * (mean - 0.5 * (u + along)) * (went - 0.5 * pace.h * (u + along))
                dragged += mass[i] * mean * went
                falling += mass[i] * pace.gravity[r] * went
                motion[1, i, r], motion[0, i, r] = motion[0, i, r], x[t, i, r]
                motion[3, i, r], motion[2, i, r], motion[4, i, r] = motion[2, i, r], v, a
                motion[5, i, r] = u
        out[t, 0], out[t, 1], out[t, 2], out[t, 3], out[t, 4] = kinetic, done, damped, dragged, falling


class Routes(NamedTuple):
    """Routes of cables.

    Args:
        segments: (s, 2), nodes of all segments.
        cable: (s,), index of each segment's cable.
        lost: (k, s), tension lost in each segment after each tick, over that at the base end.
        length: (s,) [m], before each tick.
    """

    segments: IndexTable
    cable: Indices
    lost: Matrix
    length: Vector


@device_function
def _pull(x: Matrix, routes: Any, lost_ratio: Vector, tension: Vector) -> tuple[float, float, float]:
    """Return the work of cables in a tick, its part lost at eyelets, and energy that eyelets make.

    Lengths are updated to the tick's end.
    """
    put_in, lost, made, length, slid = 0.0, 0.0, 0.0, routes.length, 0.0
    for s in range(length.shape[0] - 1, -1, -1):
        square = 0.0
        for r in range(3):
            along = x[routes.segments[s, 1], r] - x[routes.segments[s, 0], r]
            square += along * along
        now = np.sqrt(square)
        work = tension[routes.cable[s]] * (length[s] - now)
        put_in, lost, length[s] = put_in + work, lost + lost_ratio[s] * work, now
        slid += work  # of all segments after the eyelet at the segment's begin, by the tension
        first = s == 0 or routes.cable[s - 1] != routes.cable[s]
        made -= min(0.0, (lost_ratio[s] - (0.0 if first else lost_ratio[s - 1])) * slid)
        slid = 0.0 if first else slid
    return put_in, lost, made


@device_function
def _carry(wrench: Vector, pose: Vector, before: Vector) -> float:
    """Return the work of the flange in a tick, by poses of a position and nine axes, for a small rotation."""
    work = 0.0
    for r in range(3):
        j, k, turn = 3 * ((r + 1) % 3), 3 * ((r + 2) % 3), 0.0
        for c in range(3, 6):
            turn += 0.5 * (pose[k + c] * before[j + c] - pose[j + c] * before[k + c])
        work -= wrench[r] * (pose[r] - before[r]) + wrench[3 + r] * turn
    return work


@kernel
def fill_works(x: Blocks, routes: Routes, rows: Matrix, mean: Matrix, chambers: int, out: Matrix) -> None:
    """Fill the works [J] of gas, cables and flange, and energies of eyelets, in each tick.

    Args:
        x: (k, n, 3) [m].
        routes: of the cables; lengths are updated to the end.
        rows: (k + 1, columns), see `EnergyRow`, the first one before the ticks.
        mean: (k, columns), of successive rows.
        chambers: number of chambers.
        out: (k, works), the first four and the last filled.
    """
    pose = rows.shape[1] - 12
    for t in range(x.shape[0]):
        now, before, between, gas = rows[t + 1], rows[t], mean[t], 0.0
        for c in range(chambers):
            gas += between[chambers + c] * (now[c] - before[c])
        cables, lost, made = _pull(x[t], routes, routes.lost[t], between[2 * chambers : pose - 6])
        out[t, 0], out[t, 1], out[t, 3], out[t, out.shape[1] - 1] = gas, cables, lost, made
        out[t, 2] = _carry(between[pose - 6 : pose], now[pose:], before[pose:])
