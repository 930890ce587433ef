"""Loads that one side hands over to the other, and how far they are from those that it has received.

Plain numbers: numpy is slow on six.
"""

from dataclasses import dataclass
from typing import Final, final

from cosim.base.frames import Array, SixNumbers, Wrench

LEVER_M: Final = 0.1
"""Lever at which torques count as forces."""
SMALLEST_N: Final = 1e-2
"""Loads below it count as this large: what is left of them is rounding."""
NOTHING: Final[SixNumbers] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class TransferredLoads:
    """Loads about the world's origin, (force, torque) each.

    Args:
        flange: on it.
        bodies: sum over all touched bodies.
        flange_size_N: of the loads that make up the first.
        bodies_size_N: the same of the second.
        bodies_normal_N: sum of the normal forces on bodies.
    """

    flange: SixNumbers
    bodies: SixNumbers
    flange_size_N: float
    bodies_size_N: float
    bodies_normal_N: float = 0.0

    def error(self, due: SixNumbers, received: SixNumbers) -> float:
        """Return the largest relative difference of what the flange has received from this and what is due.

        Args:
            due: besides these loads, about the world's origin.
            received: about the world's origin.
        """
        return relative_error(total(self.flange, due), received, self.flange_size_N)


def six_numbers(load: Array) -> SixNumbers:
    """Return a load (6,) as plain numbers."""
    x, y, z, u, v, w = load.tolist()
    return x, y, z, u, v, w


def numbers_of(wrench: Wrench) -> SixNumbers:
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


def relative_error(given: SixNumbers, found: SixNumbers, size_N: float) -> float:
    """Return the largest component of the difference of two loads over a size."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = given, found
    force = max(abs(x - a), abs(y - b), abs(z - c))
    torque = max(abs(u - d), abs(v - e), abs(w - f))
    return max(force, torque / LEVER_M) / max(size_N, SMALLEST_N)
