"""Film surfaces with named nodes, the source of soft bodies; their creases and refinement.

A refined mesh has the same drawn shape: triangles are cut in four, and their neighbours in fewer parts.
Source: R. E. Bank, A. H. Sherman, A. Weiser, "Refinement algorithms and data structures for regular local
mesh refinement", Scientific Computing (1983): red triangles are cut in four, green ones close the mesh.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, NamedTuple, final

import numpy as np

from cosim.base.drawing import SAME_PLACE_M
from cosim.base.frames import Array, IntArray, Mask
from cosim.errors import MeshError
from cosim.soft.geometry import surface

TIP_END: Final = "end of the tip"
"""Ring of the nodes that give the direction of a tip that is a line."""
BENDING_FACTOR: Final = "bending_factor"
"""Face value that multiplies the bending stiffness of the film at its hinges; omitted: 1."""


@final
@dataclass(frozen=True, eq=False)
class Crease:
    """A line along which the film is folded when it is free of load.

    Args:
        points: (k, 3) [m] of the line, in the flange's frame.
        sheet: face group that is folded there; None: all sheets, but not where they are welded flat.
        turn_rad: from flat; positive: its ridge is on the outer side.
    """

    points: Array
    sheet: str | None
    turn_rad: float


@dataclass(frozen=True, eq=False)
class NamedMesh:
    """A film surface with named nodes, in the flange's frame; arrays are read-only.

    Args:
        positions: (n, 3) [m].
        triangles: (m, 3) node indices, normals pointing out of the gas.
        rings: node indices by name, in order around the ring.
        caps: rings of the open ends, ordered so that the fan (centre, ring[i], ring[i + 1]) faces outward.
        base_ring: name of the ring that the flange holds.
        tip_ring: name of the ring at the free end.
        seam_rings: names of the rings along which two films are welded.
        center_rings: names of the rings that the centre line runs through before the tip; none: the base.
        lines: nodes by name that a cable may lead through, base to tip.
        face_groups: indices of triangles by name, such as those of one material.
        face_values: (m, ...) of each triangle by name; a part of a triangle has that of the whole.
        sheets: face groups that are flat sheets, welded to one another where they share nodes: film folds
            within a sheet and turns freely between two. None: the film is one surface.
        chambers: face groups that enclose a gas each; every triangle is in one. None: the film encloses one.
        creases: of flat sheets.
        tip_along: (3,) direction of the film at a tip that is a line; None: unknown.

    Raises:
        MeshError: see `cosim.soft.geometry.surface.check_mesh`; or a ring or line names a node that does not
            exist, a ring has no nodes, a face group names a triangle that does not exist, or a triangle has
            no value.
    """

    positions: Array
    triangles: IntArray
    rings: Mapping[str, IntArray]
    caps: tuple[IntArray, ...]
    base_ring: str
    tip_ring: str
    seam_rings: tuple[str, ...] = ()
    center_rings: tuple[str, ...] = ()
    lines: Mapping[str, IntArray] = field(default_factory=dict)
    face_groups: Mapping[str, IntArray] = field(default_factory=dict)
    face_values: Mapping[str, Array] = field(default_factory=dict)
    sheets: tuple[str, ...] = ()
    chambers: tuple[str, ...] = ()
    creases: tuple[Crease, ...] = ()
    tip_along: Array | None = None

    def __post_init__(self) -> None:
        surface.check_mesh(self.positions, self.triangles, [self.face_groups[name] for name in self.sheets])
        for key in ("rings", "lines"):
            named = {name: _read_only(nodes) for name, nodes in getattr(self, key).items()}
            for name, nodes in named.items():
                _check_nodes(f"{key[:-1]} {name}", nodes, len(self.positions))
            object.__setattr__(self, key, MappingProxyType(named))
        surface.check_face_groups(self.face_groups, len(self.triangles))
        surface.check_face_values(self.face_values, len(self.triangles))
        groups = {name: _read_only(places) for name, places in self.face_groups.items()}
        values = {name: _values(rows) for name, rows in self.face_values.items()}
        object.__setattr__(self, "face_groups", MappingProxyType(groups))
        object.__setattr__(self, "face_values", MappingProxyType(values))
        object.__setattr__(self, "positions", _values(self.positions))
        object.__setattr__(self, "triangles", _read_only(self.triangles))
        object.__setattr__(self, "caps", tuple(_read_only(cap) for cap in self.caps))

    @property
    def seam(self) -> IntArray:
        """Nodes where two films are welded, ascending."""
        return np.unique(np.concatenate([np.zeros(0, np.int64), *(self.rings[n] for n in self.seam_rings)]))

    def divided(
        self,
        positions: Array,
        triangles: IntArray,
        parent: IntArray,
        rings: Mapping[str, IntArray],
        caps: tuple[IntArray, ...],
        lines: Mapping[str, IntArray],
    ) -> "NamedMesh":
        """Return the mesh with parts of its triangles in their place.

        Args:
            positions: (n, 3) [m].
            triangles: (parts, 3) node indices.
            parent: (parts,), the triangle that each is part of; it gives face groups and values.
            rings: that there are now.
            caps: that there are now.
            lines: that there are now.
        """
        return replace(
            self,
            positions=positions,
            triangles=triangles,
            rings=rings,
            caps=caps,
            lines=lines,
            face_groups=surface.parts_of_groups(self.face_groups, parent),
            face_values={name: rows[parent] for name, rows in self.face_values.items()},
        )

    def ring(self, name: str) -> IntArray:
        """Return the nodes of a ring.

        Raises:
            MeshError: there is no ring of that name; the message lists those that exist.
        """
        if name not in self.rings:
            raise MeshError(f"no ring {name!r}; there are {', '.join(self.rings)}")
        return self.rings[name]

    def line(self, name: str) -> IntArray:
        """Return the nodes of a line, base to tip: a cable's route.

        Raises:
            MeshError: there is no line of that name; the message lists those that exist.
        """
        if name not in self.lines:
            raise MeshError(f"no line {name!r}; there are {', '.join(self.lines)}")
        return self.lines[name]


def _check_nodes(name: str, nodes: IntArray, count: int) -> None:
    if not nodes.size:
        raise MeshError(f"{name} has no nodes")
    if nodes.min() < 0 or nodes.max() >= count:
        raise MeshError(f"{name} uses nodes {nodes.tolist()}; 0 to {count - 1} exist")


def _values(values: Array) -> Array:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def _read_only(indices: IntArray) -> IntArray:
    array = np.array(indices, dtype=np.int64)
    array.setflags(write=False)
    return array


def rest_angles(mesh: NamedMesh, hinges: IntArray) -> Array | None:
    """Return the angles at which hinges rest: pi - turn on a crease whose ridge is outside, else as drawn.

    Args:
        mesh: flat, with its creases.
        hinges: (h, 4), see `interior_hinges`.

    Returns:
        (h,) [rad]; None: the mesh has no creases.
    """
    if not mesh.creases:
        return None
    rest, n = surface.dihedral_angle(mesh.positions, hinges), len(mesh.positions)
    corners = {}
    for sheet in mesh.sheets:  # each directed edge with the corner that faces it
        a, b, c = mesh.triangles[mesh.face_groups[sheet]].T
        corners[sheet] = np.concatenate(
            [(p * n + q) * n + r for p, q, r in ((a, b, c), (b, c, a), (c, a, b))]
        )
    _, j, k, opposite = hinges.T
    for crease in mesh.creases:
        on_line = _on(crease, mesh.positions)
        folded = on_line[j] & on_line[k]
        for sheet, sheet_corners in corners.items():
            outward = np.isin((j * n + k) * n + opposite, sheet_corners)
            inward = np.isin(
                (k * n + j) * n + opposite, sheet_corners
            )  # of another sheet, welded flat to this one
            if crease.sheet is None:
                rest[folded & outward & ~_welded(hinges, corners, n)] -= crease.turn_rad
            elif crease.sheet == sheet:
                rest[folded & outward] -= crease.turn_rad
                rest[folded & inward] += crease.turn_rad
    return rest


def _welded(hinges: IntArray, corners: dict[str, IntArray], n: int) -> Mask:
    """Return which hinges (h,) lie where two sheets are one."""
    _, j, k, far = hinges.T
    every = np.concatenate(list(corners.values()))
    return np.isin((j * n + k) * n + far, every) & np.isin((k * n + j) * n + far, every)


def _on(crease: Crease, positions: Array) -> Mask:
    """Return which nodes (n,) lie on a crease's line."""
    is_on_line = np.zeros(len(positions), dtype=bool)
    for a, b in zip(crease.points[:-1], crease.points[1:], strict=True):
        along = np.clip((positions - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        is_on_line |= np.linalg.norm(positions - a - along[:, None] * (b - a), axis=1) < SAME_PLACE_M
    return is_on_line


_ALIKE = 1e-6  # relative


def refine(mesh: NamedMesh, levels: int) -> NamedMesh:
    """Return the mesh with each triangle cut into four, `levels` times; see `refine_some`.

    The half bandwidth grows by a factor near 4 per level.

    Args:
        mesh: the coarse mesh.
        levels: >= 0.

    Raises:
        MeshError: levels is negative.
    """
    if levels < 0:
        raise MeshError(f"refinement levels is {levels}; it must be >= 0")
    for _ in range(levels):
        mesh = refine_some(mesh, lambda edges: np.ones(len(edges), dtype=bool))
    return mesh


def refine_some(
    mesh: NamedMesh, chosen: Callable[[IntArray], Mask], fractions: Callable[[IntArray], Array] | None = None
) -> NamedMesh:
    """Return the mesh with some edges cut, and triangles into one part more than they have cut edges.

    A triangle with all edges cut becomes four that are alike; one with two cut edges becomes three, by the
    shorter diagonal beyond the corner between them, or four where both are alike, so that no choice breaks a
    symmetry; one with one becomes two. New nodes lie on edges of the
    drawn shape, so area, volume and rest angles stay; the new edges inside a triangle are flat. Rings and
    caps gain the new nodes of their edges, lines keep their nodes, and the parts of a triangle are in its
    face groups and have its face values. Nodes are numbered by the mean number of the coarse nodes they come
    from, unit-wise.

    Args:
        mesh: the coarse mesh.
        chosen: edges (k, 2), as nodes -> (k,), which are cut.
        fractions: edges (k, 2) -> fraction (k,) of the way to the second node at which they are; None: 1/2.
    """
    n = len(mesh.positions)
    edges, sides = np.unique(
        np.sort(surface.directed_edges(mesh.triangles), axis=1), axis=0, return_inverse=True
    )
    sides = sides.reshape(-1, 3)
    points = mesh.positions[edges].mean(axis=1)
    if fractions is not None:
        first, second = mesh.positions[edges[:, 0]], mesh.positions[edges[:, 1]]
        points = first + fractions(edges)[:, None] * (second - first)
    cut, diagonals = _unambiguous(mesh, sides, points, chosen(edges))
    ends = edges[cut]
    rank = np.concatenate([np.arange(n), ends.mean(axis=1)])
    number = np.empty(len(rank), dtype=np.int64)
    number[np.argsort(rank, kind="stable")] = np.arange(len(rank))
    positions = np.empty((len(rank), 3))
    positions[number] = np.concatenate([mesh.positions, points[cut]])

    node_of_edge = np.full(len(edges), -1)
    node_of_edge[cut] = number[n:]
    parts = _parts(number[mesh.triangles], node_of_edge[sides], diagonals)
    middle = {(int(a), int(b)): int(node) for (a, b), node in zip(ends, number[n:], strict=True)}
    return mesh.divided(
        positions=positions,
        triangles=parts.triangles,
        parent=parts.parent,
        rings={name: _with_new_nodes(ring, number, middle) for name, ring in mesh.rings.items()},
        caps=tuple(_with_new_nodes(cap, number, middle) for cap in mesh.caps),
        lines={name: number[line] for name, line in mesh.lines.items()},
    )


class _Parts(NamedTuple):
    """Parts (k, 3) of triangles, those of one next to each other, and the triangle (k,) each comes from."""

    triangles: IntArray
    parent: IntArray


def _unambiguous(mesh: NamedMesh, sides: IntArray, points: Array, cut: Mask) -> tuple[Mask, Array]:
    """Return which edges are cut, more where diagonals are alike, and the diagonals (m, 2) [m].

    Args:
        mesh: whose triangles (m, 3).
        sides: (m, 3) edges of each.
        points: (k, 3) [m], where edges would be cut.
        cut: (k,), which are.
    """
    while True:
        first = (~cut[sides]).argmax(axis=1)  # of a triangle with two cut edges the one that is whole
        (a, b, _), (_, bc, ca) = _turned(mesh.triangles, first), _turned(sides, first)
        ends = ((mesh.positions[a], points[bc]), (mesh.positions[b], points[ca]))
        diagonals = np.stack([np.linalg.norm(p - q, axis=1) for p, q in ends], axis=1)
        alike = np.ptp(diagonals, axis=1) < _ALIKE * diagonals[:, 0]
        ambiguous = alike & (cut[sides].sum(axis=1) == 2)
        if not ambiguous.any():
            return cut, diagonals
        cut = cut.copy()
        cut[sides[ambiguous]] = True


def _parts(corners: IntArray, new: IntArray, diagonals: Array) -> _Parts:
    """Return the parts of triangles (m, 3), given the new nodes on edges ab, bc, ca (m, 3) or -1."""
    count = (new >= 0).sum(axis=1)
    by_cuts = [np.flatnonzero(count == cuts) for cuts in range(4)]
    parts = [
        corners[by_cuts[0]][:, None],
        _halves(corners[by_cuts[1]], new[by_cuts[1]]),
        _thirds(corners[by_cuts[2]], new[by_cuts[2]], diagonals[by_cuts[2]]),
        _quarters(corners[by_cuts[3]], new[by_cuts[3]]),
    ]
    parent = np.concatenate([np.repeat(triangles, cuts + 1) for cuts, triangles in enumerate(by_cuts)])
    order = np.argsort(parent, kind="stable")
    return _Parts(
        np.concatenate([triangle_parts.reshape(-1, 3) for triangle_parts in parts])[order], parent[order]
    )


def _turned(table: IntArray, first: IntArray) -> list[IntArray]:
    """Return the columns of a table (m, 3), each row begun at its own column."""
    row = np.arange(len(table))
    return [table[row, (first + k) % 3] for k in range(3)]


def _halves(corners: IntArray, new: IntArray) -> IntArray:
    """Triangles (m, 3) with one edge cut -> (m, 2, 3)."""
    first = (new >= 0).argmax(axis=1)
    a, b, c = _turned(corners, first)
    ab, _, _ = _turned(new, first)
    return np.stack([np.stack(child, axis=1) for child in ((a, ab, c), (ab, b, c))], axis=1)


def _thirds(corners: IntArray, new: IntArray, diagonals: Array) -> IntArray:
    """Triangles (m, 3) with two edges cut -> (m, 3, 3): a corner, and a part cut by its shorter diagonal."""
    first = (new < 0).argmax(axis=1)  # so that ab is whole
    a, b, c = _turned(corners, first)
    _, bc, ca = _turned(new, first)
    shorter = (diagonals[:, 0] < diagonals[:, 1])[:, None, None]
    from_a = np.stack([np.stack(child, axis=1) for child in ((a, b, bc), (a, bc, ca), (bc, c, ca))], axis=1)
    from_b = np.stack([np.stack(child, axis=1) for child in ((a, b, ca), (b, bc, ca), (bc, c, ca))], axis=1)
    return np.where(shorter, from_a, from_b)


def _quarters(corners: IntArray, new: IntArray) -> IntArray:
    """Triangles (m, 3) with all edges cut -> (m, 4, 3)."""
    a, b, c = corners.T
    ab, bc, ca = new.T
    children = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.stack([np.stack(child, axis=1) for child in children], axis=1)


def _with_new_nodes(ring: IntArray, number: IntArray, middle: dict[tuple[int, int], int]) -> IntArray:
    nodes: list[int] = []
    for a, b in zip(ring.tolist(), np.roll(ring, -1).tolist(), strict=True):
        between = middle.get((min(a, b), max(a, b)))
        nodes += [int(number[a])] if between is None else [int(number[a]), between]
    return np.array(nodes, dtype=np.int64)
