"""Bodies with open ends and edges without springs, for the comparison with the published code only.

The tangent of a body with open ends is that of the closed one plus a small unsymmetric term. With K the
closed body's tangent, held by springs D at the rings of the missing caps, S the free components of these, and
E the terms of the missing caps less D,
    (K + S E S^T) x = b
is solved by a correction of low rank (`Correction`). The terms of missing caps are in
`cosim.soft.elements.pressure`.
Source of the edges without springs: the hinge lists of the code's examples UR_Pneumatic (hexagonal) and
Three_Unit_Compare (square units).
"""

from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray, Mask
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.linear.cholesky import cholesky
from cosim.soft.linear.linear_solver import Correction, GeneralLU, LinearSolver, LowRank
from cosim.soft.linear.pattern import BlockPattern

_Rims: TypeAlias = tuple[IntArray, list[tuple[IntArray, ...]], tuple[IntArray, ...], Array]


@final
class OpenCapSolver(LinearSolver):
    """Cholesky of the closed body's tangent with a correction of low rank; general LU if that fails.

    As general LU it refuses a singular matrix, not an indefinite one. `extra` holds (nodes, (3 k, 3 k)
    matrix) parts added to the symmetric blocks before factorising.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, world components that can move.
        far: nodes that are tied together across the mesh.
        like: solver of the same components with fewer couplings, whose elimination order is reused.
    """

    def __init__(
        self, pattern: BlockPattern, free: Mask, far: IntArray, like: LinearSolver | None = None
    ) -> None:
        super().__init__(pattern, free)
        closed: LinearSolver | None = like._closed if isinstance(like, OpenCapSolver) else None
        self._closed: LinearSolver = cholesky(pattern, self.free, far, closed)
        self._diagonal = np.flatnonzero(pattern.row == pattern.column)  # node by node
        self._general: GeneralLU | None = None  # made when it is needed
        self._in_use: LinearSolver = self._closed
        self._known: tuple[tuple[IntArray, ...], _Rims] | None = None  # where the last rings are

    @property
    def multiplications(self) -> float:
        return self._closed.multiplications

    def factor(self, blocks: Array, shift: float = 0.0, low_rank: LowRank | None = None) -> bool:
        held, vectors, middle = self._beside(blocks, low_rank)
        self._in_use, self._correction = self._closed, None
        if self._closed.factor(held, shift):
            self._correction = Correction.unsymmetric(vectors, middle, self._closed._product)
        if self._correction is not None:
            return True
        self._in_use = self._general = self._general or GeneralLU(self.pattern, self.free)
        self._general.extra = self.extra
        if not self._general.factor(blocks, shift):
            return False
        if low_rank is not None:
            dense = low_rank.vectors.reshape(len(low_rank.vectors), -1), np.diag(low_rank.coefficients)
            self._correction = Correction.unsymmetric(*dense, self._general._product)
        return low_rank is None or self._correction is not None

    def _beside(self, blocks: Array, low_rank: LowRank | None) -> tuple[Array, Array, Array]:
        """Return K's blocks, and S^T (k, 3 n) and E (k, k) of the correction, dense terms included.

        Without the springs, under pressure and without the pull of its caps, the closed body would buckle
        like a column.
        """
        nodes, entries_of_rings, inside, vectors = self._rims(tuple(ring for ring, _ in self.extra))
        slots, axes, sprung_blocks = self._diagonal[nodes], np.arange(3), blocks.copy()
        springs = np.abs(blocks[slots][:, axes, axes])
        sprung_blocks[slots[:, None], axes, axes] += springs
        stiffness = -np.diag(springs.ravel())
        for entries, (_, cap_terms) in zip(entries_of_rings, self.extra, strict=True):
            stiffness[entries] += cap_terms
        stiffness = stiffness[inside]
        if low_rank is None:
            return sprung_blocks, vectors, stiffness
        dense = low_rank.vectors.reshape(len(low_rank.vectors), -1)
        from scipy.linalg import block_diag  # imported here because it takes long to load

        middle = block_diag(stiffness, np.diag(low_rank.coefficients))
        return sprung_blocks, np.concatenate([vectors, dense]), middle

    def _rims(self, rings: tuple[IntArray, ...]) -> _Rims:
        """Return their nodes, places of each one's entries in E, those of free components, and S^T."""
        if self._known is None or not all(a is b for a, b in zip(rings, self._known[0], strict=True)):
            nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *rings]))
            components = _components(nodes)
            indices_of_rings = [np.searchsorted(components, _components(ring)) for ring in rings]
            inside = np.flatnonzero(self.free.ravel()[components])
            vectors = np.zeros((len(inside), 3 * self.pattern.nodes))
            vectors[np.arange(len(inside)), components[inside]] = 1.0
            entries_of_rings = [np.ix_(indices, indices) for indices in indices_of_rings]
            self._known = rings, (nodes, entries_of_rings, np.ix_(inside, inside), vectors)
        return self._known[1]

    def _factorise(self, blocks: Array, shift: float) -> bool:
        return self.factor(blocks, shift)

    def _export_factor(self) -> tuple[NDArray[Any], ...]:
        return self._in_use._export_factor()

    def _import_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        general = len(parts) == _GENERAL
        if general:
            self._general = self._general or GeneralLU(self.pattern, self.free)
        self._in_use = self._general if general and self._general else self._closed
        self._in_use._import_factor(parts)

    def _solve_sparse(self, loads: Array) -> Array:
        return self._in_use._solve_sparse(loads)


_GENERAL = 3  # parts of a general factor; those of Cholesky's are fewer


def _components(ring: IntArray) -> IntArray:
    return np.ravel(3 * ring[:, None] + np.arange(3))


_DIAGONAL = frozenset({"mid corner", "outer edge"})
_CORNER_LINES = (frozenset({"hole", "mid corner"}), frozenset({"mid corner", "outer corner"}))


def without_spring(mesh: NamedMesh, hinges: IntArray) -> Mask:
    """Return which hinges (h,) the published models lack, on an unrefined mesh.

    In every chamber the edges from a mid ring's corner to an outer edge midpoint; in square ones also
    the lines along the corners, from hole to outer ring.

    Args:
        mesh: a stack of polygonal units.
        hinges: (h, 4) nodes i, j, k, l; j-k is the edge.
    """
    springless = {_DIAGONAL, *_CORNER_LINES} if len(mesh.ring(mesh.base_ring)) == 4 else {_DIAGONAL}
    node_kinds = _places(mesh)
    return np.array(
        [frozenset({node_kinds[j], node_kinds[k]}) in springless for j, k in hinges[:, 1:3]], dtype=bool
    )


def _places(mesh: NamedMesh) -> list[str]:
    """Return where each node lies: "hole", or the ring and whether at a corner or an edge midpoint."""
    node_kinds = ["hole"] * len(mesh.positions)
    for name, ring in mesh.rings.items():
        kind = name.rpartition(".")[2]
        if kind in ("lower", "outer", "upper"):
            for index, node in enumerate(ring):
                ring_name = "outer" if kind == "outer" else "mid"
                node_kinds[node] = f"{ring_name} {'edge' if index % 2 else 'corner'}"
    return node_kinds
