"""Loads that pass from the soft robot to the rigid scene, and their balance; plain floats for speed."""

from dataclasses import dataclass
from typing import Final, final

from cosim.base.frames import Array, SixNumbers, Wrench

LEVER_M: Final = 0.1
"""Lever at which torques count as forces."""
SMALLEST_N: Final = 1e-2
"""Smallest scale of relative errors: differences of smaller loads are rounding."""
ZERO_LOAD: Final[SixNumbers] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class TransferredLoads:
    """Loads about the world's origin, (force, torque) each.

    Args:
        flange: on the flange.
        bodies: on the touched bodies, summed.
        flange_size_N: size of the largest component of the load on the flange.
        bodies_size_N: sum of the sizes of the contact forces on bodies.
        bodies_normal_N: sum of the normal forces on bodies.
    """

    flange: SixNumbers
    bodies: SixNumbers
    flange_size_N: float
    bodies_size_N: float
    bodies_normal_N: float = 0.0

    def error(self, due: SixNumbers, received: SixNumbers) -> float:
        """Return the relative error of the load that the flange has received.

        Args:
            due: load that is due in addition to `flange`, about the world's origin.
            received: load that has acted on the flange, about the world's origin.
        """
        return relative_error(total(self.flange, due), received, self.flange_size_N)


def six_numbers(load: Array) -> SixNumbers:
    """Return a load (6,) as plain numbers."""
    x, y, z, u, v, w = load.tolist()
    return x, y, z, u, v, w


def wrench_numbers(wrench: Wrench) -> SixNumbers:
    """Return a wrench as plain numbers, force then torque."""
    (x, y, z), (u, v, w) = wrench.force.tolist(), wrench.torque.tolist()
    return x, y, z, u, v, w


def total(first: SixNumbers, second: SixNumbers) -> SixNumbers:
    """Return the sum of two loads."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = first, second
    return x + a, y + b, z + c, u + d, v + e, w + f


def work_rate(first: SixNumbers, second: SixNumbers) -> float:
    """Return the power [W] of a load, force then torque, at a twist, linear then angular."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = first, second
    return x * a + y * b + z * c + u * d + v * e + w * f


def relative_error(expected: SixNumbers, actual: SixNumbers, size_N: float) -> float:
    """Return the largest component of the difference of two loads, relative to a size."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = expected, actual
    force = max(abs(x - a), abs(y - b), abs(z - c))
    torque = max(abs(u - d), abs(v - e), abs(w - f))
    return max(force, torque / LEVER_M) / max(size_N, SMALLEST_N)
