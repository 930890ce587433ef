"""How bodies of a compiled scene answer impulses."""

from __future__ import annotations

import mujoco
import numpy as np

from cosim.frames import Array, IntArray


def mobility(model: mujoco.MjModel, data: mujoco.MjData, bodies: IntArray, damping: Array) -> Array:
    """Return W = J (M + D)^-1 J^T (6 b, 6 b): velocity changes of bodies (b,) per impulse on them.

    Each linear then angular, world axes, at the centre of mass; what bodies press on within the scene is not
    counted.

    Args:
        model: compiled scene.
        data: its state, positions and inertia up to date.
        bodies: (b,) indices; a massless one counts at its origin.
        damping: D (nv,), diagonal, over a step [kg m^2 or kg].
    """
    jacobian = np.zeros((6 * len(bodies), model.nv))
    for k, body in enumerate(bodies.tolist()):
        block = jacobian[6 * k : 6 * k + 6]
        mujoco.mj_jac(model, data, block[:3], block[3:], data.xipos[body], body)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    inertia.reshape(-1)[:: model.nv + 1] += damping
    return np.asarray(jacobian @ np.linalg.solve(inertia, jacobian.T))
