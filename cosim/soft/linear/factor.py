"""A factorisation that serves later solutions too: turned with the flange, mended by what its steps show.

Its steps are -K^-1 g, with K turned by as much as the flange has turned since it was made, and corrected by
secant pairs. Each further iteration of a solution with it counts as extra; once those have cost as much as a
new factorisation, it serves no longer.
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
from cosim.soft.linear.secant_pairs import SecantPairs, bend_load, keep_pair, mend_step
from cosim.soft.linear.vectors import longest

EXTRA_MAX: Final = 8
"""Iterations beyond one a solution that have cost as much as a new factorisation: it is made."""
_STRAIGHT: Final = np.eye(3)


@final
@dataclass(frozen=True)
class KeptFactor:
    """For which problem, and at which flange rotation, the factorisation in store was made.

    Args:
        kind: see `Problem.kind`.
        frame: world from flange.
        extra: iterations with it beyond one a solution.
    """

    kind: float
    frame: Annotated[Array, (3, 3)]
    extra: int = 0


@final
class Factor:
    """Factorises tangents of one body and solves with them.

    Args:
        solver_for: makes what factorises blocks of a pattern; in the order of another one, if that is given.
        pattern: the body's own.
        free: (n, 3) bool, components that move.
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
        self.kept: KeptFactor | None = None
        self._frame, self._frame_bytes, self._known = _STRAIGHT, _STRAIGHT.tobytes(), 0
        self._shifts, self._pairs = ShiftSearch(), SecantPairs.room(len(free))

    @property
    def pattern(self) -> BlockPattern:
        """Of the blocks that were factorised last."""
        return self.solver.pattern

    def serves(self, kind: float) -> bool:
        """Return whether it serves a further iteration of a problem of some kind."""
        kept = self.kept
        return kept is not None and kept.kind == kind and kept.extra < EXTRA_MAX

    def fit(self, pattern: BlockPattern) -> LinearSolver:
        """Return what factorises blocks of a pattern; a factorisation of another one is lost."""
        if self.solver.pattern is not pattern:
            own = pattern is self._own
            self.solver = self.narrow if own else self._solver_for(pattern, self.narrow)
            self.kept = None
        return self.solver

    def make(self, tangent: Tangent, kind: float, frame: Array, shifts: tuple[float, float]) -> int:
        """Factorise a tangent, shifted where it is indefinite; return the attempts, negative if all failed.

        Args:
            tangent: what is factorised.
            kind: see `Problem.kind`.
            frame: (3, 3), world from flange.
            shifts: first and largest one [N/m].
        """
        solver, blocks, low_rank = self.fit(tangent.pattern), tangent.blocks, tangent.low_rank
        solver.extra = tangent.caps
        attempts = self._shifts.factor(lambda shift: solver.factor(blocks, shift, low_rank), *shifts)
        self._made(KeptFactor(kind, frame) if attempts == 1 else None, frame)
        return attempts

    def keep(self, kept: KeptFactor | None) -> None:
        """Remember for what the factorisation in store was made; None: it serves no later solution."""
        self._made(kept, self._frame if kept is None else kept.frame)

    def _made(self, kept: KeptFactor | None, frame: Array) -> None:
        self.kept, self._frame, self._known = kept, frame, 0
        self._frame_bytes = frame.tobytes()

    def begin(self) -> None:
        """Forget what the steps of the last solution have shown."""
        self._known = 0

    def count_extra(self, iterations: int) -> None:
        """Count iterations of a solution with the factorisation, beyond the first."""
        if iterations > 1 and self.kept is not None:
            self.kept = replace(self.kept, extra=self.kept.extra + iterations - 1)

    def step(self, gradient: Array, frame: Array, out: Array, *, roughly: bool = False) -> float:
        """Fill the step (n, 3) [m] from a gradient; return its largest component, NaN where one is no number.

        Args:
            gradient: (n, 3) [N], at the last point.
            frame: (3, 3), world from flange, now.
            out: filled.
            roughly: whether single precision will do. The factor of a step in time reads from memory in half
                the time then, and its rounding is far below what the tangent has changed since it was made.
        """
        unchecked(bend_load)(self._pairs, self._known, gradient, out)
        turn = _STRAIGHT if frame.tobytes() == self._frame_bytes else frame.dot(self._frame.T)
        solver = self.solver
        if isinstance(solver, EnvelopeCholesky) and solver.correction is None:
            leaf = unchecked(substitute_singly if roughly else substitute)
            for factor, dofs, own in solver.rounded if roughly else solver.factors:
                leaf(factor, dofs, turn, out[None, own])
        else:
            out[:] = solver.solve(out, turn)
        unchecked(mend_step)(self._pairs, self._known, out)
        return unchecked(longest)(out)

    def show(self, step: Array, before: Array, after: Array) -> bool:
        """Take in what a step has shown of the tangent; return whether it has shown something.

        Args:
            step: (n, 3) [m].
            before: (n, 3) [N], gradient where it began.
            after: the same where it ended.
        """
        known = self._known
        self._known = unchecked(keep_pair)(self._pairs, known, step, before, after, self._free)
        return self._known > known
