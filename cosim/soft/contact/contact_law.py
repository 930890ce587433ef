"""How a point presses and drags on a surface: penalty pressure and Coulomb friction with a stick spring.

With the depth s = width / 2 - d, d the distance from the tangent plane, and the stiffness k the energy is

    0                                  s <= 0
    k s^3 / (6 width)                  0 < s < width
    k ((s - width / 2)^2 / 2 + width^2 / 24)   beyond,

twice continuously differentiable; deep in contact the pressure is the stiffness per area times -d.
Friction: u = (1 - n n^T)(y - anchor), energy F f0(|u|), f0' = f1 = 2 z - z^2 for z = |u| / stick < 1 and 1
beyond, F = friction coefficient x normal force of the last step.
A glued point is held in every direction: energy k |y - anchor|^2 / 2.
Source: the smooth friction mollifier of Li et al., Incremental Potential Contact, ACM TOG 39 (2020) 49,
here on the distance from an anchor instead of the displacement in a step.
"""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import device_function, small_vector
from cosim.errors import InputError

GLUED: Final = -1.0
"""The friction by which a glued point is known."""


@final
@dataclass(frozen=True)
class ContactLaw:
    """How film and obstacle press on each other.

    Args:
        stiffness_N_m3: pressure per depth; 30 kPa of gas sink in by 0.1 mm at the default.
        smoothing_m: width of the transition; contact begins at half of it before touching.
        stick_m: tangential distance from the anchor at which the full friction acts.

    Raises:
        InputError: a value that is not above 0.
    """

    stiffness_N_m3: float = 3e8
    smoothing_m: float = 1e-4
    stick_m: float = 1e-4

    def __post_init__(self) -> None:
        for name in ("stiffness_N_m3", "smoothing_m", "stick_m"):
            if not getattr(self, name) > 0.0:
                raise InputError(f"contact: {name} is {getattr(self, name)}; it must be above 0")


@device_function
def pressing_law(depth: float, width: float) -> tuple[float, float, float]:
    """Return energy, force and stiffness over k at a depth."""
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    if depth < width:
        return depth**3 / (6.0 * width), depth**2 / (2.0 * width), depth / width
    beyond = depth - 0.5 * width
    return 0.5 * beyond * beyond + width * width / 24.0, beyond, 1.0


@device_function
def dragging_law(length: float, stick: float) -> tuple[float, float, float]:
    """Return f0, f1 / |u| and the derivative of f1 by |u| at |u| = length."""
    fraction = length / stick
    if fraction < 1.0:
        energy = stick * fraction * fraction * (1.0 - fraction / 3.0)
        return energy, (2.0 - fraction) / stick, 2.0 * (1.0 - fraction) / stick
    return length - stick / 3.0, 1.0 / length, 0.0


@device_function
def shorten(u: Vector, n: Vector, stick: float) -> None:
    """Leave of the stretch of a stick spring what a step leaves: its part across n, at most `stick` long."""
    along, square = 0.0, 0.0
    for r in range(3):
        along += n[r] * u[r]
    for r in range(3):
        u[r] -= along * n[r]
        square += u[r] * u[r]
    kept = min(1.0, stick / max(np.sqrt(square), 1e-300))
    for r in range(3):
        u[r] *= kept


@device_function
def touch(
    point: Vector,
    n: Vector,
    offset: float,
    stiffness: float,
    friction: float,
    anchor: Vector,
    width: float,
    stick: float,
    own: Vector,
    tangent: Matrix,
) -> tuple[float, float]:
    """Fill gradient (3,) and tangent (3, 3) of a contact by its point; return energy and normal force."""
    u = small_vector(3)
    if friction == GLUED:
        square = 0.0
        for r in range(3):
            own[r] = stiffness * (point[r] - anchor[r])
            square += (point[r] - anchor[r]) ** 2
            for c in range(3):
                tangent[r, c] = stiffness if r == c else 0.0
        return 0.5 * stiffness * square, 0.0
    distance, along = -offset, 0.0
    for r in range(3):
        distance += n[r] * point[r]
        u[r] = point[r] - anchor[r]
        along += n[r] * u[r]
    level, push, rate = pressing_law(0.5 * width - distance, width)
    pressing = stiffness * push
    energy = stiffness * level
    for r in range(3):
        own[r] = -pressing * n[r]
        for c in range(3):
            tangent[r, c] = stiffness * rate * n[r] * n[c]
    if friction > 0.0:
        square = 0.0
        for r in range(3):
            u[r] -= along * n[r]
            square += u[r] * u[r]
        length = np.sqrt(square)
        level, secant, rate = dragging_law(length, stick)
        energy += friction * level
        fold = friction * (rate - secant) / max(square, 1e-300)
        for r in range(3):
            own[r] += friction * secant * u[r]
            tangent[r, r] += friction * secant
            for c in range(3):
                tangent[r, c] += fold * u[r] * u[c] - friction * secant * n[r] * n[c]
    return energy, pressing
