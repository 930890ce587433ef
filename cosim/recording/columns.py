"""Columns of one component, and of time, for many ticks at once. They are made directly from arrays: an
archetype's `columns` would process every field that it has.
"""

from typing import Any

import rerun as rr

from cosim.base.frames import IntArray
from cosim.recording.entity_paths import TICKS, TIMELINE


def column(archetype: Any, field: str, batch: Any, lengths: IntArray | None = None) -> rr.ComponentColumn:
    """Return a column of one component.

    Args:
        archetype: such as `rr.Mesh3D`.
        field: of the archetype, such as "vertex_positions".
        batch: the component's values in all rows, such as `rr.components.Position3DBatch(...)`.
        lengths: number of values in each row; None for one.
    """
    name = f"{archetype.archetype_short_name()}:{field}"
    kind = rr.ComponentDescriptor(
        name, component_type=batch.component_type(), archetype=archetype.archetype()
    )
    return rr.ComponentColumn(kind, batch, lengths=lengths)


def time_columns(ticks: IntArray, tick_ns: int) -> list[rr.TimeColumn]:
    """Return both timelines of some ticks; whole nanoseconds, because rounded seconds would not join.

    Args:
        ticks: (n,), rising.
        tick_ns: length of a tick [ns].
    """
    duration = (ticks * tick_ns).astype("timedelta64[ns]")
    return [rr.TimeColumn(TIMELINE, duration=duration), rr.TimeColumn(TICKS, sequence=ticks)]
