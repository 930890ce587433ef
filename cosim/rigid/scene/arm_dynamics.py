"""Kinematics and statics of an arm in MuJoCo: poses, mass matrix, gravity torque, and the angles at which its
servos hold a load.
"""

from dataclasses import dataclass
from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.errors import ConvergenceError
from cosim.rigid.scene.arm_layout import ArmLayout, effort_limit

_ITERATIONS = 60
_TORQUE_TOLERANCE = 1e-10  # N m; a stiffness of 500 N m/rad turns it into 2e-13 rad


@final
@dataclass(frozen=True)
class ArmAtRest:
    """Statics of an arm at one configuration.

    Args:
        flange: world_from_flange.
        places: (joints, 3) [m], positions of the joints, world.
        mass_matrix: (joints, joints) [kg m^2], armature included.
        gravity_torque: (joints,) [N m], torques that hold the arm.
    """

    flange: Pose
    places: Array
    mass_matrix: Array
    gravity_torque: Array


@final
class ArmDynamics:
    """Evaluates the arm of a scene in MuJoCo at any configuration; the scene does not change.

    Args:
        model: of the scene.
        scratch: a state of the model that is overwritten.
        layout: of the arm.
        driven: (d,) addresses of the cell's joints in qpos.
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
        """Smallest and largest angles (joints,), (joints,) [rad]; infinite without limits."""
        joints = self._layout.joints
        bounded, between = self._model.jnt_limited[joints] != 0, self._model.jnt_range[joints]
        return np.where(bounded, between[:, 0], -np.inf), np.where(bounded, between[:, 1], np.inf)

    def places(self, joints: Array, cell: Array | None = None) -> tuple[Array, Array]:
        """Return positions (bodies, 3) [m], world, and axes (bodies, 3, 3), world from body, of all bodies.

        Args:
            joints: (joints,) [rad]; objects do not move.
            cell: (d,) [m] or [rad], positions of the cell's joints; None: those of its file.
        """
        model, data = self._model, self._scratch
        data.qpos[self._layout.positions] = joints
        data.qpos[self._driven] = 0.0 if cell is None else cell
        mujoco.mj_kinematics(model, data)
        return data.xpos.copy(), data.xmat.reshape(-1, 3, 3).copy()

    def at(self, joints: Array) -> ArmAtRest:
        """Return the statics of the arm at angles (joints,) [rad]; objects have no effect."""
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

    Fixed-point iteration q += residual / stiffness from the present angles. It converges because torques of
    gravity and load change far less with an angle than that of the servo (on the UR5e by a factor of about
    30).

    Args:
        model: with one position servo per joint, in joint order.
        scratch: at the present angles; overwritten.
        layout: of the arm in the model.
        joint_names: for messages.
        reference: (joints,) [rad].
        feedforward: (joints,) [N m].
        load: (6,) force [N] and torque [N m] at the flange origin, world axes.

    Raises:
        ConvergenceError: no equilibrium found, or it needs more than the joints' torque limits.
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
        f"{abs(residual[worst]):.3g} N m out of balance after {_ITERATIONS} iterations; make the load "
        "lighter, or the servos stiffer",
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
