"""What is asked of cables and pumps: by a phase, and from outside in its place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.config.schema.phase import PhaseTable
from cosim.devices.cable_drive import Order
from cosim.plan.plan import PhasePlan


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
    if phase.cable_tension_N is not None or _finds_tensions(phase):
        return [("tension", tension) for tension in planned.end.cable_tension_N]
    lengths, shortenings = phase.cable_length_m or {}, phase.cable_shortening_m or {}
    orders: list[Order | None] = []
    for name in names:
        if name in lengths:
            orders.append(("length", lengths[name]))
        else:
            orders.append(("shortening", shortenings[name]) if name in shortenings else None)
    return orders


def _finds_tensions(phase: PhaseTable) -> bool:
    return phase.tip_target is not None and phase.tip_target.reach_with == "cables"
