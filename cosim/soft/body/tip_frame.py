"""Where the tip of a body is, and how it moves with the nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.soft.body.body import SoftBody


@final
@dataclass(frozen=True)
class TipFrame:
    """Position, direction and frame of the tip ring, and how they move with the nodes.

    Args:
        position: (3,) [m], mean of the ring.
        rotation: (3, 3); the last column is the ring's unit normal, the first points to its first node.
    """

    position: Array
    rotation: Array

    @classmethod
    def of(cls, body: SoftBody, positions: Array) -> TipFrame:
        """Return the tip frame at the given node positions (n, 3) [m]."""
        center = body.tip_position(positions)
        z = body.tip_direction(positions)
        x = positions[body.tip[0]] - center
        x = x - (x @ z) * z
        x = x / np.linalg.norm(x)
        return cls(center, np.stack([x, np.cross(z, x), z], axis=1))

    @property
    def direction(self) -> Array:
        """(3,), unit normal of the ring, away from the base."""
        return np.asarray(self.rotation[:, 2])

    def motion(self, body: SoftBody, positions: Array, displacement: Array) -> Array:
        """Return the tip's (6,) displacement [m] and rotation [rad] under a nodal displacement.

        Args:
            body: whose tip it is.
            positions: (n, 3) [m].
            displacement: (n, 3) [m], infinitesimal.
        """
        ring, moved = positions[body.tip], displacement[body.tip]
        shift = moved.mean(axis=0)
        x, _, z = self.rotation.T
        area = np.cross(ring, np.roll(ring, -1, axis=0)).sum(axis=0)
        d_area = (
            np.cross(moved, np.roll(ring, -1, axis=0)) + np.cross(ring, np.roll(moved, -1, axis=0))
        ).sum(0)
        dz = (d_area - (d_area @ z) * z) / np.linalg.norm(area)
        arm, d_arm = ring[0] - self.position, moved[0] - shift
        flat = arm - (arm @ z) * z
        d_flat = d_arm - (d_arm @ z + arm @ dz) * z - (arm @ z) * dz
        dx = (d_flat - (d_flat @ x) * x) / np.linalg.norm(flat)
        # the rotation w has w x z = dz and (w x x) . (z x x) = w . z
        spin = float(dx @ np.cross(z, x))
        return np.concatenate([shift, np.cross(z, dz) + spin * z])
