"""Commands for single cables and pumps, from a phase or from live commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, final

from cosim.config.schema.phase import PhaseTable


class Order(NamedTuple):
    """Command to a cable.

    Args:
        kind: of the value.
        value: at the end of a ramp [N or m].
    """

    kind: Literal["tension", "length", "shortening"]
    value: float

    def end(self, begin: float) -> float:
        """Return the tension [N] or length [m] at the end of a ramp."""
        return begin - self.value if self.kind == "shortening" else self.value


@final
@dataclass(frozen=True)
class LiveOrders:
    """Live commands to cables and pumps; None: not commanded.

    Args:
        cables: of each cable.
        pump_pressure_Pa: setpoint of each pump.
    """

    cables: tuple[Order | None, ...]
    pump_pressure_Pa: tuple[float | None, ...]


def orders_of(
    phase: PhaseTable, end_tension_N: tuple[float, ...], names: tuple[str, ...]
) -> list[Order | None]:
    """Return the command of a phase to each cable; None: unchanged.

    Args:
        phase: of the scenario.
        end_tension_N: planned at its end, of each cable.
        names: of all cables, in order.
    """
    target = phase.tip_target
    if phase.cable_tension_N is not None or (target is not None and target.reach_with == "cables"):
        return [Order("tension", tension) for tension in end_tension_N]
    lengths, shortenings = phase.cable_length_m or {}, phase.cable_shortening_m or {}
    orders: list[Order | None] = []
    for name in names:
        if name in lengths:
            orders.append(Order("length", lengths[name]))
        else:
            orders.append(Order("shortening", shortenings[name]) if name in shortenings else None)
    return orders
