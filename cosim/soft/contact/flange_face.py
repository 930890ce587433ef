"""The flange's face: a plane in each ring of the base, which films and frames of the first unit do not pass.

Three nodes of the ring carry the plane, so that the flange feels the forces on it. The face is a tenth wider
than the drawn unit that begins there. It is modelled for films at the ring that are drawn along the plane and
on one side of it; for a sheet or a tube that stands on its base, no face behind it is known. A frame that
rests on other frames rests on the face as well, at half of their distance.
"""

from typing import Any, Final, NamedTuple

import numpy as np

from cosim.base.components import components
from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import IndexTable, Indices, Matrix, Vector
from cosim.base.kernels import kernel, small_vector
from cosim.soft.body.body import SoftBody
from cosim.soft.contact import contact_law, triangle_foot
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.self_contact_faces import FilmFaces, FilmPoints
from cosim.soft.elements.frame_stops import FrameStops
from cosim.soft.geometry.surface import directed_edges

_FLAT: Final = 1e-4  # largest distance from a plane, over the size
_ALONG: Final = 0.5  # least projected area of a film along the plane, over its area
_LEAST_AREA: Final = (
    0.05  # of a triangle of ring nodes, over the size squared, so that they are not on a line
)
_WHOLE: Final = np.array([1.0, 0.0, 0.0])
_WIDER: Final = 1.1  # radius of the face over that of the unit
_HARDER: Final = 2.0  # stiffness relative to a film, which yields as much as the film that presses on it


class FlangeFace(NamedTuple):
    """Contact points in front of the flange's face, and the face of each.

    Args:
        nodes: (b, 3), nodes of each point's triangle.
        weights: (b, 3), barycentric.
        stiffness: (b,) [N/m].
        spare: (b,) [m], see `contact_law.spare`.
        corners: (b, 3) nodes of the base that carry the face, whose normal points towards the film.
        center: (b, 3) weights of the corners in the middle of the face.
        radius: (b,) [m], of the face.
    """

    nodes: IndexTable
    weights: Matrix
    stiffness: Vector
    spare: Vector
    corners: IndexTable
    center: Matrix
    radius: Vector

    @classmethod
    def of(cls, body: SoftBody, faces: FilmFaces, points: FilmPoints, law: ContactLaw) -> "FlangeFace":
        """Return the faces of a body, as drawn."""
        no_points = np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros(0), np.zeros(0)
        parts: list[tuple[Any, ...]] = [(*no_points, no_points[0], no_points[1], np.zeros(0))]
        for ring in _rings(body):
            parts += _before(body, faces, points, ring, law)
        return cls(*(np.ascontiguousarray(np.concatenate(rows)) for rows in zip(*parts, strict=True)))


def _rings(body: SoftBody) -> list[IntArray]:
    """Return the rings of the base: groups of its nodes that edges of the film connect."""
    edges = directed_edges(body.triangles)
    edges = edges[np.isin(edges, body.base).all(axis=1)]
    ring_of_node = components(body.nodes, edges)[body.base]
    return [body.base[ring_of_node == k] for k in np.unique(ring_of_node)]


def _before(
    body: SoftBody, faces: FilmFaces, points: FilmPoints, ring: IntArray, law: ContactLaw
) -> list[tuple[Any, ...]]:
    """Return the rows of `FlangeFace` of one ring of the base; empty if no film lies along its plane."""
    x, corners = body.positions, _corners(body.positions, ring)
    if corners is None:
        return []
    a, b, c = x[corners]
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal)
    faces_at_ring = np.unique(faces.face[np.isin(body.triangles, ring).any(axis=1)])
    free = ~np.isin(points.nodes, body.base).all(axis=1)
    point_indices = np.flatnonzero(np.isin(points.home[:, 0], faces_at_ring) & free)
    if not len(point_indices):
        return []
    position = (points.weights[point_indices, :, None] * x[points.nodes[point_indices]]).sum(axis=1)
    gap, size = (position - a) @ normal, float(np.ptp(position, axis=0).max())
    if max(np.ptp(x[ring] @ normal), min(gap.max(), -gap.min())) > _FLAT * size:
        return []
    i, j, k = body.triangles[np.isin(faces.face, faces_at_ring)].T
    areas = np.cross(x[j] - x[i], x[k] - x[i])
    outward = areas.sum(axis=0)
    if abs(outward @ normal) < _ALONG * np.linalg.norm(areas, axis=1).sum():
        return []
    if gap.mean() < -_FLAT * size or (gap.mean() < _FLAT * size and outward @ normal > 0.0):
        corners, gap, normal = corners[::-1], -gap, -normal
    unit = np.unique(body.triangles[np.isin(faces.unit, faces.unit_of_face[faces_at_ring])])
    middle = x[ring].mean(axis=0)
    across = x[unit] - middle
    across -= np.outer(across @ normal, normal)
    center = np.linalg.lstsq(np.vstack((x[corners].T, np.ones(3))), np.append(middle, 1.0))[0]
    film = (
        points.nodes[point_indices], points.weights[point_indices],
        _HARDER * law.stiffness_N_m3 * points.area[point_indices], contact_law.spare(gap, law),
    )  # fmt: skip
    frame, radius = _frame(body, unit, normal), _WIDER * np.linalg.norm(across, axis=1).max()
    return [
        (
            *rows,
            *(np.tile(row, (len(rows[0]), 1)) for row in (corners, center)),
            np.full(len(rows[0]), radius),
        )
        for rows in (film, frame)
    ]


def _frame(body: SoftBody, unit: IntArray, normal: Array) -> tuple[Any, ...]:
    """Return nodes, weights, stiffness and spare distance of a unit's frame that rests on other frames."""
    no_points: tuple[Any, ...] = np.zeros((0, 3), np.int64), np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    columns = [[column] for column in no_points]
    for stops in body.of_kind(FrameStops):
        of_unit = np.isin(stops.pairs[:, 0], unit)
        nodes, (gap, stiffness) = stops.pairs[of_unit, 0], stops.springs[of_unit].T
        aside = body.positions[stops.pairs[of_unit, 1]] - body.positions[nodes]
        aside -= np.outer(aside @ normal, normal)
        rest = np.sqrt(gap**2 - (aside**2).sum(axis=1))
        rows = np.repeat(nodes[:, None], 3, axis=1), np.tile(_WHOLE, (len(nodes), 1)), stiffness, -0.5 * rest
        for column, row in zip(columns, rows, strict=True):
            column.append(row)
    return tuple(np.concatenate(column) for column in columns)


def _corners(x: Array, ring: IntArray) -> IntArray | None:
    """Return three nodes of a ring that are far from one another; None if all are on a line."""
    if len(ring) < 3:
        return None
    first = ring[np.linalg.norm(x[ring] - x[ring].mean(axis=0), axis=1).argmax()]
    distance = np.linalg.norm(x[ring] - x[first], axis=1)
    second = ring[distance.argmax()]
    height = np.linalg.norm(np.cross(x[ring] - x[first], x[second] - x[first]), axis=1)
    if height.max() < _LEAST_AREA * distance.max() ** 2:
        return None
    return np.array([first, second, ring[height.argmax()]])


@kernel
def fill_before_face(x: Matrix, face: FlangeFace, reach: float, behind: float, out: Indices) -> int:
    """Fill the indices of points near the face, in front or behind; return their number.

    Args:
        x: (n, 3) [m].
        face: of the flange.
        reach: largest distance in front of it [m].
        behind: the same behind it [m].
        out: filled up to its size.
    """
    y, n, count = small_vector(3), small_vector(3), 0
    for b in range(face.nodes.shape[0]):
        corners = face.corners[b]
        triangle_foot.fill_point(x, face.nodes[b], face.weights[b], y)
        triangle_foot.plane_of(x, corners, n)
        d, square = triangle_foot.distance_of(x, corners[0], n, y), 0.0
        if d < -behind or d + face.spare[b] >= reach:
            continue
        for r in range(3):
            lateral = y[r] - d * n[r]
            for a in range(3):
                lateral -= face.center[b, a] * x[corners[a], r]
            square += lateral * lateral
        if square > face.radius[b] ** 2:
            continue
        if count < out.shape[0]:
            out[count] = b
        count += 1
    return count
