"""The interface that exchange schemes act on: arm, soft robot, their contacts, and the wrench between them.

Action and reaction are checked in every tick: the loads that the rigid scene receives are those that the soft
robot has transferred. Transferred loads are the soft robot's wrench on the flange, and the contact forces on
its film with the opposite sign, summed node by node. Received loads are those that MuJoCo applies to the
flange and the touched bodies in the step, read back from it. Both are taken about the world's origin, so
forces times the tick are momentum and torques times the tick are angular momentum. In the staggered exchange
a tick receives the loads transferred by the last tick; in the iterated one those of the same tick, and the
remainder of the last tick.
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
from cosim.coupling.contact import contact_exchange, contact_report
from cosim.coupling.contact.light_bodies import LightBodies
from cosim.coupling.payload import fill_payload
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.robots.soft_step import SoftReply
from cosim.coupling.robots.stability_ratio import exchange_gain, stability_ratio
from cosim.coupling.schemes.transfer import (
    ZERO_LOAD,
    TransferredLoads,
    relative_error,
    six_numbers,
    total,
    work_rate,
    wrench_numbers,
)
from cosim.coupling.ticks import ServoCommand, TickLog, fill_figures, scene_columns, sizes_of
from cosim.errors import ConvergenceError, InputError
from cosim.reduced.sections.figures import FIGURES
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.rigid.scene.flange import about_origin
from cosim.soft.body.loads import Loads
from cosim.soft.solve.step_scheme import StepAccuracy

# The ratio costs as much as the rest of the exchange and changes slowly with shape and configuration. So it
# is updated after a time, within bounds of ticks; after a longer time if it is far below its bound.
_UPDATED_AFTER_S, _SELDOM_AFTER_S, _FAR_RATIO = 0.08, 0.25, 0.25
_FEWEST_TICKS, _MOST_TICKS, _MOST_TICKS_FAR = 10, 40, 64


@final
@dataclass(frozen=True)
class InterfaceState:
    """State of an interface, without scene, soft robot and contacts.

    Args:
        wrench: on the flange in the next tick.
        transferred: loads that the soft robot has transferred at the end of the last tick.
        ratio: stability ratio of the flange when it was last updated.
        ticks: done.
    """

    wrench: Wrench
    transferred: TransferredLoads
    ratio: float = 0.0
    ticks: int = 0


@final
class Interface:
    """Rigid scene, soft robot, and the loads that they exchanged last.

    `figures` (FIGURES,) are the soft robot's present wrench on the flange, centre and inertia of its mass.

    Args:
        scene: rigid scene.
        soft: soft robot.
        wrench: of the soft robot at the start, at the flange origin, world axes.
        contact: of the soft robot with the scene; None if it is not modelled.
        mounted: (10,) `inertial_parameters` of a rigid mass on the flange, flange frame; None for none.
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
        self._new_columns = room_for(TickColumns, sizes_of(joints, bodies, chambers))
        self._mounted = np.zeros(10) if mounted is None else np.array(mounted)
        self._payload, self._mass_kg, self._acting = np.zeros(10), soft.mass_kg, ZERO_LOAD
        untouched = contact_exchange.body_loads(scene.bodies, predicted=False)
        self._bodies = untouched if contact is None else contact.loads
        self.light = LightBodies(contact, soft, scene.tick_s) if contact is not None else None
        self._untouched = states_of(self.contacts())
        about_world = wrench_numbers(wrench.moved(-scene.flange_pose.translation))
        transferred = TransferredLoads(about_world, ZERO_LOAD, float(np.abs(wrench.force).max()), 0.0)
        self._state, self.figures = InterfaceState(wrench, transferred), np.zeros(FIGURES)
        self.update_figures()
        self._often = min(max(_FEWEST_TICKS, round(_UPDATED_AFTER_S / scene.tick_s)), _MOST_TICKS)
        self._seldom = min(max(_FEWEST_TICKS, round(_SELDOM_AFTER_S / scene.tick_s)), _MOST_TICKS_FAR)

    @property
    def wrench(self) -> Wrench:
        """The soft robot's present wrench on the flange, at its origin, world axes."""
        return self._state.wrench

    @property
    def transferred(self) -> TransferredLoads:
        """Loads that the soft robot has transferred at the end of the last tick."""
        return self._state.transferred

    @property
    def ratio(self) -> float:
        """Stability ratio of the flange when it was last updated."""
        return self._state.ratio

    @property
    def touched(self) -> contact_report.ContactReport:
        """Report of the last tick's contacts."""
        return contact_report.NOTHING_TOUCHED if self.contact is None else self.contact.report

    @property
    def contact_ratio(self) -> float:
        """Contact ratio of the bodies that the film touches, see `LightBodies`; 0 if it touches none."""
        return self.light.ratio if self.light is not None and self.touched.count else 0.0

    @property
    def ratio_is_due(self) -> bool:
        """Whether the stability ratio must be updated before the next tick."""
        often = self._state.ratio >= _FAR_RATIO
        return self._state.ticks % (self._often if often else self._seldom) == 0

    def update_stability_ratio(self) -> None:
        """Compute the stability ratio of the flange, as if the joints carried no algorithmic mass.

        It is the ratio of the soft robot as a rigid body, times the gain of its integrator in an exchange
        that is one tick late.
        """
        body = self.soft.mass_properties().spatial(self.scene.flange_pose.translation)
        gain = exchange_gain(self.soft.reaction_weights)
        ratio = gain * stability_ratio(self.scene.mobility(), body)
        self._state = replace(self._state, ratio=ratio)

    def count_as_one(self, ticks: int) -> None:
        """Count all exchanges since tick number `ticks` as one tick."""
        self._state = replace(self._state, ticks=ticks + 1)

    @property
    def state(self) -> InterfaceState:
        """State of the exchange; restore scene, soft robot and contacts before it."""
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
        """Return the stateful parts besides scene and soft robot, by name."""
        return {**self.contacts(), "exchange": self}

    def contacts(self) -> dict[str, Any]:
        """Return the stateful parts of contact, by name; empty if contact is not modelled."""
        return {} if self.contact is None else {"contact": self.contact, "light": self.light}

    def completed(self, states: Mapping[str, Any]) -> dict[str, Any]:
        """Return saved states, with those of untouched contact if the saved run did not model contact.

        Raises:
            InputError: contact is modelled in the saved state only.
        """
        saved = states.get("contact")
        if self.contact is None and saved is not None:
            if glued := len(saved.glued):
                raise InputError(f"the saved soft robot is glued by {glued} nodes, this one by 0")
            raise InputError("contact is modelled in the saved state only")
        return {**self._untouched, **states}

    def new_log(self, count: int) -> TickLog:
        """Return an empty log for up to `count` ticks."""
        return TickLog(self._new_columns(count))

    def load_flange(self, wrench: Wrench) -> None:
        """Apply a wrench to the flange in the next rigid step."""
        self._acting = wrench_numbers(wrench)
        self.scene.apply_flange_wrench(wrench)

    def step_rigid(self, servos: ServoCommand, log: TickLog) -> None:
        """Take the rigid step of a tick under servos and loads.

        Args:
            servos: commands.
            log: its row is filled.

        Raises:
            InstabilityError: the state is no longer finite.
        """
        error = self.momentum_error()
        self.scene.step_arm(servos.position, servos.velocity, self.feedforward(servos))
        log.log_scene(self.scene, self._rows, self._bodies, error)

    def read_rigid(self, log: TickLog) -> None:
        """Log the rigid step of a tick that another loop has taken."""
        log.log_scene(self.scene, self._rows, self._bodies, self.momentum_error())

    def feedforward(self, servos: ServoCommand) -> Array:
        """Return the servos' feedforward torques (joints,) [N m] with the present payload."""
        flange, payload = self.scene.flange, self._payload
        unchecked(fill_payload)(
            self.figures, self._mass_kg, flange.origin, flange.axes, self._mounted, payload
        )
        torque: Array = servos.payload_regressor.dot(payload)
        torque += servos.torque
        return torque

    def momentum_error(self) -> float:
        """Return the relative error between the loads on flange and bodies and the transferred ones."""
        transferred = self._state.transferred
        on_flange = relative_error(
            transferred.flange, self.scene.received_wrench(), transferred.flange_size_N
        )
        if self.contact is None or (transferred.bodies == ZERO_LOAD and not self._bodies.loaded.any()):
            return on_flange
        return max(on_flange, self.error_on_bodies())

    def error_on_bodies(self) -> float:
        """Return the relative error between the loads on bodies in this step and the transferred ones."""
        bodies, received = self._bodies, ZERO_LOAD
        for body in np.flatnonzero(bodies.loaded).tolist():
            received = total(received, about_origin(six_numbers(bodies.applied[body]), bodies.centers[body]))
        return relative_error(self.transferred.bodies, received, self.transferred.bodies_size_N)

    def advance_soft(self, loads: Loads, accuracy: StepAccuracy | None = None) -> SoftReply:
        """Take the soft step to the flange's present pose, with contacts, and load the bodies.

        Args:
            loads: on the soft robot at the end of the tick, without contacts.
            accuracy: of the step; None for an ordinary step.
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
        """Take the soft step with implicit contact of light bodies.

        A BDF2 step just after a hit may have no solution. Then the step is repeated by implicit Euler, in
        which the film is softer.
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
        """Read the figures of the soft robot after its step."""
        fill_figures(self.soft, self._state.wrench, self.figures)

    def transfer_loads(self, reply: SoftReply, log: TickLog, acted: Wrench | None = None) -> None:
        """Transfer the wrench that `advance_soft` has returned to the next tick, and end this one.

        The logged powers are those of the wrench that acted and of the soft robot's reply.

        Args:
            reply: of the soft robot.
            log: its row is filled.
            acted: wrench on the flange in this tick, at its present origin; None for that of `load_flange`.
        """
        self.update_figures()
        k, flange, state = log.done, self.scene.flange, self._state
        a, b, c, *speed = flange.spin.tolist()
        reply_wrench, twist = wrench_numbers(reply.wrench), (*speed, a, b, c)
        acting_wrench = self._acting if acted is None else wrench_numbers(acted)
        about_world = about_origin(reply_wrench, self.scene.flange_pose.translation)
        force_N = max(abs(reply_wrench[0]), abs(reply_wrench[1]), abs(reply_wrench[2]))
        log.rigid_power_W[k], log.soft_power_W[k] = (
            work_rate(acting_wrench, twist),
            -work_rate(reply_wrench, twist),
        )
        log.power_size_W[k] = _size(reply_wrench, twist)
        if self.contact is None:
            transferred = TransferredLoads(about_world, ZERO_LOAD, force_N, 0.0)
        else:
            *on_bodies, size_N, normal_N = self._bodies.transferred.tolist()
            transferred = TransferredLoads(about_world, tuple(on_bodies), force_N, size_N, normal_N)
            contact_report = self.contact.report
            log.contacts[k], log.contact_work_J[k] = contact_report.count, contact_report.work_J
            log.contact_force_N[k] = state.transferred.bodies_normal_N
            log.contact_depth_m[k], log.contact_ratio[k] = contact_report.depth_m, self.contact_ratio
            log.hit_m_s[k], log.hit_way_m[k] = contact_report.hit_m_s, contact_report.hit_way_m
            log.hit_body[k] = contact_report.hit_body
        self._state = InterfaceState(state.wrench, transferred, state.ratio, state.ticks + 1)
        log.stability_ratio[k] = state.ratio
        log.end_tick(reply, self.soft, self.figures)


def _size(load: SixNumbers, twist: SixNumbers) -> float:
    """Return the scale [W] of a load's power at a twist: the product of their sizes."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = load, twist
    force, torque = math.sqrt(x * x + y * y + z * z), math.sqrt(u * u + v * v + w * w)
    return force * math.sqrt(a * a + b * b + c * c) + torque * math.sqrt(d * d + e * e + f * f)
