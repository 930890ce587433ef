"""Triangulated surfaces: checks, edges and hinges with their angles, groups of faces, rims of open ends."""

import math
from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np

from cosim.base.components import components
from cosim.base.frames import Array, IntArray, in_mm
from cosim.base.kernels import device_function
from cosim.errors import MeshError

SMALLEST_SHAPE_RATIO = 1e-8
"""Bound on area / (longest edge)^2; an equilateral triangle has 0.43."""

_Rows = TypeVar("_Rows", Array, IntArray)
_NAMED = 6  # triangles, of those that share an edge


def triangle_area(positions: Array, triangles: IntArray) -> Array:
    """Return the area |(b - a) x (c - a)| / 2 of each triangle.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3) node indices.

    Returns:
        (m,) [m^2].
    """
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    return np.asarray(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))


def directed_edges(triangles: IntArray) -> IntArray:
    """Return the three edges of each triangle in its own sense of rotation.

    Args:
        triangles: (m, 3) node indices.

    Returns:
        (3 m, 2); rows 3 t .. 3 t + 2 are the edges ab, bc, ca of triangle t.
    """
    return np.asarray(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2))


def check_mesh(positions: Array, triangles: IntArray, sheets: Sequence[IntArray] = ()) -> None:
    """Refuse a surface on which elements are not defined.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3) node indices.
        sheets: places of the triangles of each sheet, where sheets are welded along edges and areas; each is
            checked as a surface. None: all triangles are one surface.

    Raises:
        MeshError: a position is not finite; a triangle names a node that does not exist, repeats a
            node, or is degenerate; an edge belongs to more than two triangles, or to two that turn
            opposite ways; a node belongs to no triangle. The message names it and its value.
    """
    positions = np.asarray(positions)
    triangles = np.asarray(triangles)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise MeshError(f"positions have shape {positions.shape}; (nodes, 3) is needed")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise MeshError(f"triangles have shape {triangles.shape}; (triangles, 3), not empty, is needed")
    _check_nodes(positions, triangles)
    _check_shapes(positions, triangles)
    for places in sheets:
        _check_edges(positions, triangles[places])
    if not sheets:
        _check_edges(positions, triangles)


def _check_nodes(positions: Array, triangles: IntArray) -> None:
    bad = np.flatnonzero(~np.isfinite(positions).all(axis=1))
    if bad.size:
        raise MeshError(f"node {bad[0]} lies at {positions[bad[0]].tolist()}; positions must be finite")
    bad = np.flatnonzero(((triangles < 0) | (triangles >= len(positions))).any(axis=1))
    if bad.size:
        row = triangles[bad[0]].tolist()
        raise MeshError(f"triangle {bad[0]} uses nodes {row}; nodes 0 to {len(positions) - 1} exist")
    a, b, c = triangles.T
    bad = np.flatnonzero((a == b) | (b == c) | (c == a))
    if bad.size:
        raise MeshError(f"triangle {bad[0]} uses nodes {triangles[bad[0]].tolist()}: one of them twice")
    used = np.zeros(len(positions), dtype=bool)
    used[triangles] = True
    if not used.all():
        raise MeshError(f"node {np.flatnonzero(~used)[0]} belongs to no triangle; remove it")


def _at(positions: Array, nodes: IntArray) -> str:
    return f"at {in_mm(positions[nodes].mean(axis=0))}"


def _check_shapes(positions: Array, triangles: IntArray) -> None:
    area = triangle_area(positions, triangles)
    edges = positions[directed_edges(triangles)]
    longest = np.linalg.norm(edges[:, 1] - edges[:, 0], axis=1).reshape(-1, 3).max(axis=1)
    bound = SMALLEST_SHAPE_RATIO * longest**2
    bad = np.flatnonzero(area <= bound)
    if bad.size:
        t = bad[0]
        raise MeshError(
            f"triangle {t} (nodes {triangles[t].tolist()}) {_at(positions, triangles[t])} is degenerate: "
            f"area {area[t]:.3g} m^2, at least {bound[t]:.3g} m^2 is needed for a longest edge of "
            f"{longest[t]:.3g} m"
        )


def _check_edges(positions: Array, triangles: IntArray) -> None:
    edges = directed_edges(triangles)
    undirected, inverse, count = np.unique(
        np.sort(edges, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    inverse = inverse.ravel()
    bad = np.flatnonzero(count > 2)
    if bad.size:
        sharing = (np.flatnonzero(inverse == bad[0]) // 3)[:_NAMED].tolist()
        raise MeshError(
            f"edge {undirected[bad[0]].tolist()} {_at(positions, undirected[bad[0]])} belongs to "
            f"{count[bad[0]]} triangles {sharing}"
            f"{' and others' if count[bad[0]] > _NAMED else ''}; 2 at most"
        )
    forward, count = np.unique(edges, axis=0, return_counts=True)
    bad = np.flatnonzero(count > 1)
    if bad.size:
        edge = forward[bad[0]]
        owners = (np.flatnonzero((edges == edge).all(axis=1)) // 3)[:_NAMED].tolist()
        raise MeshError(
            f"triangles {owners} both run along edge {edge.tolist()} {_at(positions, edge)} in the same "
            "sense: one of them is turned inside out"
        )


def interior_hinges(triangles: IntArray, seam: IntArray | Sequence[int] = ()) -> IntArray:
    """Return the edges that fold, each with the two nodes that face it.

    An edge shared by two triangles folds, unless both its ends are seam nodes: two films welded
    along a seam turn freely about it. Row [i, j, k, l]: j-k is the edge; the triangle with l runs
    along it from j to k, the one with i from k to j. So `dihedral_angle` is measured on the inner side
    (through the gas, if normals point outward): less than pi where the surface is convex, and near
    2 pi at the hole ring where two units meet.

    Args:
        triangles: (m, 3) node indices, consistently oriented.
        seam: (s,) node indices.

    Returns:
        (h, 4), sorted by (j, k), j < k.
    """
    edges = directed_edges(triangles)
    facing = np.asarray(triangles)[:, [2, 0, 1]].ravel()
    rising = edges[:, 0] < edges[:, 1]
    low, high = edges.min(axis=1), edges.max(axis=1)
    key = low * (int(high.max()) + 1) + high
    forward = np.flatnonzero(rising)
    backward = np.flatnonzero(~rising)
    _, at_forward, at_backward = np.intersect1d(key[forward], key[backward], return_indices=True)
    first, second = backward[at_backward], forward[at_forward]
    hinges = np.stack([facing[first], low[first], high[first], facing[second]], axis=1)
    welded = np.isin(hinges[:, 1:3], np.asarray(seam, dtype=np.int64)).all(axis=1)
    return np.asarray(hinges[~welded], dtype=np.int64)


def triangles_beside(triangles: IntArray, hinges: IntArray) -> IntArray:
    """Return the two triangles at each hinge (h, 2).

    Args:
        triangles: (m, 3) node indices.
        hinges: (h, 4) nodes i, j, k, l; the first has i, the second l.
    """
    count = int(triangles.max()) + 1

    def key(nodes: IntArray) -> IntArray:
        low, middle, high = np.sort(nodes, axis=1).T
        return np.asarray((low * count + middle) * count + high)

    keys = key(triangles)
    order = np.argsort(keys)
    beside = [order[np.searchsorted(keys[order], key(hinges[:, list(n)]))] for n in ((0, 1, 2), (1, 2, 3))]
    return np.stack(beside, axis=1)


def dihedral_angle(positions: Array, hinges: IntArray) -> Array:
    """Return the angle between the two triangles at each hinge.

    theta = atan2(|r_kj| (n . r_ij), m . n) modulo 2 pi, with r_ij = x_i - x_j, r_kj = x_k - x_j,
    r_kl = x_k - x_l, m = r_ij x r_kj, n = r_kj x r_kl; pi where the two triangles are flat. Exact for
    all angles: the arc cosine of m . n would lose half the digits near 0 and pi. Reversing a row
    keeps theta; exchanging i and l alone gives 2 pi - theta.

    Args:
        positions: (n, 3) [m].
        hinges: (h, 4) node indices i, j, k, l; j-k is the shared edge.

    Returns:
        (h,) in [0, 2 pi) [rad].
    """
    xi, xj, xk, xl = (positions[hinges[:, a]] for a in range(4))
    r_ij, r_kj, r_kl = xi - xj, xk - xj, xk - xl
    m, n = np.cross(r_ij, r_kj), np.cross(r_kj, r_kl)
    sine = np.linalg.norm(r_kj, axis=1) * np.einsum("ha,ha->h", n, r_ij)
    return np.asarray(np.arctan2(sine, np.einsum("ha,ha->h", m, n)) % (2.0 * np.pi))


TURN = 2.0 * math.pi
_EIGHTH = math.tan(math.pi / 8.0)


@device_function
def full_angle(sine: float, cosine: float) -> float:
    """Return atan2(sine, cosine) in [0, 2 pi), to 2e-15; NaN where both are zero.

    The ratio is reduced to |t| <= tan(pi / 8); there (atan(t) / t - 1) / t^2 is a polynomial in t^2 that
    meets the series at 11 Chebyshev points (5e-18 off in between).
    """
    height, width = abs(sine), abs(cosine)
    steep = height > width
    large = height if steep else width
    small = width if steep else height
    beyond = small > _EIGHTH * large
    t = (small - large if beyond else small) / (small + large if beyond else large)
    z = t * t
    p = 0.03923044778479309 - 0.019175404711104935 * z
    p = p * z - 0.050854078345894844
    p = p * z + 0.05858140904866328
    p = p * z - 0.06664510525508936
    p = p * z + 0.07692183125376892
    p = p * z - 0.0909090457530649
    p = p * z + 0.11111111015187018
    p = p * z - 0.14285714284665682
    p = p * z + 0.19999999999995516
    p = p * z - 0.3333333333333333
    angle = t + t * z * p + (0.25 * math.pi if beyond else 0.0)
    angle = 0.5 * math.pi - angle if steep else angle
    angle = math.pi - angle if cosine < 0.0 else angle
    return TURN - angle if sine < 0.0 else angle


def check_face_groups(groups: Mapping[str, IntArray], triangles: int) -> None:
    """Check that face groups hold triangles that exist, each once.

    Args:
        groups: places of triangles by name.
        triangles: how many there are.

    Raises:
        MeshError: they do not.
    """
    for name, places in groups.items():
        if places.size and (places.min() < 0 or places.max() >= triangles):
            bad = int(places.min() if places.min() < 0 else places.max())
            raise MeshError(f"face group {name} has triangle {bad}; 0 to {triangles - 1} exist")
        if len(np.unique(places)) < len(places):
            raise MeshError(f"face group {name} has a triangle twice")


def check_face_values(values: Mapping[str, Array], triangles: int) -> None:
    """Check that there is a finite value, or row of values, for every triangle.

    Raises:
        MeshError: there is not.
    """
    for name, rows in values.items():
        if len(rows) != triangles or not np.isfinite(rows).all():
            raise MeshError(
                f"face values {name} have shape {rows.shape}; {triangles} rows of finite numbers are needed"
            )


def parts_of_groups(groups: Mapping[str, IntArray], parent: IntArray) -> dict[str, IntArray]:
    """Return the face groups of parts of triangles, ascending.

    Args:
        groups: places of the whole triangles by name.
        parent: (parts,) the triangle that each is part of.
    """
    return {name: np.flatnonzero(np.isin(parent, places)) for name, places in groups.items()}


def mean_beside(triangles: IntArray, hinges: IntArray, values: Array) -> Array:
    """Return the harmonic mean (h,) of the values of both triangles at each hinge: both bend by one moment.

    Args:
        triangles: (m, 3) node indices.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
        values: (m,) of each triangle, not negative.
    """
    first, second = values[triangles_beside(triangles, hinges)].T
    # the mean of equal values is exact
    ratio = np.divide(2.0 * second, first + second, out=np.zeros(len(hinges)), where=first + second > 0.0)
    return np.asarray(first * ratio)


def rows_of(parts: Sequence[_Rows]) -> _Rows:
    """Return one array of several, row after row; the array itself where there is but one."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def nodes_of_several_fans(triangles: IntArray) -> IntArray:
    """Return the nodes whose triangles are not all joined by edges at the node, ascending.

    Args:
        triangles: (m, 3) node indices.
    """
    node, after, before = (np.roll(triangles, -k, axis=1).ravel() for k in range(3))
    n = int(triangles.max()) + 1
    _, along, to = np.intersect1d(
        node * n + after, node * n + before, return_indices=True
    )  # the next around the node
    fan = components(len(node), np.column_stack([along, to]))
    return np.flatnonzero(np.bincount(np.unique(np.stack([node, fan], axis=1), axis=0)[:, 0]) > 1)


def rims(triangles: IntArray) -> tuple[IntArray, ...]:
    """Return the nodes of each rim, so that a fan (centre, rim[i], rim[i + 1]) faces outward.

    Args:
        triangles: (m, 3) node indices, normals pointing out of the gas.

    Raises:
        MeshError: two rims meet in a node.
    """
    edges = directed_edges(triangles)
    count = int(triangles.max()) + 1
    alone = ~np.isin(edges[:, 1] * count + edges[:, 0], edges[:, 0] * count + edges[:, 1])
    # a cap runs along its rim the other way than the film
    following = dict(zip(edges[alone, 1].tolist(), edges[alone, 0].tolist(), strict=True))
    if len(following) < alone.sum():
        ends, times = np.unique(edges[alone, 1], return_counts=True)
        raise MeshError(f"two rims of the film meet in node {ends[times > 1][0]}; they must not")
    closed_rims = []
    while following:
        first, node = following.popitem()
        rim = [first]
        while node != first:
            rim.append(node)
            node = following.pop(node)
        closed_rims.append(np.array(rim, dtype=np.int64))
    return tuple(sorted(closed_rims, key=lambda rim: int(rim.min())))
