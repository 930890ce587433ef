"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio above a bound), its algorithmic mass A = J^T M_a J rides along on the joints; A
times the acceleration at which the soft side answers as before, the last one with implicit Euler, is given
back as torque. So only a change of the answer meets A: a rigid load moves as one body with the flange.
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.coupling.batch.added_inertia import AddedInertiaRow
from cosim.coupling.schemes.algorithmic_mass import algorithmic_mass
from cosim.coupling.schemes.interface import Interface, InterfaceState, ServoCommand
from cosim.coupling.schemes.ledger import LedgerEntry
from cosim.coupling.schemes.momentum_balance import TransferredLoads, received_bodies, received_flange
from cosim.coupling.schemes.scheme import Coupling
from cosim.coupling.soft_sides.answer_weights import expecting_no_change
from cosim.soft.body.loads import Loads


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (k, joints) [rad/s^2], accelerations while it was carried.
    """

    interface: InterfaceState
    added: Array
    past: Array


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
        self._ratio_bound, self.bodies_carry = ratio_bound, bodies_carry
        joints = len(interface.scene.joint_names)
        self._added = np.zeros((joints, joints))
        self._weights = expecting_no_change(interface.soft.answer_weights)
        self._past = np.zeros((len(self._weights), joints))
        self._carries = False

    def tick(self, command: ServoCommand, loads: Loads) -> LedgerEntry:
        interface = self.interface
        scene, received, handed = interface.scene, interface.wrench, interface.handed
        if interface.to_be_weighed:
            self._update_stability_ratio()
        interface.ticks += 1
        scene.set_control(command.position, command.velocity, command.feedforward)
        scene.apply_flange_wrench(received)
        if self._carries:
            self._past[1:] = self._past[:-1]
            self._past[0] = scene.joint_acceleration
            scene.apply_joint_torque(self._added @ (self._weights @ self._past))
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
            interface.body_mass.update(carry=self.bodies_carry)
        return self._entry(reply, received, algorithmic_mass=self._carries, momentum_error=momentum_error)

    def begin_row(self) -> tuple[int, AddedInertiaRow]:
        """Begin ticks that are taken elsewhere, in a row.

        Returns:
            How many may follow until the flange is to be weighed again, and what the joints carry meanwhile.
        """
        if self.interface.to_be_weighed:
            self._update_stability_ratio()
        joints = len(self._added) if self._carries else 0
        carried = AddedInertiaRow(self._added[:joints, :joints].copy(), self._weights, self._past)
        return self.interface.ticks_to_weighing, carried

    def end_row(self, ticks: int, wrench: Wrench, handed: TransferredLoads) -> None:
        """Go on from ticks that were taken elsewhere.

        Args:
            ticks: how many.
            wrench: with which the last of them has ended, at the flange origin, world axes.
            handed: the same about the world's origin.
        """
        self.interface.ticks += ticks
        self.interface.wrench, self.interface.handed = wrench, handed

    def save_state(self) -> StaggeredState:
        return StaggeredState(self.interface.save_state(), self._added, self._past.copy())

    def restore_state(self, state: StaggeredState) -> None:
        self.interface.restore_state(state.interface)
        self._added, self._carries = state.added, bool(state.added.any())
        self._past[:] = state.past

    def _update_stability_ratio(self) -> None:
        """Bring the stability ratio, and with it the carried algorithmic mass, up to date."""
        interface, scene = self.interface, self.interface.scene
        interface.update_stability_ratio()
        carries, added = interface.ratio > self._ratio_bound, np.zeros_like(self._added)
        if carries:
            contact = None if interface.contact is None else interface.contact.planes
            origin, jacobian = scene.flange_pose.translation, scene.flange.jacobian()
            mass = algorithmic_mass(interface.soft, origin, interface.ratio, contact, scene.tick_s)
            added = jacobian.T @ mass @ jacobian
        if carries or self._carries:
            scene.bodies.carried.carry_on_arm(added)
        if carries and not self._carries:
            self._past[:] = scene.joint_acceleration
        if self._carries and not carries:
            scene.apply_joint_torque(np.zeros(len(added)))
        self._added, self._carries = added, carries
