"""The factor of a step's tangent, kept for the steps to come while it serves them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array
from cosim.reduced.solve.clamp import FrameClamp


@final
@dataclass(frozen=True)
class KeptTangentState:
    """A kept factor.

    Args:
        low: (f, 6, 6), see `block_cholesky`.
        side: (f, 6, 6).
        step_s: length of the step that it was made in [s].
        two_steps: whether that looked back over two steps.
    """

    low: Annotated[Array, ("frames", 6, 6)]
    side: Annotated[Array, ("frames", 6, 6)]
    step_s: float
    two_steps: bool


@final
class KeptTangent:
    """Owns the factor; it serves steps of one length and scheme in one clamp.

    Args:
        count: of the frames.
    """

    def __init__(self, count: int) -> None:
        self.low, self.side = np.zeros((count, 6, 6)), np.zeros((count, 6, 6))
        self._clamp: FrameClamp | None = None
        self._step_s, self._two_steps = 0.0, False

    def serves(self, clamp: FrameClamp, step_s: float, two_steps: bool) -> bool:
        """Whether there is a factor that such a step may begin with."""
        return clamp is self._clamp and step_s == self._step_s and two_steps == self._two_steps

    def keep(self, kept: bool, clamp: FrameClamp, step_s: float, two_steps: bool) -> None:
        """Note the step in which the factor was made or used last, and whether it is worth keeping."""
        self._clamp, self._step_s, self._two_steps = clamp if kept else None, step_s, two_steps

    def save_state(self, clamp: FrameClamp) -> KeptTangentState | None:
        """Return the factor; None where none is kept for a clamp."""
        if clamp is not self._clamp:
            return None
        return KeptTangentState(self.low.copy(), self.side.copy(), self._step_s, self._two_steps)

    def restore_state(self, state: KeptTangentState | None, clamp: FrameClamp) -> None:
        """Return to a state of `save_state`, with the clamp of that moment."""
        if state is None:
            self._clamp = None
            return
        self.low[:], self.side[:] = state.low, state.side
        self.keep(True, clamp, state.step_s, state.two_steps)
