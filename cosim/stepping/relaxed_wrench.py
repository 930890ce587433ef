"""The wrench that an arm gives way to, in rounds with a soft robot that pushes it.

Against something hard a small motion of the flange changes the wrench by more than what moved it: taken as it
is, it would swing between two values for ever. After some rounds that did not settle, only a share of each
change is taken, by Aitken's rule for vectors.
Source: Irons and Tuck, Int. J. Numer. Methods Eng. 1 (1969) 275.
"""

from __future__ import annotations

from typing import final

import numpy as np

from cosim.base.frames import Array, Wrench

_FULL_ROUNDS = 4
_LEAST_SHARE = 0.05


@final
class RelaxedWrench:
    """Gives the wrench of each round."""

    def __init__(self) -> None:
        self._rounds, self._share = 0, 1.0
        self._given: Array | None = None
        self._change: Array | None = None

    def next(self, found: Wrench) -> Wrench:
        """Return the wrench to give way to.

        Args:
            found: of the equilibrium in this round, at the flange's origin, world axes.
        """
        wrench = np.concatenate((found.force, found.torque))
        self._rounds += 1
        if self._given is None:
            self._given = wrench
            return found
        change = wrench - self._given
        if self._change is not None and self._rounds > _FULL_ROUNDS:
            turn = change - self._change
            share = -self._share * float(self._change @ turn) / max(float(turn @ turn), 1e-300)
            self._share = min(1.0, max(_LEAST_SHARE, share))
        self._change, self._given = change, self._given + self._share * change
        return found if self._share == 1.0 else Wrench(self._given[:3], self._given[3:])
