"""Leaves over loads in a scene: the power of those on bodies, and the part of a reading that they leave."""

from cosim.base.kernel_types import Indices, Matrix, Vector
from cosim.base.kernels import kernel


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
