"""A scheme of exchange: how rigid and soft side advance together by a tick."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from typing import Any

from cosim.base.frames import Twist, Wrench
from cosim.coupling.schemes.interface import Interface, ServoCommand
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.coupling.soft_sides.soft_side import SoftReply
from cosim.soft.body.loads import Loads


class Coupling(ABC):
    """Advances arm and soft body by one tick at a time.

    Args:
        interface: between them.
    """

    def __init__(self, interface: Interface) -> None:
        self.interface = interface

    @property
    def wrench(self) -> Wrench:
        """What the soft side exerts on the flange at present, at its origin, world axes."""
        return self.interface.wrench

    @abstractmethod
    def save_state(self) -> Any:
        """Return what the next tick depends on besides the states of scene and soft side."""

    @abstractmethod
    def restore_state(self, state: Any) -> None:
        """Return to a state of `save_state`; scene and soft side have been restored before.

        Raises:
            InputError: the state does not fit.
        """

    @abstractmethod
    def tick(self, command: ServoCommand, loads: Loads) -> LedgerEntry:
        """Advance both sides by one tick.

        Args:
            command: for the servos.
            loads: on the soft body at the end of the tick.

        Raises:
            InstabilityError: the rigid side is no longer finite.
            ConvergenceError: the soft step, or the exchange, has no solution.
        """

    def _entry(
        self, reply: SoftReply, acted: Wrench, *, algorithmic_mass: bool = False, momentum_error: float = 0.0
    ) -> LedgerEntry:
        """Return what a tick exchanged, whatever the scheme.

        Args:
            reply: of the soft side.
            acted: on the flange, at its present origin, world axes.
            algorithmic_mass: whether it was carried.
            momentum_error: see `LedgerEntry`.
        """
        interface, touched = self.interface, self.interface.touched
        twist, wrench = interface.scene.flange_twist, reply.wrench
        received_W, _ = _power(acted, twist)
        power_W, size_W = _power(wrench, twist)
        return LedgerEntry(
            wrench=wrench,
            rigid_power_W=received_W,
            soft_power_W=-power_W,
            residual_N=reply.residual_N,
            newton_iterations=reply.iterations,
            stability_ratio=interface.ratio,
            algorithmic_mass=algorithmic_mass,
            contacts=touched.count,
            contact_force_N=touched.normal_force_N,
            contact_depth_m=touched.depth_m,
            contact_ratio=interface.contact_ratio,
            power_size_W=size_W,
            momentum_error=momentum_error,
        )


def _power(wrench: Wrench, twist: Twist) -> tuple[float, float]:
    """Return the power [W] of a wrench, and the product of its size and the twist's, in plain numbers."""
    (x, y, z), (u, v, w) = wrench.force.tolist(), wrench.torque.tolist()
    (a, b, c), (p, q, r) = twist.linear.tolist(), twist.angular.tolist()
    force, torque = math.sqrt(x * x + y * y + z * z), math.sqrt(u * u + v * v + w * w)
    speed, turn = math.sqrt(a * a + b * b + c * c), math.sqrt(p * p + q * q + r * r)
    return x * a + y * b + z * c + u * p + v * q + w * r, force * speed + torque * turn
