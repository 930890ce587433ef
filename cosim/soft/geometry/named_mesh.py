"""Film surfaces whose nodes have names: what a soft body is made from, however it was drawn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import MeshError
from cosim.soft.geometry.surface import check_mesh


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
        lines: nodes by name that a cable may lead through, base to tip.

    Raises:
        MeshError: see `cosim.soft.geometry.surface.check_mesh`; or a ring or line names a node that does not
            exist, or a ring has no nodes.
    """

    positions: Array
    triangles: IntArray
    rings: Mapping[str, IntArray]
    caps: tuple[IntArray, ...]
    base_ring: str
    tip_ring: str
    seam_rings: tuple[str, ...] = ()
    lines: Mapping[str, IntArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_mesh(self.positions, self.triangles)
        for key in ("rings", "lines"):
            named = {name: _read_only(nodes) for name, nodes in getattr(self, key).items()}
            for name, nodes in named.items():
                _check_nodes(f"{key[:-1]} {name}", nodes, len(self.positions))
            object.__setattr__(self, key, MappingProxyType(named))
        positions = np.array(self.positions, dtype=np.float64)
        positions.setflags(write=False)
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "triangles", _read_only(self.triangles))
        object.__setattr__(self, "caps", tuple(_read_only(cap) for cap in self.caps))

    @property
    def seam(self) -> IntArray:
        """Nodes where two films are welded, ascending."""
        return np.unique(np.concatenate([np.zeros(0, np.int64), *(self.rings[n] for n in self.seam_rings)]))

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


def _read_only(indices: IntArray) -> IntArray:
    array = np.array(indices, dtype=np.int64)
    array.setflags(write=False)
    return array
