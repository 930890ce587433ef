"""A MuJoCo scene that a user's loop steps, with a soft robot attached for each of these steps. Before a step,
the soft robot's load is added to the loop's `xfrc_applied` and `qfrc_applied`; after it, both are restored,
so the loop may write its loads at any time. Inertia that the mount carries is added within the step, see
`inertia_in_step`.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, Final, TypeAlias, final
from weakref import finalize

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, SixNumbers, Wrench, cross
from cosim.base.state_checks import check_indices
from cosim.errors import InputError, InstabilityError
from cosim.rigid.build import object_bodies
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene.arm_layout import Mounting
from cosim.rigid.scene.bodies import Bodies, touchable_geoms
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.rigid.scene.flange import MountedFrame, about_origin
from cosim.rigid.scene.inertia_in_step import CarriedInStep, steps_in_progress
from cosim.rigid.scene.step_loads import StepLoads, loads_of

_STATE: Final = mujoco.mjtState.mjSTATE_INTEGRATION
_MOST_OFF: Final = 1e-6
"""Largest deviation of MuJoCo's clock from one step later, over the step."""
Model: TypeAlias = mujoco.MjModel
Data: TypeAlias = mujoco.MjData
_RK4: Final = mujoco.mjtIntegrator.mjINT_RK4


def _servo_damping(model: mujoco.MjModel) -> Array:
    """Return the damping of each degree of freedom (nv,) by actuators of joints [N m s/rad or N s/m]."""
    total = np.zeros(model.nv)
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    on_joints = affine & (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
    damping = -model.actuator_biasprm[on_joints, 2] * model.actuator_gear[on_joints, 0] ** 2
    np.add.at(total, model.jnt_dofadr[model.actuator_trnid[on_joints, 0]], damping)
    return total


@final
@dataclass(frozen=True)
class HostState:
    """State of a user's scene, on which the next step depends.

    Args:
        integration: MuJoCo's state vector, with inputs and warm start.
        acceleration: (dofs,) of the last tick.
        load: (bodies, 6), of the soft robot on bodies.
        loaded: indices of bodies with contact loads.
        carried: (dofs, dofs) [kg m^2], inertia that is added to the mount.
        given_back: (dofs,) [N m], compensating torque of that inertia.
    """

    integration: Array
    acceleration: Array
    load: Annotated[Array, ("bodies", 6)]
    loaded: Annotated[IntArray, ("k",)]
    carried: Array
    given_back: Array


class HostScene(CoupledScene):
    """A user's scene with a soft robot on one of its sites or bodies.

    Call `begin_step` before and `end_step` after each step of MuJoCo. `load` (bodies, 6) is the load of the
    soft robot at centres of mass, `torque` (nv,) the compensating torque of the added inertia, and `acts`
    (6,) the load on the flange alone.

    Args:
        model: the user's model.
        data: its state.
        ends: mount of the soft robot, and the one that its tip is glued to, or None.
        steps: number of MuJoCo's steps in a tick.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, ends: tuple[Mounting, Mounting | None], steps: int
    ) -> None:
        super().__init__(model, data, steps * float(model.opt.timestep))
        mounting, self._far = ends
        self._steps, self._mounting, self._began_s = steps, mounting, 0.0
        self.flange = MountedFrame(model, data, mounting)
        pace = np.ones(2, np.int64)  # motions of bodies are predicted as if a tick were one step
        self.bodies = Bodies(model, data, mounting, np.zeros(model.nbody, dtype=bool), pace)
        self._resisting = self.tick_s * model.dof_damping
        self._resisting += (self.tick_s - float(model.opt.timestep)) * _servo_damping(model)
        self.load, self.torque = np.zeros((model.nbody, 6)), np.zeros(model.nv)
        dofs = len(self.bodies.carried.on_arm)
        self.acts, self._at = np.zeros(6), np.zeros(3)
        self._given_back, self._acceleration = np.zeros(dofs), np.zeros(dofs)
        self._speed, self._power_W = np.zeros(dofs), 0.0
        self._applied = data.xfrc_applied, data.qfrc_applied  # MuJoCo never moves these arrays
        self._loads, self._robot = loads_of(data), object()
        self._carried = CarriedInStep(model, data, mounting, self.bodies.carried.on_arm)
        finalize(self, _deleted, self._loads, self._robot, self._carried).atexit = False
        self._options, self._ended_s = _StepOptions(model), float(data.time)
        self.read()

    @property
    def carries(self) -> bool:
        """Whether inertia is added to the mount."""
        return bool(self.bodies.carried.on_arm.any())

    @property
    def far_body(self) -> int | None:
        """Index of the body that the soft robot's tip is glued to, or None."""
        return None if self._far is None else self._far.body

    @property
    def far_position(self) -> Array:
        """Position (3,) [m], world, of the site or body that the tip is glued to."""
        assert self._far is not None, "the tip is glued"
        return self._far.frame(self._data)[0].copy()

    @property
    def joint_acceleration(self) -> Array:
        return self._acceleration.copy()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Empty, since degrees of freedom of a user's scene need not be joints of an arm."""
        return ()

    def apply_joint_torque(self, torque: Array) -> None:
        self._given_back[:] = torque

    def apply_flange_wrench(self, wrench: Wrench) -> None:
        self.acts[:3], self.acts[3:] = wrench.force, wrench.torque

    def received_wrench(self) -> SixNumbers:
        return about_origin(self.acts.tolist(), self._at)

    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        """Return the distances to all (fixed) colliding geoms but those of the mount and of the tip's body.

        Raises:
            InputError: a colliding geom has a type that a film cannot touch.
        """
        geoms = touchable_geoms(self._model, self._mounting.body, fixed_only=fixed_only)
        if self._far is not None:
            rigid = self._model.body_weldid
            geoms = geoms[rigid[self._model.geom_bodyid[geoms]] != rigid[self._far.body]]
        for geom in geoms.tolist():
            kind = mujoco.mjtGeom(self._model.geom_type[geom])
            if kind not in object_bodies.GEOM_TYPES.values():
                name, what = self._model.geom(geom).name or geom, kind.name.removeprefix("mjGEOM_").lower()
                raise InputError(
                    f"geom {name!r} is of type {what!r}, which a film cannot touch; replace it, set its "
                    'contype and conaffinity to 0, or attach with overrides={"contact.enabled": False}'
                )
        return ContactQuery(self._model, self._data, geoms)

    def nothing_touched(self) -> ContactQuery:
        """Return distances without geoms."""
        return ContactQuery(self._model, self._data, [])

    def carry(self) -> None:
        """Add the inertia to the mass matrix, after MuJoCo has computed it for new positions."""
        self.bodies.carried.follow()

    def begin_tick(self) -> None:
        """Set the loads on flange and bodies, and the compensating torque, for the steps of a tick."""
        origin, mount = self.flange.pose.translation, self._mounting.body
        self._at[:] = origin
        force = self.acts[:3]
        self.load[mount, :3] = force
        self.load[mount, 3:] = self.acts[3:] + cross(origin - self._data.xipos[mount], force)
        dofs = self._mounting.dofs
        self.torque[dofs] = self._given_back
        self._speed[:] = self._data.qvel[dofs]
        self._power_W = self.bodies.power_W(self.load)

    def check_step(self) -> None:
        """Check that options and time are those of the end of the last step.

        Raises:
            InputError: options of the model have changed, or the loop has changed the time.
        """
        self._options.check()
        now = float(self._data.time)
        if now != self._ended_s:
            raise InputError(
                f"data.time is {now:g} s, and was {self._ended_s:g} s at the end of the last after(): each "
                "mj_step needs before() and after(); after mj_resetData or another jump in time comes "
                "reset(model, data) or restore(saved)"
            )

    def begin_step(self) -> None:
        """Add the loads to MuJoCo's arrays for one step."""
        self._began_s = float(self._data.time)
        self._loads.put_on(self._robot, self.load, self.torque)
        if self.carries:
            steps_in_progress().enter(self._carried)

    def abandon_step(self) -> None:
        """Remove the loads of a step that was interrupted."""
        if self._carried.in_step:
            steps_in_progress().leave(self._carried)
        self._loads.abandon(self._robot)

    def step(self) -> None:
        """Take one step of MuJoCo."""
        mujoco.mj_step(self._model, self._data)

    def is_of(self, model: object, data: object) -> bool:
        """Return whether these are the model and the state of the scene."""
        return model is self._model and data is self._data

    @property
    def time_s(self) -> float:
        """Time of MuJoCo's state [s]."""
        return float(self._data.time)

    def end_step(self) -> None:
        """Remove the loads after a step.

        Raises:
            InputError: MuJoCo has not taken exactly one step, the loads were overwritten in between, or the
                inertia of the mount was not added.
            InstabilityError: MuJoCo has restarted, as its state was no longer finite.
        """
        carries = self._carried.in_step
        if carries:
            steps_in_progress().leave(self._carried)
        written = self._loads.take_off(self._robot)
        began, now, step_s = self._began_s, float(self._data.time), float(self._model.opt.timestep)
        in_time = abs(now - began - step_s) <= _MOST_OFF * step_s
        if in_time and written:
            raise InputError(
                f"data.{written[0]} was written to between before() and after(), which undid the load of "
                "the soft robot; write to it ahead of before()"
            )
        if in_time and carries and not self._carried.added[0]:
            raise InputError(
                "MuJoCo did not call the control callback that adds the inertia of the mount: set yours with "
                "mujoco.set_mjcb_control() before before(), and do not disable actuation in model.opt"
            )
        if in_time:
            self._ended_s = now
            return
        if now < began + 0.5 * step_s and np.count_nonzero(self._data.warning.number):
            raise InstabilityError(
                f"MuJoCo's state became unstable at {began:.4f} s and it restarted; check masses, loads and "
                "servos, or use a shorter timestep"
            )
        raise InputError(
            f"data.time went from {began:g} s to {now:g} s between before() and after(); exactly one mj_step "
            f"of {step_s:g} s belongs there, and after mj_resetData comes reset(model, data)"
        )

    def end_tick(self) -> None:
        """Read the state at the end of a tick, before the soft robot moves."""
        self.accelerated()
        self.read()

    def accelerated(self) -> None:
        """Compute the acceleration in the tick, and the work on bodies."""
        self.bodies.work_J = 0.5 * self.tick_s * (self._power_W + self.bodies.power_W(self.load))
        data, dofs = self._data, self._mounting.dofs
        if self._steps == 1:
            self._acceleration[:] = data.qacc[dofs]
        else:
            self._acceleration[:] = (data.qvel[dofs] - self._speed) / self.tick_s

    def read(self) -> None:
        """Update poses, velocities and inertia to the present state of the joints."""
        mujoco.mj_fwdPosition(self._model, self._data)
        mujoco.mj_fwdVelocity(self._model, self._data)
        self.flange.moved()
        self.carry()

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Put only the soft robot's loads into MuJoCo's arrays, and adopt contact loads of the block."""
        forces, torques = self._applied
        of_user = forces.copy(), torques.copy()
        forces[:], torques[:] = self.load, self.torque
        try:
            yield
        finally:
            self.load[:] = forces
            forces[:], torques[:] = of_user

    @property
    def state(self) -> HostState:
        """A copy of the state on which the next step depends, with MuJoCo's state."""
        integration = np.empty(mujoco.mj_stateSize(self._model, _STATE))
        mujoco.mj_getState(self._model, self._data, integration, _STATE)
        on_arm = self.bodies.carried.on_arm.copy()
        return HostState(
            integration, self._acceleration.copy(), self.load.copy(), self.bodies.loaded, on_arm,
            self._given_back.copy(),
        )  # fmt: skip

    @state.setter
    def state(self, state: HostState) -> None:
        size = mujoco.mj_stateSize(self._model, _STATE)
        if len(state.integration) != size or len(state.load) != len(self.load):
            raise InputError(
                f"the saved scene has {len(state.integration)} numbers, here {size}: bodies and joints must "
                "be as many"
            )
        check_indices(state.loaded, self.bodies.count, "bodies")
        self.bodies.loaded = state.loaded
        self.bodies.carried.on_arm[:] = state.carried
        mujoco.mj_setState(self._model, self._data, state.integration, _STATE)
        self.load[:], self._ended_s = state.load, float(self._data.time)
        self.read()
        self._acceleration[:], self._given_back[:] = state.acceleration, state.given_back


def _deleted(loads: StepLoads, robot: object, carried: CarriedInStep) -> None:
    """Remove the loads of a scene that is deleted during a step."""
    loads.abandon(robot)
    if carried.in_step:
        steps_in_progress().leave_later(carried)


@final
class _StepOptions:
    """Initial values of the options of a model that the soft robot depends on.

    Args:
        model: the user's model.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._option, self._gravity = model, model.opt, model.opt.gravity
        self._begun, self._begun_as = self._now(), self._named()

    def check(self) -> None:
        """Check that the options have not changed.

        Raises:
            InputError: an option has changed.
        """
        if self._now() == self._begun:
            return
        check_steps(self._model)
        for name, value in self._named().items():
            if value != self._begun_as[name]:
                raise InputError(
                    f"model.opt.{name} is {value}, and was {self._begun_as[name]} when the soft robot began; "
                    "set it back, or attach to the changed model"
                )

    def _now(self) -> tuple[float, bool, int, bytes]:
        option = self._option
        weightless = option.disableflags & int(mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        return option.timestep, option.integrator == _RK4, weightless, self._gravity.tobytes()

    def _named(self) -> dict[str, Any]:
        return {"timestep": float(self._option.timestep), "gravity": gravity_of(self._model)}


def check_steps(model: mujoco.MjModel) -> None:
    """Check the integrator of a model.

    Raises:
        InputError: a step of the integrator evaluates forces several times.
    """
    if model.opt.integrator == _RK4:
        raise InputError(
            "option integrator is RK4, which evaluates forces four times in a step; the soft robot's forces "
            "are constant in a step: use Euler, implicit or implicitfast"
        )


def gravity_of(model: mujoco.MjModel) -> tuple[float, float, float]:
    """Return the gravity of a model [m/s^2], 0 if it is disabled."""
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
        return 0.0, 0.0, 0.0
    x, y, z = np.asarray(model.opt.gravity, dtype=np.float64).tolist()
    return x, y, z
