"""Adds inertia that the arm's joints carry to MuJoCo's joint-space mass matrix, M + A. Unlike a larger mass
of the bodies it has no weight and no gyroscopic forces.
"""

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray
from cosim.errors import InputError
from cosim.rigid.scene.arm_layout import Mounting


@final
class AddedInertia:
    """Adds the carried inertia A to MuJoCo's mass matrix.

    `on_arm` (joints, joints) is A; `square` indexes it in a matrix of all degrees of freedom.

    Args:
        model: compiled scene.
        data: its state.
        mounting: whose degrees of freedom carry the inertia.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, mounting: Mounting) -> None:
        self._model, self._data = model, data
        places = mass_places(model, mounting)
        self.square = np.ix_(*[np.arange(model.nv)[mounting.dofs]] * 2)
        self._lower = np.tril_indices(len(places))
        self._entries: IntArray = places[self._lower]
        self.on_arm: Array = np.zeros(places.shape)

    def carry_on_arm(self, inertia: Array) -> None:
        """Set A (joints, joints) [kg m^2], from the step in progress on.

        Raises:
            InputError: MuJoCo keeps only the diagonal of the mass matrix (a free body without children).
        """
        if (self._entries < 0).any():
            raise InputError(
                "the soft robot is heavy for the free body that carries it: MuJoCo keeps only the diagonal "
                "of that body's mass matrix; give the body a child before compiling, or attach to the MjSpec"
            )
        self.on_arm[:] = inertia
        mujoco.mj_makeM(self._model, self._data)
        mujoco.mj_factorM(self._model, self._data)
        self.follow()

    def follow(self, data: mujoco.MjData | None = None) -> None:
        """Add A to a mass matrix that MuJoCo has computed for new positions, and factorise it.

        Args:
            data: another state of the model; None: that of the scene.
        """
        if np.count_nonzero(self.on_arm):
            state = self._data if data is None else data
            state.M[self._entries] += self.on_arm[self._lower]
            mujoco.mj_factorM(self._model, state)


def mass_places(model: mujoco.MjModel, mounting: Mounting) -> IntArray:
    """Return the indices of M_ij, j <= i, in MuJoCo's sparse mass matrix, for the dofs of a mount (d, d).

    They are -1 for a free body without children, of which MuJoCo keeps only the diagonal.
    """
    joints = np.arange(model.nv)[mounting.dofs]
    places = np.full((len(joints), len(joints)), -1, dtype=np.int64)
    for i, dof in enumerate(joints):
        last = int(model.M_rowadr[dof] + model.M_rownnz[dof])
        if model.M_rownnz[dof] > i:
            places[i, : i + 1] = np.arange(last - i - 1, last)
    return places
