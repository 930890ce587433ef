"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio above a bound), its algorithmic mass A rides along as joint armature, and A times
the last joint acceleration is given back as torque, so that only the change of acceleration meets it.
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.coupling.coupling import Coupling
from cosim.coupling.interface import Interface, InterfaceState, ServoCommand
from cosim.coupling.ledger import LedgerEntry
from cosim.coupling.mass import armature_bound
from cosim.coupling.momentum import Handed, received_bodies, received_flange
from cosim.frames import Array, Wrench
from cosim.soft.body import Loads


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        added: (joints,) [kg m^2], carried algorithmic mass.
    """

    interface: InterfaceState
    added: Array


@final
class StaggeredCoupling(Coupling):
    """Advances by one step of each side, in turn.

    Args:
        interface: between the sides.
        ratio_bound: stability ratio above which the algorithmic mass is carried.
        bodies_carry: whether bodies lighter than the film's answer carry its algorithmic mass.
    """

    def __init__(self, interface: Interface, ratio_bound: float = 0.5, *, bodies_carry: bool = True) -> None:
        super().__init__(interface)
        self._ratio_bound, self._bodies_carry = ratio_bound, bodies_carry
        self._added = np.zeros(len(interface.scene.joint_names))
        self._carries = False

    def tick(self, command: ServoCommand, loads: Loads) -> LedgerEntry:
        interface = self.interface
        scene, received, handed = interface.scene, interface.wrench, interface.handed
        if interface.to_be_weighed:
            self._weigh()
        interface.ticks += 1
        scene.set_control(command.position, command.velocity, command.feedforward)
        scene.apply_flange_wrench(received)
        if self._carries:
            scene.apply_joint_torque(self._added * scene.joint_acceleration)
        lost = handed.error(received_flange(scene), received_bodies(scene))
        scene.finish_step()
        scene.begin_step()
        return self.finish_tick(loads, received, lost)

    def finish_tick(self, loads: Loads, received: Wrench, momentum_error: float) -> LedgerEntry:
        """Take the soft half of a tick, with the flange at its new pose.

        Args:
            loads: on the soft body at the end of the tick.
            received: by the rigid side in this tick, at the flange origin, world axes.
            momentum_error: of the rigid half, see `LedgerEntry`.
        """
        interface = self.interface
        reply = interface.advance_soft(loads)
        if interface.body_mass is not None:
            interface.body_mass.update(carry=self._bodies_carry)
        return self._entry(reply, received, algorithmic_mass=self._carries, momentum_error=momentum_error)

    def begin_row(self) -> tuple[int, Array]:
        """Begin ticks that are taken elsewhere, in a row.

        Returns:
            How many may follow until the flange is to be weighed again, and the algorithmic mass (joints,)
            [kg m^2] that the joints carry meanwhile; (0,) for none.
        """
        if self.interface.to_be_weighed:
            self._weigh()
        return self.interface.ticks_to_weighing, self._added if self._carries else self._added[:0]

    def end_row(self, ticks: int, wrench: Wrench, handed: Handed) -> None:
        """Go on from ticks that were taken elsewhere.

        Args:
            ticks: how many.
            wrench: with which the last of them has ended, at the flange origin, world axes.
            handed: the same about the world's origin.
        """
        self.interface.ticks += ticks
        self.interface.wrench, self.interface.handed = wrench, handed

    def save_state(self) -> StaggeredState:
        return StaggeredState(self.interface.save_state(), self._added)

    def restore_state(self, state: StaggeredState) -> None:
        self.interface.restore_state(state.interface)
        self._added, self._carries = state.added, bool(state.added.any())

    def _weigh(self) -> None:
        """Bring the stability ratio, and with it the carried algorithmic mass, up to date."""
        scene, none = self.interface.scene, np.zeros_like(self._added)
        mass = self.interface.weigh()
        carries = self.interface.ratio > self._ratio_bound
        added = armature_bound(scene.flange.jacobian(), mass) if carries else none
        if carries:
            scene.set_added_armature(added)
        elif self._carries:
            scene.set_added_armature(none)
            scene.apply_joint_torque(none)
        self._added, self._carries = added, carries
