"""The planned loads between the begin and the end of a phase."""

from __future__ import annotations

from dataclasses import fields
from typing import final

import numpy as np

from cosim.base.frozen import changed
from cosim.soft.body.gas_chamber import pressure_between
from cosim.soft.body.loads import Loads

_RAMPED = {"pressure_Pa", "cable_tension_N"}


@final
class LoadRamp:
    """Loads over the progress of a phase; asked at every tick, so it looks once at what changes at all.

    Args:
        begin: at its start.
        end: at its end.
    """

    def __init__(self, begin: Loads, end: Loads) -> None:
        self.begin, self.end = begin, end
        self._changing = frozenset(
            field.name
            for field in fields(Loads)
            if not _same(getattr(begin, field.name), getattr(end, field.name))
        )

    def at(self, share: float) -> Loads:
        """Return the loads at a share of the way, 0 to 1; see `Loads.interpolated`."""
        begin, end = self.begin, self.end
        if not self._changing or share >= 1.0:
            return end
        if not self._changing <= _RAMPED:
            return begin.interpolated(end, share)
        pulls = zip(begin.cable_tension_N, end.cable_tension_N, strict=True)
        return changed(
            end,
            pressure_Pa=pressure_between(begin.pressure_Pa, end.pressure_Pa, share),
            cable_tension_N=tuple([(1.0 - share) * first + share * last for first, last in pulls]),
        )


def _same(first: object, last: object) -> bool:
    """Return whether two values are one, or equal; different arrays count as different."""
    if first is last:
        return True
    return not isinstance(first, np.ndarray) and not isinstance(last, np.ndarray) and bool(first == last)
