"""Rotations and quaternions, against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from cosim.base.frames import quaternion_from_rotation, quaternions_from_rotations


def test_quaternions_are_those_of_the_rotations() -> None:
    """Those of small angles, of half a turn about each axis, where each entry is the largest, and others."""
    about = [
        *np.pi * np.eye(3),
        [0.0, 0.0, 0.0],
        [1e-9, 0.0, 0.0],
        [3.0, 0.5, 0.4],
        [0.4, 3.0, -0.5],
        [0.5, -0.4, 3.0],
    ]
    turns = Rotation.concatenate(
        [Rotation.from_rotvec(about), Rotation.random(20, rng=np.random.default_rng(4))]
    )
    found = quaternions_from_rotations(turns.as_matrix())
    expected = turns.as_quat(scalar_first=True)
    # a rotation has two, of which the one with a positive real part is given
    assert np.abs(np.einsum("ki,ki->k", found, expected)) == pytest.approx(np.ones(len(found)), abs=1e-14)
    assert (found[:, 0] >= 0.0).all()
    for one, rotation in zip(found, turns.as_matrix(), strict=True):
        assert one == pytest.approx(quaternion_from_rotation(rotation), abs=1e-14)
