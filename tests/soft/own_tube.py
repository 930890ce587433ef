"""A soft body from arrays: a tube with a cuff of thicker film, a cable along its side, and a named ring."""

from __future__ import annotations

import numpy as np

from cosim.build.given_body import NamedBody
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.material import Film
from cosim.soft.geometry.surface import interior_hinges

RADIUS_M, LENGTH_M, SIDES, ROWS = 0.03, 0.2, 12, 12


def tube() -> NamedBody:
    """Return the tube along +z, its first ring on the flange; caps close its ends for the gas."""
    angle = 2.0 * np.pi / SIDES * np.arange(SIDES)
    circle = RADIUS_M * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    positions = np.zeros((ROWS + 1, SIDES, 3))
    positions[:, :, :2] = circle
    positions[:, :, 2] = np.linspace(0.0, LENGTH_M, ROWS + 1)[:, None]
    ring = np.arange((ROWS + 1) * SIDES).reshape(ROWS + 1, SIDES)
    a, b = ring[:-1].ravel(), np.roll(ring[:-1], -1, axis=1).ravel()
    above_a, above_b = a + SIDES, b + SIDES
    # counter-clockwise seen from outside
    triangles = np.concatenate([np.stack([a, b, above_b], 1), np.stack([a, above_b, above_a], 1)])
    row = np.tile(np.repeat(np.arange(ROWS), SIDES), 2)
    film, thick = Film(20e6, 0.3, 1e-4), Film(20e6, 0.3, 2e-4)
    body = SoftBody.from_arrays(
        positions.reshape(-1, 3),
        triangles,
        {"cuff": thick, "wall": film},
        face_groups={"cuff": np.flatnonzero(row == 0), "wall": np.flatnonzero(row > 0)},
        hinge_nodes=interior_hinges(triangles),
        hinge_stiffness=film.bending_stiffness_Nm,
        caps=(ring[0][::-1], ring[-1]),
        cables=(Cable(ring[1:, 0], 0.9),),
        node_mass=5e-4,
        base=ring[0],
        tip=ring[-1],
        rings={"middle": ring[ROWS // 2]},
    )
    return NamedBody(body, "tube", cable_names=("side",))
