"""A serial arm as a Pinocchio model: poses, Jacobians and dynamics."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, final

import numpy as np
import pinocchio as pin

from cosim.base.arm_file import ArmFile
from cosim.base.frames import Array, Pose
from cosim.errors import InputError
from cosim.kinematics.axis_error import axis_error
from cosim.kinematics.inertial_parameters import COUNT, change_of_frame, placement

_POSE_FREEDOMS: Final = 6
_STANDARD_GRAVITY = (0.0, 0.0, -9.81)
_CREEP_RAD_s: Final = 1e-4  # speed below which dry friction is proportional to it (prismatic joints: m/s)


def model_of(arm: ArmFile) -> pin.Model:
    """Return the model of an arm's chain, with one coordinate for each joint.

    Raises:
        InputError: Pinocchio cannot read it, or reads other joints.
    """
    try:
        model = pin.buildModelFromXML(_bare_chain(arm))
    except (RuntimeError, ValueError) as error:
        text = str(error).replace("\n", ", ")
        raise InputError(f"arm {arm.name!r}: Pinocchio cannot read {arm.path}: {text}") from None
    if model.nq != model.nv or tuple(model.names[1:]) != arm.joint_names:
        raise InputError(f"arm {arm.name!r}: joints {tuple(model.names[1:])}, expected {arm.joint_names}")
    return model


def _bare_chain(arm: ArmFile) -> str:
    """Return the chain without shapes, and with continuous joints as revolute ones.

    For a continuous joint Pinocchio would use cosine and sine in place of the angle. It does not need shapes,
    but warns about them.
    """
    robot = ElementTree.fromstring(arm.urdf)
    for link in robot.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    for joint in robot.findall("joint"):
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            for limit in joint.findall("limit"):
                limit.set("lower", "-1e6")
                limit.set("upper", "1e6")
    return ElementTree.tostring(robot, encoding="unicode")


@dataclass(frozen=True)
class Payload:
    """A rigid body fixed to the flange.

    Args:
        mass_kg: not negative.
        center_of_mass: (3,) [m], flange frame.
        inertia: (3, 3) [kg m^2], about the centre of mass, flange axes.
    """

    mass_kg: float
    center_of_mass: Array
    inertia: Array


@final
class Arm:
    """A serial arm fixed to the world, with its flange frame.

    Quantities of joints are [rad], [N m]; of prismatic ones [m], [N]. Attributes: `name`; `joint_names`;
    `home` (joints,); `lower` and `upper` (joints,), the joint limits, infinite for continuous joints;
    `prismatic` (joints,), whether a joint slides; `turns_fully` (joints,), whether a joint can reach every
    direction; `joint_damping` (joints,), viscous friction from its file; `acceleration_bound` (joints,);
    `notes`, remarks from reading the arm.

    Args:
        arm: the arm to read.
        world_from_base: pose of the arm's root link; None: that of the arm's file.
        gravity: (3,) [m/s^2], world.

    Raises:
        InputError: Pinocchio cannot read the arm.
    """

    def __init__(
        self,
        arm: ArmFile,
        world_from_base: Pose | None = None,
        gravity: Array | tuple[float, float, float] = _STANDARD_GRAVITY,
    ) -> None:
        model = model_of(arm)
        base = world_from_base or arm.world_from_base
        model.jointPlacements[1] = placement(base) * model.jointPlacements[1]
        model.gravity.linear = np.array(gravity, dtype=np.float64)
        self.name, self.notes = arm.name, arm.notes
        self.joint_names = arm.joint_names
        self.home = arm.home
        self.acceleration_bound = arm.acceleration_bound
        self._model = model
        self._data = model.createData()
        self.prismatic = arm.prismatic
        self.lower = _read_only(np.where(arm.continuous, -np.inf, model.lowerPositionLimit))
        self.upper = _read_only(np.where(arm.continuous, np.inf, model.upperPositionLimit))
        self.turns_fully = ~self.prismatic & (self.upper - self.lower >= 2.0 * np.pi - 1e-6)
        self.joint_damping = _read_only(model.damping)
        self._dry: Array = _read_only(model.upperDryFrictionLimit)
        self._frame = model.getFrameId(arm.flange_frame, pin.FrameType.BODY)
        self._last_joint_from_flange = pin.SE3(model.frames[self._frame].placement)
        last = self._last_joint_from_flange
        self._last_joint_by_flange = change_of_frame(Pose(last.rotation, last.translation))
        self._own_parameters = np.concatenate(
            [inertia.toDynamicParameters() for inertia in list(model.inertias)[1:]]
        )
        self._loaded = pin.Model(model)
        self._inertias, self._last = self._loaded.inertias, model.njoints - 1
        self._bare_inertia = pin.Inertia(model.inertias[self._last])
        self._load = pin.Inertia.Zero()
        self._loaded_data = self._loaded.createData()
        self._payload: Payload | None = None

    @property
    def free_roll(self) -> bool:
        """Whether it has too few joints to follow a roll about the flange's z axis (fewer than six)."""
        return self.joint_count < _POSE_FREEDOMS

    @property
    def has_spare_joints(self) -> bool:
        """Whether it has more joints than a pose of the flange needs."""
        return self.joint_count > _POSE_FREEDOMS

    @property
    def joint_count(self) -> int:
        """Number of joints."""
        return int(self._model.nv)

    @property
    def drawn_from(self) -> tuple[Array, Array]:
        """Bounds (joints,), (joints,) of angles that may be drawn at random: the limits, or a full turn."""
        return np.where(np.isfinite(self.lower), self.lower, -np.pi), np.where(
            np.isfinite(self.upper), self.upper, np.pi
        )

    @property
    def velocity_limit(self) -> Array:
        """Largest joint speeds (joints,) [rad/s]."""
        return np.array(self._model.upperVelocityLimit)

    @property
    def effort_limit(self) -> Array:
        """Largest joint torques (joints,) [N m]."""
        return np.array(self._model.upperEffortLimit)

    @property
    def shoulder(self) -> Array:
        """Origin of the first joint (3,) [m], world; it does not move."""
        return np.array(self._model.jointPlacements[1].translation)

    @property
    def reach(self) -> float:
        """Length of the chain from the first joint's origin to the flange origin [m].

        No configuration puts the flange farther from `shoulder` than this sum of link lengths and of the
        ranges of prismatic joints.
        """
        links = [self._model.jointPlacements[i].translation for i in range(2, self._model.njoints)]
        ways = np.maximum(np.abs(self.lower), np.abs(self.upper))[self.prismatic]
        links += [*ways[:, None], self._last_joint_from_flange.translation]
        return float(sum(np.linalg.norm(link) for link in links))

    def forward(self, q: Array) -> Pose:
        """Return world_from_flange at joint angles q (joints,) [rad]."""
        pin.forwardKinematics(self._model, self._data, q)
        placement = pin.updateFramePlacement(self._model, self._data, self._frame)
        return Pose(placement.rotation, placement.translation)

    def error_towards(self, target: Pose) -> Callable[[Array], tuple[Array, Array]]:
        """Return the function q -> (e (6,), de/dq (6, joints)) with e = log(flange_from_target).

        Linear [m] then angular [rad], flange axes; zero where the flange is at the target. With less than
        six joints the roll about the flange's z axis is free, and e has five components: `axis_error`.

        Args:
            target: world_from_flange.
        """
        if self.free_roll:
            return self._axis_error_towards(target)
        model, data, frame = self._model, self._data, self._frame
        world_from_target = placement(target)

        def error(q: Array) -> tuple[Array, Array]:
            pin.computeJointJacobians(model, data, q)
            flange_from_target = pin.updateFramePlacement(model, data, frame).actInv(world_from_target)
            derivative = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            return (
                pin.log6(flange_from_target).vector,
                -pin.Jlog6(flange_from_target.inverse()) @ derivative,
            )

        return error

    def _axis_error_towards(self, target: Pose) -> Callable[[Array], tuple[Array, Array]]:
        model, data, frame = self._model, self._data, self._frame

        def error(q: Array) -> tuple[Array, Array]:
            pin.computeJointJacobians(model, data, q)
            place = pin.updateFramePlacement(model, data, frame)
            jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL)
            return axis_error(Pose(place.rotation, place.translation), jacobian, target)

        return error

    def asked_rows(self, q: Array) -> Array:
        """Return the rows (6 or 5, 6) of a flange twist, world axes, that the arm can follow.

        Args:
            q: (joints,) [rad].
        """
        if not self.free_roll:
            return np.eye(6)
        rows = np.zeros((5, 6))
        rows[:3, :3], rows[3:, 3:] = np.eye(3), self.forward(q).rotation[:, :2].T
        return rows

    def jacobian(self, q: Array) -> Array:
        """Return J (6, joints) with [linear; angular] = J qd, at the flange origin, world axes.

        Args:
            q: (joints,) [rad].
        """
        return np.array(
            pin.computeFrameJacobian(self._model, self._data, q, self._frame, pin.LOCAL_WORLD_ALIGNED)
        )

    def joint_places(self, q: Array) -> Array:
        """Return the positions of the joints (joints, 3) [m], world, at joint angles q (joints,) [rad]."""
        pin.forwardKinematics(self._model, self._data, q)
        return np.array([place.translation for place in list(self._data.oMi)[1:]])

    def mass_matrix(self, q: Array, payload: Payload | None = None) -> Array:
        """Return the joint-space mass matrix (joints, joints) [kg m^2] of the links, without armature.

        Args:
            q: (joints,) [rad].
            payload: fixed to the flange.
        """
        model, data = self._loaded_with(payload)
        upper = np.triu(pin.crba(model, data, q))
        return np.asarray(upper + np.triu(upper, 1).T)

    def gravity_torque(self, q: Array, payload: Payload | None = None) -> Array:
        """Return the joint torques (joints,) [N m] that hold the arm still against gravity.

        Args:
            q: (joints,) [rad].
            payload: fixed to the flange.
        """
        model, data = self._loaded_with(payload)
        return np.array(pin.computeGeneralizedGravity(model, data, q))

    def friction(self, velocity: Array) -> Array:
        """Return the torque (..., joints) [N m] against viscous and dry friction.

        Args:
            velocity: (..., joints) [rad/s].
        """
        return np.asarray(self.joint_damping * velocity + self.dry_friction(velocity))

    def dry_friction(self, velocity: Array) -> Array:
        """Return the torque (..., joints) [N m] against Coulomb friction; zero at rest.

        Args:
            velocity: (..., joints) [rad/s].
        """
        return np.asarray(self._dry * np.clip(velocity / _CREEP_RAD_s, -1.0, 1.0))

    def inverse_dynamics(
        self,
        q: Array,
        velocity: Array,
        acceleration: Array,
        armature: Array | None = None,
        payload: Payload | None = None,
    ) -> Array:
        """Return tau = (M + diag(armature)) a + c(q, v) + g(q) + d v + f (joints,) [N m], by RNEA.

        d v is the viscous and f the dry friction of the joints, if the arm's file gives any.

        Args:
            q: (joints,) [rad].
            velocity: (joints,) [rad/s].
            acceleration: (joints,) [rad/s^2].
            armature: (joints,) [kg m^2], rotor inertias seen at the joints.
            payload: fixed to the flange.
        """
        model, data = self._loaded_with(payload)
        torque: Array = pin.rnea(model, data, q, velocity, acceleration)
        torque = torque + self.friction(velocity)
        return torque if armature is None else torque + armature * acceleration

    def torque_rows(
        self, q: Array, velocity: Array, acceleration: Array, armature: Array
    ) -> tuple[Array, Array]:
        """Return (tau_0, Y) at n instants: tau = tau_0 + Y p is `inverse_dynamics` with a payload p.

        Args:
            q: (n, joints) [rad].
            velocity: (n, joints) [rad/s].
            acceleration: (n, joints) [rad/s^2].
            armature: (joints,) [kg m^2].

        Returns:
            tau_0 (n, joints) [N m], and Y (n, joints, 10) by the `inertial_parameters` p of a payload,
            flange frame.
        """
        model, data = self._model, self._data
        rows = zip(q, velocity, acceleration, strict=True)
        regressor = np.stack([pin.computeJointTorqueRegressor(model, data, *row) for row in rows])
        bare = regressor @ self._own_parameters + self.friction(velocity) + armature * acceleration
        return bare, regressor[:, :, -COUNT:] @ self._last_joint_by_flange

    def _loaded_with(self, payload: Payload | None) -> tuple[pin.Model, pin.Data]:
        if payload is None:
            return self._model, self._data
        if payload is not self._payload:
            load = self._load
            load.mass, load.lever = payload.mass_kg, np.asarray(payload.center_of_mass)
            load.inertia = np.asarray(payload.inertia)
            self._inertias[self._last] = self._bare_inertia + self._last_joint_from_flange.act(load)
            self._payload = payload
        return self._loaded, self._loaded_data


def _read_only(values: Array) -> Array:
    copied = np.array(values)
    copied.setflags(write=False)
    return copied
