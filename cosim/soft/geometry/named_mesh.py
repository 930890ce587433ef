"""Film surfaces whose nodes have names: what a soft body is made from, however it was drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.geometry.surface import check_face_groups, check_face_values, check_mesh, parts_of_groups

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
        face_groups: places of triangles by name, such as of their own material.
        face_values: (m, ...) of each triangle by name; a part of a triangle has that of the whole.
        sheets: face groups that are flat sheets, welded to one another where they share nodes: film folds
            within a sheet and turns freely between two. None: the film is one surface.
        chambers: face groups that enclose a gas each; every triangle is in one. None: the film encloses one.
        creases: of flat sheets.

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

    def __post_init__(self) -> None:
        check_mesh(self.positions, self.triangles, [self.face_groups[name] for name in self.sheets])
        for key in ("rings", "lines"):
            named = {name: _read_only(nodes) for name, nodes in getattr(self, key).items()}
            for name, nodes in named.items():
                _check_nodes(f"{key[:-1]} {name}", nodes, len(self.positions))
            object.__setattr__(self, key, MappingProxyType(named))
        check_face_groups(self.face_groups, len(self.triangles))
        check_face_values(self.face_values, len(self.triangles))
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
    ) -> NamedMesh:
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
            face_groups=parts_of_groups(self.face_groups, parent),
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
