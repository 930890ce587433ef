"""Ticks that are made up: a value for each column, without any physics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.base.column import columns_of, room_for
from cosim.base.columns import TickColumns
from cosim.base.frames import Array
from cosim.coupling.shape_figures import ShapeFigures
from cosim.telemetry.film_shapes import FilmShapes
from cosim.telemetry.tick_batch import Snapshot, TickBatch


def read_film(nodes: Array, volumes_m3: Array, tip: Array, direction: Array, length_m: float) -> FilmShapes:
    """Return one shape that has been read: nodes (n, 3) [m], and its figures."""
    figures = ShapeFigures(tip[None], direction[None], np.array([length_m]), volumes_m3[None])
    return FilmShapes(None, nodes[None], figures)


def made_tick(film: FilmShapes, values: Mapping[str, Any], **rare: Any) -> Snapshot:
    """Return a tick with values of columns by name; others are empty.

    Args:
        film: its shape.
        values: by name; joints, bodies, chambers and cables are as many as there.
        rare: what few ticks have, see `TickBatch`; `devices`.
    """
    counted = {
        "joints": "joint_position",
        "bodies": "body_position",
        "chambers": "chamber_pressure_Pa",
        "cables": "cable_tension_N",
    }
    sizes = {axis: len(values[name]) for axis, name in counted.items()} | {"readings": 0, "energies": 0}
    arrays, kinds = room_for(TickColumns, sizes)(1), columns_of(TickColumns)
    arrays |= {name: np.array([value], type(kinds[name].fill)) for name, value in values.items()}
    devices = rare.pop("devices", None)
    by_row = {name: {0: found} for name, found in rare.items() if found}
    return TickBatch(arrays, film, (devices,), **by_row).snapshot(0)


def changed(snapshot: Snapshot, **values: Any) -> Snapshot:
    """Return a snapshot with other values of columns, or of what few ticks have."""
    kinds, table, rare = columns_of(TickColumns), snapshot.table, dict[str, Any]()
    for name in [*values]:
        if name not in kinds:
            rare[name] = {0: values.pop(name)}
    if "devices" in rare:
        rare["devices"] = (rare["devices"][0],)
    given = {name: np.array([value], type(kinds[name].fill)) for name, value in values.items()}
    return replace(table, arrays={**table.arrays, **given}, **rare).snapshot(0)
