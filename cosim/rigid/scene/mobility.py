"""How bodies of a compiled scene answer impulses."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.linalg import lapack

from cosim.base.frames import Array, IntArray


def mobility(model: mujoco.MjModel, data: mujoco.MjData, bodies: IntArray, added: Array) -> Array:
    """Return W = J (M + D)^-1 J^T (6 b, 6 b): velocity changes of bodies (b,) per impulse on them.

    Each linear then angular, world axes, at the centre of mass; what bodies press on within the scene is not
    counted.

    Args:
        model: compiled scene.
        data: its state, positions and inertia up to date.
        bodies: (b,) indices; a massless one counts at its origin.
        added: D (nv, nv) [kg m^2 or kg]: damping over a step, less what is not to be counted in M.
    """
    jacobian = np.zeros((6 * len(bodies), model.nv))
    for k, body in enumerate(bodies.tolist()):
        block = jacobian[6 * k : 6 * k + 6]
        mujoco.mj_jac(model, data, block[:3], block[3:], data.xipos[body], body)
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    inertia += added
    _, moved, failure = lapack.dposv(inertia, jacobian.T)
    if failure:  # not positive definite; whatever comes of it
        moved = np.linalg.solve(inertia, jacobian.T)
    return np.asarray(jacobian.dot(moved))
