"""Distance of a flange from a position and a direction of its z axis, with its derivative; the roll about
that axis is free.
"""

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix

_LEAST_SINE = 1e-12


def axis_error(flange: Pose, jacobian: Array, target: Pose) -> tuple[Array, Array]:
    """Return e (5,) and de/dq (5, joints): displacement to the target's origin [m], turn to its z axis [rad].

    In flange axes. r = R^T (p_target - p), u = R^T z_target; the turn is about z x u / |z x u|, by the angle
    between both, so its z component is zero and left out. dr = [r]x w - v, du = [u]x w with the flange's own
    twist (v, w) = J dq.

    Args:
        flange: world_from_flange.
        jacobian: J (6, joints) of the flange, linear then angular, flange axes.
        target: world_from_flange.
    """
    r = flange.rotation.T @ (target.translation - flange.translation)
    u = flange.rotation.T @ target.rotation[:, 2]
    linear = cross_matrix(r) @ jacobian[3:] - jacobian[:3]
    change = cross_matrix(u) @ jacobian[3:]
    across, d_across = np.array([-u[1], u[0]]), np.stack([-change[1], change[0]])
    sine, cosine = float(np.hypot(*across)), float(u[2])
    if sine < _LEAST_SINE:  # along the target, or opposite to it, where any axis is valid
        turn = np.zeros(2) if cosine > 0.0 else np.array([np.pi, 0.0])
        return np.concatenate([r, turn]), np.concatenate([linear, d_across])
    angle, unit = float(np.arctan2(sine, cosine)), across / sine
    d_sine = unit @ d_across
    d_angle = cosine * d_sine - sine * change[2]
    d_unit = (d_across - np.outer(unit, d_sine)) / sine
    d_turn = np.outer(unit, d_angle) + angle * d_unit
    return np.concatenate([r, angle * unit]), np.concatenate([linear, d_turn])
