"""A MuJoCo scene that a user's loop steps, with a soft robot attached for each of these steps. Before a step,
the soft robot's load is added to the loop's `xfrc_applied` and `qfrc_applied`; after it, both are restored,
so the loop may write its loads at any time. Inertia that the mount carries is added within the step, see
`inertia_in_step`.
"""

import math
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeAlias, final
from weakref import finalize

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, SixNumbers, Wrench, cross
from cosim.base.state_checks import check_indices
from cosim.errors import InputError, InstabilityError
from cosim.rigid.build import engine, mjcf_files, object_bodies
from cosim.rigid.distance.contact_query import ContactQuery
from cosim.rigid.scene.arm_layout import BODY, SITE, Mounting
from cosim.rigid.scene.bodies import Bodies, touchable_geoms
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.rigid.scene.flange import MountedFrame, about_origin
from cosim.rigid.scene.inertia_in_step import CarriedInStep, steps_in_progress
from cosim.rigid.scene.step_loads import StepLoads, loads_of

_STATE: Final = mujoco.mjtState.mjSTATE_INTEGRATION
_MOST_OFF: Final = 1e-6
"""Share of a step by which MuJoCo's clock may be elsewhere than one step later."""
HostSource: TypeAlias = "mujoco.MjSpec | mujoco.MjModel | str | Path"
Model: TypeAlias = mujoco.MjModel
Data: TypeAlias = mujoco.MjData
_MOUNT: Final = "cosim_mount"
_MOST_NAMES: Final = 40
_RK4: Final = mujoco.mjtIntegrator.mjINT_RK4
_WHOLE: Final = 1e-6
"""Share of a step by which a tick may differ from whole steps."""


def _servo_damping(model: mujoco.MjModel) -> Array:
    """Return how actuators of joints damp each degree of freedom (nv,) [N m s/rad or N s/m]."""
    found = np.zeros(model.nv)
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    on_joints = affine & (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
    damping = -model.actuator_biasprm[on_joints, 2] * model.actuator_gear[on_joints, 0] ** 2
    np.add.at(found, model.jnt_dofadr[model.actuator_trnid[on_joints, 0]], damping)
    return found


@final
@dataclass(frozen=True)
class HostState:
    """Everything that the next step depends on.

    Args:
        integration: MuJoCo's own state vector, inputs and warm start included.
        acceleration: (dofs,) of the last tick.
        load: (bodies, 6), of the soft robot on bodies.
        loaded: bodies that contact loads at present.
        carried: (dofs, dofs) [kg m^2], that the mount carries.
        given_back: (dofs,) [N m], of that.
    """

    integration: Array
    acceleration: Array
    load: Annotated[Array, ("bodies", 6)]
    loaded: Annotated[IntArray, ("k",)]
    carried: Array
    given_back: Array


class HostScene(CoupledScene):
    """Somebody's scene with a soft robot on a site or body of it.

    For each of MuJoCo's steps: `begin_step`, that step, `end_step`. `load` (bodies, 6) is what the soft robot
    applies at centres of mass, `torque` (nv,) the part of the carried load that is given back; `acts` (6,) is
    the load on the flange alone.

    Args:
        model: somebody's.
        data: its state.
        ends: where the soft robot hangs, and where its tip is glued to; None for nowhere.
        steps: of MuJoCo in a tick.
    """

    def __init__(
        self, model: mujoco.MjModel, data: mujoco.MjData, ends: tuple[Mounting, Mounting | None], steps: int
    ) -> None:
        super().__init__(model, data, steps * float(model.opt.timestep))
        mounting, self._far = ends
        self._steps, self._mounting, self._began_s = steps, mounting, 0.0
        self.flange = MountedFrame(model, data, mounting)
        pace = np.ones(2, np.int64)  # how bodies give way is foreseen as if a tick were one step
        self.bodies = Bodies(model, data, mounting, np.zeros(model.nbody, dtype=bool), pace)
        self._resisting = self.tick_s * model.dof_damping
        self._resisting += (self.tick_s - float(model.opt.timestep)) * _servo_damping(model)
        self.load, self.torque = np.zeros((model.nbody, 6)), np.zeros(model.nv)
        dofs = len(self.bodies.carried.on_arm)
        self.acts, self._at = np.zeros(6), np.zeros(3)
        self._given_back, self._acceleration = np.zeros(dofs), np.zeros(dofs)
        self._speed, self._power_W = np.zeros(dofs), 0.0
        self._applied = data.xfrc_applied, data.qfrc_applied  # they stay where they are
        self._loads, self._robot = loads_of(data), object()
        self._carried = CarriedInStep(model, data, mounting, self.bodies.carried.on_arm)
        finalize(self, _deleted, self._loads, self._robot, self._carried).atexit = False
        self._options, self._ended_s = _StepOptions(model), float(data.time)
        self.read()

    @property
    def carries(self) -> bool:
        """Whether the mount carries inertia."""
        return bool(self.bodies.carried.on_arm.any())

    @property
    def far_body(self) -> int | None:
        """The body that the soft robot's tip is glued to; None for none."""
        return None if self._far is None else self._far.body

    @property
    def far_position(self) -> Array:
        """(3,) [m], world, of the site or body that was named for it."""
        assert self._far is not None, "there is one"
        return self._far.frame(self._data)[0].copy()

    @property
    def joint_acceleration(self) -> Array:
        return self._acceleration.copy()

    @property
    def joint_names(self) -> tuple[str, ...]:
        """None: what moves is not ordered by joints."""
        return ()

    def apply_joint_torque(self, torque: Array) -> None:
        self._given_back[:] = torque

    def apply_flange_wrench(self, wrench: Wrench) -> None:
        self.acts[:3], self.acts[3:] = wrench.force, wrench.torque

    def received_wrench(self) -> SixNumbers:
        return about_origin(self.acts.tolist(), self._at)

    def contact_query(self, *, fixed_only: bool = False) -> ContactQuery:
        """Return the distances to everything that collides (and is fixed), but for what the mount is part of.

        Neither for the body that the tip is glued to.

        Raises:
            InputError: something that collides has no surface that a film could touch.
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
        """Return the distances to nothing."""
        return ContactQuery(self._model, self._data, [])

    def carry(self) -> None:
        """Add what is carried to a mass matrix that MuJoCo has computed for new positions."""
        self.bodies.carried.follow()

    def begin_tick(self) -> None:
        """Take what acts on the flange and on bodies, and what is given back, for the steps of a tick."""
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
        """Check that a step may begin where the last one has ended.

        Raises:
            InputError: options of the model have changed, or the loop has gone elsewhere in time.
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
        """Apply all of it for one step of MuJoCo."""
        self._began_s = float(self._data.time)
        self._loads.put_on(self._robot, self.load, self.torque)
        if self.carries:
            steps_in_progress().enter(self._carried)

    def abandon_step(self) -> None:
        """Take off what a step that was left in the middle has put on."""
        if self._carried.in_step:
            steps_in_progress().leave(self._carried)
        self._loads.abandon(self._robot)

    def step(self) -> None:
        """Take one step of MuJoCo."""
        mujoco.mj_step(self._model, self._data)

    def is_of(self, model: object, data: object) -> bool:
        """Return whether these are its model and its state."""
        return model is self._model and data is self._data

    @property
    def time_s(self) -> float:
        """MuJoCo's."""
        return float(self._data.time)

    def end_step(self) -> None:
        """Take it off.

        Raises:
            InputError: MuJoCo has not taken one step, loads have been written to meanwhile, or the inertia of
                the mount was left out.
            InstabilityError: MuJoCo has begun anew, as its state was no longer finite.
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
                "MuJoCo did not call the control callback by which the mount carries inertia: set yours by "
                "mujoco.set_mjcb_control() ahead of before(), and do not disable actuation in model.opt"
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
        """Read what the tick has led to, before the soft robot moves."""
        self.accelerated()
        self.read()

    def accelerated(self) -> None:
        """Find the acceleration in the tick, and the work on bodies."""
        self.bodies.work_J = 0.5 * self.tick_s * (self._power_W + self.bodies.power_W(self.load))
        data, dofs = self._data, self._mounting.dofs
        if self._steps == 1:
            self._acceleration[:] = data.qacc[dofs]
        else:
            self._acceleration[:] = (data.qvel[dofs] - self._speed) / self.tick_s

    def read(self) -> None:
        """Bring poses, velocities and inertia up to the present state of the joints."""
        mujoco.mj_fwdPosition(self._model, self._data)
        mujoco.mj_fwdVelocity(self._model, self._data)
        self.flange.moved()
        self.carry()

    @contextmanager
    def lent(self) -> Iterator[None]:
        """Let MuJoCo's arrays hold the soft robot's loads alone; keep what loads of contact become there."""
        forces, torques = self._applied
        given = forces.copy(), torques.copy()
        forces[:], torques[:] = self.load, self.torque
        try:
            yield
        finally:
            self.load[:] = forces
            forces[:], torques[:] = given

    @property
    def state(self) -> HostState:
        """A copy of all that the next step depends on, MuJoCo's state included."""
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
    """Take off what a scene has applied that is deleted in the middle of a step."""
    loads.abandon(robot)
    if carried.in_step:
        steps_in_progress().leave_later(carried)


@final
class _StepOptions:
    """Options of a model on which the steps of a soft robot depend, as they were when it began.

    Args:
        model: whose options may change.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._option, self._gravity = model, model.opt, model.opt.gravity
        self._begun, self._begun_as = self._now(), self._named()

    def check(self) -> None:
        """Raise InputError where they have changed."""
        if self._now() == self._begun:
            return
        _check_steps(self._model)
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
        return {"timestep": float(self._option.timestep), "gravity": _gravity(self._model)}


@final
@dataclass(frozen=True)
class HostModel:
    """Somebody's model, as it is when a soft robot is attached.

    Args:
        spec: from which it is compiled; None: it has been.
        at: name of the site or body.
        far: name of the one that the soft robot's tip is glued to; None for none.
        timestep_s: of MuJoCo.
        gravity: (3,) [m/s^2].
        steps: of MuJoCo in a tick.
    """

    spec: mujoco.MjSpec | None
    at: str
    far: str | None
    timestep_s: float
    gravity: tuple[float, float, float]
    steps: int

    @classmethod
    def of(cls, source: HostSource, at: str | tuple[str, str], tick_s: float | None) -> "HostModel":
        """Return a model that has the site or body.

        Args:
            source: specification, which may get a massless body; or a compiled model; or path of an MJCF.
            at: name of a site, or else of a body; or two, the second for the soft robot's tip.
            tick_s: of the soft robot; None: MuJoCo's timestep.

        Raises:
            InputError: MuJoCo refuses it, it has no such site or body, or its steps will not do.
        """
        spec, model = _read(source)
        if not (isinstance(at, str) or (isinstance(at, tuple | list) and len(at) == 2)):
            raise InputError(f"at is {at!r}; give the name of a site or body, or two names for a soft joint")
        at, far = (at, None) if isinstance(at, str) else at
        mounting = find_mounting(model, at)
        _find_far(model, mounting, far)
        _check_steps(model)
        if spec is not None and model.body_simple[mounting.body]:
            # MuJoCo keeps no whole mass matrix of a body without children; what it carries needs one
            (spec.site(at).parent if mounting.kind == SITE else spec.body(at)).add_body(name=_free_name(spec))
        timestep_s = float(model.opt.timestep)
        return cls(spec, at, far, timestep_s, _gravity(model), _steps(tick_s, timestep_s))

    def scene(self, model: mujoco.MjModel, data: mujoco.MjData) -> HostScene:
        """Return the scene of a compiled model with its state.

        Raises:
            InputError: it is not the model that was attached to.
        """
        for what, value in (("model", model), ("data", data)):
            wanted = mujoco.MjModel if what == "model" else mujoco.MjData
            if not isinstance(value, wanted):
                raise InputError(f"{what} is {type(value).__name__}; give a mujoco.{wanted.__name__}")
        mounting = find_mounting(model, self.at)
        _check_steps(model)
        here = (float(model.opt.timestep), _gravity(model))
        for what, one, other in zip(
            ("timestep", "gravity"), here, (self.timestep_s, self.gravity), strict=True
        ):
            if one != other:
                raise InputError(
                    f"model.opt.{what} is {one}, and was {other} when it was attached to; set it before"
                )
        return HostScene(model, data, (mounting, _find_far(model, mounting, self.far)), self.steps)


def find_mounting(model: mujoco.MjModel, name: str) -> Mounting:
    """Return where a site or body of a model is.

    Args:
        model: compiled.
        name: of a site, or else of a body.

    Raises:
        InputError: no site or body has that name.
    """
    for kind, what in ((SITE, mujoco.mjtObj.mjOBJ_SITE), (BODY, mujoco.mjtObj.mjOBJ_BODY)):
        index = mujoco.mj_name2id(model, what, name) if isinstance(name, str) else -1
        if index >= 0:
            body = int(model.site_bodyid[index]) if kind == SITE else index
            return Mounting(kind, index, body, _moving(model, body))
    sites = _listed(model.site(k).name for k in range(model.nsite))
    bodies = _listed(model.body(k).name for k in range(1, model.nbody))
    raise InputError(f"at is {name!r}, which is no site or body; sites: {sites}; bodies: {bodies}")


def _find_far(model: mujoco.MjModel, mounting: Mounting, name: str | None) -> Mounting | None:
    """Return where the tip of a mounted soft robot is glued to.

    Raises:
        InputError: no site or body has that name, or it goes with the mount.
    """
    far = None if name is None else find_mounting(model, name)
    if far is not None and model.body_weldid[far.body] == model.body_weldid[mounting.body]:
        raise InputError(f"at: {name!r} goes rigidly with what carries the soft robot; name another body")
    return far


def _read(source: HostSource) -> tuple[mujoco.MjSpec | None, mujoco.MjModel]:
    if isinstance(source, str | Path):
        read = mjcf_files.read_mjcf_file(Path(source), "scene")
        return read.spec, read.model
    engine.set_up_engine()
    if isinstance(source, mujoco.MjModel):
        return None, source
    if not isinstance(source, mujoco.MjSpec):
        raise InputError(
            f"spec is {type(source).__name__}; give a mujoco.MjSpec, a mujoco.MjModel, or the path of an MJCF"
        )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # whoever compiles it sees them
            model = source.copy().compile()
        engine.check_finite(model)
    except ValueError as error:
        text = str(error).replace("\n", ", ")
        raise InputError(f"spec: MuJoCo refuses it: {text:.500}") from None
    return source, model


def _check_steps(model: mujoco.MjModel) -> None:
    if model.opt.integrator == _RK4:
        raise InputError(
            "option integrator is RK4, whose steps evaluate forces four times; the soft robot's act once a "
            "step: use Euler, implicit or implicitfast"
        )


def _gravity(model: mujoco.MjModel) -> tuple[float, float, float]:
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY:
        return 0.0, 0.0, 0.0
    x, y, z = np.asarray(model.opt.gravity, dtype=np.float64).tolist()
    return x, y, z


def _steps(tick_s: float | None, timestep_s: float) -> int:
    if tick_s is None:
        return 1
    steps = tick_s / timestep_s if isinstance(tick_s, float | int) else math.nan
    if not (math.isfinite(steps) and steps > 0.5 and abs(steps - round(steps)) <= _WHOLE):
        raise InputError(f"tick_s is {tick_s!r}; must be one or several timesteps of {timestep_s:g} s")
    return round(steps)


def _free_name(spec: mujoco.MjSpec) -> str:
    number = 1
    while spec.body(f"{_MOUNT}_{number}") is not None:
        number += 1
    return f"{_MOUNT}_{number}"


def _listed(names: Iterable[str]) -> str:
    known = [name for name in names if name]
    more = ", ..." if len(known) > _MOST_NAMES else ""
    return ", ".join(known[:_MOST_NAMES]) + more if known else "none with a name"


def _moving(model: mujoco.MjModel, body: int) -> IntArray:
    """Return the degrees of freedom that move a body, from the root on."""
    found: list[int] = []
    while body:
        first, count = int(model.body_dofadr[body]), int(model.body_dofnum[body])
        found = [*range(first, first + count), *found]
        body = int(model.body_parentid[body])
    return np.array(found, np.int64)
