"""The rigid half of a staggered tick to first order: how arm and servos answer small changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.half_ticks import take_rigid_half
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.ticks import CarriedInertia, Servos
from cosim.errors import ConvergenceError

_ANGLE, _SPEED, _FIGURE = 1e-6, 1e-5, 1e-4
_NOTHING: Final = CarriedInertia(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)))


def rigid_slopes(interface: Interface, servos: Callable[[Array, Array], Servos], reference: Array) -> Array:
    """Return how positions and speeds (2 joints, columns) end after the rigid half of a tick.

    By central differences of MuJoCo's step, which has no derivatives; the state is restored. Columns are
    joint positions, speeds, figures of the soft side (see `fill_figures`), and the servos' references of
    position and speed.

    Args:
        interface: between the sides, without mass that rides on the joints.
        servos: returns what the servos are asked for, by references (joints,) of position and speed.
        reference: (joints,) [rad], present one of position.
    """
    scene = interface.scene
    saved, ticks = scene.save_state(), interface.begin(1).ticks
    rigid = interface.rigid(_NOTHING)
    joints, figures = len(scene.joint_names), ticks.figures[0].copy()
    here = (scene.joint_position, scene.joint_velocity, figures, reference, np.zeros(joints))
    steps = (_ANGLE, _SPEED, _FIGURE, _ANGLE, _SPEED)
    sizes = [len(part) for part in here]
    ends, start, scale = np.cumsum(sizes)[:-1], np.concatenate(here), np.repeat(steps, sizes)

    def after(values: Array) -> Array:
        position, speed, load, aim, pace = np.split(values, ends)
        scene.restore_state(saved)
        scene.set_joint_state(position, speed)
        flange = scene.flange_pose
        ticks.figures[0], ticks.origin[0], ticks.axes[0] = load, flange.translation, flange.rotation
        if not take_rigid_half(rigid, servos(aim, pace), ticks, 0):
            raise ConvergenceError("MuJoCo warns near the present state: no linear model", 0.0, 0)
        return np.concatenate([ticks.joints[0], ticks.joint_speed[0]])

    try:
        columns = [
            (after(start + step) - after(start - step)) / (2.0 * size)
            for step, size in zip(np.diag(scale), scale, strict=True)
        ]
    finally:
        scene.restore_state(saved)
    return np.array(columns).T
