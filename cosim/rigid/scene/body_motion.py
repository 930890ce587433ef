"""Kernels for the motion of bodies: their velocities, and their displacement from MuJoCo's poses to the end
of the tick.
"""

from typing import NamedTuple

from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector


class BodyMotions(NamedTuple):
    """Velocities of all bodies; MuJoCo's arrays.

    Args:
        spin: (bodies, 6), angular then linear [1/s, m/s], each at its tree's centre of mass.
        tree: (bodies, 3) [m], these centres of all trees, world.
        root: (bodies,), the tree of each body.
        mass_center: (bodies, 3) [m], centres of mass, world.
        flange: body that goes with it.
    """

    spin: Matrix
    tree: Matrix
    root: Indices
    mass_center: Matrix
    flange: int


@device_function
def fill_speed(motions: BodyMotions, body: int, out: Vector) -> None:
    """Fill out (6,) with a body's velocity at the world's origin, then its angular velocity."""
    spin, place = motions.spin[body], motions.tree[motions.root[body]]
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        out[r] = spin[3 + r] - (spin[s] * place[q] - spin[q] * place[s])
        out[3 + r] = spin[r]


@device_function
def led(lead: Vector, place: Vector, r: int) -> float:
    """Return component r of a lead at a place."""
    s, q = (r + 1) % 3, (r + 2) % 3
    return lead[r] + lead[3 + s] * place[q] - lead[3 + q] * place[s]


@kernel
def add_way(motions: BodyMotions, ahead: Indices, of: int, time_s: float, lead: Matrix) -> None:
    """Add to leads (bodies, 6) of bodies the way that they go in a time, seen from the flange.

    Args:
        motions: velocities.
        ahead: (bodies,), of which those count that are `of`.
        of: value.
        time_s: the time [s].
        lead: added to: translation at the world's origin [m], then turn [rad].
    """
    now, flange = small_vector(6), small_vector(6)
    fill_speed(motions, motions.flange, flange)
    for b in range(ahead.shape[0]):
        if ahead[b] == of:
            fill_speed(motions, b, now)
            for r in range(6):
                lead[b, r] += time_s * (now[r] - flange[r])
