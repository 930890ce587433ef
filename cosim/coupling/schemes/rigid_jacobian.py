"""The rigid step of a staggered tick to first order: how arm and servos answer small changes."""

from collections.abc import Callable

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.schemes.algorithmic_mass import CarriedInertia
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.ticks import ServoCommands
from cosim.errors import ConvergenceError, InstabilityError
from cosim.reduced.sections.figures import supplied_wrench
from cosim.rigid.scene.scene import RigidScene

_ANGLE, _SPEED, _ACCELERATION, _FIGURE = 1e-6, 1e-5, 1e-3, 1e-4


def rigid_jacobian(
    interface: Interface,
    carried: CarriedInertia,
    servos: Callable[[Array, Array], ServoCommands],
    reference: Array,
) -> Array:
    """Return how the arm's state ends after the rigid step of a tick, to first order.

    By central differences of MuJoCo's step, which has no derivatives; the state is restored. Rows are joint
    positions, speeds and, where joints carry algorithmic mass, the last accelerations and those in `past`.
    Columns are the same, figures of the soft side (see `Interface.figures`), and the servos' references of
    position and speed.

    Args:
        interface: between the sides.
        carried: on the joints; of (0, 0) for none.
        servos: returns what the servos are asked for, by references (joints,) of position and speed.
        reference: (joints,) [rad], present one of position.
    """
    scene = interface.scene
    assert isinstance(scene, RigidScene), "linear models are of scenes that cosim steps"
    saved, taken, carries, past = scene.state, interface.room(1), carried.acts, carried.past.copy()
    joints, last = len(scene.joint_names), np.vstack([scene.joint_acceleration, past])
    last, figures = last.ravel() if carries else last[:0].ravel(), interface.figures.copy()
    here = (scene.joint_position, scene.joint_velocity, last, figures, reference, np.zeros(joints))
    steps = (_ANGLE, _SPEED, _ACCELERATION, _FIGURE, _ANGLE, _SPEED)
    sizes = [len(part) for part in here]
    ends, start, scale = np.cumsum(sizes)[:-1], np.concatenate(here), np.repeat(steps, sizes)

    def after(values: Array) -> Array:
        position, speed, felt, load, accuracy, pace = np.split(values, ends)
        scene.state = saved
        scene.set_joint_state(position, speed)
        if carries:
            scene.set_acceleration(felt[:joints])
            carried.past[:] = felt[joints:].reshape(past.shape)
        interface.figures[:] = load
        interface.load_flange(supplied_wrench(load))
        carried.compensate(scene)
        try:
            interface.step_rigid(servos(accuracy, pace).row(0), taken)
        except InstabilityError as error:
            raise ConvergenceError("MuJoCo warns near the present state: no linear model", 0.0, 0) from error
        felt = np.concatenate([scene.joint_acceleration, carried.past.ravel()])[: len(last)]
        return np.concatenate([taken.joint_position[0], taken.joint_velocity[0], felt])

    try:
        columns = [
            (after(start + step) - after(start - step)) / (2.0 * size)
            for step, size in zip(np.diag(scale), scale, strict=True)
        ]
    finally:
        scene.state = saved
        interface.figures[:] = figures
    return np.array(columns).T
