"""The rigid scene: an arm with servos, and objects, stepped in two halves by MuJoCo.

What `RigidScene.save_state` returns.

One tick of the coupling reads

    scene.set_control(...); scene.apply_flange_wrench(...)
    scene.finish_step()     accelerations, integration, flange sensor
    scene.begin_step()      positions and velocities of the new state

so that, between two ticks, everything readable belongs to one and the same instant.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose, SixNumbers, Wrench
from cosim.base.solid import BodyShape
from cosim.errors import InputError
from cosim.rigid.build.compiled_scene import CompiledScene
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.build.mjcf_files import raise_instability
from cosim.rigid.build.pair_friction import body_names
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene.arm import ArmDynamics, ArmLayout, CellDrives, Flange, Mounting, droop, effort_limit
from cosim.rigid.scene.bodies import Bodies, touchable_geoms
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.rigid.scene.link_contacts import LinkContacts
from cosim.rigid.scene.native import NativeScene, native_scene


@final
@dataclass(frozen=True)
class RigidState:
    """Everything that a step depends on or leaves behind.

    Args:
        integration: MuJoCo's own state vector, inputs and warm start included.
        armature: (dofs,) [kg m^2] or [kg].
        acceleration: (dofs,) of the last finished step.
        servo_torque: (dofs,) [N m] or [N], of the last finished step.
        flange_load: (6,) reading of the flange sensor.
        loaded: bodies that contact loads at present.
        on_arm: (joints, joints) [kg m^2], that the arm's joints carry.
    """

    integration: Array
    armature: Array
    acceleration: Array
    servo_torque: Array
    flange_load: Array
    loaded: Annotated[IntArray, ("k",)]
    on_arm: Array


_STATE, _ALIKE = mujoco.mjtState.mjSTATE_INTEGRATION, "bodies and joints must be as many"


@final
class RigidScene(CoupledScene):
    """An arm on its base with servos, a flange sensor, and objects around it.

    Joint quantities are ordered as `joint_names`; bodies as `body_names`, the world first. `armature`
    (joints,) [kg m^2] is the rotors' inertia, without what is carried.

    Args:
        description: what the scene is made of.
        compiled: of that description, if it has been compiled already.
        shared: model and state of a scene with several arms, of which this is one.

    Raises:
        InputError: MuJoCo refuses the arm's file or an object.
    """

    flange: Flange
    coupled: CoupledScene
    """As a soft robot exchanges loads with it: itself, unless it is one of several arms."""
    other_arms: tuple[str, ...] = ()
    """What the names of their bodies begin with."""

    def __init__(
        self,
        description: SceneDescription,
        compiled: CompiledScene | None = None,
        shared: tuple[mujoco.MjModel, mujoco.MjData] | None = None,
    ) -> None:
        self.description = description
        self._compiled = compiled or CompiledScene(description)
        model = self._compiled.model() if shared is None else shared[0]
        super().__init__(model, mujoco.MjData(model) if shared is None else shared[1], description.tick_s)
        self._scratch = mujoco.MjData(model)
        self.coupled = self
        self._layout = layout = ArmLayout.of(model, description.arm.joint_names, description.prefix)
        self._v = layout.dofs
        # Views: MuJoCo's arrays stay where they are in memory; looking one up costs as much as its copy.
        self._q: Array = self._data.qpos[layout.positions]
        self._acceleration: Array = self._data.qacc[self._v]
        self._torque: Array = self._data.qfrc_applied[self._v]
        self._warnings = self._data.warning.number
        # Servo inputs are interleaved: position, velocity, feedforward of each joint in turn.
        self._control = self._data.ctrl.reshape(-1, 3)[layout.joints]
        self.armature: Array = self._model.dof_armature[self._v].copy()
        self.armature.setflags(write=False)
        self.flange = Flange(self._model, self._data, layout)
        self._pace: IntArray = np.full(2, description.substeps)
        tick_s, self._step_s = description.tick_s, float(self._model.opt.timestep)
        self._resisting = tick_s * self._model.dof_damping
        # Servos damp by the speed at the end of a step: (M + h K) a = f(q, v). MuJoCo's implicit integrators
        # do so as well but solve contacts with M alone: what a palm clamps slides when the arm accelerates.
        self._servo_inertia = self._step_s * self.servo_damping
        self._resisting[self._v] += (tick_s - self._step_s) * self.servo_damping
        self._model.dof_armature[self._v] += self._servo_inertia
        self.cell = CellDrives(self._model, self._data)
        self.bodies = Bodies(self._model, self._data, layout.mounting, self.cell.bodies, self._pace)
        self.links = LinkContacts(self._model, self._data, layout, self.cell.bodies)
        self.dynamics = ArmDynamics(self._model, self._scratch, layout, self.cell.places, self._servo_inertia)
        self.set_joint_state(description.arm.home)
        self.set_control(description.arm.home)

    @property
    def mounting(self) -> Mounting:
        """Where the soft robot hangs."""
        return self._layout.mounting

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints, base to flange."""
        return self.description.arm.joint_names

    @property
    def shapes(self) -> tuple[BodyShape, ...]:
        """What is drawn of the bodies."""
        return self._compiled.shapes

    @property
    def drawn_as(self) -> str:
        """By what the arm is drawn, see `ArmDrawing.note`."""
        return self._compiled.drawings[self.description.prefix].note

    @property
    def tick_s(self) -> float:
        """Length of a tick [s]: of the clock, or of a fine one, see `go_finely`."""
        return self._step_s if self._pace[0] < self.substeps else self._tick_s

    @property
    def substeps(self) -> int:
        """How many steps MuJoCo takes in a tick of the clock."""
        return self.description.substeps

    def go_finely(self, left: int | None) -> None:
        """Let ticks be single steps of MuJoCo, so many left in a tick of the clock; None: whole ticks."""
        self._pace[:] = self.substeps if left is None else (1, left)

    @property
    def joint_position(self) -> Array:
        """(joints,) [rad]."""
        return self._q.copy()

    @property
    def joint_velocity(self) -> Array:
        """(joints,) [rad/s]."""
        return np.array(self._data.qvel[self._v])

    @property
    def joint_acceleration(self) -> Array:
        """(joints,) [rad/s^2], of the last finished step."""
        return self._acceleration.copy()

    @property
    def servo_torque(self) -> Array:
        """(joints,) [N m] that the servos gave in the last finished step, within the arm's limits."""
        return np.array(self._data.qfrc_actuator[self._v])

    @property
    def servo_reference(self) -> Array:
        """(joints,) [rad] that the servos track."""
        return np.array(self._control[:, 0])

    @property
    def effort_limit(self) -> Array:
        """Largest servo torques (joints,) [N m]; infinite where the arm's file names none."""
        return effort_limit(self._model, self._layout)

    @property
    def servo_damping(self) -> Array:
        """(joints,) [N m s/rad]."""
        return np.array(-self._model.actuator_biasprm[self._layout.joints, 2])

    @property
    def mass_matrix(self) -> Array:
        """Joint-space mass matrix (joints, joints) [kg m^2], armature included."""
        full = np.empty((self._model.nv, self._model.nv))
        mujoco.mj_fullM(self._model, self._data, full)
        return np.array(full[self._v, self._v]) - np.diag(self._servo_inertia)

    @property
    def bias_torque(self) -> Array:
        """c(q, v) + g(q) (joints,) [N m]: what the joints need at zero acceleration."""
        return np.array(self._data.qfrc_bias[self._v])

    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        """Return the distances to everything that collides (and is fixed), the arm itself left out."""
        model, made = self._model, self.description
        geoms = touchable_geoms(model, self._layout.mount, fixed_only=fixed_only)
        names = body_names(model, geoms, [wire.name for wire in made.wires])
        return ContactQuery(
            model, self._data, geoms, made.friction.on_film(names, model.geom_friction[geoms, 0])
        )

    def set_joint_state(self, position: Array, velocity: Array | None = None) -> None:
        """Put the arm at an angle and a speed; everything readable follows.

        Args:
            position: (joints,) [rad].
            velocity: (joints,) [rad/s], zero unless given.
        """
        self._q[:] = position
        self._data.qvel[self._v] = 0.0 if velocity is None else velocity
        self.begin_step()

    def set_control(
        self, position: Array, velocity: Array | None = None, feedforward: Array | None = None
    ) -> None:
        """Set what the servos track from now on.

        Args:
            position: (joints,) [rad].
            velocity: (joints,) [rad/s], zero unless given.
            feedforward: (joints,) [N m], zero unless given.
        """
        self._control[:, 0] = position
        self._control[:, 1] = 0.0 if velocity is None else velocity
        self._control[:, 2] = 0.0 if feedforward is None else feedforward

    def apply_flange_wrench(self, wrench: Wrench) -> None:
        """Set the load on the flange from now on: at the flange origin, world axes."""
        self.flange.apply(wrench)

    def received_wrench(self) -> SixNumbers:
        """Return what acts on the flange now, about the world's origin, read back from MuJoCo."""
        return self.flange.received()

    def apply_joint_torque(self, torque: Array) -> None:
        """Set a torque (joints,) [N m] on the joints from now on, besides servos and flange load."""
        self._torque[:] = torque

    def begin_step(self) -> None:
        """Bring poses, velocities and inertia up to the present joint state (first half of a step)."""
        self.flange.moved()
        mujoco.mj_step1(self._model, self._data)
        self.check()  # it starts anew from a state that is not finite
        self.bodies.carried.follow()

    def finish_step(self) -> None:
        """Compute accelerations, advance the state by a tick and read the sensor (second half).

        Raises:
            InstabilityError: the state is no longer finite.
        """
        for _ in range(self._pace[0] - 1):
            mujoco.mj_step2(self._model, self._data)
            self.begin_step()
        mujoco.mj_step2(self._model, self._data)
        # Site axes still belong to the instant of the reading until `begin_step`.
        self.flange.read_sensor()
        self.check()
        self.cell.arrive()

    def check(self) -> None:
        """Raise InstabilityError where MuJoCo has warned: the state is no longer finite."""
        if np.count_nonzero(self._warnings):
            raise_instability(self._data)

    def native(self) -> NativeScene:
        """Return the scene for kernels that step it themselves.

        Raises:
            SceneError: MuJoCo's library cannot be found.
        """
        return native_scene(self._model, self._data, self._layout, self.cell, self._pace)

    def stepped(self, began: Pose) -> None:
        """Follow steps that kernels have taken.

        Args:
            began: pose of the flange at the beginning of the last of them.
        """
        self.flange.stepped(began)

    def static_configuration(
        self, reference: Array, feedforward: Array | None = None, wrench: Wrench | None = None
    ) -> Array:
        """Return the angles (joints,) [rad] at which the servos hold a constant load; nothing changes.

        Solves stiffness (q_ref - q) + feedforward + J(q)^T wrench = g(q).

        Args:
            reference: q_ref (joints,) [rad].
            feedforward: (joints,) [N m], zero unless given.
            wrench: on the flange, at its origin, world axes; none unless given.

        Raises:
            ConvergenceError: no equilibrium, or one that asks for more than the joints' torque.
        """
        np.copyto(self._scratch.qpos, self._data.qpos)
        load = wrench or Wrench()
        return droop(
            self._model, self._scratch, layout=self._layout, joint_names=self.joint_names,
            reference=np.asarray(reference, dtype=np.float64), load=np.concatenate((load.force, load.torque)),
            feedforward=np.zeros(len(self.joint_names)) if feedforward is None else feedforward,
        )  # fmt: skip

    def save_state(self) -> RigidState:
        """Return a copy of the whole state, from which `restore_state` repeats steps bit for bit."""
        integration = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, integration, _STATE)
        armature, acceleration = np.array(self._model.dof_armature), np.array(self._data.qacc)
        servo_torque = np.array(self._data.qfrc_actuator)
        load, on_arm = self.flange.measured, self.bodies.carried.on_arm.copy()
        return RigidState(integration, armature, acceleration, servo_torque, load, self.bodies.loaded, on_arm)

    def restore_state(self, state: RigidState) -> None:
        """Return to a state of `save_state`, model edits included; everything readable follows.

        Raises:
            InputError: the state is of a scene with other bodies or joints.
        """
        size = mujoco.mj_stateSize(self._model, _STATE)
        if len(state.integration) != size:
            raise InputError(f"the saved scene has {len(state.integration)} numbers, here {size}: {_ALIKE}")
        self._warnings[:] = 0
        self.bodies.loaded = state.loaded
        self.bodies.carried.on_arm[:] = state.on_arm
        self._model.dof_armature[:] = state.armature
        mujoco.mj_setState(self._model, self._data, state.integration, _STATE)
        self.begin_step()
        self._data.qacc[:] = state.acceleration
        self._data.qfrc_actuator[:] = state.servo_torque
        self.flange.measured = state.flange_load
