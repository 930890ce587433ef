"""The Jacobian of a staggered tick's rigid step, with the servos, by central differences."""

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
    """Return the Jacobian of the arm's state after the rigid step of a tick.

    By central differences, as MuJoCo's step has no derivatives; the state is restored. Rows are joint
    positions, speeds and, if the joints carry algorithmic mass, the last accelerations and those in `past`.
    Columns are the same quantities before the step, the figures of the soft robot (see `Interface.figures`),
    and the servos' references of position and speed.

    Args:
        interface: between arm and soft robot.
        carried: inertia on the joints, (0, 0) for none.
        servos: (position, speed) references (joints,) -> commands of the servos.
        reference: (joints,) [rad], present reference of position.
    """
    scene = interface.scene
    assert isinstance(scene, RigidScene), "linear models are of scenes that cosim steps"
    saved, log, carries, past = scene.state, interface.new_log(1), carried.acts, carried.past.copy()
    joints, last = len(scene.joint_names), np.vstack([scene.joint_acceleration, past])
    last, figures = last.ravel() if carries else last[:0].ravel(), interface.figures.copy()
    inputs = (scene.joint_position, scene.joint_velocity, last, figures, reference, np.zeros(joints))
    steps = (_ANGLE, _SPEED, _ACCELERATION, _FIGURE, _ANGLE, _SPEED)
    sizes = [len(block) for block in inputs]
    ends, start, scale = np.cumsum(sizes)[:-1], np.concatenate(inputs), np.repeat(steps, sizes)

    def state_after(state: Array) -> Array:
        position, speed, accelerations, load, position_reference, speed_reference = np.split(state, ends)
        scene.state = saved
        scene.set_joint_state(position, speed)
        if carries:
            scene.set_acceleration(accelerations[:joints])
            carried.past[:] = accelerations[joints:].reshape(past.shape)
        interface.figures[:] = load
        interface.load_flange(supplied_wrench(load))
        carried.compensate(scene)
        try:
            interface.step_rigid(servos(position_reference, speed_reference).row(0), log)
        except InstabilityError as error:
            raise ConvergenceError("MuJoCo warns near the present state: no linear model", 0.0, 0) from error
        accelerations = np.concatenate([scene.joint_acceleration, carried.past.ravel()])[: len(last)]
        return np.concatenate([log.joint_position[0], log.joint_velocity[0], accelerations])

    try:
        columns = [
            (state_after(start + step) - state_after(start - step)) / (2.0 * size)
            for step, size in zip(np.diag(scale), scale, strict=True)
        ]
    finally:
        scene.state = saved
        interface.figures[:] = figures
    return np.array(columns).T
