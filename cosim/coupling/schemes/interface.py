"""What every scheme of exchange acts on: both sides, their contacts, and the wrench between them.

Action and reaction are checked in every tick: what the rigid side has received is what was handed over.
Transferred: the soft side's wrench on the flange, and the contact forces on its film with the opposite sign,
summed node by node. Received: what MuJoCo holds applied to the flange and to the touched bodies in the step,
read back from it. Both are taken about the world's origin, so forces represent momentum and torques for
angular momentum, each times the tick. In the staggered exchange a tick receives what the tick before has
handed over; in the iterated one, what the same tick hands over, and what the last one left over.

`rigid_slopes` is the rigid half of a staggered tick to first order: how arm and servos answer small changes.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, Pose, SixNumbers, Wrench, cross
from cosim.coupling import half_ticks
from cosim.coupling.contact import contact_arrays, contact_exchange, contact_report
from cosim.coupling.contact.giving_way import LightBodies, LightBodiesState
from cosim.coupling.half_ticks import RigidSide, hand_over, read_rigid_half, take_rigid_half
from cosim.coupling.soft_sides.soft_side import SoftReply, SoftSide, exchange_gain, stability_ratio
from cosim.coupling.ticks import CarriedInertia, Servos, TicksTaken
from cosim.errors import ConvergenceError, InputError
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import StepAim

NOTHING: SixNumbers = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@final
@dataclass(frozen=True)
class TransferredLoads:
    """Loads about the world's origin, (force, torque) each; plain numbers, as numpy is slow on six.

    Args:
        flange: on it.
        bodies: sum over all touched bodies.
        flange_size_N: of the loads that make up the first.
        bodies_size_N: the same of the second.
        bodies_normal_N: sum of the normal forces on bodies.
    """

    flange: SixNumbers
    bodies: SixNumbers
    flange_size_N: float
    bodies_size_N: float
    bodies_normal_N: float = 0.0

    def error(self, due: SixNumbers, received: SixNumbers) -> float:
        """Return the largest relative difference of what the flange has received from this and what is due.

        Args:
            due: besides these loads, about the world's origin.
            received: about the world's origin.
        """
        return _error(_sum(self.flange, due), received, self.flange_size_N)


def six_numbers(load: Array) -> SixNumbers:
    """Return a load (6,) as plain numbers."""
    x, y, z, u, v, w = load.tolist()
    return x, y, z, u, v, w


def _sum(first: SixNumbers, second: SixNumbers) -> SixNumbers:
    (x, y, z, u, v, w), (a, b, c, d, e, f) = first, second
    return x + a, y + b, z + c, u + d, v + e, w + f


def _error(given: SixNumbers, found: SixNumbers, size_N: float) -> float:
    """Return the largest component of the difference of two loads over a size."""
    (x, y, z, u, v, w), (a, b, c, d, e, f) = given, found
    force = max(abs(x - a), abs(y - b), abs(z - c))
    torque = max(abs(u - d), abs(v - e), abs(w - f))
    return max(force, torque / half_ticks.LEVER_M) / max(size_N, half_ticks.SMALLEST_N)


# Shape and configuration hardly change meanwhile, and the ratio costs as much as the rest of the exchange.
# So it is found after a time, in bounds of ticks; after a longer one where nothing hangs on it.
_UPDATED_AFTER_S, _SELDOM_AFTER_S, _FAR_RATIO = 0.08, 0.25, 0.25
_FEWEST_TICKS, _MOST_TICKS, _MOST_TICKS_FAR = 10, 40, 64


@final
@dataclass(frozen=True)
class InterfaceState:
    """Where an interface is, without scene and soft side.

    Args:
        wrench: on the flange in the next tick.
        handed: what the soft side has handed over at the end of the last tick.
        touched: contacts of the last tick.
        ratio: stability ratio of the flange when it was last updated.
        ticks: done.
        contact: of the soft body with the scene; None where it is not modelled.
        light: bodies that give way, the same.
    """

    wrench: Wrench
    handed: TransferredLoads
    touched: contact_report.ContactReport
    ratio: float
    ticks: int
    contact: contact_exchange.ContactState | None
    light: LightBodiesState | None


@final
class Interface:
    """Rigid side, soft side, and what they last exchanged.

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
        soft: SoftSide,
        wrench: Wrench,
        contact: contact_exchange.ContactExchange | None = None,
        mounted: Array | None = None,
    ) -> None:
        self.scene, self.soft, self.contact = scene, soft, contact
        self._rigid_half = take_rigid_half if scene.steps_itself else read_rigid_half
        self._mounted = np.zeros(10) if mounted is None else mounted
        self._native, bodies = scene.native(), scene.bodies
        self._bodies = contact_arrays.BodyLoads(
            bodies.applied,
            bodies.mass_centers,
            bodies.bearing,
            np.zeros(bodies.count),
            np.zeros(8),
            contact_arrays.leads_of(bodies),
        )
        if contact is not None:
            self._bodies = contact.arrays.bodies
        self.light = LightBodies(contact, soft, scene.tick_s) if contact is not None else None
        self._untouched = self._contacts()
        self.wrench = wrench
        about_world = wrench.moved(-scene.flange_pose.translation)
        flange = six_numbers(np.concatenate([about_world.force, about_world.torque]))
        self.handed = TransferredLoads(flange, NOTHING, float(np.abs(wrench.force).max()), 0.0)
        self.ticks = 0
        self._often = min(max(_FEWEST_TICKS, round(_UPDATED_AFTER_S / scene.tick_s)), _MOST_TICKS)
        self._seldom = min(max(_FEWEST_TICKS, round(_SELDOM_AFTER_S / scene.tick_s)), _MOST_TICKS_FAR)
        self.ratio, self._updated_every = 0.0, self._seldom

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
        return self.ticks % self._updated_every == 0

    def update_stability_ratio(self) -> None:
        """Find the stability ratio of the flange, as if no algorithmic mass rode on the joints.

        That of the soft side as a rigid body, times what its integrator makes of it in an exchange that is
        one tick late.
        """
        body = self.soft.mass_properties().spatial(self.scene.flange_pose.translation)
        gain = exchange_gain(self.soft.answer_weights)
        self._take_ratio(gain * stability_ratio(self.scene.mobility(), body))

    def _take_ratio(self, ratio: float) -> None:
        self.ratio, self._updated_every = ratio, self._seldom if ratio < _FAR_RATIO else self._often

    def save_state(self) -> InterfaceState:
        """Return what the next exchange depends on besides the states of scene and soft side."""
        contact, light = self._contacts()
        return InterfaceState(self.wrench, self.handed, self.touched, self.ratio, self.ticks, contact, light)

    def restore_state(self, state: InterfaceState) -> None:
        """Return to a state of `save_state`; scene and soft side have been restored before.

        Contact that has not been modelled before begins untouched.

        Raises:
            InputError: contact is modelled in the state only.
        """
        if self.contact is None and state.contact is not None:
            raise InputError("contact is modelled in the saved state only")
        self.wrench, self.handed = state.wrench, state.handed
        self._take_ratio(state.ratio)
        self.ticks = state.ticks
        contact, light = (state.contact, state.light) if state.contact else self._untouched
        if self.contact is not None and contact is not None:
            self.contact.check_state(contact)
            self.contact.restore_state(contact)
            self.contact.report = state.touched if state.contact else contact_report.NOTHING_TOUCHED
        if self.light is not None and light is not None:
            self.light.restore_state(light)

    def _contacts(self) -> tuple[contact_exchange.ContactState | None, LightBodiesState | None]:
        contact = None if self.contact is None else self.contact.save_state()
        return contact, None if self.light is None else self.light.save_state()

    def begin(self, count: int) -> TicksTaken:
        """Return room for ticks, with what is there before the first of them."""
        flange, handed, bodies = self.scene.flange_pose, self.handed, self._bodies
        joints, chambers = len(self._native.position), len(self.soft.pressures_Pa)
        taken = TicksTaken.room(count, joints, len(bodies.loaded), chambers)
        taken.begin(self.soft, self.wrench, flange)
        taken.ticks.handed[0] = *handed.flange, handed.flange_size_N
        bodies.handed[:] = *handed.bodies, handed.bodies_size_N, handed.bodies_normal_N
        return taken

    def rigid(self, carried: CarriedInertia) -> RigidSide:
        """Return the rigid side as kernels see it, with what the joints carry."""
        return RigidSide(self._native, carried, self._bodies, self._mounted, self.soft.mass_kg)

    def step_rigid(self, rigid: RigidSide, servos: Servos, taken: TicksTaken) -> None:
        """Take the rigid step of the tick in progress, or read that which somebody else has taken.

        Args:
            rigid: side.
            servos: what they are asked for in this tick alone.
            taken: its row is filled.

        Raises:
            InstabilityError: the state is no longer finite.
        """
        if not self._rigid_half(rigid, servos, taken.ticks.from_on(taken.done), 0):
            self.scene.check()
        self.scene.stepped(taken.ticks.flange(taken.done))

    def error_on_bodies(self) -> float:
        """Return how far what acts on bodies in the step in progress is from what was handed over."""
        bodies = self._bodies
        loads = bodies.applied[bodies.loaded != 0]
        loads[:, 3:] += cross(bodies.centers[bodies.loaded != 0], loads[:, :3])
        received = six_numbers(loads.sum(axis=0))
        return _error(self.handed.bodies, received, self.handed.bodies_size_N)

    def advance_soft(self, loads: Loads, aim: StepAim | None = None) -> SoftReply:
        """Take the soft step to the flange's present pose, with the contacts that are there.

        Afterwards the bodies bear the contacts' loads.

        Args:
            loads: on the soft body at the end of the tick, contacts not counted.
            aim: how closely; as an ordinary step unless given.
        """
        soft, flange, tick_s = self.soft, self.scene.flange_pose, self.scene.tick_s
        if self.light is not None:
            reply = self._advance_with(self.light, flange, loads, aim)
        elif aim is None:
            reply = soft.advance(flange, loads, tick_s)
        else:
            reply = soft.advance_closely(flange, loads, tick_s, aim)
        self.wrench = reply.wrench
        return reply

    def _advance_with(self, light: LightBodies, flange: Pose, loads: Loads, aim: StepAim | None) -> SoftReply:
        """Take the soft step with bodies that may give way.

        A step that looks back over a hit may find nothing on which film and bodies agree: then it looks back
        over one step alone, by implicit Euler, in which the film is softer.
        """
        soft, before = self.soft, self.soft.state
        try:
            return light.advance(flange, loads, aim)
        except ConvergenceError:
            if before.earlier is None:
                raise
        soft.restore(before)
        soft.restart()
        return light.advance(flange, loads, aim)

    def take_reply(self, taken: TicksTaken, reply: SoftReply, acted: Array | None = None) -> None:
        """Fill the row of the tick in progress with what `advance_soft` has returned, and hand it over.

        Args:
            taken: filled.
            reply: of the soft side.
            acted: (6,), on the flange in the tick, at its origin, world axes; unless given, as MuJoCo has it.
        """
        k, ticks, touched = taken.done, taken.ticks, self.touched
        taken.take(reply, self.soft)
        hand_over(self._native.applied if acted is None else acted, ticks, k)
        ticks.contacts[k] = touched.count
        ticks.contact[k] = self.handed.bodies_normal_N, touched.depth_m, self.contact_ratio
        ticks.work[k, 0] = touched.work_J
        ticks.hit[k] = touched.hit_m_s, touched.hit_way_m, touched.hit_body
        taken.stability_ratio[k] = self.ratio
        flange, bodies = taken.ticks.handed[taken.done], self._bodies.handed
        self.handed = TransferredLoads(
            six_numbers(flange[:6]), six_numbers(bodies[:6]), float(flange[6]), *bodies[6:].tolist()
        )
        self.ticks += 1


class Coupling(ABC):
    """Advances arm and soft body.

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
    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        """Advance both sides by up to n ticks, at least one; how many changes no result.

        Args:
            servos: what they are asked for.
            loads: on the soft body at the ends of the ticks.

        Returns:
            What they leave, and the error of the tick after the last one, if that has failed.

        Raises:
            InstabilityError: the rigid side is no longer finite, in the first tick.
            ConvergenceError: the first soft step, or the first exchange, has no solution.
        """


_ANGLE, _SPEED, _ACCELERATION, _FIGURE = 1e-6, 1e-5, 1e-3, 1e-4


def rigid_slopes(
    interface: Interface, carried: CarriedInertia, servos: Callable[[Array, Array], Servos], reference: Array
) -> Array:
    """Return how the arm's state ends after the rigid half of a tick, to first order.

    By central differences of MuJoCo's step, which has no derivatives; the state is restored. Rows are joint
    positions, speeds and, where joints carry algorithmic mass, the last accelerations and those in `past`.
    Columns are the same, figures of the soft side (see `fill_figures`), and the servos' references of
    position and speed.

    Args:
        interface: between the sides.
        carried: on the joints; of (0, 0) for none.
        servos: returns what the servos are asked for, by references (joints,) of position and speed.
        reference: (joints,) [rad], present one of position.
    """
    scene = interface.scene
    assert isinstance(scene, RigidScene), "linear models are of scenes that cosim steps"
    saved, ticks = scene.save_state(), interface.begin(1).ticks
    rigid, carries, past = interface.rigid(carried), len(carried.inertia), carried.past.copy()
    joints, last = len(scene.joint_names), np.vstack([scene.joint_acceleration, past])
    last, figures = last.ravel() if carries else last[:0].ravel(), ticks.figures[0].copy()
    here = (scene.joint_position, scene.joint_velocity, last, figures, reference, np.zeros(joints))
    steps = (_ANGLE, _SPEED, _ACCELERATION, _FIGURE, _ANGLE, _SPEED)
    sizes = [len(part) for part in here]
    ends, start, scale = np.cumsum(sizes)[:-1], np.concatenate(here), np.repeat(steps, sizes)

    def after(values: Array) -> Array:
        position, speed, felt, load, aim, pace = np.split(values, ends)
        scene.restore_state(saved)
        scene.set_joint_state(position, speed)
        if carries:
            rigid.scene.acceleration[:], carried.past[:] = felt[:joints], felt[joints:].reshape(past.shape)
        flange = scene.flange_pose
        ticks.figures[0], ticks.origin[0], ticks.axes[0] = load, flange.translation, flange.rotation
        if not take_rigid_half(rigid, servos(aim, pace), ticks, 0):
            raise ConvergenceError("MuJoCo warns near the present state: no linear model", 0.0, 0)
        felt = np.concatenate([rigid.scene.acceleration, carried.past.ravel()])[: len(last)]
        return np.concatenate([ticks.joints[0], ticks.joint_speed[0], felt])

    try:
        columns = [
            (after(start + step) - after(start - step)) / (2.0 * size)
            for step, size in zip(np.diag(scale), scale, strict=True)
        ]
    finally:
        scene.restore_state(saved)
    return np.array(columns).T
