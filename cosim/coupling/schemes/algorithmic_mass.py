"""The algorithmic mass: inertia that the arm's joints carry for a soft robot that is heavy for the flange.

A small motion xi of the flange carries the film rigidly, without strain, but the film lags behind by
X = K^-1 c m E xi: K the tangent of the step, E the rigid motions of the nodes of mass m, c the weight of
inertia in the step's scheme. Within the tick the wrench on the flange changes by -c E^T m (E - X) xi; in a
slow motion it changes by -c E^T m E xi, as for a rigid body. The carried mass is

    M_a = s_0 (E^T m E - (1 - b) E^T m X),    b = min(1, 1 / r^2),

with r the stability ratio and s_0 = c h^2 the first of `reaction_weights`. With b = 1 (the whole mass) slow
motions are exact, but motion grows weakly if a soft film is heavy (r above 1.5, implicit Euler). With b = 0
it does not grow up to r = 10, but a jump of the acceleration loses the impulse of a tick. A compensating
torque cancels the carried mass at the expected acceleration, so the mass resists deviations only. A fraction
f of M_a is carried; with a_n the acceleration of the last tick:

    implicit Euler:  f = 1,              expected = a_n
    BDF2:            f = min(1, r / 2),  expected = a_n + b' (a_n - a_n-1),    b' = min(1, 1.2 / r)

A rigid load under constant acceleration moves as one body with the flange in both cases. With BDF2 the arm
feels the soft robot's wrench to second order where b' = 1, which would be unstable for a heavier soft robot.
Implicit Euler reacts one tick late; the whole mass at the last acceleration compensates for that.
Source: the amplification of a chain on a mass, in tests/coupling/test_algorithmic_mass.py.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.contact.levers import rigid_motions
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.coupling.robots.stability_ratio import IMPLICIT_EULER
from cosim.rigid.scene.coupled_scene import CoupledScene
from cosim.soft.contact.obstacle_contact import ContactPlanes


@final
@dataclass(frozen=True)
class CarriedInertia:
    """Inertia that the arm's joints carry, and the accelerations at which a torque compensates it.

    Args:
        inertia: (joints, joints) [kg m^2], algorithmic mass; zero for none.
        weights: (2,) of the last accelerations in the expected one, see `carried_fraction`.
        past: (2, joints) [rad/s^2], accelerations of the last two ticks, last first; updated while it acts.
        acts: whether the inertia is not zero.
    """

    inertia: Array
    weights: Array
    past: Array
    acts: bool

    def compensate(self, scene: CoupledScene) -> None:
        """Apply the torque that cancels the inertia at the expected acceleration."""
        if self.acts:
            self.past[1], self.past[0] = self.past[0], scene.joint_acceleration
            scene.apply_joint_torque(self.inertia @ (self.weights @ self.past))


def rigid_fraction(ratio: float) -> float:
    """Return b, the fraction of the film's lag within a tick that is carried as rigid mass.

    Args:
        ratio: r, stability ratio of the flange.
    """
    return 1.0 if ratio <= 1.0 else 1.0 / ratio**2


def carried_fraction(weights: tuple[float, ...], ratio: float) -> tuple[float, Array]:
    """Return f, the fraction of the algorithmic mass that is carried, and weights of accelerations.

    The weights (2,) are those of the last two accelerations in the expected one, last first.

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
        soft: soft robot after its step.
        origin: (3,) [m], of the flange.
        ratio: r, stability ratio of the flange.
        contact: contacts with the soft robot; None for none.
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
