"""Response of bodies to impulses: Jacobians, the mobility W = J (M + D)^-1 J^T, and the stiffness of active
constraints.
"""

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray


def jacobian_of(model: mujoco.MjModel, data: mujoco.MjData, bodies: IntArray) -> Array:
    """Return J (6 b, nv) of bodies (b,): linear then angular, world axes, at the centre of mass.

    For a massless body that is at its origin.
    """
    jacobian = np.zeros((6 * len(bodies), model.nv))
    for k, body in enumerate(bodies.tolist()):
        block = jacobian[6 * k : 6 * k + 6]
        mujoco.mj_jac(model, data, block[:3], block[3:], data.xipos[body], body)
    return jacobian


def mobility(model: mujoco.MjModel, data: mujoco.MjData, jacobian: Array, added: Array) -> Array:
    """Return W = J (M + D)^-1 J^T (k, k): velocity changes per impulse, without contacts in the scene.

    Args:
        model: compiled scene.
        data: its state, with positions and inertia up to date.
        jacobian: J (k, nv).
        added: D (nv, nv) [kg m^2 or kg], such as damping over a step.
    """
    from scipy.linalg import lapack  # imported here because it takes long to load

    if not model.nv:
        return np.zeros((len(jacobian), len(jacobian)))
    inertia = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    inertia += added
    _, moved, failure = lapack.dposv(inertia, jacobian.T)
    if failure:  # not positive definite
        moved = np.linalg.solve(inertia, jacobian.T)
    return np.asarray(jacobian.dot(moved))


def active_constraints(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return J^T D J (nv, nv) of the active constraints; forces must be up to date.

    Tangential directions of a sliding contact are left out.
    """
    jacobian = np.empty((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(jacobian, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr, data.efc_J_colind)
    else:
        jacobian[:] = data.efc_J.reshape(data.nefc, model.nv)
    state, kind = data.efc_state, data.efc_type
    acts = state == mujoco.mjtConstraintState.mjCNSTRSTATE_QUADRATIC
    slides = state == mujoco.mjtConstraintState.mjCNSTRSTATE_CONE
    first = np.concatenate([[True], np.diff(data.efc_id) != 0]) | np.append(True, np.diff(kind) != 0)
    acts |= slides & first  # a contact's rows follow its normal one
    rows = jacobian[acts]
    return np.asarray((rows.T * data.efc_D[acts]) @ rows)
