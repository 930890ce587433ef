"""Kernels for the motion of bodies: their velocities, and their displacement from MuJoCo's poses to the end
of the tick.
"""

from typing import NamedTuple

from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_vector


class BodyMotions(NamedTuple):
    """Velocities of all bodies, in MuJoCo's arrays.

    Args:
        spin: (bodies, 6), angular then linear [1/s, m/s], at the centre of mass of the body's tree.
        tree: (bodies, 3) [m], centres of mass of the trees, world.
        root: (bodies,), index of the tree of each body.
        mass_center: (bodies, 3) [m], centres of mass, world.
        flange: index of the body with the flange.
    """

    spin: Matrix
    tree: Matrix
    root: Indices
    mass_center: Matrix
    flange: int


@device_function
def fill_speed(motions: BodyMotions, body: int, out: Vector) -> None:
    """Fill out (6,) with a body's velocity at the world's origin, then its angular velocity."""
    spin, center = motions.spin[body], motions.tree[motions.root[body]]
    for r in range(3):
        s, q = (r + 1) % 3, (r + 2) % 3
        out[r] = spin[3 + r] - (spin[s] * center[q] - spin[q] * center[s])
        out[3 + r] = spin[r]


@device_function
def led(lead: Vector, point: Vector, r: int) -> float:
    """Return component r of the displacement `lead` (6,) at a point."""
    s, q = (r + 1) % 3, (r + 2) % 3
    return lead[r] + lead[3 + s] * point[q] - lead[3 + q] * point[s]


@kernel
def add_way(motions: BodyMotions, ahead: Indices, of: int, time_s: float, lead: Matrix) -> None:
    """Add displacements of bodies relative to the flange to `lead`, at constant velocity.

    Args:
        motions: velocities.
        ahead: (bodies,), see `PosePrediction`.
        of: only bodies with this value of `ahead` count.
        time_s: duration [s].
        lead: (bodies, 6), result: translation at the world's origin [m], then rotation [rad].
    """
    now, flange = small_vector(6), small_vector(6)
    fill_speed(motions, motions.flange, flange)
    for b in range(ahead.shape[0]):
        if ahead[b] == of:
            fill_speed(motions, b, now)
            for r in range(6):
                lead[b, r] += time_s * (now[r] - flange[r])
