"""What every scheme of exchange acts on: both sides, their contacts, and the wrench between them.

Action and reaction are checked in every tick: what the rigid side has received is what was transferred over.
Transferred: the soft side's wrench on the flange, and the contact forces on its film with the opposite sign,
summed node by node. Received: what MuJoCo holds applied to the flange and to the touched bodies in the step,
read back from it. Both are taken about the world's origin, so forces represent momentum and torques for
angular momentum, each times the tick. In the staggered exchange a tick receives what the tick before has
transferred over; in the iterated one, what the same tick hands over, and what the last one left over.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np

from cosim.base.column import room_for
from cosim.base.columns import TickColumns
from cosim.base.frames import Array, Pose, SixNumbers, Wrench
from cosim.base.kernels import unchecked
from cosim.base.state import states_of
from cosim.coupling.contact import contact_arrays, contact_exchange, contact_report
from cosim.coupling.contact.light_bodies import LightBodies
from cosim.coupling.payload import fill_payload
from cosim.coupling.robots.soft_robot import SoftReply, SoftRobot, exchange_gain, stability_ratio
from cosim.coupling.schemes.transfer import (
    NOTHING,
    TransferredLoads,
    numbers_of,
    relative_error,
    six_numbers,
    total,
    work_rate,
)
from cosim.coupling.ticks import ServoCommand, TickLog, fill_figures, scene_columns, sizes_of
from cosim.errors import ConvergenceError, InputError
from cosim.reduced.sections.figures import FIGURES
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.rigid.scene.flange import about_origin
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import StepAccuracy

# Shape and configuration hardly change meanwhile, and the ratio costs as much as the rest of the exchange.
# So it is found after a time, in bounds of ticks; after a longer one where nothing hangs on it.
_UPDATED_AFTER_S, _SELDOM_AFTER_S, _FAR_RATIO = 0.08, 0.25, 0.25
_FEWEST_TICKS, _MOST_TICKS, _MOST_TICKS_FAR = 10, 40, 64


@final
@dataclass(frozen=True)
class InterfaceState:
    """Where an interface is, without scene, soft side and contacts.

    Args:
        wrench: on the flange in the next tick.
        transferred: what the soft side has transferred over at the end of the last tick.
        ratio: stability ratio of the flange when it was last updated.
        ticks: done.
    """

    wrench: Wrench
    transferred: TransferredLoads
    ratio: float = 0.0
    ticks: int = 0


@final
class Interface:
    """Rigid side, soft side, and what they last exchanged.

    `figures` (FIGURES,) are what the soft side exerts on the flange at present, with centre and inertia of
    its mass.

    Args:
        scene: rigid side.
        soft: soft side.
        wrench: of the soft side at the start, at the flange origin, world axes.
        contact: of the soft body with the scene; None where it is not modelled.
        mounted: (10,) `inertial_parameters` of a rigid mass on the flange, flange frame; none unless given.
    """

    def __init__(
        self,
        scene: CoupledScene,
        soft: SoftRobot,
        wrench: Wrench,
        contact: contact_exchange.ContactExchange | None = None,
        mounted: Array | None = None,
    ) -> None:
        self.scene, self.soft, self.contact = scene, soft, contact
        self._rows = scene_columns(scene)
        joints, bodies, chambers = len(scene.joint_names), scene.bodies.count, len(soft.pressures_Pa)
        self._room = room_for(TickColumns, sizes_of(joints, bodies, chambers))
        self._mounted = np.zeros(10) if mounted is None else np.array(mounted)
        self._payload, self._mass_kg, self._acting = np.zeros(10), soft.mass_kg, NOTHING
        untouched = contact_arrays.BodyLoads.of(scene.bodies, ahead=False)
        self._bodies = untouched if contact is None else contact.loads
        self.light = LightBodies(contact, soft, scene.tick_s) if contact is not None else None
        self._untouched = states_of(self.contacts())
        about_world = numbers_of(wrench.moved(-scene.flange_pose.translation))
        transferred = TransferredLoads(about_world, NOTHING, float(np.abs(wrench.force).max()), 0.0)
        self._state, self.figures = InterfaceState(wrench, transferred), np.zeros(FIGURES)
        self.update_figures()
        self._often = min(max(_FEWEST_TICKS, round(_UPDATED_AFTER_S / scene.tick_s)), _MOST_TICKS)
        self._seldom = min(max(_FEWEST_TICKS, round(_SELDOM_AFTER_S / scene.tick_s)), _MOST_TICKS_FAR)

    @property
    def wrench(self) -> Wrench:
        """What the soft side exerts on the flange at present, at its origin, world axes."""
        return self._state.wrench

    @property
    def transferred(self) -> TransferredLoads:
        """What the soft side has transferred over at the end of the last tick."""
        return self._state.transferred

    @property
    def ratio(self) -> float:
        """Stability ratio of the flange when it was last updated."""
        return self._state.ratio

    @property
    def touched(self) -> contact_report.ContactReport:
        """What the contacts of the last tick did."""
        return contact_report.NOTHING_TOUCHED if self.contact is None else self.contact.report

    @property
    def contact_ratio(self) -> float:
        """Of the bodies that the film has touched last, see `LightBodies`; 0 where it touches none."""
        return self.light.ratio if self.light is not None and self.touched.count else 0.0

    @property
    def ratio_is_due(self) -> bool:
        """Whether the stability ratio is to be updated ahead of the next tick."""
        often = self._state.ratio >= _FAR_RATIO
        return self._state.ticks % (self._often if often else self._seldom) == 0

    def update_stability_ratio(self) -> None:
        """Find the stability ratio of the flange, as if no algorithmic mass rode on the joints.

        That of the soft side as a rigid body, times what its integrator makes of it in an exchange that is
        one tick late.
        """
        body = self.soft.mass_properties().spatial(self.scene.flange_pose.translation)
        gain = exchange_gain(self.soft.reaction_weights)
        ratio = gain * stability_ratio(self.scene.mobility(), body)
        self._state = replace(self._state, ratio=ratio)

    def count_as_one(self, ticks: int) -> None:
        """Count what was exchanged since so many ticks as one tick."""
        self._state = replace(self._state, ticks=ticks + 1)

    @property
    def state(self) -> InterfaceState:
        """What the next exchange depends on; scene, soft side and contacts are restored before it."""
        return self._state

    @state.setter
    def state(self, state: InterfaceState) -> None:
        self._state, transferred = state, state.transferred
        self._bodies.transferred[:] = (
            *transferred.bodies,
            transferred.bodies_size_N,
            transferred.bodies_normal_N,
        )
        self.update_figures()

    def parts(self) -> dict[str, Any]:
        """Return what the next exchange depends on besides scene and soft side, by name."""
        return {**self.contacts(), "exchange": self}

    def contacts(self) -> dict[str, Any]:
        """Return what knows the contacts, by name; nothing where contact is not modelled."""
        return {} if self.contact is None else {"contact": self.contact, "light": self.light}

    def completed(self, states: Mapping[str, Any]) -> dict[str, Any]:
        """Return saved states of the parts; contact that the saved run did not model begins untouched.

        Raises:
            InputError: contact is modelled in the saved state only.
        """
        saved = states.get("contact")
        if self.contact is None and saved is not None:
            if glued := len(saved.glued):
                raise InputError(f"the saved soft robot is glued by {glued} nodes, this one by 0")
            raise InputError("contact is modelled in the saved state only")
        return {**self._untouched, **states}

    def room(self, count: int) -> TickLog:
        """Return room for so many ticks."""
        return TickLog(self._room(count))

    def load_flange(self, wrench: Wrench) -> None:
        """Let a wrench act on the flange in the rigid step to come."""
        self._acting = numbers_of(wrench)
        self.scene.apply_flange_wrench(wrench)

    def step_rigid(self, servos: ServoCommand, taken: TickLog) -> None:
        """Take the rigid step of a tick: servos and loads act, then poses are those at its end.

        Args:
            servos: what they are asked for.
            taken: its row is filled.

        Raises:
            InstabilityError: the state is no longer finite.
        """
        error = self.momentum_error()
        self.scene.step_arm(servos.position, servos.velocity, self.feedforward(servos))
        taken.log_scene(self.scene, self._rows, self._bodies, error)

    def read_rigid(self, taken: TickLog) -> None:
        """Read the rigid step of a tick that somebody else has taken."""
        taken.log_scene(self.scene, self._rows, self._bodies, self.momentum_error())

    def feedforward(self, servos: ServoCommand) -> Array:
        """Return the torques (joints,) [N m] that servos are asked for, with the present payload."""
        flange, payload = self.scene.flange, self._payload
        unchecked(fill_payload)(
            self.figures, self._mass_kg, flange.origin, flange.axes, self._mounted, payload
        )
        torque: Array = servos.payload_regressor.dot(payload)
        torque += servos.torque
        return torque

    def momentum_error(self) -> float:
        """Return how far what acts on flange and bodies is from what was transferred over."""
        transferred = self._state.transferred
        on_flange = relative_error(
            transferred.flange, self.scene.received_wrench(), transferred.flange_size_N
        )
        if self.contact is None or (transferred.bodies == NOTHING and not self._bodies.loaded.any()):
            return on_flange
        return max(on_flange, self.error_on_bodies())

    def error_on_bodies(self) -> float:
        """Return how far what acts on bodies in the step in progress is from what was transferred over."""
        bodies, received = self._bodies, NOTHING
        for body in np.flatnonzero(bodies.loaded).tolist():
            received = total(received, about_origin(six_numbers(bodies.applied[body]), bodies.centers[body]))
        return relative_error(self.transferred.bodies, received, self.transferred.bodies_size_N)

    def advance_soft(self, loads: Loads, accuracy: StepAccuracy | None = None) -> SoftReply:
        """Take the soft step to the flange's present pose, with the contacts that are there.

        Afterwards the bodies bear the contacts' loads.

        Args:
            loads: on the soft body at the end of the tick, contacts not counted.
            accuracy: how closely; as an ordinary step unless given.
        """
        soft, flange, tick_s = self.soft, self.scene.flange_pose, self.scene.tick_s
        if self.light is not None:
            reply = self._advance_with(self.light, flange, loads, accuracy)
        elif accuracy is None:
            reply = soft.advance(flange, loads, tick_s)
        else:
            reply = soft.advance_accurately(flange, loads, tick_s, accuracy)
        state = self._state
        self._state = InterfaceState(reply.wrench, state.transferred, state.ratio, state.ticks)
        return reply

    def _advance_with(
        self, light: LightBodies, flange: Pose, loads: Loads, accuracy: StepAccuracy | None
    ) -> SoftReply:
        """Take the soft step with bodies that may give way.

        A step that looks back over a hit may find nothing on which film and bodies agree: then it looks back
        over one step alone, by implicit Euler, in which the film is softer.
        """
        soft, before = self.soft, self.soft.state
        try:
            return light.advance(flange, loads, accuracy)
        except ConvergenceError:
            if before.earlier is None:
                raise
        soft.restore(before)
        soft.restart()
        return light.advance(flange, loads, accuracy)

    def update_figures(self) -> None:
        """Read the figures of the soft side after its step."""
        fill_figures(self.soft, self._state.wrench, self.figures)

    def transfer_loads(self, reply: SoftReply, taken: TickLog, acted: Wrench | None = None) -> None:
        """Hand over the wrench that `advance_soft` has returned, and end the tick in progress.

        Powers are those of what has acted and of the answer.

        Args:
            reply: of the soft side.
            taken: its row is filled.
            acted: on the flange in the tick, at its origin now; that of `load_flange` unless given.
        """
        self.update_figures()
        k, flange, state = taken.done, self.scene.flange, self._state
        a, b, c, *speed = flange.spin.tolist()
        answer, moving = numbers_of(reply.wrench), (*speed, a, b, c)
        acting = self._acting if acted is None else numbers_of(acted)
        about_world = about_origin(answer, self.scene.flange_pose.translation)
        force_N = max(abs(answer[0]), abs(answer[1]), abs(answer[2]))
        taken.rigid_power_W[k], taken.soft_power_W[k] = work_rate(acting, moving), -work_rate(answer, moving)
        taken.power_size_W[k] = _size(answer, moving)
        if self.contact is None:
            transferred = TransferredLoads(about_world, NOTHING, force_N, 0.0)
        else:
            *on_bodies, size_N, normal_N = self._bodies.transferred.tolist()
            transferred = TransferredLoads(about_world, tuple(on_bodies), force_N, size_N, normal_N)
            touched = self.contact.report
            taken.contacts[k], taken.contact_work_J[k] = touched.count, touched.work_J
            taken.contact_force_N[k] = state.transferred.bodies_normal_N
            taken.contact_depth_m[k], taken.contact_ratio[k] = touched.depth_m, self.contact_ratio
            taken.hit_m_s[k], taken.hit_way_m[k] = touched.hit_m_s, touched.hit_way_m
            taken.hit_body[k] = touched.hit_body
        self._state = InterfaceState(state.wrench, transferred, state.ratio, state.ticks + 1)
        taken.stability_ratio[k] = state.ratio
        taken.end_tick(reply, self.soft, self.figures)


def _size(load: SixNumbers, twist: SixNumbers) -> float:
    """Return the product of the sizes of a load and a twist [W]: a power of this size is large."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = load, twist
    force, torque = math.sqrt(x * x + y * y + z * z), math.sqrt(u * u + v * v + w * w)
    return force * math.sqrt(a * a + b * b + c * c) + torque * math.sqrt(d * d + e * e + f * f)
