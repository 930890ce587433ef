"""A factorisation that later solutions reuse: rotated with the flange, corrected by secants of its steps.

Its steps are -K^-1 g, with K rotated by the flange's rotation since the factorisation, and corrected by
secant pairs. Iterations of a solution after the first one are counted as extra; once they have cost as much
as a new factorisation, it is not reused any more.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, Mask
from cosim.base.kernels import unchecked
from cosim.soft.linear.cholesky import EnvelopeCholesky
from cosim.soft.linear.envelope_kernels import substitute, substitute_singly
from cosim.soft.linear.linear_solver import LinearSolver, ShiftSearch, Tangent
from cosim.soft.linear.pattern import BlockPattern
from cosim.soft.linear.secant_pairs import SecantPairs, add_pair, secant_load, secant_step
from cosim.soft.linear.vectors import longest

EXTRA_MAX: Final = 8
"""Number of extra iterations that cost as much as a new factorisation."""
_STRAIGHT: Final = np.eye(3)


@final
@dataclass(frozen=True)
class FactorKey:
    """The problem and flange rotation of the stored factorisation.

    Args:
        kind: see `Problem.kind`.
        frame: world from flange.
        extra: number of extra iterations with it.
    """

    kind: float
    frame: Annotated[Array, (3, 3)]
    extra: int = 0


@final
class Factor:
    """Factorises tangents of one body and solves with them.

    Args:
        solver_for: (pattern, like) -> linear solver for blocks of a pattern, in the elimination order of
            another solver if that is not None.
        pattern: of the body.
        free: (n, 3) bool, components that move.
        like: of the same body and clamp, whose elimination order is reused; None for none.
    """

    def __init__(
        self,
        solver_for: Callable[[BlockPattern, LinearSolver | None], LinearSolver],
        pattern: BlockPattern,
        free: Mask,
        like: "Factor | None" = None,
    ) -> None:
        self._solver_for, self._free, self._own = solver_for, free, pattern
        self.narrow: LinearSolver = solver_for(pattern, None if like is None else like.narrow)
        self.solver: LinearSolver = self.narrow
        self.key: FactorKey | None = None
        self._frame, self._frame_bytes, self._known = _STRAIGHT, _STRAIGHT.tobytes(), 0
        self._shifts, self._pairs = ShiftSearch(), SecantPairs.empty(len(free))

    @property
    def pattern(self) -> BlockPattern:
        """Pattern of the blocks that were factorised last."""
        return self.solver.pattern

    def is_usable_for(self, kind: float) -> bool:
        """Return whether it can be reused for a further iteration of a problem of this kind."""
        key = self.key
        return key is not None and key.kind == kind and key.extra < EXTRA_MAX

    def fit(self, pattern: BlockPattern) -> LinearSolver:
        """Return the linear solver for blocks of a pattern; a factorisation of another pattern is lost."""
        if self.solver.pattern is not pattern:
            is_body_pattern = pattern is self._own
            self.solver = self.narrow if is_body_pattern else self._solver_for(pattern, self.narrow)
            self.key = None
        return self.solver

    def make(self, tangent: Tangent, kind: float, frame: Array, shifts: tuple[float, float]) -> int:
        """Factorise a tangent, shifted if it is indefinite; return the attempts, negative if all failed.

        Args:
            tangent: to factorise.
            kind: see `Problem.kind`.
            frame: (3, 3), world from flange.
            shifts: first and largest one [N/m].
        """
        solver, blocks, low_rank = self.fit(tangent.pattern), tangent.blocks, tangent.low_rank
        solver.extra = tangent.caps
        attempts = self._shifts.factor(lambda shift: solver.factor(blocks, shift, low_rank), *shifts)
        self._made(FactorKey(kind, frame) if attempts == 1 else None, frame)
        return attempts

    def set_key(self, key: FactorKey | None) -> None:
        """Set the problem of the stored factorisation; None: later solutions do not reuse it."""
        self._made(key, self._frame if key is None else key.frame)

    def _made(self, key: FactorKey | None, frame: Array) -> None:
        self.key, self._frame, self._known = key, frame, 0
        self._frame_bytes = frame.tobytes()

    def begin(self) -> None:
        """Drop the secants of the last solution."""
        self._known = 0

    def count_extra(self, iterations: int) -> None:
        """Count the extra iterations of a solution with the factorisation."""
        if iterations > 1 and self.key is not None:
            self.key = replace(self.key, extra=self.key.extra + iterations - 1)

    def step(self, gradient: Array, frame: Array, out: Array, *, roughly: bool = False) -> float:
        """Fill the step (n, 3) [m] of a gradient; return its largest component, NaN if one is not a number.

        Args:
            gradient: (n, 3) [N], at the last point.
            frame: (3, 3), world from flange, now.
            out: filled.
            roughly: whether to use the factor in single precision. It is read from memory in half the time,
                and its rounding is far below the change of the tangent since the factorisation.
        """
        unchecked(secant_load)(self._pairs, self._known, gradient, out)
        turn = _STRAIGHT if frame.tobytes() == self._frame_bytes else frame.dot(self._frame.T)
        solver = self.solver
        if isinstance(solver, EnvelopeCholesky) and solver.correction is None:
            leaf = unchecked(substitute_singly if roughly else substitute)
            for factor, dofs, nodes in solver.rounded if roughly else solver.factors:
                leaf(factor, dofs, turn, out[None, nodes])
        else:
            out[:] = solver.solve(out, turn)
        unchecked(secant_step)(self._pairs, self._known, out)
        return unchecked(longest)(out)

    def add_secant(self, step: Array, before: Array, after: Array) -> bool:
        """Add the secant of a step; return whether it was usable.

        Args:
            step: (n, 3) [m].
            before: (n, 3) [N], gradient at the start of the step.
            after: gradient at its end.
        """
        pairs_before = self._known
        self._known = unchecked(add_pair)(self._pairs, pairs_before, step, before, after, self._free)
        return self._known > pairs_before
