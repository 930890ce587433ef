"""What every scheme of exchange acts on: both sides, their contacts, and the wrench between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

from cosim.coupling.body_mass import BodyMass, BodyMassState
from cosim.coupling.contact import NOTHING_TOUCHED, ContactExchange, ContactReport, ContactState
from cosim.coupling.mass import stability_ratio
from cosim.coupling.soft_side import SoftReply, SoftSide
from cosim.errors import InputError
from cosim.frames import Array, Wrench
from cosim.rigid.scene import RigidScene
from cosim.soft.body import Loads


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
@dataclass(frozen=True)
class InterfaceState:
    """Where an interface is, without scene and soft side.

    Args:
        wrench: on the flange in the next tick.
        touched: contacts of the last tick.
        contact: of the soft body with the scene; None where it is not modelled.
        body_mass: that free bodies carry, the same.
    """

    wrench: Wrench
    touched: ContactReport
    contact: ContactState | None
    body_mass: BodyMassState | None


@final
class Interface:
    """Rigid side, soft side, and what they last exchanged.

    Args:
        scene: rigid side.
        soft: soft side.
        wrench: of the soft side at the start, at the flange origin, world axes.
        contact: of the soft body with the scene; None where it is not modelled.
    """

    def __init__(
        self, scene: RigidScene, soft: SoftSide, wrench: Wrench, contact: ContactExchange | None = None
    ) -> None:
        self.scene, self.soft, self.contact = scene, soft, contact
        self.body_mass = BodyMass(contact, soft, scene.tick_s) if contact is not None else None
        self.wrench = wrench
        self.touched: ContactReport = NOTHING_TOUCHED

    @property
    def contact_ratio(self) -> float:
        """Largest algorithmic mass of the film over the inertia of a free body that it touches."""
        return 0.0 if self.body_mass is None else self.body_mass.ratio

    def algorithmic_mass(self) -> Array:
        """Return the soft side's mass (6, 6) as a rigid body, at the flange origin, world axes."""
        return self.soft.mass_properties().spatial(self.scene.flange_pose.translation)

    def stability_ratio(self, algorithmic_mass: Array) -> float:
        """Return the largest eigenvalue of flange mobility times algorithmic mass (6, 6)."""
        return stability_ratio(self.scene.flange_mobility(), algorithmic_mass)

    def save_state(self) -> InterfaceState:
        """Return what the next exchange depends on besides the states of scene and soft side."""
        contact = None if self.contact is None else self.contact.save_state()
        mass = None if self.body_mass is None else self.body_mass.save_state()
        return InterfaceState(self.wrench, self.touched, contact, mass)

    def restore_state(self, state: InterfaceState) -> None:
        """Return to a state of `save_state`; scene and soft side have been restored before.

        Raises:
            InputError: contact is modelled in the one and not in the other.
        """
        if (self.contact is None) is not (state.contact is None):
            where = "the saved state" if self.contact is None else "this run"
            raise InputError(f"contact is modelled in {where} only")
        self.wrench, self.touched = state.wrench, state.touched
        if self.contact is not None and state.contact is not None:
            self.contact.restore_state(state.contact)
        if self.body_mass is not None and state.body_mass is not None:
            self.body_mass.restore_state(state.body_mass)

    def advance_soft(self, loads: Loads) -> SoftReply:
        """Take the soft step to the flange's present pose, with the contacts that are there."""
        scene, soft = self.scene, self.soft
        if self.contact is None:
            return soft.advance(scene.flange_pose, loads, scene.tick_s)
        planes = self.contact.find(soft.state, scene.tick_s)
        loads = loads if planes is None else replace(loads, contact=planes)
        reply = soft.advance(scene.flange_pose, loads, scene.tick_s)
        self.touched = self.contact.settle(soft.state.positions)
        return reply
