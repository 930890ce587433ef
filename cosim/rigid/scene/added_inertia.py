"""Inertia that the arm and bodies on joints carry for a while, added to the joint-space mass matrix.

M + A + sum_b J_b^T D_b J_b, with A on the arm's joints, and D_b in the axes of body b, about its origin.
Unlike extra mass of the bodies it weighs nothing and knows no gyroscopic forces; unlike armature of the
joints it costs a chain no more inertia than its bodies carry.
"""

from __future__ import annotations

from typing import final

import mujoco
import numpy as np

from cosim.base.frames import Array, IntArray


@final
class AddedInertia:
    """Keeps MuJoCo's mass matrix up to date with what is carried.

    `on_arm` (joints, joints) is A, `bodies` (b,) and `inertia` (b, 6, 6) say what bodies carry.

    Args:
        model: compiled scene.
        data: its state.
        arm: degrees of freedom of the arm's joints.
    """

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, arm: slice) -> None:
        self._model, self._data = model, data
        # entries of the sparse matrix: each row holds the ancestors of its degree of freedom and itself
        self._rows: IntArray = np.repeat(np.arange(model.nv), model.M_rownnz)
        starts = np.repeat(model.M_rowadr, model.M_rownnz)
        firsts = np.repeat(np.cumsum(model.M_rownnz) - model.M_rownnz, model.M_rownnz)
        self._entries: IntArray = starts + np.arange(len(self._rows)) - firsts
        self._columns: IntArray = model.M_colind[self._entries]
        self._arm = arm
        joints = arm.stop - arm.start
        self.on_arm: Array = np.zeros((joints, joints))
        self.bodies: IntArray = np.zeros(0, np.int64)
        self.inertia: Array = np.zeros((0, 6, 6))

    def carry(self, bodies: IntArray, inertia: Array) -> None:
        """Set what bodies carry from the step in progress on.

        Args:
            bodies: (b,), on joints.
            inertia: (b, 6, 6), linear then angular, about the bodies' origins, body axes.
        """
        self.bodies, self.inertia = np.array(bodies), np.array(inertia)
        self.renew()

    def carry_on_arm(self, inertia: Array) -> None:
        """Set what the arm's joints carry (joints, joints) [kg m^2] from the step in progress on."""
        self.on_arm = np.array(inertia)
        self.renew()

    def renew(self) -> None:
        """Compute and factorise the mass matrix again, for model edits."""
        mujoco.mj_makeM(self._model, self._data)
        if self._carries:
            self._add(self.on_arm)
        mujoco.mj_factorM(self._model, self._data)

    def follow(self) -> None:
        """Add what is carried to a mass matrix that MuJoCo has computed for new positions."""
        if self._carries:
            self._add(self.on_arm)
            mujoco.mj_factorM(self._model, self._data)

    def follow_bodies(self) -> None:
        """Add what bodies carry, after a kernel has added what the arm's joints do."""
        if len(self.bodies):
            self._add(np.zeros_like(self.on_arm))
            mujoco.mj_factorM(self._model, self._data)

    def mobility(self, bodies: IntArray) -> Array:
        """Return J M^-1 J^T (6 b, 6 b) of bodies (b,) without what they carry; about origins, body axes."""
        mujoco.mj_makeM(self._model, self._data)
        mujoco.mj_factorM(self._model, self._data)
        jacobian = np.concatenate([self._jacobian(int(body)) for body in bodies])
        solved = np.empty_like(jacobian)
        mujoco.mj_solveM(self._model, self._data, solved, jacobian)
        self.follow()
        return np.asarray(jacobian @ solved.T)

    @property
    def _carries(self) -> bool:
        return len(self.bodies) > 0 or bool(np.count_nonzero(self.on_arm))

    def _add(self, on_arm: Array) -> None:
        added = np.zeros((self._model.nv, self._model.nv))
        added[self._arm, self._arm] = on_arm
        for body, inertia in zip(self.bodies, self.inertia, strict=True):
            jacobian = self._jacobian(int(body))
            added += jacobian.T @ inertia @ jacobian
        self._data.M[self._entries] += added[self._rows, self._columns]

    def _jacobian(self, body: int) -> Array:
        """Return J (6, dofs), linear then angular, at the body's origin, body axes."""
        world = np.empty((6, self._model.nv))
        mujoco.mj_jacBody(self._model, self._data, world[:3], world[3:], body)
        turn = self._data.xmat[body].reshape(3, 3)
        return np.concatenate([turn.T @ world[:3], turn.T @ world[3:]])
