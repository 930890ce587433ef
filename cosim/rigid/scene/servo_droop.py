"""Quasi-static rest of a servo-held arm: where it droops to under a constant load."""

from __future__ import annotations

import mujoco
import numpy as np

from cosim.base.frames import Array
from cosim.errors import ConvergenceError
from cosim.rigid.scene.layout import ArmLayout, effort_limit

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

    Fixed-point steps q += residual / stiffness. They contract because gravity and load change far less
    over an angle than the servo does (on the UR5e by a factor of about 30).

    Args:
        model: with one position servo per joint, in joint order.
        scratch: its configuration holds the other bodies; overwritten.
        layout: of the arm in the model.
        joint_names: for messages.
        reference: (joints,) [rad].
        feedforward: (joints,) [N m].
        load: (6,) force [N] and torque [N m] at the flange origin, world axes.

    Raises:
        ConvergenceError: no equilibrium found, or it asks for more than the joints' torque.
    """
    stiffness = -model.actuator_biasprm[layout.joints, 1]
    scratch.qvel[:] = 0.0
    jacobian, gravity = np.empty((6, model.nv)), np.empty(model.nv)
    q = reference.copy()
    servo = residual = np.zeros_like(q)
    for iteration in range(_ITERATIONS):
        scratch.qpos[layout.positions] = q
        mujoco.mj_fwdKinematics(model, scratch)
        mujoco.mj_comVel(model, scratch)
        mujoco.mj_rne(model, scratch, 0, gravity)
        mujoco.mj_jacSite(model, scratch, jacobian[:3], jacobian[3:], layout.site)
        servo = stiffness * (reference - q) + feedforward
        residual = servo + jacobian[:, layout.dofs].T @ load - gravity[layout.dofs]
        if np.max(np.abs(residual)) < _TORQUE_TOLERANCE:
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
