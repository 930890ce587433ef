"""Contact with one half-space, for tests of the soft model alone."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Array
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.contact.contact_points import ContactSurface
from cosim.soft.contact.obstacle_contact import ContactPlanes


def half_space(
    surface: ContactSurface,
    normal: Array,
    height_m: float,
    law: ContactLaw,
    friction: Array | float = 0.0,
    anchor: Array | None = None,
) -> ContactPlanes:
    """Return the contact of every point of a body with the half-space normal . y < height_m.

    Args:
        surface: of the body.
        normal: (3,), unit.
        height_m: [m].
        law: of contact.
        friction: (p,) or one number [N].
        anchor: (p, 3) [m]; the origin unless given.
    """
    count = len(surface)
    return ContactPlanes.empty(count, law).changed(
        nodes=surface.nodes,
        weights=surface.weights,
        slots=surface.slots,
        normal=np.tile(normal, (count, 1)),
        offset=np.full(count, height_m),
        stiffness=law.stiffness_N_m3 * surface.area,
        friction=np.array(np.broadcast_to(friction, (count,)), dtype=np.float64),
        anchor=np.zeros((count, 3)) if anchor is None else anchor,
    )
