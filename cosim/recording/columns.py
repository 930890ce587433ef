"""Columns of components, straight from arrays: an archetype's `columns` looks at every field that it has."""

from __future__ import annotations

from typing import Any

import rerun as rr

from cosim.base.frames import IntArray


def column(archetype: Any, field: str, batch: Any, lengths: IntArray | None = None) -> rr.ComponentColumn:
    """Return a column of one component.

    Args:
        archetype: such as `rr.Mesh3D`.
        field: of the archetype, such as "vertex_positions".
        batch: the component's values in all rows, such as `rr.components.Position3DBatch(...)`.
        lengths: values of each row; None: one.
    """
    name = f"{archetype.archetype_short_name()}:{field}"
    kind = rr.ComponentDescriptor(
        name, component_type=batch.component_type(), archetype=archetype.archetype()
    )
    return rr.ComponentColumn(kind, batch, lengths=lengths)
