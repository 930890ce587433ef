"""The contact law of a point on a surface: penalty pressure, and Coulomb friction with a stick spring.

With the depth s = width / 2 - d, d the distance from the surface, and the stiffness k the energy is

    0                                  s <= 0
    k s^3 / (6 width)                  0 < s < width
    k ((s - width / 2)^2 / 2 + width^2 / 24)   beyond,

twice continuously differentiable; deep in contact the pressure is the stiffness per area times -d.
Friction: u = (1 - n n^T)(y - anchor), energy F f0(|u|), f0' = f1 = 2 z - z^2 for z = |u| / stick < 1 and 1
beyond, F = friction coefficient x normal force of the last step.
A glued point is held in every direction: energy k |y - anchor|^2 / 2.
All contacts call these functions (film with scene, film with film, chains of frames), so another law needs
only another `press` or `drag`.
Source: the smooth friction mollifier of Li et al., Incremental Potential Contact, ACM TOG 39 (2020) 49,
here on the distance from an anchor instead of the displacement in a step.
"""

from dataclasses import dataclass
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.base.kernel_types import Matrix, Vector
from cosim.base.kernels import device_function, small_vector
from cosim.errors import InputError

GLUED: Final = -1.0
"""Value of the friction that marks a glued point."""
ONSET: Final = 0.5
"""Distance from the surface, in widths, at which a point begins to press."""
_APART: Final = 1e-3  # fraction of the width added to spare distances, so that rounding causes no pressure


@final
@dataclass(frozen=True)
class ContactLaw:
    """Parameters of the contact law.

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

    @property
    def widths(self) -> Array:
        """(2,) [m], of the transitions: across, then along the surface."""
        return np.array([self.smoothing_m, self.stick_m])

    @property
    def onset_m(self) -> float:
        """Distance from the surface at which a point begins to press."""
        return ONSET * self.smoothing_m


def spare(drawn_m: Array, law: ContactLaw) -> Array:
    """Return the spare distances (k,) [m], added to distances so that surfaces do not press as drawn.

    They begin to press at half of their drawn distance (k,) [m], or at the onset of the law if that is less.
    """
    half_m, onset_m = 0.5 * np.maximum(drawn_m, 0.0) + np.minimum(drawn_m, 0.0), law.onset_m
    begin = np.minimum(half_m, onset_m)
    return np.maximum(onset_m - begin + _APART * law.smoothing_m * (begin < onset_m), 0.0)


@device_function
def depth_of(distance: float, width: float) -> float:
    """Return the depth of a point, measured from the onset of contact, by its distance from the surface."""
    return ONSET * width - distance


@device_function
def press(depth: float, width: float) -> tuple[float, float, float]:
    """Return energy, force and stiffness over k at a depth; force is the derivative of the energy."""
    if depth <= 0.0:
        return 0.0, 0.0, 0.0
    if depth < width:
        return depth**3 / (6.0 * width), depth**2 / (2.0 * width), depth / width
    beyond = depth - 0.5 * width
    return 0.5 * beyond * beyond + width * width / 24.0, beyond, 1.0


@device_function
def drag(length: float, stick: float) -> tuple[float, float, float]:
    """Return f0, f1 / |u| and the derivative of f1 by |u| at |u| = length."""
    fraction = length / stick
    if fraction < 1.0:
        energy = stick * fraction * fraction * (1.0 - fraction / 3.0)
        return energy, (2.0 - fraction) / stick, 2.0 * (1.0 - fraction) / stick
    return length - stick / 3.0, 1.0 / length, 0.0


@device_function
def shorten(u: Vector, n: Vector, stick: float) -> None:
    """Reduce the stretch of a stick spring after a step: its part across n, at most `stick` long."""
    scale = min(1.0, stick / max(np.sqrt(_flatten(u, n)), 1e-300))
    for r in range(3):
        u[r] *= scale


@device_function
def rub(u: Vector, n: Vector, limit: float, stick: float, gradient: Vector, tangent: Matrix) -> float:
    """Add gradient (3,) and tangent (3, 3) of a stick spring by its stretch u; return its energy.

    Args:
        u: (3,) [m], stretch; its part along n is removed.
        n: (3,), normal.
        limit: largest friction force [N].
        stick: stretch at which that acts [m].
        gradient: (3,) [N], added to.
        tangent: (3, 3) [N/m], added to.
    """
    square = _flatten(u, n)
    level, secant, rate = drag(np.sqrt(square), stick)
    fold = limit * (rate - secant) / max(square, 1e-300)
    for r in range(3):
        gradient[r] += limit * secant * u[r]
        tangent[r, r] += limit * secant
        for c in range(3):
            tangent[r, c] += fold * u[r] * u[c] - limit * secant * n[r] * n[c]
    return limit * level


@device_function
def _flatten(u: Vector, n: Vector) -> float:
    """Remove the part of u along n; return the square of the rest."""
    along, square = 0.0, 0.0
    for r in range(3):
        along += n[r] * u[r]
    for r in range(3):
        u[r] -= along * n[r]
        square += u[r] * u[r]
    return square


@device_function
def touch(
    point: Vector,
    n: Vector,
    offset: float,
    stiffness: float,
    friction: float,
    anchor: Vector,
    widths: Vector,
    gradient: Vector,
    tangent: Matrix,
) -> tuple[float, float, float]:
    """Fill gradient (3,) and tangent (3, 3) of a contact by its point; return energy, normal force, distance.

    Args:
        point: (3,) [m].
        n: (3,), normal of the tangent plane n . y = offset.
        offset: [m].
        stiffness: k [N/m].
        friction: largest friction force [N], or `GLUED`.
        anchor: (3,) [m], of the stick spring.
        widths: (2,) [m], see `ContactLaw.widths`.
        gradient: (3,) [N], filled.
        tangent: (3, 3) [N/m], filled.
    """
    u, distance = small_vector(3), -offset
    for r in range(3):
        distance += n[r] * point[r]
        u[r] = point[r] - anchor[r]
    if friction == GLUED:
        square = 0.0
        for r in range(3):
            gradient[r] = stiffness * u[r]
            square += u[r] ** 2
            for c in range(3):
                tangent[r, c] = stiffness if r == c else 0.0
        return 0.5 * stiffness * square, 0.0, distance
    level, push, rate = press(depth_of(distance, widths[0]), widths[0])
    pressing = stiffness * push
    energy = stiffness * level
    for r in range(3):
        gradient[r] = -pressing * n[r]
        for c in range(3):
            tangent[r, c] = stiffness * rate * n[r] * n[c]
    if friction > 0.0:
        energy += rub(u, n, friction, widths[1], gradient, tangent)
    return energy, pressing, distance


@device_function
def resting_stiffness(distance: float, stiffness: float, friction: float, widths: Vector) -> float:
    """Return the trace of a contact's tangent [N/m] while its stick spring is slack; see `touch`."""
    if friction == GLUED:
        return 3.0 * stiffness
    rate = press(depth_of(distance, widths[0]), widths[0])[2]
    return stiffness * rate + 2.0 * friction * drag(0.0, widths[1])[1]
