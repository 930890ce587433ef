"""Action and reaction, checked in every tick: what the rigid side has received is what was handed over.

Transferred: the soft side's wrench on the flange, and the contact forces on its film with the opposite sign,
summed node by node. Received: what MuJoCo holds applied to the flange and to the touched bodies in the step,
read back from it. Both are taken about the world's origin, so forces stand for momentum and torques for
angular momentum, each times the tick. In the staggered exchange a tick receives what the tick before has
handed over; in the iterated one, what the same tick hands over, and what the last one left over.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from cosim.base.frames import Array, SixNumbers
from cosim.coupling.half_ticks import LEVER_M, SMALLEST_N
from cosim.rigid.scene.scene import RigidScene

NOTHING: SixNumbers = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class TransferredLoads:
    """Loads about the world's origin, (force, torque) each; plain numbers, as numpy is slow on six.

    Args:
        flange: on it.
        bodies: sum over all touched bodies.
        flange_size_N: of the loads that make up the first.
        bodies_size_N: the same of the second.
    """

    flange: SixNumbers
    bodies: SixNumbers
    flange_size_N: float
    bodies_size_N: float

    def plus(self, flange: SixNumbers, bodies: SixNumbers) -> TransferredLoads:
        """Return these loads and others on top."""
        return TransferredLoads(
            _sum(self.flange, flange), _sum(self.bodies, bodies), self.flange_size_N, self.bodies_size_N
        )

    def error(self, flange: SixNumbers, bodies: SixNumbers) -> float:
        """Return the largest relative difference to what was received."""
        on_flange = _error(self.flange, flange, self.flange_size_N)
        if bodies is self.bodies:
            return on_flange
        return max(on_flange, _error(self.bodies, bodies, self.bodies_size_N))


def received_flange(scene: RigidScene) -> SixNumbers:
    """Return what acts on the flange in the step in progress, about the world's origin."""
    return scene.received_wrench()


def received_bodies(scene: RigidScene) -> SixNumbers:
    """Return what acts on the touched bodies in the step in progress, about the world's origin."""
    loaded = scene.bodies.loaded
    return six_numbers(scene.bodies.received(loaded).sum(axis=0)) if len(loaded) else NOTHING


def six_numbers(load: Array) -> SixNumbers:
    """Return a load (6,) as plain numbers."""
    x, y, z, u, v, w = load.tolist()
    return x, y, z, u, v, w


def _sum(first: SixNumbers, second: SixNumbers) -> SixNumbers:
    (x, y, z, u, v, w), (a, b, c, d, e, f) = first, second
    return x + a, y + b, z + c, u + d, v + e, w + f


def _error(given: SixNumbers, found: SixNumbers, size_N: float) -> float:
    """Return the largest component of the difference of two loads over a size."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = given, found
    force = max(abs(x - a), abs(y - b), abs(z - c))
    torque = max(abs(u - d), abs(v - e), abs(w - f))
    return max(force, torque / LEVER_M) / max(size_N, SMALLEST_N)
