"""What a chain of frames shows its surroundings: the wrench on the flange, centre and inertia of its mass."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import void

from cosim.base.frames import Array, Mask, Wrench
from cosim.base.kernels import MATRIX, VECTOR, device_function, kernel, small_vector
from cosim.reduced.sections.section_strains import CUBE, FLAGS
from cosim.soft.elements.mass_terms import mass_moments

WRENCH, CENTER, INERTIA, FIGURES = 0, 6, 9, 18
"""Places in the figures (FIGURES,): wrench (6,), centre (3,) [m] and inertia (3, 3) [kg m^2] about it."""


def figures_of(frames: Array, free: Mask, mass: Array, gradient: Array) -> Array:
    """Return the figures of a chain; see `fill_figures`."""
    figures = np.empty(FIGURES)
    fill_figures(frames, free, mass, gradient, figures)
    return figures


def supplied_wrench(figures: Array) -> Wrench:
    """Return what a chain exerts on the flange, at its origin."""
    return Wrench.owning(figures[WRENCH : WRENCH + 3], figures[WRENCH + 3 : CENTER])


def center_and_inertia(figures: Array) -> tuple[Array, Array]:
    """Return the centre (3,) [m] and the inertia (3, 3) [kg m^2] about it."""
    return figures[CENTER:INERTIA], figures[INERTIA:].reshape(3, 3)


@kernel(void(CUBE, FLAGS, CUBE, MATRIX, VECTOR), taken_in=True)
def fill_figures(frames: Array, free: Any, mass: Array, gradient: Array, out: Array) -> None:
    """Fill out (FIGURES,): the wrench on the flange at its origin, centre and inertia of the mass.

    Held frames are supplied with the gradient (f, 6) of the potential; the flange bears its opposite.
    """
    for k in range(CENTER):
        out[k] = 0.0
    for f in range(frames.shape[0]):
        if not free[f]:
            for r in range(3):
                i, k = (r + 1) % 3, (r + 2) % 3
                arm_i, arm_k = frames[f, 0, i] - frames[0, 0, i], frames[f, 0, k] - frames[0, 0, k]
                out[WRENCH + r] -= gradient[f, r]
                out[WRENCH + 3 + r] -= gradient[f, 3 + r] + arm_i * gradient[f, k] - arm_k * gradient[f, i]
    moments = small_vector(9)
    total = mass_moments(mass, frames, moments)
    fill_center_and_inertia(total, moments, frames[0, 0], out)


@device_function
def fill_center_and_inertia(total, moments, place, out):  # type: ignore[no-untyped-def]
    """Fill centre and inertia in figures out (FIGURES,).

    Args:
        total: mass [kg].
        moments: (9,), see `mass_moments`.
        place: (3,) [m]; what weighs nothing may have its centre anywhere.
        out: filled.
    """
    for r in range(3):
        out[CENTER + r] = moments[r] / total if total > 0.0 else place[r]
    at = 3
    for r in range(3):
        for c in range(r, 3):
            product = moments[at] - moments[r] * out[CENTER + c]
            at += 1
            out[INERTIA + 3 * r + c] = out[INERTIA + 3 * c + r] = -product
    x, y, z = out[INERTIA], out[INERTIA + 4], out[INERTIA + 8]
    out[INERTIA], out[INERTIA + 4], out[INERTIA + 8] = -y - z, -x - z, -x - y
