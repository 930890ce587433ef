"""Only for the comparison with the published code: bodies with open ends, edges without springs.

The tangent of a body with open ends is that of the closed one, and a small term that is not symmetric.

With K the closed body's tangent, held by springs D at the rings that caps would close, S the free components
of these and E what the missing caps add there, less D,

    (K + S E S^T) x = b,

solved as a term of low rank beside K (`Correction`). What the missing caps take from gradient and tangent is
in `cosim.soft.elements.pressure`.
Source of the edges without springs: the hinge lists of the code's examples UR_Pneumatic (hexagonal) and
Three_Unit_Compare (square units).
"""

from typing import Any, NamedTuple, TypeAlias, final

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from cosim.base.frames import Array, IntArray, Mask
from cosim.base.kernel_types import Blocks, Cubes, Indices, Matrix, Vector
from cosim.base.kernels import address_of, device_function, kernel
from cosim.base.numba_insides import caller
from cosim.soft.elements.pressure import add_cap_stiffness
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.linear.cholesky import EnvelopeCholesky, cholesky
from cosim.soft.linear.envelope_kernels import TileFactor, forward
from cosim.soft.linear.kept_factor import KeptEnvelope
from cosim.soft.linear.linear_solver import Correction, EnvelopeArrays, GeneralLU, LinearSolver, LowRank
from cosim.soft.linear.pattern import BlockPattern

_Rims: TypeAlias = tuple[IntArray, list[tuple[IntArray, ...]], tuple[IntArray, ...], Array]


class RimArrays(NamedTuple):
    """The rings that caps would close, and room for what goes beside the closed body's tangent.

    Args:
        calls: (3,) addresses of `add_cap_stiffness`, `forward` and `fill_inner`.
        nodes: (m,) of all rings, ascending.
        diagonal: (m,), where the pair of each with itself is in the blocks.
        rings: nodes of all rings, ring after ring.
        firsts: (rings + 1,), where those of each begin.
        place: which of the nodes each of these is.
        inside: (k,), components 3 m + axis that can move.
        pressure: (rings,) [Pa], in the chamber that each would close; scratch, as all that follows.
        springs: (m, 3) [N/m], D.
        stiffness: of the largest ring, see `add_cap_stiffness`.
        whole: (3 m, 3 m) [N/m].
        found: (k, equations), L^-1 S.
        work: (k, 2 k).
    """

    calls: Indices
    nodes: Indices
    diagonal: Indices
    rings: Indices
    firsts: Indices
    place: Indices
    inside: Indices
    pressure: Vector
    springs: Matrix
    stiffness: Cubes
    whole: Matrix
    found: Matrix
    work: Matrix


@device_function
def hold_rims(rims: RimArrays, blocks: Blocks) -> None:
    """Add the springs D to a tangent's blocks (b, 3, 3): as stiff as what is there."""
    for m in range(rims.nodes.shape[0]):
        for r in range(3):
            spring = abs(blocks[rims.diagonal[m], r, r])
            rims.springs[m, r] = spring
            blocks[rims.diagonal[m], r, r] += spring


@device_function
def _eliminate(work: Matrix) -> bool:
    """Bring the left half of work (k, 2 k) to the identity; return False where it is singular."""
    size = work.shape[0]
    for p in range(size):
        best = p
        for i in range(p + 1, size):
            if abs(work[i, p]) > abs(work[best, p]):
                best = i
        if not 0.0 < abs(work[best, p]) < np.inf:
            return False
        for c in range(p, 2 * size):
            work[p, c], work[best, c] = work[best, c], work[p, c]
        scale = 1.0 / work[p, p]
        for c in range(p, 2 * size):
            work[p, c] *= scale
        for i in range(size):
            factor = work[i, p]
            if i != p and factor != 0.0:
                for c in range(p, 2 * size):
                    work[i, c] -= factor * work[p, c]
    return True


@kernel(reorder_sums=True)
def fill_inner(rims: RimArrays, inner: Matrix) -> bool:
    """Fill N = (1 + E G)^-1 E (k, k), G = (L^-1 S)^T L^-1 S; return whether there is one."""
    size, found, inside, work = rims.inside.shape[0], rims.found, rims.inside, rims.work
    for i in range(size):
        for k in range(i + 1):
            product = 0.0
            for e in range(found.shape[1]):
                product += found[i, e] * found[k, e]
            inner[i, k] = inner[k, i] = product
    for i in range(size):
        for k in range(size):
            work[i, k], work[i, size + k] = 1.0 if i == k else 0.0, rims.whole[inside[i], inside[k]]
            for m in range(size):
                work[i, k] += rims.whole[inside[i], inside[m]] * inner[m, k]
    if not _eliminate(work):
        return False
    for i in range(size):
        for k in range(size):
            inner[i, k] = work[i, size + k]
    return True


_CALLED = (add_cap_stiffness, forward, fill_inner)
_CAPS, _FORWARD, _INNER = range(len(_CALLED))
_add_cap_stiffness, _forward, _fill_inner = map(caller, _CALLED)


@device_function
def correct_rims(rims: RimArrays, kept: KeptEnvelope, x: Matrix) -> bool:
    """Fill what corrects solutions with the factor of the closed body, held by springs; return if there is.

    Args:
        rims: scratch is filled.
        kept: of one part; `inner` is filled.
        x: (n, 3) [m], where the tangent is.
    """
    whole, factor = rims.whole, kept.factor
    whole[:, :], rims.found[:, :] = 0.0, 0.0
    for m in range(rims.nodes.shape[0]):
        for r in range(3):
            whole[3 * m + r, 3 * m + r] = -rims.springs[m, r]
    for ring in range(rims.firsts.shape[0] - 1):
        begin, end = rims.firsts[ring], rims.firsts[ring + 1]
        count, place = end - begin, rims.place[begin:end]
        rims.stiffness[:count, :count] = 0.0
        _add_cap_stiffness(rims.calls[_CAPS], (x, rims.rings[begin:end], rims.pressure[ring], rims.stiffness))
        for i in range(count):
            for k in range(count):
                for r in range(3):
                    for c in range(3):
                        whole[3 * place[i] + r, 3 * place[k] + c] += rims.stiffness[i, k, r, c]
    tiles = TileFactor(factor.start, factor.first, factor.store, factor.inverse)
    _forward(rims.calls[_FORWARD], (tiles, factor.dofs, kept.vectors, rims.found))
    return _fill_inner(rims.calls[_INNER], (rims, kept.inner))


@final
class OpenCapSolver(LinearSolver):
    """Cholesky of the closed body's tangent with a term of low rank beside it, general LU where it has none.

    As general LU it refuses a singular matrix, not an indefinite one. `extra` holds (nodes, (3 k, 3 k)
    matrix) parts added to the symmetric blocks before factorising.

    Args:
        pattern: of the whole body.
        free: (n, 3) bool, world components that can move.
        far: nodes that are tied together across the mesh.
        like: solver of the same components with fewer ties, whose order of elimination is taken over.
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
        self._arrays: tuple[object, RimArrays] | None = None
        self.extra: list[tuple[IntArray, Array]] = []

    @property
    def closed(self) -> LinearSolver:
        """Of the closed body."""
        return self._closed

    @property
    def multiplications(self) -> float:
        return self._closed.multiplications

    @property
    def rims(self) -> RimArrays | None:
        """What kernels take to make the factorisation again; None where they cannot."""
        closed, correction, known = self._closed, self._correction, self._known
        if self._in_use is not closed or correction is None or known is None or len(closed.apart) > 2:
            return None
        rings, (nodes, _, inside, vectors) = known
        if not isinstance(closed, EnvelopeCholesky) or correction.vectors is not vectors:
            return None
        if self._arrays is None or self._arrays[0] is not known:
            firsts, size = np.cumsum([0, *map(len, rings)]), len(vectors)
            most, count, nodes_of = int(np.diff(firsts).max()), len(nodes), np.concatenate(rings)
            self._arrays = known, RimArrays(
                np.array([address_of(called) for called in _CALLED]), nodes, self._diagonal[nodes], nodes_of,
                firsts, np.searchsorted(nodes, nodes_of), inside[0].ravel(),
                np.empty(len(rings)), np.empty((count, 3)),
                np.empty((most, most, 3, 3)), np.empty((3 * count, 3 * count)),
                np.empty((size, len(closed.envelope.inverse))), np.empty((size, 2 * size)),
            )  # fmt: skip
        return self._arrays[1]

    @property
    def apart(self) -> IntArray:
        return self._closed.apart

    @property
    def envelope(self) -> EnvelopeArrays | None:
        return self._in_use.envelope

    def leave_lent(self, rings: tuple[IntArray, ...]) -> bool:
        """Go on with a copy where a saved state holds the factor; return whether one did.

        Args:
            rings: of the open ends.
        """
        closed, correction = self._closed, self._correction
        if not (isinstance(closed, EnvelopeCholesky) and closed.leave_lent()):
            return False
        if correction is not None:
            vectors = self._rims(rings)[3]
            alike = np.array_equal(vectors, correction.vectors)  # those of another solver are equal alone
            self._correction = Correction(vectors if alike else correction.vectors, correction.inner.copy())
        return True

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
        """Return K's blocks, S^T (k, 3 n) and E (k, k) of what goes beside it, dense terms included.

        Without the springs, under pressure and without the pull of its caps, the closed body would buckle
        like a column.
        """
        nodes, places, inside, vectors = self._rims(tuple(ring for ring, _ in self.extra))
        slots, axes, held = self._diagonal[nodes], np.arange(3), blocks.copy()
        springs = np.abs(blocks[slots][:, axes, axes])
        held[slots[:, None], axes, axes] += springs
        stiffness = -np.diag(springs.ravel())
        for place, (_, part) in zip(places, self.extra, strict=True):
            stiffness[place] += part
        stiffness = stiffness[inside]
        if low_rank is None:
            return held, vectors, stiffness
        dense = low_rank.vectors.reshape(len(low_rank.vectors), -1)
        middle = block_diag(stiffness, np.diag(low_rank.coefficients))
        return held, np.concatenate([vectors, dense]), middle

    def _rims(self, rings: tuple[IntArray, ...]) -> _Rims:
        """Return their nodes, places of each one's entries in E, those of free components, and S^T."""
        if self._known is None or not all(a is b for a, b in zip(rings, self._known[0], strict=True)):
            nodes = np.unique(np.concatenate([np.zeros(0, np.int64), *rings]))
            components = _components(nodes)
            own = [np.searchsorted(components, _components(ring)) for ring in rings]
            inside = np.flatnonzero(self.free.ravel()[components])
            vectors = np.zeros((len(inside), 3 * self.pattern.nodes))
            vectors[np.arange(len(inside)), components[inside]] = 1.0
            places = [np.ix_(place, place) for place in own]
            self._known = rings, (nodes, places, np.ix_(inside, inside), vectors)
        return self._known[1]

    def _factorise(self, blocks: Array, shift: float) -> bool:
        return self.factor(blocks, shift)

    def _lend_factor(self) -> tuple[NDArray[Any], ...]:
        return self._in_use._lend_factor()

    def _take_factor(self, parts: tuple[NDArray[Any], ...]) -> None:
        general = len(parts) == _GENERAL
        if general:
            self._general = self._general or GeneralLU(self.pattern, self.free)
        self._in_use = self._general if general and self._general else self._closed
        self._in_use._take_factor(parts)

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
    bare = {_DIAGONAL, *_CORNER_LINES} if len(mesh.ring(mesh.base_ring)) == 4 else {_DIAGONAL}
    places = _places(mesh)
    return np.array([frozenset({places[j], places[k]}) in bare for j, k in hinges[:, 1:3]], dtype=bool)


def _places(mesh: NamedMesh) -> list[str]:
    """Return where each node lies: "hole", or the ring and whether at a corner or an edge midpoint."""
    places = ["hole"] * len(mesh.positions)
    for name, ring in mesh.rings.items():
        kind = name.rpartition(".")[2]
        if kind in ("lower", "outer", "upper"):
            for place, node in enumerate(ring):
                ring_name = "outer" if kind == "outer" else "mid"
                places[node] = f"{ring_name} {'edge' if place % 2 else 'corner'}"
    return places
