"""Figures of a shape, and their differences between two shapes."""

from typing import Any

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.coupling.robots.film_robot import FilmRobot
from cosim.soft.beams.beam_rings import stiffener_strain


def shape_figures(side: FilmRobot, shape: Array, flange: Pose) -> dict[str, Any]:
    """Return tip (3,) [m], sag, length [m], volume [m^3], largest strain of the stiffeners, None without.

    Args:
        side: with the body of the shape.
        shape: (n, 3) [m].
        flange: its pose.
    """
    figures = side.shape_reader().figures([shape])
    strain = stiffener_strain(side.body, shape)
    return {
        "tip_m": figures.tip_position[0],
        "sag_m": float(figures.sag_m(flange.translation[None], flange.rotation[:, 2][None])[0]),
        "length_m": float(figures.center_line_m[0]),
        "volume_m3": float(figures.volumes_m3[0].sum()),
        "peak_strain": None if strain is None else strain.peak,
    }


def differences(one: dict[str, Any], other: dict[str, Any]) -> dict[str, float]:
    """Return the differences of the figures that two shapes both have."""
    return {
        key: float(np.linalg.norm(np.subtract(value, other[key])))
        for key, value in one.items()
        if value is not None and other[key] is not None
    }
