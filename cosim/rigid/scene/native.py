"""A scene as kernels see it: MuJoCo's arrays, and what is called every step by addresses.

Stepping by way of Python costs several times what the step itself does.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Annotated, NamedTuple

import mujoco
import numpy as np
from numba import types
from numpy.typing import NDArray

from cosim.base.frames import Array, IntArray
from cosim.base.kernels import IndexTable, Indices, Matrix, Vector
from cosim.errors import SceneError
from cosim.rigid.scene.arm import ArmLayout, CellDrives, Mounting

BEGIN, FINISH, FACTORISE = 0, 1, 2
"""Places in `NativeScene.steps`: the half steps, and the factorisation of the mass matrix."""
ACCELERATE, CONSTRAIN, VELOCITIES, REBEGIN, REFINISH, REFACTORISE = range(6)
"""Places in `Foresight.steps`: accelerations without and with constraints, velocities of bodies; then those
of `NativeScene.steps`."""


class NativeScene(NamedTuple):
    """Views of one scene; MuJoCo's arrays stay where they are in memory.

    Args:
        pace: (2,), how many steps of MuJoCo the next rigid half takes, and how many are left until its
            tick of the clock ends.
        step_s: the length of one [s].
        steps: (3,) addresses of the functions of both half steps and of the factorisation of the mass matrix.
        sides: (2,) addresses of model and state, which are their arguments.
        control: (joints, 3), position, velocity and feedforward of each servo.
        position: (joints,) [rad].
        speed: (joints,) [rad/s].
        servo_torque: (joints,) [N m], of the last finished step.
        acceleration: (joints,) [rad/s^2].
        torque: (joints,) [N m], applied besides servos.
        applied: (6,), load on the flange at its origin, world axes.
        center: (3,) [m], where MuJoCo has the flange's centre of mass.
        origin: (3,) [m], of the flange.
        axes: (3, 3), world from flange.
        velocity: (6,), angular then linear, of the flange's body at `reference`.
        reference: (3,) [m].
        places: (bodies, 3) [m].
        quaternions: (bodies, 4), world from body.
        warnings: (kinds,), how often MuJoCo has warned.
        mass: entries of the sparse mass matrix.
        mass_places: (joints, joints), where in it the lower triangle of the arm's joints is.
        coordinates: of all joints, and
        speeds: of all degrees of freedom.
        drive_place: (d,), of a cell's joints in the first, and
        drive_dof: (d,), in the second.
        drive_aim: (2, d), see `CellDrives.aim`.
    """

    pace: Indices
    step_s: float
    steps: Indices
    sides: Indices
    control: Matrix
    position: Vector
    speed: Vector
    servo_torque: Vector
    acceleration: Vector
    torque: Vector
    applied: Vector
    center: Vector
    origin: Vector
    axes: Matrix
    velocity: Vector
    reference: Vector
    places: Matrix
    quaternions: Matrix
    warnings: Annotated[NDArray[np.int32], types.Array(types.int32, 1, "A")]
    mass: Vector
    mass_places: IndexTable
    coordinates: Vector
    speeds: Vector
    drive_place: Indices
    drive_dof: Indices
    drive_aim: Matrix


class StateRows(NamedTuple):
    """What a step of a scene depends on; MuJoCo's arrays, each as one row of numbers.

    Args:
        position: of all joints.
        speed: (nv,), of all degrees of freedom.
        warm: (nv,), accelerations from which contact forces are solved.
        torque: (nv,), applied.
        applied: (6 bodies,), loads on them.
        control: (3 joints,), position, velocity and feedforward of each servo.
    """

    position: Vector
    speed: Vector
    warm: Vector
    torque: Vector
    applied: Vector
    control: Vector


class StepsAhead(NamedTuple):
    """A second state of a scene, in which a tick of several steps is taken ahead.

    Args:
        pace: (2,), see `NativeScene`.
        step_s: length of a step [s].
        sides: (2,) addresses of the model and of the second state.
        here: the scene's own state, and
        there: the second one.
        spin: (bodies, 6), and
        tree: (bodies, 3) [m], of the second state, see `Leads`.
        mass: entries of its sparse mass matrix.
        mass_places: see `NativeScene`.
        carried: (joints, joints) [kg m^2], that the arm's joints carry.
    """

    pace: Indices
    step_s: float
    sides: Indices
    here: StateRows
    there: StateRows
    spin: Matrix
    tree: Matrix
    mass: Vector
    mass_places: IndexTable
    carried: Matrix


class Foresight(NamedTuple):
    """How a scene is going to move, by MuJoCo's own accelerations; its arrays stay where they are in memory.

    Args:
        steps: (6,) addresses of functions.
        sides: (2,) addresses of model and state, which are their arguments.
        speed: (nv,), velocities of all degrees of freedom.
        acceleration: (nv,), theirs in the last step.
        kept: (2, nv), scratch.
        mass: entries of the sparse mass matrix.
        diagonal: (nv,), where in it the diagonal is.
        damping: (nv,), of the joints.
        ahead: for ticks of several steps.
    """

    steps: Indices
    sides: Indices
    speed: Vector
    acceleration: Vector
    kept: Matrix
    mass: Vector
    diagonal: Indices
    damping: Vector
    ahead: StepsAhead


def foresight(
    model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting, pace: IntArray, carried: Array
) -> Foresight:
    """Return how a scene is going to move.

    Raises:
        SceneError: MuJoCo's library cannot be found.
    """
    diagonal = np.asarray(model.M_rowadr + model.M_rownnz - 1, np.int64)
    return Foresight(
        np.array(_addresses(_ANSWERS + _STEPS)), np.array((model._address, data._address)), data.qvel,
        data.qacc, np.zeros((2, model.nv)), data.M, diagonal, model.dof_damping,
        _steps_ahead(model, data, mounting, pace, carried),
    )  # fmt: skip


def _steps_ahead(
    model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting, pace: IntArray, carried: Array
) -> StepsAhead:
    """Return a second state of a scene; the scene's own where a tick is one step, which needs none."""
    other = mujoco.MjData(model) if pace[0] > 1 else data
    here, there = (
        StateRows(
            state.qpos, state.qvel, state.qacc_warmstart, state.qfrc_applied, state.xfrc_applied.reshape(-1),
            state.ctrl,
        )
        for state in (data, other)
    )  # fmt: skip
    return StepsAhead(
        pace, float(model.opt.timestep), np.array((model._address, other._address)), here, there, other.cvel,
        other.subtree_com, other.M, mass_places(model, mounting), carried,
    )  # fmt: skip


def native_scene(
    model: mujoco.MjModel, data: mujoco.MjData, layout: ArmLayout, cell: CellDrives, pace: IntArray
) -> NativeScene:
    """Return a compiled scene as kernels see it.

    Raises:
        SceneError: MuJoCo's library cannot be found.
    """
    mount = layout.mount
    return NativeScene(
        pace, float(model.opt.timestep), np.array(_addresses(_STEPS)),
        np.array((model._address, data._address)), data.ctrl.reshape(-1, 3)[layout.joints],
        data.qpos[layout.positions], data.qvel[layout.dofs], data.qfrc_actuator[layout.dofs],
        data.qacc[layout.dofs], data.qfrc_applied[layout.dofs],
        data.xfrc_applied[mount], data.xipos[mount], data.site_xpos[layout.site],
        data.site_xmat[layout.site].reshape(3, 3), data.cvel[mount],
        data.subtree_com[model.body_rootid[mount]], data.xpos, data.xquat, data.warning.number,
        data.M, mass_places(model, layout.mounting), data.qpos, data.qvel, np.array(cell.places, np.int64),
        np.array(cell.dofs, np.int64), cell.goal,
    )  # fmt: skip


def mass_places(model: mujoco.MjModel, mounting: Mounting) -> IntArray:
    """Return where MuJoCo keeps M_ij, j <= i, of what moves a mount: each is moved by all before it.

    -1 where it keeps the diagonal alone, of a free body without children.
    """
    joints = np.arange(model.nv)[mounting.dofs]
    places = np.full((len(joints), len(joints)), -1, dtype=np.int64)
    for i, dof in enumerate(joints):
        last = int(model.M_rowadr[dof] + model.M_rownnz[dof])
        if model.M_rownnz[dof] > i:
            places[i, : i + 1] = np.arange(last - i - 1, last)
    return places


_STEPS = "mj_step1", "mj_step2", "mj_factorM"
_ANSWERS = "mj_fwdAcceleration", "mj_fwdConstraint", "mj_comVel"


@cache
def _addresses(names: tuple[str, ...]) -> tuple[int, ...]:
    """Return the addresses of functions of MuJoCo's library."""
    folder = Path(mujoco.__file__).parent
    for path in sorted(folder.glob("*mujoco*")):
        if path.suffix in (".dll", ".dylib") or ".so." in path.name:
            library = ctypes.CDLL(str(path))  # it is loaded already: this finds it
            return tuple(ctypes.cast(library[name], ctypes.c_void_p).value or 0 for name in names)
    raise SceneError(f"MuJoCo's library is not in {folder}: install its package (`pip install mujoco`)", None)
