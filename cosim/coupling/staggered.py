"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio above a bound), its algorithmic mass A rides along as joint armature, and A times
the last joint acceleration is given back as torque, so that only the change of acceleration meets it.
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from cosim.coupling.body_mass import BodyMass
from cosim.coupling.contact import NOTHING_TOUCHED, ContactExchange, ContactReport
from cosim.coupling.ledger import LedgerEntry
from cosim.coupling.mass import armature_bound, stability_ratio
from cosim.coupling.soft_side import SoftReply, SoftSide
from cosim.frames import Array, Wrench
from cosim.rigid.scene import RigidScene
from cosim.soft.body import Loads

# Shape and configuration hardly change in 20 ms; the ratio costs as much as the rest of the exchange.
_RATIO_EVERY_TICKS = 10


@final
@dataclass(frozen=True)
class ServoCommand:
    """What the arm's servos are asked for in a tick.

    Args:
        position: (joints,) [rad].
        velocity: (joints,) [rad/s].
        feedforward: (joints,) [N m].
    """

    position: Array
    velocity: Array
    feedforward: Array


@final
class StaggeredCoupling:
    """Advances arm and soft body by one tick at a time.

    Args:
        scene: rigid side.
        soft: soft side.
        wrench: of the soft side at the start, at the flange origin, world axes.
        ratio_bound: stability ratio above which the algorithmic mass is carried.
        contact: of the soft body with the scene; None where it is not modelled.
    """

    def __init__(
        self,
        scene: RigidScene,
        soft: SoftSide,
        wrench: Wrench,
        ratio_bound: float = 0.5,
        contact: ContactExchange | None = None,
    ) -> None:
        self.scene = scene
        self.soft = soft
        self._wrench = wrench
        self._ratio_bound = ratio_bound
        self._ratio = 0.0
        self._added = np.zeros(len(scene.joint_names))
        self._ticks = 0
        self.contact = contact
        self.touched: ContactReport = NOTHING_TOUCHED
        self._body_mass = BodyMass(contact, soft, scene.tick_s) if contact is not None else None

    @property
    def wrench(self) -> Wrench:
        """What the soft side exerts on the flange at present, at its origin, world axes."""
        return self._wrench

    def tick(self, command: ServoCommand, loads: Loads) -> LedgerEntry:
        """Advance both sides by one tick.

        Args:
            command: for the servos.
            loads: on the soft body at the end of the tick.

        Raises:
            InstabilityError: the rigid side is no longer finite.
            ConvergenceError: the soft step has no solution.
        """
        scene = self.scene
        if self._ticks % _RATIO_EVERY_TICKS == 0:
            self._weigh()
        self._ticks += 1
        scene.set_control(command.position, command.velocity, command.feedforward)
        received = self._wrench
        scene.apply_flange_wrench(received)
        if self._added.any():
            scene.apply_joint_torque(self._added * scene.joint_acceleration)
        scene.finish_step()
        scene.begin_step()
        reply = self._advance_soft(loads)
        self._wrench = reply.wrench
        return LedgerEntry(
            wrench=reply.wrench,
            rigid_power_W=received.power(scene.flange_twist),
            soft_power_W=reply.power_W,
            residual_N=reply.residual_N,
            newton_iterations=reply.iterations,
            stability_ratio=self._ratio,
            algorithmic_mass=bool(self._added.any()),
            contacts=self.touched.count,
            contact_force_N=self.touched.normal_force_N,
            contact_depth_m=self.touched.depth_m,
            contact_ratio=0.0 if self._body_mass is None else self._body_mass.ratio,
        )

    def _advance_soft(self, loads: Loads) -> SoftReply:
        """Take the soft step, with the contacts that are there."""
        scene, soft = self.scene, self.soft
        if self.contact is None or self._body_mass is None:
            return soft.advance(scene.flange_pose, loads, scene.tick_s)
        planes = self.contact.find(soft.state, scene.tick_s)
        loads = loads if planes is None else replace(loads, contact=planes)
        reply = soft.advance(scene.flange_pose, loads, scene.tick_s)
        self.touched = self.contact.settle(soft.state.positions)
        self._body_mass.update()
        return reply

    def _weigh(self) -> None:
        """Bring the stability ratio, and with it the carried algorithmic mass, up to date."""
        scene = self.scene
        if self._added.any():
            scene.set_added_armature(np.zeros_like(self._added))
        mass = self.soft.mass_properties().spatial(scene.flange_pose.translation)
        self._ratio = stability_ratio(scene.flange_mobility(), mass)
        carry = self._ratio > self._ratio_bound
        added = armature_bound(scene.flange_jacobian, mass) if carry else np.zeros_like(self._added)
        if added.any():
            scene.set_added_armature(added)
        elif self._added.any():
            scene.apply_joint_torque(added)
        self._added = added
