"""What every scheme of exchange acts on: both sides, their contacts, and the wrench between them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import final

from cosim.base.frames import Array, Wrench
from cosim.coupling.contact.added_mass_free import BodyMass, BodyMassState
from cosim.coupling.contact.contact_exchange import ContactExchange, ContactState
from cosim.coupling.contact.contact_report import NOTHING_TOUCHED, ContactReport
from cosim.coupling.schemes.momentum_balance import NOTHING, TransferredLoads, six_numbers
from cosim.coupling.soft_sides.answer_weights import exchange_gain
from cosim.coupling.soft_sides.mass import stability_ratio
from cosim.coupling.soft_sides.soft_side import SoftReply, SoftSide
from cosim.errors import InputError
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.loads import Loads
from cosim.soft.solve.time_scheme import StepAim

# Shape and configuration hardly change meanwhile, and the ratio costs as much as the rest of the exchange.
# So it is found after a time, in bounds of ticks; after a longer one where nothing hangs on it.
_WEIGHED_AFTER_S, _SELDOM_AFTER_S, _FAR_RATIO = 0.04, 0.1, 0.25
_FEWEST_TICKS, _MOST_TICKS, _MOST_TICKS_FAR = 10, 20, 50


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
        handed: what the soft side has handed over at the end of the last tick.
        touched: contacts of the last tick.
        ratio: stability ratio of the flange when it was last weighed.
        ticks: done.
        contact: of the soft body with the scene; None where it is not modelled.
        body_mass: that free bodies carry, the same.
    """

    wrench: Wrench
    handed: TransferredLoads
    touched: ContactReport
    ratio: float
    ticks: int
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
        self._untouched = self._contacts()
        self.wrench = wrench
        self.handed = TransferredLoads.of(wrench, scene.flange_pose.translation, NOTHING, 0.0)
        self.touched: ContactReport = NOTHING_TOUCHED
        self.ratio = 0.0
        self.ticks = 0
        self._often = min(max(_FEWEST_TICKS, round(_WEIGHED_AFTER_S / scene.tick_s)), _MOST_TICKS)
        self._seldom = min(max(_FEWEST_TICKS, round(_SELDOM_AFTER_S / scene.tick_s)), _MOST_TICKS_FAR)

    @property
    def contact_ratio(self) -> float:
        """Largest algorithmic mass of the film over the inertia of a free body that it touches."""
        return 0.0 if self.body_mass is None else self.body_mass.ratio

    @property
    def to_be_weighed(self) -> bool:
        """Whether the stability ratio is due to be found anew."""
        return self.ticks % self._weighed_every == 0

    @property
    def ticks_to_weighing(self) -> int:
        """Ticks until it is due the next time, the one in progress counted; at least one."""
        return self._weighed_every - self.ticks % self._weighed_every

    @property
    def _weighed_every(self) -> int:
        return self._seldom if self.ratio < _FAR_RATIO else self._often

    def update_stability_ratio(self) -> None:
        """Find the stability ratio of the flange, as if no algorithmic mass rode on the joints.

        That of the soft side as a rigid body, times what its integrator makes of it in an exchange that is
        one tick late.
        """
        body = self.soft.mass_properties().spatial(self.scene.flange_pose.translation)
        gain = exchange_gain(self.soft.answer_weights)
        self.ratio = gain * stability_ratio(self.scene.mobility(), body)

    def save_state(self) -> InterfaceState:
        """Return what the next exchange depends on besides the states of scene and soft side."""
        contact, mass = self._contacts()
        return InterfaceState(self.wrench, self.handed, self.touched, self.ratio, self.ticks, contact, mass)

    def restore_state(self, state: InterfaceState) -> None:
        """Return to a state of `save_state`; scene and soft side have been restored before.

        Contact that has not been modelled before begins untouched.

        Raises:
            InputError: contact is modelled in the state only.
        """
        if self.contact is None and state.contact is not None:
            raise InputError("contact is modelled in the saved state only")
        self.wrench, self.handed, self.touched = state.wrench, state.handed, state.touched
        self.ratio, self.ticks = state.ratio, state.ticks
        contact, mass = (state.contact, state.body_mass) if state.contact else self._untouched
        if self.contact is not None and contact is not None:
            self.contact.check_state(contact)
            self.contact.restore_state(contact)
        if self.body_mass is not None and mass is not None:
            self.body_mass.restore_state(mass)

    def _contacts(self) -> tuple[ContactState | None, BodyMassState | None]:
        contact = None if self.contact is None else self.contact.save_state()
        return contact, None if self.body_mass is None else self.body_mass.save_state()

    def advance_soft(self, loads: Loads, aim: StepAim | None = None) -> SoftReply:
        """Take the soft step to the flange's present pose, with the contacts that are there.

        Afterwards the bodies bear the contacts' loads.

        Args:
            loads: on the soft body at the end of the tick, contacts not counted.
            aim: how closely; as an ordinary step unless given.
        """
        scene, soft, flange = self.scene, self.soft, self.scene.flange_pose
        if self.contact is not None:
            planes = self.contact.find(soft.state, scene.tick_s)
            loads = loads if planes is None else replace(loads, contact=planes)
        if aim is None:
            reply = soft.advance(flange, loads, scene.tick_s)
        else:
            reply = soft.advance_closely(flange, loads, scene.tick_s, aim)
        self.wrench, film_load = reply.wrench, NOTHING
        if self.contact is not None:
            self.touched = self.contact.settle(soft.state.positions)
        if self.contact is not None and self.contact.planes is not None:
            film_load = six_numbers(self.contact.film_load)
        self.handed = TransferredLoads.of(
            reply.wrench, flange.translation, film_load, self.touched.normal_force_N
        )
        return reply
