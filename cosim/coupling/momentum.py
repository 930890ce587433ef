"""Action and reaction, checked in every tick: what the rigid side has received is what was handed over.

Handed over: the soft side's wrench on the flange, and the contact forces on its film with the opposite sign,
summed node by node. Received: what MuJoCo holds applied to the flange and to the touched bodies in the step,
read back from it. Both are taken about the world's origin, so forces stand for momentum and torques for
angular momentum, each times the tick. In the staggered exchange a tick receives what the tick before has
handed over; in the iterated one, what the same tick hands over, and what the last one left over.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.frames import Array, Wrench, cross
from cosim.rigid.scene import RigidScene

_LEVER_M = 0.1  # torques count as forces at this lever
_SMALLEST_N = 1e-2  # loads below it count as this large: what is left of them is rounding


@final
@dataclass(frozen=True)
class Handed:
    """Loads about the world's origin, (force, torque) each.

    Args:
        flange: (6,).
        bodies: (6,), sum over all touched bodies.
        size_N: (2,), of the loads that make up either.
    """

    flange: Array
    bodies: Array
    size_N: Array

    @classmethod
    def of(cls, wrench: Wrench, origin: Array, film_load: Array, pressing_N: float) -> Handed:
        """Return what the soft side hands over at the end of a step.

        Args:
            wrench: on the flange.
            origin: (3,) [m], of the flange.
            film_load: (6,), on bodies, about the world's origin.
            pressing_N: sum of the normal forces on them.
        """
        flange = _about_world(wrench, origin)
        return cls(flange, film_load, np.array([np.abs(wrench.force).max(), pressing_N]))

    def plus(self, flange: Array, bodies: Array) -> Handed:
        """Return these loads and others (6,), (6,) on top."""
        return Handed(self.flange + flange, self.bodies + bodies, self.size_N)

    def error(self, flange: Array, bodies: Array) -> float:
        """Return the largest relative difference to what was received, (6,) and (6,)."""
        differences = np.array([self.flange - flange, self.bodies - bodies])
        differences[:, 3:] /= _LEVER_M
        return float((np.abs(differences).max(axis=1) / np.maximum(self.size_N, _SMALLEST_N)).max())


def received_flange(scene: RigidScene) -> Array:
    """Return what acts on the flange in the step in progress (6,), about the world's origin."""
    wrench = scene.received_wrench()
    return np.concatenate([wrench.force, wrench.torque])


def received_bodies(scene: RigidScene) -> Array:
    """Return what acts on the touched bodies in the step in progress (6,), about the world's origin."""
    loaded = scene.bodies.loaded
    return np.asarray(scene.bodies.received(loaded).sum(axis=0)) if len(loaded) else np.zeros(6)


def _about_world(wrench: Wrench, origin: Array) -> Array:
    return np.concatenate([wrench.force, wrench.torque - cross(-origin, wrench.force)])
