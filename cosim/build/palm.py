"""A soft robot's palm as the rigid side and the arm's feedforward want it."""

from __future__ import annotations

import numpy as np

from cosim.config.schema.soft_robot import PalmTable
from cosim.coupling.soft_sides.mass import MassProperties
from cosim.rigid.build.description import SceneObject

PALM_NAME = "palm"


def palm_object(palm: PalmTable) -> SceneObject:
    """Return the plate in the flange frame."""
    return SceneObject(
        PALM_NAME, "cylinder", (palm.radius_m, palm.thickness_m), (0.0, 0.0, 0.5 * palm.thickness_m),
        mass_kg=palm.mass_kg, rgba=palm.rgba, friction=palm.friction,
    )  # fmt: skip


def palm_mass(palm: PalmTable) -> MassProperties:
    """Return the plate's mass in the flange frame; I_x = I_y = m (3 r^2 + t^2) / 12, I_z = m r^2 / 2."""
    r, t = palm.radius_m, palm.thickness_m
    across, along = palm.mass_kg * (3.0 * r * r + t * t) / 12.0, 0.5 * palm.mass_kg * r * r
    return MassProperties(palm.mass_kg, np.array([0.0, 0.0, 0.5 * t]), np.diag([across, across, along]))
