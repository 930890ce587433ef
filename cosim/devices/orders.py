"""x"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, final

from cosim.plan.plan import PhasePlan

Order: TypeAlias = tuple[Literal["tension", "length", "shortening"], float]
"""What a phase asks of a cable, at the end of its ramp [N or m]."""


def _end(order: Order | None, begin: float) -> float:
    """Return the tension [N] or length [m] at the end of a ramp."""
    if order is None:
        return begin
    return begin - order[1] if order[0] == "shortening" else order[1]


@final
@dataclass(frozen=True)
class LiveOrders:
    """What is commanded from outside; None: nothing is.

    Args:
        cables: of each cable.
        pump_pressure_Pa: setpoint of each pump.
    """

    cables: tuple[Order | None, ...]
    pump_pressure_Pa: tuple[float | None, ...]


def orders_of(planned: PhasePlan, names: tuple[str, ...]) -> list[Order | None]:
    """Return what a phase asks of each cable."""
    phase = planned.phase
    target = phase.tip_target
    if phase.cable_tension_N is not None or (target is not None and target.reach_with == "cables"):
        return [("tension", tension) for tension in planned.end.cable_tension_N]
    lengths, shortenings = phase.cable_length_m or {}, phase.cable_shortening_m or {}
    orders: list[Order | None] = []
    for name in names:
        if name in lengths:
            orders.append(("length", lengths[name]))
        else:
            orders.append(("shortening", shortenings[name]) if name in shortenings else None)
    return orders
