"""A scene as kernels see it: MuJoCo's arrays, and its two half steps by their addresses.

Stepping by way of Python costs several times what the step itself does.
"""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from cosim.frames import Array, IntArray
from cosim.kernels import INDICES, MATRIX, VECTOR
from cosim.rigid.layout import ArmLayout

BEGIN, FINISH = 0, 1
"""Places of the half steps in `NativeScene.steps`."""


class NativeScene(NamedTuple):
    """Views of one scene; MuJoCo's arrays stay where they are in memory.

    Args:
        steps: (2,) addresses of the functions of both half steps.
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
    """

    steps: IntArray
    sides: IntArray
    control: Array
    position: Array
    speed: Array
    servo_torque: Array
    acceleration: Array
    torque: Array
    applied: Array
    center: Array
    origin: Array
    axes: Array
    velocity: Array
    reference: Array
    places: Array
    quaternions: Array
    warnings: Any


NATIVE_SCENE = types.NamedTuple(
    (
        INDICES, INDICES, MATRIX, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, VECTOR, MATRIX,
        VECTOR, VECTOR, MATRIX, MATRIX, types.Array(types.int32, 1, "A"),
    ),
    NativeScene,
)  # fmt: skip


def _call_step(_typing: Any, address: Any, model: Any, data: Any) -> Any:
    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        word = ir.IntType(64)  # a pointer is passed as one
        function = ir.FunctionType(ir.VoidType(), [word, word])
        builder.call(builder.inttoptr(arguments[0], function.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), generate


call_step: Any = intrinsic(_call_step)
"""Calls one of MuJoCo's half steps from a kernel: call_step(address, model, data)."""


def native_scene(model: mujoco.MjModel, data: mujoco.MjData, layout: ArmLayout) -> NativeScene | None:
    """Return a compiled scene as kernels see it; None where MuJoCo's library cannot be found."""
    steps = _half_steps()
    if steps is None:
        return None
    mount = layout.mount
    return NativeScene(
        np.array(steps), np.array((model._address, data._address)), data.ctrl.reshape(-1, 3),
        data.qpos[layout.positions], data.qvel[layout.dofs], data.qfrc_actuator[layout.dofs],
        data.qacc[layout.dofs], data.qfrc_applied[layout.dofs],
        data.xfrc_applied[mount], data.xipos[mount], data.site_xpos[layout.site],
        data.site_xmat[layout.site].reshape(3, 3), data.cvel[mount],
        data.subtree_com[model.body_rootid[mount]], data.xpos, data.xquat, data.warning.number,
    )  # fmt: skip


@cache
def _half_steps() -> tuple[int, int] | None:
    """Return the addresses of `mj_step1` and `mj_step2`."""
    for path in sorted(Path(mujoco.__file__).parent.glob("*mujoco*")):
        if path.suffix in (".dll", ".dylib") or ".so." in path.name:
            library = ctypes.CDLL(str(path))  # it is loaded already: this finds it
            begin, finish = (
                ctypes.cast(f, ctypes.c_void_p).value for f in (library.mj_step1, library.mj_step2)
            )
            return None if begin is None or finish is None else (begin, finish)
    return None
