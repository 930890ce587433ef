"""Relaxation of the wrench on an arm, in rounds of statics with a soft robot. Against a stiff obstacle, a
small motion of the flange changes the wrench by more than its cause, so unrelaxed rounds would oscillate.
After some rounds, each change is multiplied by a factor of Aitken's rule for vectors. Source: Irons and Tuck,
Int. J. Numer. Methods Eng. 1 (1969) 275.
"""

from typing import Final, final

import numpy as np

from cosim.base.frames import Array, Wrench

_FULL_ROUNDS: Final = 4
_LEAST_FACTOR: Final = 0.05


@final
class RelaxedWrench:
    """Relaxes the wrench of each round of an increment."""

    def __init__(self) -> None:
        self._rounds, self._factor = 0, 1.0
        self._relaxed: Array | None = None
        self._change: Array | None = None

    def next(self, found: Wrench) -> Wrench:
        """Return the relaxed wrench.

        Args:
            found: wrench of the equilibrium in this round, at the flange's origin, world axes.
        """
        wrench = np.concatenate((found.force, found.torque))
        self._rounds += 1
        if self._relaxed is None:
            self._relaxed = wrench
            return found
        change = wrench - self._relaxed
        if self._change is not None and self._rounds > _FULL_ROUNDS:
            turn = change - self._change
            factor = -self._factor * float(self._change @ turn) / max(float(turn @ turn), 1e-300)
            self._factor = min(1.0, max(_LEAST_FACTOR, factor))
        self._change, self._relaxed = change, self._relaxed + self._factor * change
        return found if self._factor == 1.0 else Wrench(self._relaxed[:3], self._relaxed[3:])
