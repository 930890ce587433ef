"""The arm of a compiled scene: where it sits, its dynamics, its flange, where its servos droop to.

Where a soft robot is mounted, and where the arm sits in a compiled MuJoCo model.

The flange of a compiled scene: where it is, how it moves, what acts on it and what it measures.

Quasi-static rest of a servo-held arm: where it droops to under a constant load.

The joints of a cell: they follow their commands whatever pushes them, like drives that do not give way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Mask, Pose, SixNumbers, Twist, Wrench
from cosim.errors import ConvergenceError
from cosim.rigid.build.description import (
    CELL,
    FLANGE_CONTACTS,
    FLANGE_SITE,
    FORCE_SENSOR,
    OBJECT_CONTACTS,
    TORQUE_SENSOR,
)

SITE, BODY = int(mujoco.mjtObj.mjOBJ_SITE), int(mujoco.mjtObj.mjOBJ_XBODY)
NO_OBJECT = int(mujoco.mjtObj.mjOBJ_UNKNOWN)


@final
@dataclass(frozen=True)
class Mounting:
    """Where a soft robot hangs in a compiled model: the frame that is its flange.

    Args:
        kind: SITE or BODY.
        index: of the site, or of the body.
        body: to which the frame is fixed.
        dofs: degrees of freedom that move it, from the root on.
    """

    kind: int
    index: int
    body: int
    dofs: slice | IntArray

    def frame(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Return views of the frame's origin (3,) [m] and of its axes (3, 3), world from frame."""
        places, axes = (data.site_xpos, data.site_xmat) if self.kind == SITE else (data.xpos, data.xmat)
        return places[self.index], axes[self.index].reshape(3, 3)


@dataclass(frozen=True)
class ArmLayout:
    """Indices of the arm; joints are consecutive, so slices (views, no copies) are enough.

    Args:
        joints: of the arm among joints and actuators.
        positions: in qpos.
        dofs: in qvel.
        site: the flange.
        mount: massless body at the flange.
        force: of the flange's force sensor in sensordata.
        torque: of the flange's torque sensor in sensordata.
        contacts: in sensordata, how many contacts what is mounted on the flange has.
        carries: whether something rigid is mounted on the flange.
        object_sensors: (o, 2 + k), a free object of each row, where in sensordata all of its contacts with
            rigid bodies are counted, and where those with what is mounted on each flange, this one first.
    """

    joints: slice
    positions: slice
    dofs: slice
    site: int
    mount: int
    force: slice
    torque: slice
    contacts: int
    carries: bool
    object_sensors: IntArray

    @property
    def mounting(self) -> Mounting:
        """Where the soft robot hangs."""
        return Mounting(SITE, self.site, self.mount, self.dofs)

    @classmethod
    def of(cls, model: mujoco.MjModel, joint_names: tuple[str, ...], prefix: str = "") -> "ArmLayout":
        """Return the layout of the arm with the named joints, base to flange, all names behind a prefix."""
        joints = np.array([model.joint(prefix + name).id for name in joint_names])
        site = int(model.site(prefix + FLANGE_SITE).id)
        force, torque = (int(model.sensor(prefix + name).adr[0]) for name in (FORCE_SENSOR, TORQUE_SENSOR))
        return cls(
            joints=_consecutive(joints),
            positions=_consecutive(model.jnt_qposadr[joints]),
            dofs=_consecutive(model.jnt_dofadr[joints]),
            site=site,
            mount=int(model.site_bodyid[site]),
            force=slice(force, force + 3),
            torque=slice(torque, torque + 3),
            contacts=int(model.sensor(prefix + FLANGE_CONTACTS).adr[0]),
            carries=bool((model.body_parentid == model.site_bodyid[site]).any()),
            object_sensors=_object_sensors(model, int(model.site_bodyid[site])),
        )


def _object_sensors(model: mujoco.MjModel, mount: int) -> IntArray:
    """Return where contacts of free objects are counted, see `ArmLayout.object_sensors`."""
    rows: dict[int, list[int]] = {}
    for sensor in range(model.nsensor):
        if model.sensor(sensor).name.startswith(OBJECT_CONTACTS):
            body, with_all = int(model.sensor_objid[sensor]), model.sensor_reftype[sensor] == NO_OBJECT
            row, address = rows.setdefault(body, [body]), int(model.sensor_adr[sensor])
            first = not with_all and model.sensor_refid[sensor] == mount
            row.insert(2 if first else len(row), address)
    return np.array(list(rows.values()), np.int64).reshape(len(rows), -1 if rows else 3)


def effort_limit(model: mujoco.MjModel, layout: ArmLayout) -> Array:
    """Return the largest servo torques (joints,) [N m]; infinite where the arm's file names none."""
    largest = model.jnt_actfrcrange[layout.joints, 1]
    return np.where(largest > 0.0, largest, np.inf)


def _consecutive(addresses: IntArray) -> slice:
    first, count = int(addresses[0]), len(addresses)
    if not np.array_equal(addresses, np.arange(first, first + count)):
        raise AssertionError(f"the arm's joints are not consecutive in the compiled model: {addresses}")
    return slice(first, first + count)


@final
@dataclass(frozen=True)
class ArmAtRest:
    """An arm that stands still.

    Args:
        flange: world_from_flange.
        places: (joints, 3) [m], of the joints, world.
        mass_matrix: (joints, joints) [kg m^2], armature included.
        gravity_torque: (joints,) [N m], which hold it.
    """

    flange: Pose
    places: Array
    mass_matrix: Array
    gravity_torque: Array


@final
class ArmDynamics:
    """Asks MuJoCo about the arm of a scene, which does not move.

    Args:
        model: of the scene.
        scratch: a state of it that is overwritten.
        layout: of the arm.
        driven: (d,) places of the cell's joints in the state.
        servo_inertia: (joints,) [kg m^2], part of the model's armature that represents the servos' damping.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        scratch: mujoco.MjData,
        layout: ArmLayout,
        driven: IntArray,
        servo_inertia: Array,
    ) -> None:
        self._model, self._scratch, self._layout, self._driven = model, scratch, layout, driven
        self._servo_inertia = servo_inertia

    @property
    def limits(self) -> tuple[Array, Array]:
        """Smallest and largest angles (joints,), (joints,) [rad]; infinite where a joint has none."""
        joints = self._layout.joints
        bounded, between = self._model.jnt_limited[joints] != 0, self._model.jnt_range[joints]
        return np.where(bounded, between[:, 0], -np.inf), np.where(bounded, between[:, 1], np.inf)

    def places(self, joints: Array, cell: Array | None = None) -> tuple[Array, Array]:
        """Return where bodies are (bodies, 3) [m], world, and their axes (bodies, 3, 3), world from body.

        Args:
            joints: (joints,) [rad]; objects stay where they are.
            cell: (d,) [m] or [rad], where its joints are; as in its file unless given.
        """
        model, data = self._model, self._scratch
        data.qpos[self._layout.positions] = joints
        data.qpos[self._driven] = 0.0 if cell is None else cell
        mujoco.mj_kinematics(model, data)
        return data.xpos.copy(), data.xmat.reshape(-1, 3, 3).copy()

    def at(self, joints: Array) -> ArmAtRest:
        """Return the arm at angles (joints,) [rad]; objects do not matter."""
        model, data, layout = self._model, self._scratch, self._layout
        data.qpos[layout.positions], data.qvel[:] = joints, 0.0
        mujoco.mj_fwdKinematics(model, data)
        mujoco.mj_comVel(model, data)
        mujoco.mj_makeM(model, data)
        full, weight, v = np.empty((model.nv, model.nv)), np.empty(model.nv), layout.dofs
        mujoco.mj_fullM(model, data, full)
        mujoco.mj_rne(model, data, 0, weight)
        flange = Pose(data.site_xmat[layout.site].reshape(3, 3), data.site_xpos[layout.site])
        mass = full[v, v] - np.diag(self._servo_inertia)
        return ArmAtRest(flange, data.xanchor[layout.joints].copy(), mass, weight[v].copy())


class MountedFrame:
    """The frame on which a soft robot hangs; a view into a scene's model and state.

    Pose and velocity are found once between two calls of `moved`; MuJoCo's arrays stay where they are in
    memory, so they are looked up once.

    Args:
        model: compiled scene.
        data: its state.
        mounting: where it is.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting) -> None:
        self._model, self._data, self._mounting = model, data, mounting
        self._origin, self._axes = mounting.frame(data)
        self._pose: Pose | None = None
        self._spin, self._known = np.zeros(6), False  # whether it is that of the present state

    @property
    def axes(self) -> Array:
        """(3, 3), a view, world from flange."""
        return self._axes

    @property
    def origin(self) -> Array:
        """(3,) [m], a view, world."""
        return self._origin

    def moved(self) -> None:
        """Forget pose and velocity; MuJoCo has computed new ones."""
        self._pose, self._known = None, False

    @property
    def pose(self) -> Pose:
        """world_from_flange."""
        if self._pose is None:
            self._pose = Pose.owning(self._axes.copy(), self._origin.copy())
        return self._pose

    @property
    def spin(self) -> Array:
        """(6,), a view: angular [rad/s] then linear [m/s] velocity, at its origin, world axes."""
        if not self._known:
            at, self._known = self._mounting, True
            mujoco.mj_objectVelocity(self._model, self._data, at.kind, at.index, self._spin, False)
        return self._spin

    @property
    def twist(self) -> Twist:
        """Velocity of the flange, at its origin, world axes."""
        spin = self.spin.copy()
        return Twist.owning(spin[3:], spin[:3])

    def jacobian(self) -> Array:
        """Return J (6, dofs) with [linear; angular] = J qd, at the flange origin, world axes.

        Its columns are the degrees of freedom that move the flange.
        """
        return self.whole_jacobian()[:, self._mounting.dofs]

    def whole_jacobian(self) -> Array:
        """Return the same for all degrees of freedom of the scene, (6, nv)."""
        jacobian = np.empty((6, self._model.nv))
        mujoco.mj_jac(self._model, self._data, jacobian[:3], jacobian[3:], self._origin, self._mounting.body)
        return jacobian


def about_origin(load: Sequence[float], place: Array) -> SixNumbers:
    """Return a load (6,) about a point (3,) [m] as one about the world's origin: force, then torque."""
    (x, y, z, u, v, w), (a, b, c) = load, place.tolist()
    return x, y, z, u + b * z - c * y, v + c * x - a * z, w + a * y - b * x


@final
class Flange(MountedFrame):
    """The flange of an arm: a frame on a massless body, with a sensor.

    Args:
        model: compiled scene.
        data: its state.
        layout: where the arm sits in it.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, layout: ArmLayout) -> None:
        super().__init__(model, data, layout.mounting)
        self._applied: Array = data.xfrc_applied[layout.mount]
        self._center: Array = data.xipos[layout.mount]
        self._sensor = data.sensordata[layout.force], data.sensordata[layout.torque]
        self._read_at = Pose()  # axes of what the sensor shows
        self._restored: Array | None = np.zeros(6)  # in place of what it shows

    def apply(self, wrench: Wrench) -> None:
        """Set the load on the flange from now on: at its origin, world axes."""
        self._applied[:3], self._applied[3:] = wrench.force, wrench.torque

    def received(self) -> SixNumbers:
        """Return what acts on the flange now: force, and torque about the world's origin, world axes.

        Read back from MuJoCo, so it holds whatever has been applied by whomever.
        """
        return about_origin(self._applied.tolist(), self._center)

    def read_sensor(self) -> None:
        """Take over what the sensor shows until the next step; it has not `moved` since it was computed."""
        self._read_at, self._restored = self.pose, None

    @property
    def measured(self) -> Array:
        """Load (6,) that what hangs on the flange put on the arm when its sensor was read, world axes."""
        if self._restored is not None:
            return self._restored
        # MuJoCo reports what the arm exerts on the flange, the wanted load is its opposite.
        return -np.concatenate([self._read_at.rotation @ part for part in self._sensor])

    @measured.setter
    def measured(self, load: Array) -> None:
        self._restored = load


_ITERATIONS = 60
_TORQUE_TOLERANCE = 1e-10  # N m; a stiffness of 500 N m/rad turns it into 2e-13 rad


def droop(
    model: mujoco.MjModel,
    scratch: mujoco.MjData,
    *,
    layout: ArmLayout,
    joint_names: tuple[str, ...],
    reference: Array,
    feedforward: Array,
    load: Array,
) -> Array:
    """Return the joint angles at which servo torque, gravity and a flange load balance.

    Fixed-point steps q += residual / stiffness, from where the arm is. They contract because gravity and load
    change far less over an angle than the servo does (on the UR5e by a factor of about 30).

    Args:
        model: with one position servo per joint, in joint order.
        scratch: in its present configuration; overwritten.
        layout: of the arm in the model.
        joint_names: for messages.
        reference: (joints,) [rad].
        feedforward: (joints,) [N m].
        load: (6,) force [N] and torque [N m] at the flange origin, world axes.

    Raises:
        ConvergenceError: no equilibrium found, or it asks for more than the joints' torque.
    """
    stiffness, (places, dofs) = -model.actuator_biasprm[layout.joints, 1], (layout.positions, layout.dofs)
    scratch.qvel[:] = 0.0
    jacobian, gravity, angles = np.empty((6, model.nv)), np.empty(model.nv), scratch.qpos
    q = angles[places]
    servo = residual = np.zeros_like(q)
    for iteration in range(_ITERATIONS):
        angles[places] = q
        mujoco.mj_fwdKinematics(model, scratch)
        mujoco.mj_comVel(model, scratch)
        mujoco.mj_rne(model, scratch, 0, gravity)
        mujoco.mj_jacSite(model, scratch, jacobian[:3], jacobian[3:], layout.site)
        servo = stiffness * (reference - q) + feedforward
        residual = servo + jacobian[:, dofs].T @ load - gravity[dofs]
        if abs(residual).max() < _TORQUE_TOLERANCE:
            _check_torque(servo, effort_limit(model, layout), joint_names, iteration)
            return q
        q = q + residual / stiffness
    _check_torque(servo, effort_limit(model, layout), joint_names, _ITERATIONS)
    worst = int(np.argmax(np.abs(residual)))
    raise ConvergenceError(
        f"the arm's servos find no rest under this load: joint {joint_names[worst]} is still "
        f"{abs(residual[worst]):.3g} N m out of balance after {_ITERATIONS} iterations",
        residual_N=float(np.abs(residual[worst])),
        iterations=_ITERATIONS,
    )


def _check_torque(servo: Array, limit: Array, joint_names: tuple[str, ...], iterations: int) -> None:
    excess = np.abs(servo) - limit
    worst = int(np.argmax(excess))
    if excess[worst] > 0.0:
        raise ConvergenceError(
            f"holding this load takes {abs(servo[worst]):.1f} N m at joint {joint_names[worst]}, which can "
            f"give {limit[worst]:.1f} N m; bring the arm closer in or make the load lighter",
            residual_N=float(excess[worst]),
            iterations=iterations,
        )


@final
class CellDrives:
    """Moves the joints of a cell; a view into a scene's model and state.

    `names` are those of the joints, in the order of all arrays here; `bodies` (bodies,) says which bodies of
    the scene belong to the cell; `places` and `dofs` are where MuJoCo has the joints, `goal` (2, joints) is
    what `aim` has set.

    Args:
        model: compiled scene.
        data: its state.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        cell = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, CELL)
        self.bodies: Mask = (model.body_rootid == cell) & (cell > 0)
        joints = np.flatnonzero(self.bodies[model.jnt_bodyid])
        self.names = tuple(model.joint(int(joint)).name.removeprefix(f"{CELL}/") for joint in joints)
        self._data = data
        self.places, self.dofs = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
        self.goal = np.zeros((2, len(joints)))

    def aim(self, position: Array, velocity: Array) -> None:
        """Set where joints are at the end of the step to come, and how fast they continue from there.

        Args:
            position: (joints,) [m] or [rad], from where the cell's file has them.
            velocity: (joints,) [m/s] or [rad/s].
        """
        self.goal[:] = position, velocity

    def drive(self, left: int, step_s: float) -> None:
        """Put the joints on their way to where they are to be at the end of a tick.

        Args:
            left: steps of MuJoCo until then; the last one has been integrated at the speed of before.
            step_s: length of one [s].
        """
        if not self.names:
            return
        position, velocity = self._data.qpos, self._data.qvel
        if left == 1:
            position[self.places], velocity[self.dofs] = self.goal
            return
        gone = step_s * velocity[self.dofs]
        way = (self.goal[0] - position[self.places] + gone) / left
        position[self.places] += way - gone
        velocity[self.dofs] = way / step_s
