"""The algorithmic mass: what the joints carry of a soft side that is heavy for the flange.

What is carried: a small motion xi of the flange takes the film along rigidly, which strains nothing, but the
film lags behind by X = K^-1 c m E xi: K the tangent of the step, E the rigid motions of the nodes m, c the
weight of inertia in the step's scheme. Within the tick the wrench on the flange changes by
-c E^T m (E - X) xi; in a slow motion it ends up changed by -c E^T m E xi, as that of a rigid body. Carried:

    M_a = s_0 (E^T m E - (1 - b) E^T m X),    b = min(1, 1 / r^2),

r the stability ratio, s_0 = c h^2 the first of `reaction_weights`. The whole mass, b = 1, leaves slow motions
as they are, but under a soft film that is heavy (r above 1.5, implicit Euler) the motion grows weakly. Under
that of the tick, b = 0, it does not up to r = 10; where the acceleration jumps, a tick's impulse is lost.

What the mass takes at the expected acceleration is given back as torque, so that only the unexpected meets
it. With a the accelerations of the last ticks:

    implicit Euler:  share = 1,              expected = a_n
    BDF2:            share = min(1, r / 2),  expected = a_n + b' (a_n - a_n-1),    b' = min(1, 1.2 / r)

A rigid load that is accelerated evenly moves as one body with the flange in any case. With BDF2 the arm feels
the soft side's own wrench to second order where b' = 1; under a heavier soft side that would grow. Implicit
Euler answers a tick late by itself: its whole mass at the last acceleration makes up for that.

Source: the amplification of a chain on a mass, in tests/coupling/test_algorithmic_mass.py.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.contact.levers import rigid_motions
from cosim.coupling.robots.soft_robot import IMPLICIT_EULER, SoftRobot
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.soft.contact.obstacle_contact import ContactPlanes


@final
@dataclass(frozen=True)
class CarriedInertia:
    """Inertia that rides on the arm's joints, and the accelerations by which it is given back.

    Args:
        inertia: (joints, joints) [kg m^2], algorithmic mass; zero for none.
        weights: (2,) of the last accelerations, see `carried_fraction`.
        past: (2, joints) [rad/s^2], of the last tick and the one before; kept up to date while it acts.
        acts: whether there is any.
    """

    inertia: Array
    weights: Array
    past: Array
    acts: bool

    def compensate(self, scene: CoupledScene) -> None:
        """Give back as torque what the inertia takes as long as the soft side answers as before."""
        if self.acts:
            self.past[1], self.past[0] = self.past[0], scene.joint_acceleration
            scene.apply_joint_torque(self.inertia @ (self.weights @ self.past))


def rigid_fraction(ratio: float) -> float:
    """Return b, how much of what the film lags behind within a tick is carried all the same.

    Args:
        ratio: r, stability ratio of the flange.
    """
    return 1.0 if ratio <= 1.0 else 1.0 / ratio**2


def carried_fraction(weights: tuple[float, ...], ratio: float) -> tuple[float, Array]:
    """Return the share of the algorithmic mass that rides along, and what of it is given back.

    The latter are the weights (2,) of the last accelerations in the expected one, last first.

    Args:
        weights: s, of `reaction_weights`.
        ratio: r, stability ratio of the flange.
    """
    if weights == IMPLICIT_EULER:
        return 1.0, np.array([1.0, 0.0])
    change = 1.2 / max(ratio, 1.2)
    return min(1.0, 0.5 * ratio), np.array([1.0 + change, -change])


def algorithmic_mass(
    soft: SoftRobot, origin: Array, ratio: float, contact: ContactPlanes | None, step_s: float
) -> Array:
    """Return M_a (6, 6), linear then angular, about a point, world axes.

    Args:
        soft: after its step.
        origin: (3,) [m], of the flange.
        ratio: r, stability ratio of the flange.
        contact: with the body; None for none.
        step_s: h [s].
    """
    mass = soft.mass_properties().spatial(origin)
    lacking = 1.0 - rigid_fraction(ratio)
    if lacking > 0.0:
        rigid = rigid_motions(soft.state.positions, origin)
        momentum = np.ascontiguousarray((soft.body.node_mass[:, None, None] * rigid).transpose(2, 0, 1))
        lagging = soft.response(soft.inertia_weight(step_s) * momentum, contact, step_s)
        if lagging is not None:  # the tangent is not indefinite
            behind = lacking * np.einsum("inr,jnr->ij", momentum, lagging)
            mass -= 0.5 * (behind + behind.T)
    return np.asarray(soft.reaction_weights[0] * mass)
