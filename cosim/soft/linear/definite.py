"""Whether a static tangent is still positive definite where it was not factorised: as its pivots fall."""

from dataclasses import dataclass
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array

_FALLEN_MOST: Final = 0.3  # share by which a pivot may fall that is not looked at
_NEAR: Final = 3.0  # how much further than between two tangents
_SHORT: Final = 0.2  # over the way between two tangents
_ALONG: Final = 0.5  # cosine of two ways


@final
@dataclass(frozen=True)
class DefiniteTangent:
    """A static tangent that was positive definite, and how its pivots fell on the way from the one before it.

    Args:
        pivots: see `EnvelopeCholesky.pivots`.
        place: (n, 3) [m], where it was taken, flange axes, from the middle of all nodes.
        way: (n, 3) [m], from the one before; zero for the first one.
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
