"""The rigid scene: an arm with servos, and objects, which MuJoCo steps. A step begins in the middle of
MuJoCo's: accelerations and integration (mj_step2), then positions and velocities of the new state (mj_step1).
So all values that are read between two steps belong to one instant.
"""

from dataclasses import dataclass
from typing import Annotated, final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose, SixNumbers, Wrench
from cosim.base.solid import BodyShape, MovableBody
from cosim.base.state_checks import check_indices
from cosim.errors import InputError
from cosim.rigid.build import compiled_scene, engine
from cosim.rigid.build.description import SceneDescription
from cosim.rigid.build.pair_friction import body_names
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene import bodies, coupled_scene
from cosim.rigid.scene.arm_dynamics import ArmDynamics, droop
from cosim.rigid.scene.arm_layout import ArmLayout, Mounting, effort_limit
from cosim.rigid.scene.cell_drives import CellDrives
from cosim.rigid.scene.flange import Flange
from cosim.rigid.scene.link_contacts import LinkContacts
from cosim.rigid.scene.load_leaves import add_mounted
from cosim.rigid.scene.servos import ArmServos, finish_step

_STATE, _ALIKE = mujoco.mjtState.mjSTATE_INTEGRATION, "bodies and joints must be as many"


@final
@dataclass(frozen=True)
class RigidState:
    """State of a rigid scene: everything that the next step depends on.

    Args:
        integration: MuJoCo's state vector, inputs and warm start included.
        armature: (dofs,) [kg m^2] or [kg].
        acceleration: (dofs,) of the last finished step.
        actuation: (dofs,) [N m] or [N], MuJoCo's actuator forces in the last finished step.
        servo_torque: (joints,) [N m], of the last finished step.
        flange_load: (6,) reading of the flange sensor.
        loaded: (k,) bodies with contact loads.
        on_arm: (joints, joints) [kg m^2], inertia that the arm's joints carry.
    """

    integration: Array
    armature: Array
    acceleration: Array
    actuation: Array
    servo_torque: Array
    flange_load: Array
    loaded: Annotated[IntArray, ("k",)]
    on_arm: Array


@final
class RigidScene(coupled_scene.CoupledScene):
    """An arm on its base with servos, a flange sensor, and objects around it.

    Joint quantities are ordered as `joint_names`; bodies as `body_names`, the world first. `armature`
    (joints,) [kg m^2] is the rotors' inertia, without carried inertia.

    Args:
        description: of the scene.
        compiled: of that description; None: it is compiled here.
        shared: model and state of a scene with several arms, of which this is one.

    Raises:
        InputError: MuJoCo refuses the arm's file or an object.
    """

    flange: Flange
    coupled: coupled_scene.CoupledScene
    """The scene that exchanges loads with the soft robot: itself, unless it is one of several arms."""
    other_arms: tuple[str, ...] = ()
    """Prefixes of the other arms' bodies."""

    def __init__(
        self,
        description: SceneDescription,
        compiled: compiled_scene.CompiledScene | None = None,
        shared: tuple[mujoco.MjModel, mujoco.MjData] | None = None,
    ) -> None:
        self.description = description
        self._compiled = compiled or compiled_scene.CompiledScene(description)
        model = self._compiled.model() if shared is None else shared[0]
        super().__init__(model, mujoco.MjData(model) if shared is None else shared[1], description.tick_s)
        self._scratch = mujoco.MjData(model)
        self.coupled = self
        self._layout = layout = ArmLayout.of(model, description.arm.joint_names, description.prefix)
        self._v = layout.dofs
        # Views: MuJoCo's arrays do not move in memory, and looking one up costs as much as copying it.
        self._q: Array = self._data.qpos[layout.positions]
        self._speed: Array = self._data.qvel[self._v]
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
        # Servo damping is implicit: (M + h K) a = f(q, v). MuJoCo's implicit integrators do this as well but
        # solve contacts with M alone, so an object in a gripper slides when the arm accelerates.
        self._servo_inertia = self._step_s * self.servo_damping
        self._resisting[self._v] += (tick_s - self._step_s) * self.servo_damping
        self._model.dof_armature[self._v] += self._servo_inertia
        self._model.jnt_actfrclimited[layout.joints] = 0  # `servos` limit u - h K a; MuJoCo would limit u
        self.servos = ArmServos(self._model, self._data, self._v, self.servo_damping, self.effort_limit)
        self.joint_rows = self._q, self._speed, self.servos.torque
        self.others: IntArray = np.zeros(self._model.nbody, np.int64)
        """(bodies,), 1 for bodies that the soft robots of other arms touch."""
        sensed = self._data.sensordata
        self._flange_load = self._data.xfrc_applied[layout.mount]
        self._flange_sensor = sensed[layout.force], sensed[layout.torque]
        self.cell = CellDrives(self._model, self._data)
        self.bodies = bodies.Bodies(self._model, self._data, layout.mounting, self.cell.bodies, self._pace)
        self.links = LinkContacts(self._model, self._data, layout, self.cell.bodies)
        self.dynamics = ArmDynamics(self._model, self._scratch, layout, self.cell.places, self._servo_inertia)
        self.set_joint_state(description.arm.home)
        self.set_control(description.arm.home)

    @property
    def mounting(self) -> Mounting:
        """The frame that the soft robot is mounted on."""
        return self._layout.mounting

    @property
    def carries(self) -> bool:
        """Whether a rigid body is mounted on the flange."""
        return self._layout.carries

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the arm's joints, base to flange."""
        return self.description.arm.joint_names

    @property
    def shapes(self) -> tuple[BodyShape, ...]:
        """Meshes of the bodies, for drawing."""
        return self._compiled.shapes

    @property
    def drawn_as(self) -> str:
        """The model that the arm is drawn with, see `ArmDrawing.note`."""
        return self._compiled.drawings[self.description.prefix].note

    @property
    def objects(self) -> tuple[MovableBody, ...]:
        """Objects that can move."""
        free = set(self._model.jnt_bodyid[self._model.jnt_type == mujoco.mjtJoint.mjJNT_FREE].tolist())
        bodies = self._layout.object_sensors[:, 0].tolist()
        return tuple(MovableBody(body, body in free, _figures(self._model, body)) for body in bodies)

    @property
    def tick_s(self) -> float:
        """Length of a rigid step [s]: a tick of the clock, or a substep, see `set_substep`."""
        return self._step_s if self._pace[0] < self.substeps else self._tick_s

    @property
    def substeps(self) -> int:
        """Number of MuJoCo's steps in a tick of the clock."""
        return self.description.substeps

    def set_substep(self, left: int | None) -> None:
        """Make a rigid step a single step of MuJoCo, with `left` of them in the tick; None: a whole tick."""
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
        """(joints,) [N m], torques of the servos in the last finished step, within the arm's limits."""
        return self.servos.torque.copy()

    @property
    def servo_reference(self) -> Array:
        """(joints,) [rad] that the servos track."""
        return np.array(self._control[:, 0])

    @property
    def effort_limit(self) -> Array:
        """Largest servo torques (joints,) [N m]; infinite if the arm's file gives none."""
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
        """c(q, v) + g(q) (joints,) [N m], joint torques at zero acceleration."""
        return np.array(self._data.qfrc_bias[self._v])

    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        """Return the distance query for all geoms that collide, without those of the arm.

        Args:
            fixed_only: whether only fixed bodies count.
        """
        model, made = self._model, self.description
        geoms = bodies.touchable_geoms(model, self._layout.mount, fixed_only=fixed_only)
        names = body_names(model, geoms, [wire.name for wire in made.wires])
        return ContactQuery(
            model, self._data, geoms, made.friction.on_film(names, model.geom_friction[geoms, 0])
        )

    def set_joint_state(self, position: Array, velocity: Array | None = None) -> None:
        """Set angles and speeds of the arm, and update poses, velocities and inertia.

        Args:
            position: (joints,) [rad].
            velocity: (joints,) [rad/s]; None: zero.
        """
        self._q[:] = position
        self._data.qvel[self._v] = 0.0 if velocity is None else velocity
        self.begin_step()

    def set_control(
        self, position: Array, velocity: Array | None = None, feedforward: Array | None = None
    ) -> None:
        """Set the references of the servos.

        Args:
            position: (joints,) [rad].
            velocity: (joints,) [rad/s]; None: zero.
            feedforward: (joints,) [N m]; None: zero.
        """
        self._control[:, 0] = position
        self._control[:, 1] = 0.0 if velocity is None else velocity
        self._control[:, 2] = 0.0 if feedforward is None else feedforward

    def apply_flange_wrench(self, wrench: Wrench) -> None:
        """Set the load on the flange, at its origin, world axes."""
        self.flange.apply(wrench)

    def received_wrench(self) -> SixNumbers:
        """Return the load on the flange about the world's origin, read back from MuJoCo."""
        return self.flange.received()

    def set_acceleration(self, acceleration: Array) -> None:
        """Replace the acceleration of the last step by one (joints,) [rad/s^2]."""
        self._acceleration[:] = acceleration

    def apply_joint_torque(self, torque: Array) -> None:
        """Set a torque (joints,) [N m] on the joints, in addition to servos and flange load."""
        self._torque[:] = torque

    def begin_step(self) -> None:
        """Update poses, velocities and inertia for the present joint state (mj_step1)."""
        self.flange.moved()
        mujoco.mj_step1(self._model, self._data)
        self.check()  # MuJoCo resets a state that is not finite
        self.bodies.carried.follow()

    def step_arm(self, position: Array, velocity: Array, torque: Array) -> None:
        self.set_control(position, velocity, torque)
        self.step()

    def step(self) -> None:
        """Take the rigid step of a tick; in substeps the servos' references continue at their speed.

        Raises:
            InstabilityError: the state is not finite.
        """
        bodies, control, (steps, left) = self.bodies, self._control, self._pace.tolist()
        began = self._speed.copy() if steps > 1 else None
        presses = bool(np.count_nonzero(bodies.bearing))
        work, power = 0.0, bodies.power_W(bodies.applied) if presses else 0.0
        if self._layout.carries:
            self.mounted[:] = 0.0
        for i in range(steps):
            if i:
                control[:, 0] += self._step_s * control[:, 1]
            self._finish_step(left - i, 1.0 / steps)
            self.begin_step()
            if presses:  # a constant force changes a body's energy by its mean speed
                before, power = power, bodies.power_W(bodies.applied)
                work += 0.5 * self._step_s * (before + power)
        bodies.work_J = work
        self.servos.end()
        if began is not None:  # the exchange needs the mean acceleration of the tick
            self._acceleration[:] = (self._speed - began) / (steps * self._step_s)

    def _finish_step(self, left: int, fraction: float) -> None:
        """Compute accelerations, integrate (mj_step2) and read the flange's sensor.

        Args:
            left: steps until the end of the clock's tick.
            fraction: length of the step over that of the rigid step.
        """
        finish_step(self._model, self._data, (self.servos,))
        self.flange.read_sensor()  # site axes still belong to the instant of the reading
        if self._layout.carries:
            self.add_mounted(self._flange_load, fraction)
        self.cell.drive(left, self._step_s)

    def add_mounted(self, load: Array, fraction: float) -> None:
        """Add to `mounted` the part of the flange sensor's reading that the soft robot does not explain.

        Args:
            load: (6,) [N, N m], of the soft robot on the flange, world axes.
            fraction: length of the step over that of the tick.
        """
        add_mounted(load, self.flange.axes, *self._flange_sensor, fraction, self.mounted)

    def read_touch(self, touch: Array) -> None:
        layout, sensed = self._layout, self._data.sensordata
        if layout.carries:
            touch[0, 1] = sensed[layout.contacts]
        for body, total, *counted in layout.object_sensors.tolist():
            shown = [float(sensed[place]) for place in counted]
            touch[body, 1], touch[body, 2] = self.others[body] + sum(shown), sensed[total] - sum(shown)

    def check(self) -> None:
        """Check MuJoCo's warnings.

        Raises:
            InstabilityError: MuJoCo has warned: the state is not finite.
        """
        if np.count_nonzero(self._warnings):
            engine.raise_instability(self._data)

    def static_configuration(
        self, reference: Array, feedforward: Array | None = None, wrench: Wrench | None = None
    ) -> Array:
        """Return the angles (joints,) [rad] at which the servos hold a constant load; the scene is unchanged.

        Solves stiffness (q_ref - q) + feedforward + J(q)^T wrench = g(q).

        Args:
            reference: q_ref (joints,) [rad].
            feedforward: (joints,) [N m]; None: zero.
            wrench: on the flange, at its origin, world axes; None: none.

        Raises:
            ConvergenceError: there is no equilibrium, or it needs more than the joints' torque limits.
        """
        np.copyto(self._scratch.qpos, self._data.qpos)
        load = wrench or Wrench()
        return droop(
            self._model, self._scratch, layout=self._layout, joint_names=self.joint_names,
            reference=np.asarray(reference, dtype=np.float64), load=np.concatenate((load.force, load.torque)),
            feedforward=np.zeros(len(self.joint_names)) if feedforward is None else feedforward,
        )  # fmt: skip

    @property
    def state(self) -> RigidState:
        """A copy of the state that the next step depends on, edits of MuJoCo's model included."""
        integration = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, integration, _STATE)
        armature, acceleration = np.array(self._model.dof_armature), np.array(self._data.qacc)
        actuation, servo_torque = np.array(self._data.qfrc_actuator), self.servo_torque
        load, on_arm = self.flange.measured, self.bodies.carried.on_arm.copy()
        return RigidState(
            integration, armature, acceleration, actuation, servo_torque, load, self.bodies.loaded, on_arm
        )

    @state.setter
    def state(self, state: RigidState) -> None:
        size = mujoco.mj_stateSize(self._model, _STATE)
        if len(state.integration) != size:
            raise InputError(f"the saved scene has {len(state.integration)} numbers, here {size}: {_ALIKE}")
        check_indices(state.loaded, self.bodies.count, "bodies")
        self._warnings[:] = 0
        self.bodies.loaded = state.loaded
        self.bodies.carried.on_arm[:] = state.on_arm
        self._model.dof_armature[:] = state.armature
        mujoco.mj_setState(self._model, self._data, state.integration, _STATE)
        self.begin_step()
        self._data.qacc[:] = state.acceleration
        self._data.qfrc_actuator[:] = state.actuation
        self.servos.torque[:] = state.servo_torque
        self.flange.measured = state.flange_load


def _figures(model: mujoco.MjModel, body: int) -> tuple[float, ...]:
    turn = Pose.from_quaternion(np.array(model.body_iquat[body]), np.zeros(3)).rotation
    inertia = turn @ np.diag(model.body_inertia[body]) @ turn.T
    six = inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    return tuple(np.concatenate([[model.body_mass[body]], model.body_ipos[body], six]).tolist())
