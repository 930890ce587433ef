"""Kernels for loads in a scene: torques of servos, power on bodies, and the flange sensor's reading without
the soft robot's load.
"""

from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import kernel


@kernel
def near_limit(asked: Vector, carried: Vector, acceleration: Vector, limit: Vector) -> bool:
    """Return whether any servo may exceed its torque limit, see `ArmServos`.

    Args:
        asked: u (joints,) [N m], at the speed at which a step begins.
        carried: h K (joints,) [kg m^2].
        acceleration: a (joints,) [rad/s^2].
        limit: (joints,) [N m].
    """
    near = False
    for j in range(asked.shape[0]):
        near = near or abs(asked[j]) + carried[j] * abs(acceleration[j]) > limit[j]
    return near


@kernel
def fill_servo_torque(
    asked: Vector, damping: Vector, speed: Vector, began: Vector, limit: Vector, torque: Vector
) -> None:
    """Fill the torques u - K (v_end - v_begin) of servos over a step, within their limits.

    Args:
        asked: u (joints,) [N m].
        damping: K (joints,) [N m s/rad].
        speed: (joints,) [rad/s], at the end of the step.
        began: (joints,) [rad/s], at its beginning.
        limit: (joints,) [N m].
        torque: (joints,) [N m], filled.
    """
    for j in range(asked.shape[0]):
        given = asked[j] - damping[j] * (speed[j] - began[j])
        torque[j] = min(max(given, -limit[j]), limit[j])


@kernel
def power_on_bodies(
    loads: Matrix, loaded: Indices, spin: Matrix, tree: Matrix, root: Indices, center: Matrix
) -> float:
    """Return the power [W] of the loads on some bodies.

    Args:
        loads: (bodies, 6) [N, N m], about centres of mass, world axes.
        loaded: (bodies,), 1 for bodies whose loads are summed.
        spin: (bodies, 6) [rad/s, m/s], angular then linear velocity, at `tree`.
        tree: (bodies, 3) [m], centres of mass of trees of bodies, world.
        root: (bodies,), the tree of each body.
        center: (bodies, 3) [m], centres of mass of bodies, world.
    """
    power = 0.0
    for b in range(loaded.shape[0]):
        if loaded[b] != 0:
            at = root[b]
            for r in range(3):
                s, q = (r + 1) % 3, (r + 2) % 3
                arm_s, arm_q = center[b, s] - tree[at, s], center[b, q] - tree[at, q]
                speed = spin[b, 3 + r] + spin[b, s] * arm_q - spin[b, q] * arm_s
                power += loads[b, r] * speed + loads[b, 3 + r] * spin[b, r]
    return power


@kernel
def add_mounted(
    load: Vector, axes: Matrix, force: Vector, torque: Vector, fraction: float, mounted: Vector
) -> None:
    """Add to mounted (6,) the part of a flange sensor's reading that a load on the flange does not explain.

    Args:
        load: (6,) [N, N m], on the flange at its origin, world axes.
        axes: (3, 3), world from flange, at the sensor's reading.
        force: (3,) [N], of the arm on the flange, flange axes.
        torque: (3,) [N m], of the arm on the flange, flange axes.
        fraction: length of the step over that of the tick.
        mounted: (6,) [N, N m], world axes; the mean over the tick is accumulated.
    """
    for r in range(3):
        mounted[r] -= fraction * load[r]
        mounted[3 + r] -= fraction * load[3 + r]
        for c in range(3):
            mounted[r] -= fraction * axes[r, c] * force[c]
            mounted[3 + r] -= fraction * axes[r, c] * torque[c]
