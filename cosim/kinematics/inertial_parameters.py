"""Ten numbers of a rigid body in which joint torques are linear.

    (m, m c, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz)    I about the frame's origin, not about the centre c.

Source: Siciliano et al., Robotics: Modelling, Planning and Control, 2009, section 7.2; order as in Pinocchio.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix

COUNT: Final = 10
_ROWS, _COLUMNS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])


def inertial_parameters(mass_kg: float, center: Array, inertia: Array) -> Array:
    """Return the parameters (10,) of a body.

    Args:
        mass_kg: total.
        center: (3,) [m], of mass.
        inertia: (3, 3) [kg m^2], about the centre, axes of the frame.
    """
    offset = cross_matrix(center)
    about_origin = inertia - mass_kg * offset @ offset
    return np.concatenate([[mass_kg], mass_kg * center, about_origin[_ROWS, _COLUMNS]])


def change_of_frame(frame_from_body: Pose) -> Array:
    """Return T (10, 10): parameters in a frame = T parameters in the body's own axes.

    With the second moments S = trace(I) / 2 1 - I, which are a sum of m x x^T, all moves as points do:
        [S, m c; (m c)^T, m] -> H [S, m c; (m c)^T, m] H^T,    H = [R, t; 0, 1].
    """
    homogeneous = np.eye(4)
    homogeneous[:3, :3], homogeneous[:3, 3] = frame_from_body.rotation, frame_from_body.translation
    columns = []
    for unit in np.eye(COUNT):
        moved = homogeneous @ _moments(unit) @ homogeneous.T
        second = moved[:3, :3]
        inertia = np.trace(second) * np.eye(3) - second
        columns.append(np.concatenate([[moved[3, 3]], moved[:3, 3], inertia[_ROWS, _COLUMNS]]))
    return np.stack(columns, axis=1)


def _moments(parameters: Array) -> Array:
    """Return the sum (4, 4) of m (x, 1) (x, 1)^T of a body with such parameters (10,)."""
    inertia = np.empty((3, 3))
    inertia[_ROWS, _COLUMNS] = inertia[_COLUMNS, _ROWS] = parameters[4:]
    result = np.empty((4, 4))
    result[:3, :3] = 0.5 * np.trace(inertia) * np.eye(3) - inertia
    result[:3, 3] = result[3, :3] = parameters[1:4]
    result[3, 3] = parameters[0]
    return result
