"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio above a bound), its algorithmic mass A = J^T M_a J rides along on the joints; A
times the acceleration at which the soft side answers as before, the last one with implicit Euler, is given
back as torque. So only a change of the answer meets A: a rigid load moves as one body with the flange.
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.

A tick is a row of length one. Kernels take rows, until the flange or bodies are to be weighed, or a soft half
is more than they know: lists of what is near serve no longer, a tangent is indefinite, gas is sealed, films
touch one another. That half is left to Python, and the row goes on.

What is carried: a small motion xi of the flange takes the film along rigidly, which strains nothing, but the
film lags behind by X = K^-1 c m E xi: K the tangent of the step, E the rigid motions of the nodes m, c the
weight of inertia in the step's scheme. Within the tick the wrench on the flange changes by
-c E^T m (E - X) xi; in a slow motion it ends up changed by -c E^T m E xi, as that of a rigid body. Carried:

    M_a = s_0 (E^T m E - (1 - b) E^T m X),    b = min(1, 1 / r^2),

r the stability ratio, s_0 = c h^2 the first of `answer_weights`. The whole mass, b = 1, leaves slow motions
as they are, but under a soft film that is heavy (r above 1.5, implicit Euler) the motion grows weakly. Under
that of the tick, b = 0, it does not up to r = 10; where the acceleration jumps, a tick's impulse is lost.
Source: the amplification of a chain on a mass, in tests/coupling/test_algorithmic_mass.py.

The automatic exchange is iterated where the staggered one would need an algorithmic mass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling.contact.added_mass import RATIO_BOUND, rigid_motions
from cosim.coupling.half_ticks import RIGID_SIDE_WARNS, SOFT_HALF_LEFT, SOFT_STEP_BEGUN
from cosim.coupling.schemes.interface import Coupling, Interface, InterfaceState
from cosim.coupling.schemes.iterated import IteratedCoupling, IteratedState, IterationOptions
from cosim.coupling.soft_halves import soft_halves
from cosim.coupling.soft_sides.soft_side import SoftSide, expecting_no_change
from cosim.coupling.ticks import CarriedInertia, Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes


def rigid_share(ratio: float) -> float:
    """Return b, how much of what the film lags behind within a tick is carried all the same.

    Args:
        ratio: r, stability ratio of the flange.
    """
    return 1.0 if ratio <= 1.0 else 1.0 / ratio**2


def algorithmic_mass(
    soft: SoftSide, origin: Array, ratio: float, contact: ContactPlanes | None, step_s: float
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
    lacking = 1.0 - rigid_share(ratio)
    if lacking > 0.0:
        rigid = rigid_motions(soft.state.positions, origin)
        momentum = np.ascontiguousarray((soft.body.node_mass[:, None, None] * rigid).transpose(2, 0, 1))
        lagging = soft.response(soft.inertia_weight(step_s) * momentum, contact, step_s)
        if lagging is not None:  # the tangent is not indefinite
            behind = lacking * np.einsum("inr,jnr->ij", momentum, lagging)
            mass -= 0.5 * (behind + behind.T)
    return np.asarray(soft.answer_weights[0] * mass)


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (k, joints) [rad/s^2], accelerations while it was carried.
    """

    interface: InterfaceState
    added: Array
    past: Array


@final
class StaggeredCoupling(Coupling):
    """Advances by one step of each side, in turn.

    Args:
        interface: between the sides.
        ratio_bound: stability ratio above which the algorithmic mass is carried.
        bodies_carry: whether bodies lighter than the film's answer carry its algorithmic mass.
    """

    def __init__(self, interface: Interface, ratio_bound: float = 0.5, *, bodies_carry: bool = True) -> None:
        super().__init__(interface)
        self._ratio_bound, self.bodies_carry = ratio_bound, bodies_carry
        joints = len(interface.scene.joint_names)
        self._added = np.zeros((joints, joints))
        self._weights = expecting_no_change(interface.soft.answer_weights)
        self._past = np.zeros((len(self._weights), joints))
        self._carries = False
        self._halves = soft_halves(interface)

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        self.interface.scene.check()
        count = min(len(loads), self._halves.most)
        taken = self.interface.begin(count)
        try:
            while taken.done < count:
                self._go_on(taken, servos.some(taken.done, count), loads[taken.done : count])
        except BaseException as error:  # whatever it is, what has been taken is to be shown first
            if not taken.done:
                raise
            taken.error = error
        self._halves.end(taken)
        return taken

    def _go_on(self, taken: TicksTaken, servos: Servos, loads: Sequence[Loads]) -> None:
        """Take ticks until flange or bodies are to be weighed again, or Python has taken a soft half."""
        interface, first = self.interface, taken.done
        if interface.to_be_weighed:
            self._update_stability_ratio()
        most = interface.ticks_to_weighing
        taken.algorithmic_mass[first : first + most] = self._carries
        joints = len(self._added) if self._carries else 0
        carried = CarriedInertia(self._added[:joints, :joints].copy(), self._weights, self._past)
        done, ending = self._halves.take(interface.rigid(carried), servos.some(0, most), loads[:most], taken)
        if done:
            interface.follow(taken, done)
            self._weigh_bodies(taken)
        if ending == RIGID_SIDE_WARNS:
            interface.scene.check()
        if ending not in (SOFT_HALF_LEFT, SOFT_STEP_BEGUN):
            return
        self._halves.end(taken)
        interface.scene.stepped(taken.ticks.flange(taken.done))
        interface.take_reply(taken, interface.advance_soft(loads[done]))
        self._weigh_bodies(taken)

    def _weigh_bodies(self, taken: TicksTaken) -> None:
        """Bring what bodies carry up to date after the last tick."""
        interface = self.interface
        if interface.body_mass is not None:
            interface.body_mass.update(carry=self.bodies_carry)
            taken.ticks.contact[taken.done - 1, 2] = interface.contact_ratio

    def save_state(self) -> StaggeredState:
        return StaggeredState(self.interface.save_state(), self._added, self._past.copy())

    def restore_state(self, state: StaggeredState) -> None:
        self.interface.restore_state(state.interface)
        self._added, self._carries = state.added, bool(state.added.any())
        self._past[:] = state.past

    def _update_stability_ratio(self) -> None:
        """Bring the stability ratio, and with it the carried algorithmic mass, up to date."""
        interface, scene = self.interface, self.interface.scene
        interface.update_stability_ratio()
        carries, added = interface.ratio > self._ratio_bound, np.zeros_like(self._added)
        if carries:
            contact = None if interface.contact is None else interface.contact.planes
            origin, jacobian = scene.flange_pose.translation, scene.flange.jacobian()
            mass = algorithmic_mass(interface.soft, origin, interface.ratio, contact, scene.tick_s)
            added = jacobian.T @ mass @ jacobian
        if carries or self._carries:
            scene.bodies.carried.carry_on_arm(added)
        if carries and not self._carries:
            self._past[:] = scene.joint_acceleration
        if self._carries and not carries:
            scene.apply_joint_torque(np.zeros(len(added)))
        self._added, self._carries = added, carries


_FLANGE_RATIO_BOUND = 0.5  # of the stability ratio, above which ticks are iterated


@final
@dataclass(frozen=True)
class AutomaticState:
    """Where an `AutomaticCoupling` is.

    Args:
        iterated: its iterated scheme; the staggered one has no state of its own, as it carries no mass.
        iterates: whether the last tick was iterated.
    """

    iterated: IteratedState
    iterates: bool


@final
class AutomaticCoupling(Coupling):
    """Decides before every tick, by the stability ratios of flange and touched bodies.

    Args:
        interface: between the sides.
        options: when the iterated scheme's loads agree.
    """

    def __init__(self, interface: Interface, options: IterationOptions | None = None) -> None:
        super().__init__(interface)
        self._staggered = StaggeredCoupling(interface, np.inf, bodies_carry=False)
        self._iterated = IteratedCoupling(interface, options)
        self._iterates = False

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        interface = self.interface
        if interface.to_be_weighed:
            interface.update_stability_ratio()
        iterates = interface.ratio > _FLANGE_RATIO_BOUND or interface.contact_ratio > RATIO_BOUND
        if iterates and not self._iterates:
            self._iterated.begin_again()
        self._iterates = iterates
        return (self._iterated if iterates else self._staggered).advance(servos.some(0, 1), loads[:1])

    def save_state(self) -> AutomaticState:
        return AutomaticState(self._iterated.save_state(), self._iterates)

    def restore_state(self, state: AutomaticState) -> None:
        self._iterated.restore_state(state.iterated)
        self._iterates = state.iterates
