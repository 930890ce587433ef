"""A step of MuJoCo with servos that damp implicitly and give no more torque than their joints bear.

A servo's torque is u - h K a, where u is the torque at the speed at which the step begins, K its damping, h
the step and a the acceleration. The joints carry h K as armature, so MuJoCo solves (M + h K) a = u + ..., and
its own actuator force is u, which depends on the step. A joint at its limit gets the limit itself instead,
and its armature is then without h K.
"""

import ctypes
from functools import cache
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import device_function, kernel
from cosim.base.numba_insides import call_native
from cosim.errors import SceneError

_SECOND_HALF = (
    "mj_fwdActuation", "mj_fwdAcceleration", "mj_fwdConstraint", "mj_rnePostConstraint", "mj_sensorAcc",
    "mj_checkAcc", "mj_Euler", "mj_factorM",
)  # fmt: skip
"""What `mj_step2` calls, in its order. It marks the inner forces as out of date; here they are computed."""
_ACTUATE, _ACCELERATE, _CONSTRAIN, _SENSE, _END, _FACTORISE = 0, 1, 2, 3, 7, 7
_SPEED, _ASKED, _SIDE = range(3)


class ServoSide(NamedTuple):
    """Servos of some joints, and what takes the second half of a step; MuJoCo's arrays stay where they are.

    Args:
        steps: (8,) addresses of functions.
        sides: (2,) addresses of model and state, which are their arguments.
        step_s: length of a step [s].
        torque: (joints,) [N m], that each servo gave in the last step.
        limit: (joints,) [N m], largest; infinite for none.
        damping: (joints,) [N m s/rad], of the servos.
        dofs: (joints,), degrees of freedom.
        diagonal: (joints,), where their entries of the mass matrix are.
        kept: (3, joints), scratch: speeds at the step's begin, u, and at which limit a joint is (-1, 0, 1).
        force: (nv,), actuator forces.
        speed: (nv,), velocities.
        acceleration: (nv,), of the step.
        friction: (nv,), viscous, of the joints.
        mass: entries of the sparse mass matrix.
    """

    steps: Indices
    sides: Indices
    step_s: float
    torque: Vector
    limit: Vector
    damping: Vector
    dofs: Indices
    diagonal: Indices
    kept: Matrix
    force: Vector
    speed: Vector
    acceleration: Vector
    friction: Vector
    mass: Vector


def no_servos() -> ServoSide:
    """Return what represents a scene whose servos somebody else sees to."""
    none, nowhere = np.zeros(0), np.zeros(0, np.int64)
    return ServoSide(
        nowhere, nowhere, 0.0, none, none, none, nowhere, nowhere, np.zeros((3, 0)), none, none, none, none,
        none,
    )  # fmt: skip


def servo_side(
    model: mujoco.MjModel, data: mujoco.MjData, dofs: IntArray, damping: Array, limit: Array
) -> ServoSide:
    """Return the servos of joints, whose armature has h K in it, and whose forces MuJoCo does not limit.

    Args:
        model: compiled scene.
        data: its state.
        dofs: (joints,), degrees of freedom.
        damping: (joints,) [N m s/rad].
        limit: (joints,) [N m].

    Raises:
        SceneError: MuJoCo's library cannot be found.
    """
    diagonal = np.asarray(model.M_rowadr + model.M_rownnz - 1, np.int64)[dofs]
    return ServoSide(
        np.array(addresses(_SECOND_HALF)), np.array((model._address, data._address)),
        float(model.opt.timestep), np.zeros(len(dofs)), limit, damping, dofs, diagonal,
        np.zeros((3, len(dofs))), data.qfrc_actuator, data.qvel, data.qacc, model.dof_damping, data.M,
    )  # fmt: skip


@cache
def addresses(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the addresses of functions of MuJoCo's library.

    Raises:
        SceneError: MuJoCo's library cannot be found.
    """
    folder = Path(mujoco.__file__).parent
    for path in sorted(folder.glob("*mujoco*")):
        if path.suffix in (".dll", ".dylib") or ".so." in path.name:
            library = ctypes.CDLL(str(path))  # it is loaded already: this finds it
            return tuple(ctypes.cast(library[name], ctypes.c_void_p).value or 0 for name in names)
    raise SceneError(f"MuJoCo's library is not in {folder}: install its package (`pip install mujoco`)", None)


@device_function
def _call(side: ServoSide, first: int, end: int) -> None:
    for i in range(first, end):
        call_native(side.steps[i], side.sides[0], side.sides[1])


@device_function
def _limit(side: ServoSide) -> bool:
    """Put joints at their limits, or take them off; return whether that has changed any."""
    kept, changed = side.kept, False
    for j in range(side.dofs.shape[0]):
        dof, limit, carried = side.dofs[j], side.limit[j], side.step_s * side.damping[j]
        inertia = side.mass[side.diagonal[j]]
        # friction of joints is implicit in MuJoCo's step; joints count as if each were alone
        acceleration = side.acceleration[dof] * inertia / (inertia + side.step_s * side.friction[dof])
        torque, at = kept[_ASKED, j] - carried * acceleration, 0.0
        if torque > limit:
            at = 1.0
        elif torque < -limit:
            at = -1.0
        if at != kept[_SIDE, j]:
            changed = True
            side.mass[side.diagonal[j]] += carried * (abs(kept[_SIDE, j]) - abs(at))
            side.force[dof] = at * limit if at != 0.0 else kept[_ASKED, j]
            kept[_SIDE, j] = at
    return changed


@device_function
def finish_step(side: ServoSide) -> None:
    """Take the second half of a step: accelerations, sensors, and the state at its end."""
    kept, joints = side.kept, side.dofs.shape[0]
    _call(side, _ACTUATE, _SENSE)
    for j in range(joints):
        dof = side.dofs[j]
        kept[_SPEED, j], kept[_ASKED, j], kept[_SIDE, j] = side.speed[dof], side.force[dof], 0.0
    for _ in range(2 * joints):
        if not _limit(side):
            break
        _call(side, _FACTORISE, _FACTORISE + 1)
        _call(side, _ACCELERATE, _SENSE)
    _call(side, _SENSE, _END)
    for j in range(joints):
        torque = kept[_ASKED, j] - side.damping[j] * (side.speed[side.dofs[j]] - kept[_SPEED, j])
        if kept[_SIDE, j] != 0.0:
            torque = kept[_SIDE, j] * side.limit[j]
        side.torque[j] = min(max(torque, -side.limit[j]), side.limit[j])


@kernel
def take_second_half(side: ServoSide) -> None:
    """Take the second half of a step, see `finish_step`."""
    finish_step(side)
