"""Leaves over loads in a scene: of servos, on bodies, and the part of a reading that they leave."""

from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import kernel


@kernel
def near_limit(asked: Vector, carried: Vector, acceleration: Vector, limit: Vector) -> bool:
    """Return whether any servo may give more torque than its joint bears, see `ArmServos`.

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
        loaded: (bodies,), 1 for those that count.
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
    load: Vector, axes: Matrix, force: Vector, torque: Vector, share: float, mounted: Vector
) -> None:
    """Add to mounted (6,) a share of what a flange's sensor shows beyond a load on the flange.

    Args:
        load: (6,) [N, N m], on the flange at its origin, world axes.
        axes: (3, 3), world from flange, as the sensor was read.
        force: (3,) [N], and
        torque: (3,) [N m], that the arm exerts on the flange, flange axes.
        share: of the step in a tick.
        mounted: filled, world axes.
    """
    for r in range(3):
        mounted[r] -= share * load[r]
        mounted[3 + r] -= share * load[3 + r]
        for c in range(3):
            mounted[r] -= share * axes[r, c] * force[c]
            mounted[3 + r] -= share * axes[r, c] * torque[c]
