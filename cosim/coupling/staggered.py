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
from cosim.frames import Array
from cosim.soft.body import Loads

# Shape and configuration hardly change in 20 ms; the ratio costs as much as the rest of the exchange.
RATIO_EVERY_TICKS = 10


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        ratio: stability ratio.
        added: (joints,) [kg m^2], carried algorithmic mass.
        ticks: done.
    """

    interface: InterfaceState
    ratio: float
    added: Array
    ticks: int


@final
class StaggeredCoupling(Coupling):
    """Advances by one step of each side, in turn.

    Args:
        interface: between the sides.
        ratio_bound: stability ratio above which the algorithmic mass is carried.
    """

    def __init__(self, interface: Interface, ratio_bound: float = 0.5) -> None:
        super().__init__(interface)
        self._ratio_bound = ratio_bound
        self._ratio = 0.0
        self._added = np.zeros(len(interface.scene.joint_names))
        self._ticks = 0

    def tick(self, command: ServoCommand, loads: Loads) -> LedgerEntry:
        interface = self.interface
        scene = interface.scene
        if self._ticks % RATIO_EVERY_TICKS == 0:
            self._weigh()
        self._ticks += 1
        scene.set_control(command.position, command.velocity, command.feedforward)
        received = interface.wrench
        scene.apply_flange_wrench(received)
        if self._added.any():
            scene.apply_joint_torque(self._added * scene.joint_acceleration)
        scene.finish_step()
        scene.begin_step()
        reply = interface.advance_soft(loads)
        interface.wrench = reply.wrench
        if interface.body_mass is not None:
            interface.body_mass.update()
        touched = interface.touched
        return LedgerEntry(
            wrench=reply.wrench,
            rigid_power_W=received.power(scene.flange_twist),
            soft_power_W=reply.power_W,
            residual_N=reply.residual_N,
            newton_iterations=reply.iterations,
            stability_ratio=self._ratio,
            algorithmic_mass=bool(self._added.any()),
            contacts=touched.count,
            contact_force_N=touched.normal_force_N,
            contact_depth_m=touched.depth_m,
            contact_ratio=interface.contact_ratio,
        )

    def save_state(self) -> StaggeredState:
        return StaggeredState(self.interface.save_state(), self._ratio, self._added, self._ticks)

    def restore_state(self, state: StaggeredState) -> None:
        self.interface.restore_state(state.interface)
        self._ratio, self._added, self._ticks = state.ratio, state.added, state.ticks

    def _weigh(self) -> None:
        """Bring the stability ratio, and with it the carried algorithmic mass, up to date."""
        scene = self.interface.scene
        if self._added.any():
            scene.set_added_armature(np.zeros_like(self._added))
        mass = self.interface.algorithmic_mass()
        self._ratio = self.interface.stability_ratio(mass)
        carry = self._ratio > self._ratio_bound
        added = armature_bound(scene.flange_jacobian, mass) if carry else np.zeros_like(self._added)
        if added.any():
            scene.set_added_armature(added)
        elif self._added.any():
            scene.apply_joint_torque(added)
        self._added = added
