"""The least shift that makes a matrix positive definite."""

from __future__ import annotations

from collections.abc import Callable
from typing import final

_GROWTH = 6.0


@final
class ShiftSearch:
    """Searches the least shift mu_k = mu_0 6^k that makes a matrix positive definite.

    A matrix that is definite with a shift is so with any larger one. Hence a search may begin anywhere and
    find the same: next to where the last one ended it takes two or three factorisations, instead of one for
    each shift below.
    """

    def __init__(self) -> None:
        self._power = 0

    def factor(self, definite: Callable[[float], bool], start: float, most: float) -> int:
        """Factorise with no shift or the first that serves; return the attempts, negative if none did.

        Args:
            definite: factorises with a shift; whether the matrix is positive definite. Its last call counts.
            start: mu_0, larger than 0.
            most: largest shift.
        """
        attempts = 0

        def serves(power: int) -> bool:
            nonlocal attempts
            attempts += 1
            return definite(start * _GROWTH**power)

        if definite(0.0):
            return 1
        power = max(0, self._power - 1)
        if serves(power):
            while power > 0 and serves(power - 1):
                power -= 1
            if power > 0:  # the last attempt failed
                serves(power)
        else:
            while not serves(power := power + 1):
                if start * _GROWTH ** (power + 1) > most:
                    return -1 - attempts
        self._power = power
        return 1 + attempts
