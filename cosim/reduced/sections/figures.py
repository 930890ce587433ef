"""Wrench of a chain on the flange, and centre and inertia of its mass."""

import numpy as np

from cosim.base.frames import Array, Mask, Wrench
from cosim.base.kernel_types import Blocks, Flags, Matrix, Vector
from cosim.base.kernels import kernel, small_vector
from cosim.soft.elements.mass_terms import mass_moments

WRENCH, CENTER, INERTIA, FIGURES = 0, 6, 9, 18
"""Offsets in the figures (FIGURES,): wrench (6,), centre (3,) [m] and inertia (3, 3) [kg m^2] about it."""


def figures_of(frames: Array, free: Mask, mass: Array, gradient: Array) -> Array:
    """Return the figures of a chain; see `fill_figures`."""
    figures = np.empty(FIGURES)
    fill_figures(frames, free, mass, gradient, figures)
    return figures


def supplied_wrench(figures: Array) -> Wrench:
    """Return the wrench of a chain on the flange, about its origin, world axes."""
    return Wrench.owning(figures[WRENCH : WRENCH + 3], figures[WRENCH + 3 : CENTER])


def center_and_inertia(figures: Array) -> tuple[Array, Array]:
    """Return the centre (3,) [m] and the inertia (3, 3) [kg m^2] about it."""
    return figures[CENTER:INERTIA], figures[INERTIA:].reshape(3, 3)


@kernel
def fill_figures(frames: Blocks, free: Flags, mass: Blocks, gradient: Matrix, out: Vector) -> None:
    """Fill out (FIGURES,): the wrench on the flange at its origin, centre and inertia of the mass.

    The support of held frames exerts the gradient (f, 6) of the potential; the opposite acts on the flange.
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
    moments, at = small_vector(9), 3
    total = mass_moments(mass, frames, moments)
    for r in range(3):
        # without mass any centre is valid
        out[CENTER + r] = moments[r] / total if total > 0.0 else frames[0, 0, r]
    for r in range(3):
        for c in range(r, 3):
            product = moments[at] - moments[r] * out[CENTER + c]
            at += 1
            out[INERTIA + 3 * r + c] = out[INERTIA + 3 * c + r] = -product
    x, y, z = out[INERTIA], out[INERTIA + 4], out[INERTIA + 8]
    out[INERTIA], out[INERTIA + 4], out[INERTIA + 8] = -y - z, -x - z, -x - y
