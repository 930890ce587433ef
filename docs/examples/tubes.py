"""An open tube as a source of soft bodies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, final

import numpy as np

from cosim.config.schema.body_sources import BodySourceTable
from cosim.config.toml.quantities import Count, Positive
from cosim.soft.geometry.named_mesh import NamedMesh
from cosim.soft.geometry.surface import rims


@final
@dataclass(frozen=True, kw_only=True)
class TubeTable(BodySourceTable):
    """A tube along the flange's z axis, its first ring on the flange.

    Args:
        sides: nodes of each ring.
        rows: of triangles between the rings.
    """

    kind: Literal["tube"] = "tube"
    radius_m: Positive
    length_m: Positive
    sides: Count = 12
    rows: Count = 12

    def set_names(self) -> tuple[str, ...]:
        return ("base", "middle", "tip", "side")

    def mesh(self) -> NamedMesh:
        angle = 2.0 * np.pi / self.sides * np.arange(self.sides)
        positions = np.zeros((self.rows + 1, self.sides, 3))
        positions[:, :, 0] = self.radius_m * np.cos(angle)
        positions[:, :, 1] = self.radius_m * np.sin(angle)
        positions[:, :, 2] = np.linspace(0.0, self.length_m, self.rows + 1)[:, None]
        ring = np.arange((self.rows + 1) * self.sides).reshape(self.rows + 1, self.sides)
        a, b = ring[:-1].ravel(), np.roll(ring[:-1], -1, axis=1).ravel()
        above_a, above_b = a + self.sides, b + self.sides
        triangles = np.concatenate([np.stack([a, b, above_b], 1), np.stack([a, above_b, above_a], 1)])
        side = ring[1:, 0]
        sets = {"base": ring[0], "middle": ring[self.rows // 2], "tip": ring[-1], "side": side}
        return NamedMesh(
            positions.reshape(-1, 3), triangles, sets, rims(triangles), "base", "tip", lines={"side": side}
        )
