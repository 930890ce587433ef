"""Stacks of polygonal units as triangle meshes, each unit two films welded at the rim; finer around holes.

Around a small hole the film's displacements vary with the logarithm of the distance from the axis: nodes are
put at a third of the logarithmic way outwards, not at the midpoint. Measured: docs/necks.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np

from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import MeshError
from cosim.soft.geometry.named_mesh import NamedMesh, refine_some

FUSED: Final = "fused"
"""Face group of the triangles whose two films are fused."""


class Ring(NamedTuple):
    """A ring of a graded film.

    Args:
        place: 0 at the hole, or at the polygon around the circle within which films are fused, 1 at the rim.
        per_side: number of nodes per side.
        from_inside: whether diagonals that end at it begin at the corners of the ring within it.
        circle: whether its nodes lie on a circle.
    """

    place: float
    per_side: int = 2
    from_inside: bool = True
    circle: bool = False


_HOLE, _FUSED = Ring(0.0), Ring(0.0, circle=True)
GRADED: Final = (Ring(0.1), Ring(0.42), Ring(0.8, from_inside=False), Ring(1.0, 4, False))
"""Places and diagonals were chosen on the first unit of the hexagonal arm: docs/mesh_study.md."""


@dataclass(frozen=True)
class PolygonalStack:
    """A stack of n-gonal pneumatic units that share their hole rings.

    Node order per unit: hole n, lower mid ring 2n, outer ring 2n, upper mid ring 2n; last comes the
    hole ring of the tip. In the rings of 2n, even indices point to corners and odd ones lie on the
    edge midpoints. Seven triangles per film and side. Source: the drawn shape of Sim-FAST's
    pneumatic examples (Y. Zhu, CC-BY 4.0).

    Args:
        sides: corners of the polygon, >= 3.
        units: >= 1.
        corner_radius_m: axis to outer corner in the first unit [m].
        hole_radius_m: axis to corner of the hole, in all units [m].
        unit_height_m: drawn height of a unit [m].
        taper: ratio of the corner radii of neighbouring units.
        mid_ring_fraction: place of the mid rings, 0 at the hole and 1 at the outer ring.
        ring_heights: heights of lower mid, outer and upper mid ring as fractions of the unit.
        first_corner_rad: direction of corner 0 about +z [rad]; None: -pi / sides, so that the
            edge between corners 0 and 1 faces +x.

    Raises:
        MeshError: a value is out of its bounds; the message names both.
    """

    sides: int
    units: int
    corner_radius_m: float
    hole_radius_m: float
    unit_height_m: float
    taper: float = 1.0
    mid_ring_fraction: float = 0.5
    ring_heights: tuple[float, float, float] = (0.25, 0.5, 0.75)
    first_corner_rad: float | None = None

    def __post_init__(self) -> None:
        low, middle, high = self.ring_heights
        smallest = self.corner_radius_m * min(1.0, self.taper ** (self.units - 1))
        conditions = {
            f"sides is {self.sides}; at least 3 are needed": self.sides >= 3,
            f"units is {self.units}; at least 1 is needed": self.units >= 1,
            f"hole_radius_m is {self.hole_radius_m}; it must be > 0": self.hole_radius_m > 0.0,
            f"unit_height_m is {self.unit_height_m}; it must be > 0": 0.0 < self.unit_height_m < np.inf,
            f"taper is {self.taper}; it must be > 0": 0.0 < self.taper < np.inf,
            f"corner_radius_m is {self.corner_radius_m} and {smallest:.4g} in the smallest unit; "
            f"it must exceed hole_radius_m = {self.hole_radius_m}": self.hole_radius_m < smallest < np.inf,
            f"mid_ring_fraction is {self.mid_ring_fraction}; it must lie between 0 and 1 (exclusive)": (
                0.0 < self.mid_ring_fraction < 1.0
            ),
            f"ring_heights are {self.ring_heights}; they must rise between 0 and 1 (exclusive)": (
                0.0 < low < middle < high < 1.0
            ),
        }
        for message, holds in conditions.items():
            if not holds:
                raise MeshError(message)

    def mesh(self) -> NamedMesh:
        """Return the drawn shape.

        Its base ring lies at z = 0, the stack grows along +z. Rings run counter-clockwise about +z:
        unit_k.hole, unit_k.lower, unit_k.outer, unit_k.upper, tip. `unit_k.hole` is the lower hole ring of
        unit k = 1, 2, ...; it is also the upper one of unit k - 1. The films are welded along the outer
        rings. Line corner_k leads through the outer nodes at corner k = 0, 1, ... of all units. Face value
        wrinkle_panel_m is the width of the panels of a unit.
        """
        n = self.sides
        rings, levels = dict[str, IntArray](), list[Array]()
        for unit in range(self.units):
            start = 7 * n * unit
            for name, first, count in (("hole", 0, n), ("lower", n, 2 * n), ("outer", 3 * n, 2 * n),
                                       ("upper", 5 * n, 2 * n)):  # fmt: skip
                rings[f"unit_{unit + 1}.{name}"] = np.arange(start + first, start + first + count)
            levels += self._unit_positions(unit)
        rings["tip"] = 7 * n * self.units + np.arange(n)
        levels.append(self._polygon(self.hole_radius_m, self.units * self.unit_height_m)[::2])
        triangles = [self._unit_triangles(unit) for unit in range(self.units)]
        return self._named(np.concatenate(levels), np.concatenate(triangles), rings)

    def graded_mesh(self, fused_radius_m: float | None = None) -> NamedMesh:
        """Return the drawn shape with its nodes where units bend and where frames are loaded.

        Names are those of `mesh`; some rings have none. Triangles within the fused radius are in face group
        FUSED.

        Args:
            fused_radius_m: within which films are fused, between hole and rims; None: none are.
        """
        course: tuple[Ring, ...] = (_HOLE, *GRADED)
        start = self.hole_radius_m
        if fused_radius_m is not None:
            start, course = fused_radius_m / np.cos(np.pi / self.sides), (_HOLE, _FUSED, *GRADED)
        rim = len(course) - 1
        counts = [self.sides * ring.per_side for ring in (*course, *course[-2:0:-1])]
        first = np.concatenate([[0], np.cumsum(counts)])
        nodes = [
            [first[-1] * unit + np.arange(*ends) for ends in pairwise(first)] for unit in range(self.units)
        ]
        tip = first[-1] * self.units + np.arange(counts[0])
        rings, levels, triangles = dict[str, IntArray](), list[Array](), list[IntArray]()
        for unit, unit_rings in enumerate(nodes):
            for name, ring_number in (("hole", 0), ("lower", rim - 2), ("outer", rim), ("upper", rim + 2)):
                rings[f"unit_{unit + 1}.{name}"] = unit_rings[ring_number]
            levels += self._graded_positions(unit, course, start)
            above = tip if unit + 1 == self.units else nodes[unit + 1][0]
            for film, orientation in ((unit_rings, -1), ([above, *unit_rings[: -rim - 1 : -1]], 1)):
                strips = zip(film, film[1 : rim + 1], course[1:], strict=False)
                triangles += [
                    _strip(a, b, self.sides, ring.from_inside)[:, ::orientation] for a, b, ring in strips
                ]
        rings["tip"] = tip
        levels.append(self._polygon(self.hole_radius_m, self.units * self.unit_height_m))
        mesh = self._named(np.concatenate(levels), np.concatenate(triangles), rings)
        if fused_radius_m is None:
            return mesh
        sizes = [len(strip) for strip in triangles]
        fused = np.repeat(np.arange(len(sizes)) % rim == 0, sizes)
        return replace(mesh, face_groups={FUSED: np.flatnonzero(fused)})

    def _named(self, positions: Array, triangles: IntArray, rings: dict[str, IntArray]) -> NamedMesh:
        """Return the mesh of positions and of triangles in the order of units, given its rings."""
        outer = [f"unit_{unit + 1}.outer" for unit in range(self.units)]
        per_side = len(rings[outer[0]]) // self.sides
        return NamedMesh(
            positions=positions,
            triangles=triangles,
            rings=rings,
            caps=(rings["unit_1.hole"][::-1], rings["tip"]),
            base_ring="unit_1.hole",
            tip_ring="tip",
            seam_rings=tuple(outer),
            center_rings=tuple(f"unit_{unit + 1}.hole" for unit in range(self.units)),
            lines={
                f"corner_{k}": np.array([rings[name][per_side * k] for name in outer])
                for k in range(self.sides)
            },
            face_values={"wrinkle_panel_m": np.repeat(self._panels(), len(triangles) // self.units)},
        )

    def _panels(self) -> Array:
        """Distance (units,) [m] between the sides of outer ring and hole, seen along the axis."""
        outer = self.corner_radius_m * self.taper ** np.arange(self.units)
        return np.asarray((outer - self.hole_radius_m) * np.cos(np.pi / self.sides))

    def _polygon(self, radius: float, height: float, per_side: int = 2) -> Array:
        """Corners of the polygon at a height, and further nodes along its edges: (per_side sides, 3) [m]."""
        first = -np.pi / self.sides if self.first_corner_rad is None else self.first_corner_rad
        angle = first + 2.0 * np.pi / self.sides * np.arange(self.sides)
        corners = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        fraction = np.arange(per_side)[None, :, None] / per_side
        points = np.full((per_side * self.sides, 3), height)
        edge_points = (1.0 - fraction) * corners[:, None] + fraction * np.roll(corners, -1, axis=0)[:, None]
        points[:, :2] = edge_points.reshape(-1, 2)
        return points

    def _unit_positions(self, unit: int) -> list[Array]:
        outer = self.corner_radius_m * self.taper**unit
        middle = self.hole_radius_m + self.mid_ring_fraction * (outer - self.hole_radius_m)
        low, half, high = (self.unit_height_m * (unit + height) for height in self.ring_heights)
        return [
            self._polygon(self.hole_radius_m, self.unit_height_m * unit)[::2],
            self._polygon(middle, low),
            self._polygon(outer, half),
            self._polygon(middle, high),
        ]

    def _graded_positions(self, unit: int, course: tuple[Ring, ...], start: float) -> list[Array]:
        """Return the nodes of a unit ring by ring, those of the hole above it left out."""
        outer, hole = self.corner_radius_m * self.taper**unit, self.hole_radius_m
        kinks = (hole, hole + self.mid_ring_fraction * (outer - hole), outer)
        low, half, high = self.ring_heights

        def placed(ring: Ring, heights: tuple[float, float, float]) -> Array:
            radius = start + ring.place * (outer - start)
            points = self._polygon(radius, 0.0, ring.per_side)
            size = np.ones(len(points))
            if ring.circle:
                size = radius * np.cos(np.pi / self.sides) / np.linalg.norm(points, axis=1)
            points *= size[:, None]
            points[:, 2] = self.unit_height_m * (unit + np.interp(radius * size, kinks, heights))
            return points

        lower = [placed(ring, (0.0, low, half)) for ring in course[1:]]
        upper = [placed(ring, (1.0, high, half)) for ring in course[-2:0:-1]]
        return [self._polygon(hole, self.unit_height_m * unit), *lower, *upper]

    def _unit_triangles(self, unit: int) -> IntArray:
        """Both films of a unit: the lower faces -z, the upper +z."""
        n, start = self.sides, 7 * self.sides * unit
        hole, above = start + np.arange(n), start + 7 * n + np.arange(n)
        lower, outer, upper = (start + n * first + np.arange(2 * n) for first in (1, 3, 5))
        return np.concatenate([_film(hole, lower, outer)[:, ::-1], _film(above, upper, outer)])


def _strip(inner: IntArray, outer: IntArray, sides: int, from_inside: bool) -> IntArray:
    """Return the triangles between two rings, alike on both halves of each side, counter-clockwise about +z.

    Args:
        inner: nodes, an even number to a side.
        outer: the same.
        sides: of the polygon.
        from_inside: whether diagonals between nodes of one place begin at the inner ring's corners.
    """
    by_side = [ring.reshape(sides, -1) for ring in (inner, outer)]
    closed_sides = [np.column_stack([nodes, np.roll(nodes[:, 0], -1)]) for nodes in by_side]
    k, m = (nodes.shape[1] for nodes in by_side)
    triangles = []
    for direction in (1, -1):
        near, far = (nodes[:, ::direction] for nodes in closed_sides)
        i = j = 0
        while 2 * i < k or 2 * j < m:
            ahead = (i + 1) * m - (j + 1) * k  # above 0: the outer ring's next node comes first
            if 2 * i == k or (2 * j < m and (ahead > 0 or (ahead == 0 and from_inside))):
                corners = (near[:, i], far[:, j], far[:, j + 1])
                j += 1
            else:
                corners = (near[:, i], far[:, j], near[:, i + 1])
                i += 1
            triangles.append(np.stack(corners[::direction], axis=1))
    return np.concatenate(triangles)


def _film(hole: IntArray, middle: IntArray, outer: IntArray) -> IntArray:
    """Return the 7 triangles per side of one film, counter-clockwise about +z: (7 sides, 3)."""
    h, h_next = hole, np.roll(hole, -1)
    m, m_half, m_next = middle[::2], middle[1::2], np.roll(middle[::2], -1)
    o, o_half, o_next = outer[::2], outer[1::2], np.roll(outer[::2], -1)
    corners = [
        (h, m_half, h_next),
        (h, m, m_half),
        (h_next, m_half, m_next),
        (m, o_half, m_half),
        (m_half, o_half, m_next),
        (m, o, o_half),
        (m_next, o_half, o_next),
    ]
    return np.concatenate([np.stack(triangle, axis=1) for triangle in corners])


_ROUNDING: Final = 1e-9
_LOGARITHMIC_WAY: Final = 1.0 / 3.0
_NONE: Final = np.zeros(0, np.int64)


def with_finer_holes(
    mesh: NamedMesh, holes: Sequence[str], levels: int, fused_radius_m: float | None = None
) -> NamedMesh:
    """Return the mesh with all edges cut that end at hole rings, `levels` times.

    Where films are fused, the first cuts are at that radius, the next those of all edges that end at fused
    triangles. Triangles within the radius are in face group FUSED.

    Args:
        mesh: the coarse mesh, the z axis through its holes.
        holes: names of the rings.
        levels: >= 0, with fused films >= 1.
        fused_radius_m: from the axis, beyond the hole rings and within all other nodes; None: none are fused.

    Raises:
        MeshError: a hole ring reaches beyond the radius, another node is within it, or no level puts nodes
            there.
    """
    if fused_radius_m is not None:
        _check_fused(mesh, holes, levels, fused_radius_m)
    for level in range(levels):
        core = np.zeros(len(mesh.positions), dtype=bool)
        core[np.concatenate([mesh.ring(name) for name in holes])] = True
        core[mesh.triangles[mesh.face_groups.get(FUSED, _NONE)]] = True
        if level == 0 and fused_radius_m is not None:
            mesh = _with_groups(_cut_around(mesh, core, fused_radius_m), fused_radius_m)
        else:
            mesh = _cut_around(mesh, core)
    return mesh


def _check_fused(mesh: NamedMesh, holes: Sequence[str], levels: int, fused_radius_m: float) -> None:
    if levels < 1:
        raise MeshError(f"holes are refined {levels} times; fused films need 1 or more")
    ring = np.concatenate([mesh.ring(name) for name in holes])
    distance = _from_axis(mesh)
    inner, outer = float(distance[ring].max()), float(np.delete(distance, ring).min())
    if not inner * (1.0 + _ROUNDING) < fused_radius_m < outer * (1.0 - _ROUNDING):
        raise MeshError(
            f"fused_radius_m is {fused_radius_m:g}; it must lie between {inner:.4g}, the corners of the "
            f"hole rings, and {outer:.4g}, the next node"
        )


def _with_groups(mesh: NamedMesh, fused_radius_m: float) -> NamedMesh:
    fused = (_from_axis(mesh) <= fused_radius_m * (1.0 + _ROUNDING))[mesh.triangles].all(axis=1)
    return replace(mesh, face_groups={**mesh.face_groups, FUSED: np.flatnonzero(fused)})


def _from_axis(mesh: NamedMesh) -> Array:
    return np.hypot(mesh.positions[:, 0], mesh.positions[:, 1])


def _cut_around(mesh: NamedMesh, core: Mask, radius_m: float | None = None) -> NamedMesh:
    """Return the mesh with all edges cut that end at core nodes (n,).

    Those with both ends there are cut midway, those that leave at a distance from the axis: the given one, or
    a part of the logarithmic way to their other end.
    """

    def touching(edges: IntArray) -> Mask:
        return np.asarray(core[edges].any(axis=1))

    def fractions(edges: IntArray) -> Array:
        cut_fractions = np.full(len(edges), 0.5)
        leaving = np.flatnonzero(core[edges].sum(axis=1) == 1)
        outwards = core[edges[leaving, 0]]
        ordered = np.where(outwards[:, None], edges[leaving], edges[leaving, ::-1])
        near, far = (mesh.positions[ordered[:, k], :2] for k in range(2))
        start, end = np.linalg.norm(near, axis=1), np.linalg.norm(far, axis=1)
        cut_radius = (
            start * (end / start) ** _LOGARITHMIC_WAY if radius_m is None else np.full(len(start), radius_m)
        )
        crossing = _crossing(near, far, cut_radius)
        cut_fractions[leaving] = np.where(outwards, crossing, 1.0 - crossing)
        return cut_fractions

    return refine_some(mesh, touching, fractions)


def _crossing(near: Array, far: Array, radius: Array) -> Array:
    """Return the fraction (k,) of the way from points (k, 2) to others at which |point| is a radius (k,)."""
    step = far - near
    # |near + t step| = radius: a t^2 + 2 b t + c = 0, c < 0
    a, b = np.einsum("kr,kr->k", step, step), np.einsum("kr,kr->k", near, step)
    c = np.einsum("kr,kr->k", near, near) - radius**2
    return np.asarray((np.sqrt(b * b - a * c) - b) / a)
