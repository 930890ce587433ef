"""Extrapolation of pivots, to know whether a static tangent is positive definite without factorising it."""

from dataclasses import dataclass
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array

_FALLEN_MOST: Final = 0.3  # largest relative fall of a pivot that is accepted without a check
_NEAR: Final = 3.0  # largest distance, over that of the last two tangents
_SHORT: Final = 0.2  # distance, over that of the last two tangents, below which any direction is accepted
_ALONG: Final = 0.5  # least cosine of the directions


@final
@dataclass(frozen=True)
class DefiniteTangent:
    """A static tangent that was positive definite, and the fall of its pivots since the one before it.

    Args:
        pivots: see `EnvelopeCholesky.pivots`.
        shape: (n, 3) [m], of the tangent, flange axes, about the mean of all nodes.
        motion: (n, 3) [m], from the shape of the tangent before; zero for the first one.
        fallen: largest fall of a pivot since then, over its new value.
    """

    pivots: Annotated[Array, ("pivots",)]
    shape: Annotated[Array, ("nodes", 3)]
    motion: Annotated[Array, ("nodes", 3)]
    fallen: float = 0.0

    @classmethod
    def after(
        cls, before: "DefiniteTangent | None", pivots: Array, begin: Array, end: Array
    ) -> "DefiniteTangent":
        """Return the record of a new tangent, somewhere between two shapes, which may be the same.

        Args:
            before: the last record.
            pivots: of the new tangent.
            begin: (n, 3) [m], one shape.
            end: the other shape.
        """
        if before is None or len(before.pivots) != len(pivots):
            return cls(pivots, end, np.zeros_like(end))
        along, offset = end - begin, before.shape - begin
        fraction = float((along * offset).sum()) / max(float((along**2).sum()), 1e-300)
        nearest = begin + min(max(fraction, 0.0), 1.0) * along  # so that the rate is not underestimated
        fallen = float((before.pivots / pivots - 1.0).max(initial=0.0))
        return cls(pivots, end, nearest - before.shape, fallen)

    def reaches(self, end: Array, begin: Array | None = None) -> bool:
        """Return whether no pivot falls by much up to another shape, extrapolated at the last rate.

        Args:
            end: (n, 3) [m].
            begin: shape of the tangent; None for `shape`.
        """
        beyond = end - (self.shape if begin is None else begin)
        far, before = (float(np.sqrt((motion**2).sum())) for motion in (beyond, self.motion))
        # in another direction the rate is valid for short motions only: pivots that rose may fall again
        follows = float((beyond * self.motion).sum()) >= _ALONG * far * before
        return (
            (follows or far <= _SHORT * before)
            and far <= _NEAR * before
            and self.fallen * max(far, before) <= _FALLEN_MOST * before
        )
