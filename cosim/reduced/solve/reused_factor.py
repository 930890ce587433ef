"""The factor of a step's tangent, for reuse at the start of the next step."""

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array
from cosim.reduced.sections.chain_arrays import ChainWork
from cosim.soft.solve.step_prediction import StepCoefficients


@final
@dataclass(frozen=True)
class SavedFactor:
    """Saved state of a factor that may be reused.

    Args:
        low: (f, 6, 6), diagonal blocks of the Cholesky factor.
        side: (f, 6, 6), off-diagonal blocks.
        two_steps: whether its step is one of a two-step scheme.
        span_s: span of its step, see `StepCoefficients`.
    """

    low: Annotated[Array, ("frames", 6, 6)]
    side: Annotated[Array, ("frames", 6, 6)]
    two_steps: bool
    span_s: float


@final
class ReusedFactor:
    """A factor in `work`, for steps of one length and scheme with the same clamp object.

    Args:
        work: work arrays; all but those of the factor are shared.
    """

    def __init__(self, work: ChainWork) -> None:
        self.work = work._replace(low=np.zeros_like(work.low), side=np.zeros_like(work.side))
        self._of: tuple[object, bool, float] | None = None

    def is_of(self, clamp: object, coefficients: StepCoefficients) -> bool:
        """Return whether a step with this clamp and scheme can reuse the factor."""
        step = self._of
        return (
            step is not None
            and step[0] is clamp
            and step[1] == coefficients.two_steps
            and step[2] == coefficients.span
        )

    def keep(self, reusable: bool, clamp: object, coefficients: StepCoefficients) -> None:
        """Set the last step that made or used the factor, and whether the next step may reuse it."""
        self._of = (clamp, coefficients.two_steps, coefficients.span) if reusable else None

    def save_state(self, clamp: object) -> SavedFactor | None:
        """Return the factor for a clamp; None if none was made."""
        if self._of is None or self._of[0] is not clamp:
            return None
        return SavedFactor(self.work.low.copy(), self.work.side.copy(), *self._of[1:])

    def restore_state(self, state: SavedFactor | None, clamp: object) -> None:
        """Return to a state of `save_state`, with the clamp of that moment."""
        self._of = None
        if state is not None:
            self.work.low[:], self.work.side[:] = state.low, state.side
            self._of = clamp, state.two_steps, state.span_s
