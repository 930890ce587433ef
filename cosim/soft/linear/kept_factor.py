"""A factorisation that is used for later solutions as well, and what Newton's method saves of itself.

A factorisation by its envelope as kernels keep it: solved with, turned with the flange, and rebuilt.

Nodes begin to end of a body are one or more of its parts that nothing couples.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple, final

import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Blocks, Indices, Masks, Matrix
from cosim.base.kernels import address_of, device_function, handing_on_views
from cosim.base.numba_insides import caller
from cosim.soft.linear import linear_solver, pattern, secant_pairs
from cosim.soft.linear.envelope_kernels import TileEntries, TileFactor, factorise, substitute, turned
from cosim.soft.linear.linear_solver import NODE, SOLVED, STORED, TILED, EnvelopeArrays, FactorState

EXTRA_MAX: Final = 8
"""Iterations beyond one a solution that have cost as much as a new factorisation: it is made."""

_FALLEN_MOST: Final = 0.3  # share by which a pivot may fall that is not looked at
_NEAR: Final = 3.0  # how much further than between two tangents
_SHORT: Final = 0.2  # over the way between two tangents
_ALONG: Final = 0.5  # cosine of two ways


@final
@dataclass(frozen=True)
class KeptFactor:
    """For which problem, and at which flange rotation, a part of the factorisation in store was made.

    Args:
        kind: see `Problem.kind`.
        frame: world from flange.
        extra: iterations with it beyond one a solution.
    """

    kind: float
    frame: Annotated[Array, (3, 3)]
    extra: int = 0


KeptParts = tuple[KeptFactor | None, ...]


def nothing_kept(apart: IntArray) -> KeptParts:
    """Return what represents no part kept of those whose nodes begin at `apart` (k + 1,)."""
    return (None,) * (len(apart) - 1)


@final
@dataclass(frozen=True)
class DefiniteTangent:
    """A static tangent that was positive definite, and how its pivots fell on the way from the one before it.

    Args:
        pivots: see `EnvelopeCholesky.pivots`.
        place: (n, 3) [m], where it was taken, flange axes, from the middle of all nodes.
        way: (n, 3) [m], from the one before; zero where there is none to compare with.
        fallen: largest fall of a pivot meanwhile, over what is left of it.
    """

    pivots: Annotated[Array, ("pivots",)]
    place: Annotated[Array, ("nodes", 3)]
    way: Annotated[Array, ("nodes", 3)]
    fallen: float = 0.0

    @classmethod
    def after(
        cls, before: "DefiniteTangent | None", pivots: Array, begin: Array, end: Array
    ) -> "DefiniteTangent":
        """Return one that was made somewhere on a way, at its end if that has no length.

        Args:
            before: the last one.
            pivots: of the new one.
            begin: (n, 3) [m], of the way.
            end: of the way.
        """
        if before is None or len(before.pivots) != len(pivots):
            return cls(pivots, end, np.zeros_like(end))
        along, gone = end - begin, before.place - begin
        share = float((along * gone).sum()) / max(float((along**2).sum()), 1e-300)
        nearest = begin + min(max(share, 0.0), 1.0) * along  # no rate of fall is taken for less than it is
        fallen = float((before.pivots / pivots - 1.0).max(initial=0.0))
        return cls(pivots, end, nearest - before.place, fallen)

    def reaches(self, end: Array, begin: Array | None = None) -> bool:
        """Return whether no pivot falls by much until an end, if they fall as before.

        Args:
            end: (n, 3) [m].
            begin: where the tangent was taken; `place` unless given.
        """
        beyond = end - (self.place if begin is None else begin)
        far, before = (float(np.sqrt((way**2).sum())) for way in (beyond, self.way))
        # another way tells nothing, unless it is short: what rose on this one may fall again, by its share
        follows = float((beyond * self.way).sum()) >= _ALONG * far * before
        return (
            (follows or far <= _SHORT * before)
            and far <= _NEAR * before
            and self.fallen * max(far, before) <= _FALLEN_MOST * before
        )


@final
@dataclass(frozen=True)
class NewtonState:
    """What a solver carries from one solution to the next: kept factors change the iterates.

    Args:
        kept: what each part of the factorisation was made for; None where none is kept.
        factor: the factorisation; None where none is kept of any part.
        gradient: (n, 3) [N], at the last solution.
        wide: pattern of the factorisation where films touched one another; None for the body's own.
        definite: last static tangent that was seen to be so; None for none.
    """

    kept: tuple[KeptFactor | None, ...]
    factor: FactorState | None
    gradient: Annotated[Array, ("nodes", 3)]
    wide: pattern.BlockPattern | None = None
    definite: DefiniteTangent | None = None


_CALLED = (substitute, factorise, secant_pairs.bend_load, secant_pairs.mend_step)
_SUBSTITUTE, _FACTORISE, _BEND, _MEND = range(len(_CALLED))
_substitute, _factorise, _bend_load, _mend_step = map(caller, _CALLED)


def envelope_calls() -> IntArray:
    """Return the addresses (4,) of the kernels that a kept factorisation calls."""
    return np.array([address_of(called) for called in _CALLED])


OUTSIDE: Final = 2
"""Stands for a factorisation that is there, of another kind."""


class KeptEnvelope(NamedTuple):
    """A factorisation by its envelope, and the flange's axes when each part of it was made.

    Args:
        calls: (4,), see `envelope_calls`.
        there: (parts,), 1 where there is one, 0 for none, OUTSIDE for one of another kind.
        made: (parts,), how often a kernel has rebuilt each, or failed to.
        factor: see `EnvelopeArrays`.
        entries: see `EnvelopeEntries`.
        extra: (parts,), iterations with each beyond one a step; see `EXTRA_MAX`.
        frame: (parts, 3, 3), world from flange; of all the same where dense terms go beside the factor.
        vectors: (k, 3 n), W of these, see `Correction`.
        inner: (k, k), N.
        scratch: (1, n, 3).
        share: (1, k).
        free: (n, 3), components that move.
    """

    calls: Indices
    there: Indices
    made: Indices
    factor: EnvelopeArrays
    entries: linear_solver.EnvelopeEntries
    extra: Indices
    frame: Blocks
    vectors: Matrix
    inner: Matrix
    scratch: Blocks
    share: Matrix
    free: Masks


@device_function
def _turn_since(frame: Matrix, flange: Matrix, turn: Matrix) -> None:
    """Fill turn (3, 3) with the rotation from the axes (3, 3) of a factorisation to the flange's."""
    turned = False
    for r in range(3):
        for c in range(3):
            turned |= flange[1 + c, r] != frame[r, c]
    for r in range(3):
        for c in range(3):
            turn[r, c] = 1.0 if r == c and not turned else 0.0
            if turned:
                for k in range(3):
                    turn[r, c] += flange[1 + k, r] * frame[c, k]


@device_function
def is_kept(kept: KeptEnvelope, begin: int, end: int) -> bool:
    """Return whether the factorisation of nodes begin to end is there, and is kept."""
    for k in range(kept.there.shape[0]):
        first, last = kept.factor.parts[k, NODE], kept.factor.parts[k + 1, NODE]
        beyond = first < begin or end < last or kept.there[k] == 0 or kept.extra[k] >= EXTRA_MAX
        if first < end and begin < last and beyond:
            return False
    return True


@device_function
def count_extra(kept: KeptEnvelope, iterations: float, begin: int, end: int) -> None:
    """Count iterations of a step with the factorisation of nodes begin to end."""
    for k in range(kept.there.shape[0]):
        if iterations > 1 and begin <= kept.factor.parts[k, NODE] < end:
            kept.extra[k] += iterations - 1


@handing_on_views
def _factor_of(kept: KeptEnvelope, k: int) -> TileFactor:
    """Return that of part k."""
    factor, a, b = kept.factor, kept.factor.parts[k], kept.factor.parts[k + 1]
    return TileFactor(
        factor.start[a[TILED] : b[TILED]], factor.first[a[TILED] : b[TILED]],
        factor.store[a[STORED] : b[STORED]], factor.inverse[4 * a[TILED] : 4 * b[TILED]],
    )  # fmt: skip


@device_function
def _substitute_parts(
    kept: KeptEnvelope, flange: Matrix, turn: Matrix, begin: int, end: int, solution: Blocks
) -> None:
    """Solve in place with the factor of nodes begin to end; turned to the flange unless that is empty."""
    factor = kept.factor
    for k in range(kept.there.shape[0]):
        a, b = factor.parts[k], factor.parts[k + 1]
        if not begin <= a[NODE] < end:
            continue
        if flange.shape[0] > 0:
            _turn_since(kept.frame[k], flange, turn)
        own = solution[0, a[NODE] : b[NODE]].reshape((1, b[NODE] - a[NODE], 3))
        given = _factor_of(kept, k), factor.dofs[a[SOLVED] : b[SOLVED]], turn, own
        _substitute(kept.calls[_SUBSTITUTE], given)


@device_function
def _solve_dense(kept: KeptEnvelope, flange: Matrix, turn: Matrix, solution: Blocks) -> None:
    """Solve in place with the factor and the dense terms beside it, of all nodes; see `Correction`."""
    load, y, count = kept.scratch[0], solution[0].reshape(solution[0].size), kept.inner.shape[0]
    _turn_since(kept.frame[0], flange, turn)
    turned(solution[0], turn)
    for i in range(load.shape[0]):
        for r in range(3):
            load[i, r] = solution[0, i, r]
    for r in range(3):
        for c in range(3):
            turn[r, c] = 1.0 if r == c else 0.0
    end = load.shape[0]
    _substitute_parts(kept, flange[:0], turn, 0, end, solution)
    for k in range(count):
        kept.share[0, k] = 0.0
        for i in range(y.shape[0]):
            kept.share[0, k] += kept.vectors[k, i] * y[i]
    flat = load.reshape(load.size)
    for k in range(count):
        share = 0.0
        for m in range(count):
            share += kept.inner[k, m] * kept.share[0, m]
        if share != 0.0:
            for i in range(y.shape[0]):
                flat[i] -= share * kept.vectors[k, i]
    for i in range(y.shape[0]):
        y[i] = flat[i]
    _substitute_parts(kept, flange[:0], turn, 0, end, solution)
    _turn_since(kept.frame[0], flange, turn)
    for r in range(3):
        for c in range(r):
            turn[r, c], turn[c, r] = turn[c, r], turn[r, c]
    turned(solution[0], turn)


@device_function
def solve_kept(
    kept: KeptEnvelope,
    axes: tuple[Matrix, Matrix],
    shown: tuple[secant_pairs.SecantPairs, int],
    nodes: tuple[int, int],
    gradient: Matrix,
    solution: Blocks,
) -> float:
    """Fill the solution of nodes begin to end, corrected by some pairs; return its largest component.

    NaN if one is none.

    Args:
        kept: the factorisation.
        axes: (4, 3), see `flange_axes`, and (3, 3), scratch.
        shown: pairs, see `bend_load`, and how many of them there have been.
        nodes: first of them, and the node after the last.
        gradient: (n, 3) [N], of all nodes.
        solution: (1, n, 3) [m], of all nodes; filled.
    """
    flange, turn = axes
    pairs, count = shown
    begin, end = nodes
    found, longest = solution[0, begin:end], 0.0
    _bend_load(kept.calls[_BEND], (pairs, count, gradient[begin:end], found))
    if kept.inner.shape[0] > 0:
        _solve_dense(kept, flange, turn, solution)
    else:
        _substitute_parts(kept, flange, turn, begin, end, solution)
    _mend_step(kept.calls[_MEND], (pairs, count, found))
    for i in range(found.shape[0]):
        for r in range(3):
            if math.isnan(found[i, r]):
                return math.nan
            longest = max(longest, abs(found[i, r]))
    return longest


@device_function
def renew(kept: KeptEnvelope, blocks: Blocks, flange: Matrix, begin: int, end: int) -> bool:
    """Factorise the tangent of nodes begin to end again; return whether it is positive definite.

    Args:
        kept: filled.
        blocks: (b, 3, 3) [N/m], of the tangent of all nodes.
        flange: (4, 3), see `flange_axes`.
        begin: first of the nodes.
        end: the node after the last.
    """
    factor, entries, values = kept.factor, kept.entries, blocks.reshape(blocks.size)
    for k in range(kept.there.shape[0]):
        a, b = factor.parts[k], factor.parts[k + 1]
        if not begin <= a[NODE] < end:
            continue
        first, last = entries.parts[k], entries.parts[k + 1]
        kept.made[k] += 1
        kept.extra[k] = 0
        own = TileEntries(
            entries.source[first[0] : last[0]],
            entries.place[first[0] : last[0]],
            entries.first[first[1] : last[1]],
        )
        given = values, own, 0.0, b[SOLVED] - a[SOLVED], _factor_of(kept, k)
        kept.there[k] = _factorise(kept.calls[_FACTORISE], given)
        for r in range(3):
            for c in range(3):
                kept.frame[k, r, c] = flange[1 + c, r]
        if not kept.there[k]:
            return False
    return True
