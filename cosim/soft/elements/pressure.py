"""Gas pressure on the film and its caps: energy -p V at a commanded pressure, or U(V) of a sealed gas.

V = sum over triangles of a . (b x c) / 6. A cap closes a hole ring by a fan to the ring's mean point c,
which is not a node:  V_cap = c . sum_i (r_i x r_i+1) / 6.
In a closed chamber the follower pressure is conservative and its stiffness symmetric. An open chamber (the
paper's model) has no cap force, and its load has no energy. `add_cap_force` subtracts the forces of the caps,
so that each film node carries a third of its triangles' p A. `GasChambers` holds the enclosures of a body and
the stiffness terms of its missing caps; `FilmPotential` adds the potential of the gas.
"""

from collections.abc import Iterable, Sequence
from typing import final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Cubes, IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel, small_matrix, small_vector
from cosim.soft.linear.pattern import add_block


@device_function
def _cross_block(v: Vector, factor: float, out: Matrix) -> None:
    """Fill out with factor * S(v), S(v) b = v x b."""
    out[0, 0] = out[1, 1] = out[2, 2] = 0.0
    out[0, 1] = -factor * v[2]
    out[0, 2] = factor * v[1]
    out[1, 0] = factor * v[2]
    out[1, 2] = -factor * v[0]
    out[2, 0] = -factor * v[1]
    out[2, 1] = factor * v[0]


@device_function
def _cross(v: tuple[float, float, float], w: tuple[float, float, float]) -> tuple[float, float, float]:
    return v[1] * w[2] - v[2] * w[1], v[2] * w[0] - v[0] * w[2], v[0] * w[1] - v[1] * w[0]


@kernel
def add_pressure(
    x: Matrix, triangles: IndexTable, pressure: float, slots: IndexTable, gradient: Matrix, blocks: Blocks
) -> float:
    """Add -p V of all film triangles to gradient, and to blocks if slots is not empty.

    Returns the triangles' contribution to V [m^3].
    """
    k = small_matrix(3, 3)
    with_hessian = slots.shape[0] > 0
    sixth = pressure / 6.0
    volume = 0.0
    for e in range(triangles.shape[0]):
        ia, ib, ic = triangles[e, 0], triangles[e, 1], triangles[e, 2]
        # read before anything is written: x and gradient could be one for all that the compiler knows
        a, b, c = (
            (x[ia, 0], x[ia, 1], x[ia, 2]),
            (x[ib, 0], x[ib, 1], x[ib, 2]),
            (x[ic, 0], x[ic, 1], x[ic, 2]),
        )
        bc, ca, ab = _cross(b, c), _cross(c, a), _cross(a, b)
        for r in range(3):
            volume += a[r] * bc[r]
            gradient[ia, r] -= sixth * bc[r]
            gradient[ib, r] -= sixth * ca[r]
            gradient[ic, r] -= sixth * ab[r]
        if with_hessian:
            # d(b x c)/db = -S(c), d(c x a)/dc = -S(a), d(b x c)/dc = S(b)
            _cross_block(x[ic], -sixth, k)  # pair (b, a)
            add_block(blocks, slots[e, 1], k)
            _cross_block(x[ib], sixth, k)  # pair (c, a)
            add_block(blocks, slots[e, 3], k)
            _cross_block(x[ia], -sixth, k)  # pair (c, b)
            add_block(blocks, slots[e, 4], k)
    return volume / 6.0


@kernel
def fill_volumes(shapes: Blocks, triangles: IndexTable, rings: Indices, starts: Indices, out: Vector) -> None:
    """Fill V (k,) [m^3] alone of shapes (k, n, 3) [m]; cap c is rings[starts[c] : starts[c + 1]]."""
    total, area = small_vector(3), small_vector(3)
    for k in range(shapes.shape[0]):
        x, film = shapes[k], 0.0
        for e in range(triangles.shape[0]):
            ia, ib, ic = triangles[e, 0], triangles[e, 1], triangles[e, 2]
            for r in range(3):
                s, t = (r + 1) % 3, (r + 2) % 3
                film += x[ia, r] * (x[ib, s] * x[ic, t] - x[ib, t] * x[ic, s])
        out[k] = film / 6.0
        for c in range(starts.shape[0] - 1):
            out[k] += _cap_volume(x, rings[starts[c] : starts[c + 1]], total, area)


@device_function
def _cap_volume(x: Matrix, ring: Indices, total: Vector, area: Vector) -> float:
    """Return a cap's part of V [m^3]; fill in the sums of r_i and of r_i x r_i+1."""
    count = ring.shape[0]
    total[:] = 0.0
    area[:] = 0.0
    for i in range(count):
        a, b = ring[i], ring[(i + 1) % count]
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            total[r] += x[a, r]
            area[r] += x[a, s] * x[b, t] - x[a, t] * x[b, s]
    return (total[0] * area[0] + total[1] * area[1] + total[2] * area[2]) / (6.0 * count)


@kernel
def add_cap(
    x: Matrix, ring: Indices, pressure: float, slots: Indices, gradient: Matrix, blocks: Blocks
) -> float:
    """Add the gradient of -p V of one cap to gradient, its Hessian to blocks if slots is not empty.

    Returns the cap's part of V [m^3].
    """
    count = ring.shape[0]
    with_hessian = slots.shape[0] > 0
    factor = pressure / (6.0 * count)
    total, area = small_vector(3), small_vector(3)
    k = small_matrix(3, 3)
    difference = small_vector(3)
    volume = _cap_volume(x, ring, total, area)
    for i in range(count):
        before, after = ring[(i - 1) % count], ring[(i + 1) % count]
        for r in range(3):
            difference[r] = x[after, r] - x[before, r]
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            # d(total . area)/dr_i = area + (r_i+1 - r_i-1) x total
            gradient[ring[i], r] -= factor * (area[r] + difference[s] * total[t] - difference[t] * total[s])
    pair = 0
    for a in range(count if with_hessian else 0):  # ring nodes are coupled pairwise
        for b in range(a + 1):
            # rows a, columns b of d/dr_b [area + (r_a+1 - r_a-1) x total]
            for r in range(3):
                da = x[ring[(a + 1) % count], r] - x[ring[(a - 1) % count], r]
                db = x[ring[(b + 1) % count], r] - x[ring[(b - 1) % count], r]
                difference[r] = da - db
                if b == (a + 1) % count:
                    difference[r] -= total[r]
                if b == (a - 1) % count:
                    difference[r] += total[r]
            _cross_block(difference, -factor, k)
            add_block(blocks, slots[pair], k)
            pair += 1
    return volume


@kernel
def add_cap_force(x: Matrix, ring: Indices, pressure: float, gradient: Matrix) -> None:
    """Add the pressure force [N] that a cap would put on its ring to the rows of the ring in gradient.

    Each fan triangle (c, r_i, r_i+1) gives a third of its p A to each corner; that of c is spread evenly.

    Args:
        x: (n, 3) [m].
        ring: (k,) nodes, ordered so that the fan's normal points out of the gas.
        pressure: gauge [Pa].
        gradient: (n, 3) [N].
    """
    count = ring.shape[0]
    mean, total = small_vector(3), small_vector(3)
    for r in range(3):
        mean[r] = total[r] = 0.0
        for i in range(count):
            mean[r] += x[ring[i], r]
        mean[r] /= count
    for i in range(count):
        a, b = ring[i], ring[(i + 1) % count]
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            first, second = (x[a, s] - mean[s], x[a, t] - mean[t]), (x[b, s] - mean[s], x[b, t] - mean[t])
            force = pressure / 6.0 * (first[0] * second[1] - first[1] * second[0])
            gradient[a, r] += force
            gradient[b, r] += force
            total[r] += force
    for i in range(count):
        for r in range(3):
            gradient[ring[i], r] += total[r] / count


@kernel
def add_cap_stiffness(x: Matrix, ring: Indices, pressure: float, out: Cubes) -> None:
    """Add the derivative (k, k, 3, 3) [N/m] of `add_cap_force` by the ring's nodes, not symmetric."""
    count = ring.shape[0]
    mean, first_cross, second_cross = small_vector(3), small_matrix(3, 3), small_matrix(3, 3)
    first, second = small_vector(3), small_vector(3)
    for r in range(3):
        mean[r] = 0.0
        for i in range(count):
            mean[r] += x[ring[i], r] / count
    for i in range(count):
        following = (i + 1) % count
        for r in range(3):
            first[r], second[r] = x[ring[i], r] - mean[r], x[ring[following], r] - mean[r]
        _cross_block(first, pressure / 6.0, first_cross)
        _cross_block(second, pressure / 6.0, second_cross)
        for t in range(count):
            # the thirds at a triangle's corners act there; that at the mean point is divided among all nodes
            weight = 1.0 / count + (1.0 if t in (i, following) else 0.0)
            for r in range(3):
                for c in range(3):
                    out[t, i, r, c] -= weight * second_cross[r, c]
                    out[t, following, r, c] += weight * first_cross[r, c]
                    for b in range(count):
                        out[t, b, r, c] += weight * (second_cross[r, c] - first_cross[r, c]) / count


def cap_stiffness(positions: Array, ring: IntArray, pressure_Pa: float) -> Array:
    """Return the derivative (3 k, 3 k) [N/m] of the gradient from `add_cap_force`, not symmetric.

    Args:
        positions: (n, 3) [m].
        ring: (k,) nodes.
        pressure_Pa: gauge pressure.
    """
    stiffness, size = np.zeros((len(ring), len(ring), 3, 3)), 3 * len(ring)
    add_cap_stiffness(np.ascontiguousarray(positions), ring, pressure_Pa, stiffness)
    return stiffness.transpose(0, 2, 1, 3).reshape(size, size)


@final
class GasChambers:
    """Film triangles and caps of each chamber.

    Args:
        enclosures: film triangles (t, 3) and caps of each chamber.
    """

    def __init__(self, enclosures: Iterable[tuple[IntArray, Sequence[IntArray]]]) -> None:
        no_nodes = np.zeros(0, np.int64)
        self._chambers = [
            (
                np.ascontiguousarray(triangles),
                np.concatenate([no_nodes, *caps]),
                np.cumsum([0, *map(len, caps)]),
                caps,
            )
            for triangles, caps in enclosures
        ]
        self.count = len(self._chambers)

    def enclosed_volumes(self, shapes: Array) -> Array:
        """Return the volume (k, chambers) [m^3] of each chamber in shapes (k, n, 3) [m]."""
        volumes = np.empty((self.count, len(shapes)))
        for (triangles, rings, starts, _), chamber_volumes in zip(self._chambers, volumes, strict=True):
            fill_volumes(shapes, triangles, rings, starts, chamber_volumes)
        return volumes.T.copy()

    def open_cap_stiffness(self, positions: Array, pressures_Pa: Array) -> list[tuple[IntArray, Array]]:
        """Return the stiffness terms of missing caps, by ring.

        Args:
            positions: (n, 3) [m].
            pressures_Pa: (chambers,), gauge.
        """
        pairs = zip(self._chambers, pressures_Pa.tolist(), strict=True)
        return [
            (ring, cap_stiffness(positions, ring, pressure))
            for (*_, caps), pressure in pairs
            for ring in caps
        ]
