"""A root of r(l) by secants that are kept from one problem to the next, much alike, problem.

With the pairs (dl, dr) of the present problem as columns of L and V, and H the approximate inverse of dr/dl
at its start, the inverse is H + (L - H V) V^+ (V^+: least squares), and the step is -(that) r.
Sources: Degroote, Bathe, Vierendeels, Computers and Structures 87 (2009) 793 (IQN-ILS);
Bogaers, Kok, Reddy, Franz, CMAME 279 (2014) 113 (the inverse is kept: MVQN).
"""

from __future__ import annotations

from typing import final

import numpy as np

from cosim.base.frames import Array

_INDEPENDENT = 1e-8  # singular values of V, over the largest, below which secants say nothing
_LEARNT = 1e-6  # secants below this share of the interface's load are rounding, and are not kept


@final
class QuasiNewton:
    """Steps towards the root; all vectors are in comparable units.

    Args:
        inverse: (n, n), approximate inverse of dr/dl.
    """

    def __init__(self, inverse: Array) -> None:
        self._inverse = np.array(inverse)
        self._loads: list[Array] = []
        self._residuals: list[Array] = []

    def step(self, load: Array, residual: Array) -> Array:
        """Take in r (n,) at l (n,), and return the step (n,) to where the root should be."""
        self._loads.append(load)
        self._residuals.append(residual)
        return -(self._updated(0.0) @ residual)

    def inverse(self, scale: float) -> Array:
        """Return the inverse (n, n) with what was learnt, above the rounding of loads of a size."""
        return self._updated(_LEARNT * scale)

    def _updated(self, smallest: float) -> Array:
        moved = np.diff(np.array(self._loads), axis=0).T if len(self._loads) > 1 else None
        if moved is None:
            return self._inverse
        changed = np.diff(np.array(self._residuals), axis=0).T
        length = np.linalg.norm(changed, axis=0)
        kept = length > max(smallest, 1e-300)
        if not kept.any():
            return self._inverse
        # of unit length: a late, short secant counts as much as an early one
        moved, changed = moved[:, kept] / length[kept], changed[:, kept] / length[kept]
        solved = np.linalg.pinv(changed, rcond=_INDEPENDENT)
        return np.asarray(self._inverse + (moved - self._inverse @ changed) @ solved)
