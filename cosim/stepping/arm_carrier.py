"""Arms that carry the flange in a MuJoCo scene: a single one, or one of several."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, final

import numpy as np

from cosim.base.frames import Array, Wrench
from cosim.base.solid import BodyShape, FilmInLink, LinkContact, MovableBody
from cosim.config.schema.settings import CouplingTable
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.robots.mass_properties import MassProperties
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.schemes import iterated
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.rigid_jacobian import rigid_jacobian
from cosim.coupling.schemes.staggered import StaggeredCoupling
from cosim.coupling.ticks import ServoCommands, TickLog
from cosim.errors import InputError, SolverError
from cosim.kinematics.arm import Arm, Payload
from cosim.kinematics.inertial_parameters import inertial_parameters
from cosim.plan.cell_motion import CellMotion
from cosim.plan.joint_path import JointReference
from cosim.rigid.scene import arms
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.loads import Loads
from cosim.soft.contact.contact_law import ContactLaw
from cosim.stepping.scene_carrier import SceneCarrier

_AT_REST_rad: Final = 1e-9


@final
@dataclass(frozen=True)
class ArmCarrierState:
    """State of an arm, without its scene and the exchange.

    Args:
        reference: (joints,) [rad] of the last increment, in statics.
        mounted_load: (6,), load of other bodies on the flange in the last tick; None at rest.
    """

    reference: Array
    mounted_load: Annotated[Array, (6,)] | None = None


class ArmCarrier(SceneCarrier):
    """Moves the flange by servos with inverse-dynamics feedforward.

    Args:
        arm: kinematics and inverse dynamics.
        scene: rigid side.
        soft: soft side.
        payload_compensation: whether the feedforward includes the soft robot's weight.
        contact: law of the soft robot's contact with the scene; None for no contact.
        mounted: other rigid mass on the flange, flange frame; None for none.
        exchange: scheme of the exchange of loads.
        cell: motion of the cell's joints; None without any.
    """

    def __init__(
        self,
        arm: Arm,
        scene: RigidScene,
        soft: SoftRobot,
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
        self._touching: tuple[LinkContact, ...] = ()
        self.state = ArmCarrierState(np.zeros(arm.joint_count))
        """State for the next step, without scene and exchange."""

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

    def hold(self, wrench: Wrench) -> Array:
        scene, load = self._scene, np.concatenate([wrench.force, wrench.torque])
        scene.servos.torque[:] = scene.bias_torque - scene.flange.jacobian().T @ load
        return scene.servo_torque

    def linear_rigid_step(self) -> Array:
        coupling = self._coupling
        if not isinstance(coupling, StaggeredCoupling):
            raise InputError("a linear model needs the staggered exchange: set coupling.scheme = 'staggered'")
        if coupling.interface.touched.count:
            raise InputError("a linear model has no contact; move the soft robot off all bodies")

        def servos(position: Array, velocity: Array) -> ServoCommands:
            still = np.zeros((1, len(position)))
            return self.servos(JointReference(position[None], velocity[None], still))

        return rigid_jacobian(coupling.interface, coupling.carried(), servos, self._scene.servo_reference)

    @property
    def sliding(self) -> tuple[bool, ...]:
        return tuple(self._arm.prismatic.tolist())

    @property
    def mounted(self) -> tuple[float, ...]:
        return () if self._mounted is None else self._mounted.figures()

    @property
    def mounted_load(self) -> Array:
        if self.state.mounted_load is not None:
            return self.state.mounted_load
        if self._mounted is None:
            return np.zeros(6)
        weight = self._mounted.mass_kg * np.array(self._scene.description.gravity)
        lever = self.flange_pose.rotation @ self._mounted.center
        return np.concatenate([weight, np.cross(lever, weight)])

    @property
    def objects(self) -> tuple[MovableBody, ...]:
        return self._scene.objects

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
        self.state = ArmCarrierState(joints)

    @property
    def deflection(self) -> Array:
        return self._scene.joint_position - self.state.reference

    def track(self, reference: Array, deflection: Array) -> None:
        self._scene.set_joint_state(reference + deflection)
        self.state = replace(self.state, reference=reference)

    def relax_under(self, reference: Array, wrench: Wrench) -> bool:
        scene, still = self._scene, np.zeros_like(reference)
        feedforward = self._arm.inverse_dynamics(reference, still, still, payload=self._payload())
        joints = scene.static_configuration(reference, feedforward, wrench)
        if float(np.abs(joints - scene.joint_position).max()) < _AT_REST_rad:
            return False
        scene.set_joint_state(joints)
        return True

    def link_contacts(self, *, among_links: bool) -> tuple[LinkContact, ...]:
        scene = self._scene
        links = scene.links
        self._touching = links.at(scene.joint_position) if among_links else links.with_objects()
        return self._touching

    def link_contacts_in(
        self, joints: Array, positions: Array, quaternions: Array
    ) -> tuple[LinkContact, ...]:
        self._touching = self._scene.links.at(joints, positions, quaternions)
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

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        ticks = super().advance(servos, loads)
        if ticks.done:
            mounted_load = ticks.mounted_load[ticks.done - 1].copy()
            self.state = replace(self.state, mounted_load=mounted_load)
        return ticks

    def parts(self) -> dict[str, Any]:
        return {**super().parts(), "arm": self}

    def servos(self, references: JointReference) -> ServoCommands:
        position, velocity = references.position, references.velocity
        acceleration = references.acceleration
        new, row = references.distinct()
        torque, by_payload = self._arm.torque_rows(
            position[new], velocity[new], acceleration[new], self._scene.armature
        )
        if not self._compensation:
            by_payload = np.zeros_like(by_payload)
        # MuJoCo's speeds are those in the middle of a tick, positions and forces those at its start
        speed = velocity + 0.5 * self._scene.tick_s * acceleration
        return ServoCommands(position, speed, torque[row], by_payload[row])

    def _payload(self) -> Payload | None:
        """Return the payload at its present shape as a rigid body; None without compensation."""
        if not self._compensation:
            return None
        mass = self._soft.mass_properties()
        if self._mounted is not None:
            mass = mass.joined(self._mounted.moved(self.flange_pose))
        center, inertia = mass.in_frame(self.flange_pose)
        return Payload(mass.mass_kg, center, inertia)


@final
class SharedArm(ArmCarrier):
    """One of several arms: `begin_with_others`, the step of the scene, `advance`; see `ArmCarrier`."""

    @property
    def _shared(self) -> arms.SharedScene:
        assert isinstance(self._coupled, arms.SharedScene), "several arms are in the scene"
        return self._coupled

    def set_configuration(self, joints: Array) -> None:
        super().set_configuration(joints)
        self._shared.flange.moved()

    def begin_with_others(self, servos: ServoCommands) -> None:
        assert isinstance(self._coupling, StaggeredCoupling), "couple() comes before"
        self._coupling.begin()
        self._shared.begin_tick()
        command = servos.row(0)
        feedforward = self._coupling.interface.feedforward(command)
        self._scene.set_control(command.position, command.velocity, feedforward)

    def advance(self, servos: ServoCommands, loads: Sequence[Loads]) -> TickLog:
        self._shared.end_tick()
        with self._shared.lent():
            return super().advance(servos, loads)

    def parts(self) -> dict[str, Any]:
        raise InputError("a run of several arms cannot be saved; run each arm alone, or start again")


def make_coupling(settings: CouplingTable, interface: Interface) -> Coupling:
    """Return the scheme of a scenario's exchange."""
    options = iterated.IterationOptions(settings.tolerance, settings.iterations_max)
    if settings.scheme == "iterated":
        return iterated.IteratedCoupling(interface, options)
    return StaggeredCoupling(interface)


def exchange_report(settings: CouplingTable) -> str:
    """Return a text on the exchange of loads."""
    if settings.scheme == "staggered":
        return "staggered, both ways at every tick"
    return f"iterated: every tick repeated until the loads agree to {settings.tolerance:g}"
