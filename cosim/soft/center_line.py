"""The line through the centres of a chamber's hole rings."""

from __future__ import annotations

import numpy as np

from cosim.frames import Array, IntArray
from cosim.soft.body import SoftBody


def hole_rings(body: SoftBody) -> IntArray:
    """Return the hole rings (rings, nodes per ring), base to tip; those of the first of several copies."""
    names = [name for name in body.rings if name.endswith(".hole") and "/" not in name]
    return np.stack([*(body.rings[name] for name in names), body.rings["tip"]])


def center_line_length(rings: IntArray, positions: Array) -> float:
    """Return the length [m] of the polyline through the rings' centres.

    Args:
        rings: (rings, nodes per ring), base to tip.
        positions: (n, 3) [m].
    """
    steps = np.diff(positions[rings].mean(axis=1), axis=0)
    return float(np.sqrt((steps * steps).sum(axis=1)).sum())
