"""An arm with servos as the carrier of the flange.

One of several arms in a scene as the carrier of its flange: one call steps the scene for all of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.base.solid import BodyShape, FilmInLink, LinkContact
from cosim.config.schema.scenario import CouplingTable
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.schemes.interface import Coupling, Interface
from cosim.coupling.schemes.iterated import IteratedCoupling, IterationOptions
from cosim.coupling.schemes.linear_rigid import rigid_slopes
from cosim.coupling.schemes.staggered import AutomaticCoupling, StaggeredCoupling
from cosim.coupling.soft_sides.soft_side import MassProperties, SoftSide
from cosim.coupling.ticks import Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.errors import InputError, SolverError
from cosim.kinematics.arm import Arm, Payload, inertial_parameters
from cosim.plan.motion import CellMotion, JointReference
from cosim.rigid.scene.arms import SharedScene
from cosim.rigid.scene.scene import RigidScene, RigidState
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.stepping.scene_carrier import SceneCarrier

_SETTLED_RAD = 1e-9


@final
@dataclass(frozen=True)
class ArmCarrierState:
    """Where arm and scene are.

    Args:
        scene: rigid side.
        reference: (joints,) [rad] of the last increment, in statics.
        coupling: exchange with the soft side; None in statics.
    """

    scene: RigidState
    reference: Array
    coupling: Any


class ArmCarrier(SceneCarrier):
    """Moves the flange by servos with inverse-dynamics feedforward.

    Args:
        arm: kinematics and inverse dynamics.
        scene: rigid side.
        soft: soft side.
        payload_compensation: whether the feedforward knows the soft robot's weight.
        mounted: rigid mass on the flange besides the soft robot, flange frame; None for none.
        contact: law of the soft robot's contact with the scene; None for no contact.
        exchange: scheme in which both sides exchange their loads.
        cell: how the joints of the cell move; None where it has none.
    """

    def __init__(
        self,
        arm: Arm,
        scene: RigidScene,
        soft: SoftSide,
        payload_compensation: bool,
        contact: ContactLaw | None = None,
        mounted: MassProperties | None = None,
        exchange: CouplingTable | None = None,
        cell: CellMotion | None = None,
    ) -> None:
        super().__init__(scene.coupled, soft, contact)
        self._arm, self._scene, self._cell = arm, scene, cell
        self._compensation, self._mounted = payload_compensation, mounted
        self._exchange = exchange or CouplingTable()
        self._reference = np.zeros(arm.joint_count)
        self._touching: tuple[LinkContact, ...] = ()

    @property
    def joint_position(self) -> Array:
        return self._scene.joint_position

    @property
    def joint_names(self) -> tuple[str, ...]:
        return self._scene.joint_names

    @property
    def joint_velocity(self) -> Array:
        return self._scene.joint_velocity

    @property
    def joint_torque(self) -> Array:
        return self._scene.servo_torque

    def flange_jacobian(self) -> Array:
        return self._scene.flange.jacobian()

    def holding_torque(self, wrench: Wrench) -> Array:
        load = np.concatenate([wrench.force, wrench.torque])
        return np.asarray(self._scene.bias_torque - self._scene.flange.jacobian().T @ load)

    def linear_half(self) -> Array:
        coupling = self._coupling
        if not isinstance(coupling, StaggeredCoupling):
            raise InputError("a linear model is of the staggered exchange: set coupling.scheme = 'staggered'")
        if coupling.interface.touched.count:
            raise InputError("a linear model has no contact; move the soft robot off all bodies")

        def servos(position: Array, velocity: Array) -> Servos:
            still = np.zeros((1, len(position)))
            return self.servos(JointReference(position[None], velocity[None], still))

        return rigid_slopes(coupling.interface, coupling.carried(), servos, self._scene.servo_reference)

    @property
    def sliding(self) -> tuple[bool, ...]:
        return tuple(self._arm.prismatic.tolist())

    @property
    def mounted(self) -> tuple[float, ...]:
        return () if self._mounted is None else self._mounted.figures()

    @property
    def shapes(self) -> tuple[BodyShape, ...]:
        return self._scene.shapes

    @property
    def report(self) -> Mapping[str, str]:
        arm, cell = self._arm, self._scene.description.cell
        servos = f"{arm.name}, {arm.joint_count} joints, servos with inverse-dynamics feedforward"
        notes = filter(None, (*arm.notes, self._scene.drawn_as))
        return {
            "Arm": "; ".join((servos, *notes)),
            **({} if cell is None else {"Cell": cell.report}),
            "Exchange": exchange_report(self._exchange),
            "Payload compensation": "on" if self._compensation else "off",
        }

    def set_configuration(self, joints: Array) -> None:
        self._scene.set_joint_state(joints)
        self._reference = joints

    def track(self, reference: Array) -> None:
        self._scene.set_joint_state(reference + self._scene.joint_position - self._reference)
        self._reference = reference

    def relax_under(self, reference: Array, wrench: Wrench) -> bool:
        scene, still = self._scene, np.zeros_like(reference)
        feedforward = self._arm.inverse_dynamics(reference, still, still, payload=self._payload())
        joints = scene.static_configuration(reference, feedforward, wrench)
        if float(np.abs(joints - scene.joint_position).max()) < _SETTLED_RAD:
            return False
        scene.set_joint_state(joints)
        return True

    def link_contacts(self, *, among_links: bool) -> tuple[LinkContact, ...]:
        scene = self._scene
        links = scene.links
        self._touching = links.at(scene.joint_position) if among_links else links.with_objects()
        return self._touching

    def link_contacts_in(self, joints: Array, places: Array, quaternions: Array) -> tuple[LinkContact, ...]:
        self._touching = self._scene.links.at(joints, places, quaternions)
        return self._touching

    def film_in_links(self, positions: Array, joints: Array) -> tuple[FilmInLink, ...]:
        return self._scene.links.with_film(positions, joints)

    def with_links(self, error: SolverError) -> SolverError:
        touching = ", ".join(f"{contact.link} in {contact.other}" for contact in self._touching)
        return error.at(f"with {touching}") if touching else error

    @property
    def drives_cell(self) -> bool:
        return self._cell is not None

    def drive_cell(self, phase: int, time_s: float) -> None:
        if self._cell is not None:
            self._scene.cell.aim(*self._cell.at(phase, time_s))

    def _exchanging(self, wrench: Wrench, contact: ContactExchange | None) -> Coupling:
        load, mounted = self._mounted, None
        if load is not None:
            mounted = inertial_parameters(load.mass_kg, load.center, load.inertia)
        interface = Interface(self._coupled, self._soft, wrench, contact, mounted)
        return make_coupling(self._exchange, interface)

    def save_state(self) -> ArmCarrierState:
        coupling = None if self._coupling is None else self._coupling.save_state()
        saved = ArmCarrierState(self._scene.save_state(), self._reference, coupling)
        self._known.add(saved)
        return saved

    def restore_state(self, state: object) -> None:
        if not isinstance(state, ArmCarrierState):
            raise InputError("the saved state is of a held base, this flange is carried")
        self._restore_exchange(state, state.coupling, state.scene.loaded)
        self._reference = state.reference

    def servos(self, references: JointReference) -> Servos:
        position, velocity = references.position, references.velocity
        acceleration = references.acceleration
        new, row = references.distinct()
        torque, by_payload = self._arm.torque_rows(
            position[new], velocity[new], acceleration[new], self._scene.armature
        )
        if not self._compensation:
            by_payload = np.zeros_like(by_payload)
        # MuJoCo's speeds are ways over a tick, those of its middle; position and force are of its begin
        speed = velocity + 0.5 * self._scene.tick_s * acceleration
        return Servos(position, speed, torque[row], by_payload[row])

    def _payload(self) -> Payload | None:
        """Return what hangs on the flange as a rigid payload, at its present shape; None: unknown to it."""
        if not self._compensation:
            return None
        mass = self._soft.mass_properties()
        if self._mounted is not None:
            mass = mass.joined(self._mounted.moved(self.flange_pose))
        center, inertia = mass.in_frame(self.flange_pose)
        return Payload(mass.mass_kg, center, inertia)


@final
class SharedArm(ArmCarrier):
    """An arm among others: `begin`, the step of the scene, `advance`; see `ArmCarrier`."""

    @property
    def _shared(self) -> SharedScene:
        assert isinstance(self._coupled, SharedScene), "several arms are in the scene"
        return self._coupled

    def set_configuration(self, joints: Array) -> None:
        super().set_configuration(joints)
        self._shared.flange.moved()

    def begin_with_others(self, servos: Servos) -> None:
        assert isinstance(self._coupling, StaggeredCoupling), "couple() comes before"
        self._coupling.begin(opening=False)
        self._shared.begin_tick()
        payload, feedforward = self._payload(), servos.torque[0]
        if payload is not None:
            known = inertial_parameters(payload.mass_kg, payload.center_of_mass, payload.inertia)
            feedforward = feedforward + servos.by_payload[0] @ known
        self._scene.set_control(servos.position[0], servos.velocity[0], feedforward)

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        self._shared.end_tick()
        with self._shared.lent():
            return super().advance(servos, loads)

    def save_state(self) -> Any:
        raise InputError("a run of several arms cannot be saved; run each arm alone, or start again")


def make_coupling(settings: CouplingTable, interface: Interface) -> Coupling:
    """Return the scheme that a scenario asks for."""
    options = IterationOptions(settings.tolerance, settings.iterations_max)
    if settings.scheme == "iterated":
        return IteratedCoupling(interface, options)
    if settings.scheme == "auto":
        return AutomaticCoupling(interface, options)
    return StaggeredCoupling(interface)


def exchange_report(settings: CouplingTable) -> str:
    """Return in words how both sides exchange their loads."""
    if settings.scheme == "staggered":
        return "staggered, both ways at every tick"
    agreed = f"every tick repeated until the loads agree to {settings.tolerance:g}"
    if settings.scheme == "iterated":
        return f"iterated: {agreed}"
    return f"automatic: staggered; where that would need algorithmic mass, {agreed}"
