"""The rigid half of a staggered tick to first order: how arm and servos answer small changes.

A file by itself: it is no scheme and no part of a tick, and differentiates what `half_ticks` does.
"""

from collections.abc import Callable

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.half_ticks import take_rigid_half
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.ticks import CarriedInertia, Servos
from cosim.errors import ConvergenceError
from cosim.rigid.scene.scene import RigidScene

_ANGLE, _SPEED, _ACCELERATION, _FIGURE = 1e-6, 1e-5, 1e-3, 1e-4


def rigid_slopes(
    interface: Interface, carried: CarriedInertia, servos: Callable[[Array, Array], Servos], reference: Array
) -> Array:
    """Return how the arm's state ends after the rigid half of a tick, to first order.

    By central differences of MuJoCo's step, which has no derivatives; the state is restored. Rows are joint
    positions, speeds and, where joints carry algorithmic mass, the last accelerations and those in `past`.
    Columns are the same, figures of the soft side (see `fill_figures`), and the servos' references of
    position and speed.

    Args:
        interface: between the sides.
        carried: on the joints; of (0, 0) for none.
        servos: returns what the servos are asked for, by references (joints,) of position and speed.
        reference: (joints,) [rad], present one of position.
    """
    scene = interface.scene
    assert isinstance(scene, RigidScene), "linear models are of scenes that cosim steps"
    saved, ticks = scene.save_state(), interface.begin(1).ticks
    rigid, carries, past = interface.rigid(carried), len(carried.inertia), carried.past.copy()
    joints, last = len(scene.joint_names), np.vstack([scene.joint_acceleration, past])
    last, figures = last.ravel() if carries else last[:0].ravel(), ticks.figures[0].copy()
    here = (scene.joint_position, scene.joint_velocity, last, figures, reference, np.zeros(joints))
    steps = (_ANGLE, _SPEED, _ACCELERATION, _FIGURE, _ANGLE, _SPEED)
    sizes = [len(part) for part in here]
    ends, start, scale = np.cumsum(sizes)[:-1], np.concatenate(here), np.repeat(steps, sizes)

    def after(values: Array) -> Array:
        position, speed, felt, load, aim, pace = np.split(values, ends)
        scene.restore_state(saved)
        scene.set_joint_state(position, speed)
        if carries:
            rigid.scene.acceleration[:], carried.past[:] = felt[:joints], felt[joints:].reshape(past.shape)
        flange = scene.flange_pose
        ticks.figures[0], ticks.origin[0], ticks.axes[0] = load, flange.translation, flange.rotation
        if not take_rigid_half(rigid, servos(aim, pace), ticks, 0):
            raise ConvergenceError("MuJoCo warns near the present state: no linear model", 0.0, 0)
        felt = np.concatenate([rigid.scene.acceleration, carried.past.ravel()])[: len(last)]
        return np.concatenate([ticks.joints[0], ticks.joint_speed[0], felt])

    try:
        columns = [
            (after(start + step) - after(start - step)) / (2.0 * size)
            for step, size in zip(np.diag(scale), scale, strict=True)
        ]
    finally:
        scene.restore_state(saved)
    return np.array(columns).T
