"""Snapshots as numbers that can be compared."""

from __future__ import annotations

from typing import Any

import numpy as np

from cosim.telemetry.tick_batch import Snapshot


def numbers(snapshot: Snapshot) -> dict[str, Any]:
    """Return what a snapshot shows, as arrays, wall time left out."""
    left_out = ("scheme", "tick_wall_s")
    stored = {name: array[0] for name, array in snapshot.table.arrays.items() if name not in left_out}
    read = ("node_position", "chamber_volume_m3", "tip_position", "sag_m", "power_error")
    return {**stored, **{name: np.asarray(getattr(snapshot, name)) for name in read}}


def assert_close(found: list[Snapshot], expected: list[Snapshot], tolerance: float) -> None:
    assert len(found) == len(expected)
    for one, other in zip(found, expected, strict=True):
        mine, others = numbers(one), numbers(other)
        for name, value in mine.items():
            np.testing.assert_allclose(value, others[name], rtol=tolerance, atol=tolerance, err_msg=name)
