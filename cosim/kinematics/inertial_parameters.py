"""Ten parameters of a rigid body in which joint torques are linear: (m, m c, I_xx, I_xy, I_yy, I_xz, I_yz,
I_zz), with I about the frame's origin, not about the centre c. Source: Siciliano et al., Robotics: Modelling,
Planning and Control, 2009, section 7.2; order as in Pinocchio.
"""

from typing import Final

import numpy as np
import pinocchio as pin

from cosim.base.frames import Array, Pose

COUNT: Final = 10


def inertial_parameters(mass_kg: float, center: Array, inertia: Array) -> Array:
    """Return the parameters (10,) of a body.

    Args:
        mass_kg: total.
        center: (3,) [m], of mass.
        inertia: (3, 3) [kg m^2], about the centre, axes of the frame.
    """
    return np.array(pin.Inertia(mass_kg, center, inertia).toDynamicParameters())


def change_of_frame(frame_from_body: Pose) -> Array:
    """Return T (10, 10): parameters in a frame = T parameters in the body's axes."""

    def moved(parameters: Array) -> Array:
        body = pin.Inertia.FromDynamicParameters(parameters)
        return np.array(placement(frame_from_body).act(body).toDynamicParameters())

    mass, *others = np.eye(COUNT)  # parameters without mass are moved together with a point mass
    point = moved(mass)
    return np.stack([point, *(moved(mass + other) - point for other in others)], axis=1)


def placement(pose: Pose) -> pin.SE3:
    """Return a pose as Pinocchio's placement."""
    return pin.SE3(np.array(pose.rotation), np.array(pose.translation))
