"""The serial staggered exchange: one MuJoCo step with the last wrench, one soft step with the new pose.

Per tick: the wrench of the tick before acts on the flange while MuJoCo steps; the soft side then takes
one implicit step with the flange's new pose and returns the next wrench. Where the soft side is heavy for
the flange (stability ratio r above a bound), a share of its algorithmic mass A = J^T M_a J rides along on the
joints. What it takes at the expected acceleration is given back as torque.
Where the scene can be touched, contacts are found between the two steps, and act on bodies one tick later.

Fine ticks: a tick of the clock in which something light is hit or thrown, as several exchanges.

Where the film comes on to a body that can move, or takes one along on the flange, by more than a bound in a
tick, a step of that length has the body fly past what it would meet. Such a tick is taken in as many pieces
as MuJoCo takes steps in it, each an exchange with one step of either side. The film's first step of another
length is one of implicit Euler; after the last piece it looks back over a whole tick again. Each change
shakes the film, and a light body turns back within one tick, slow at its end while its load is largest. So
ticks stay fine until several in a row have been calm.

Servos and loads continue within the tick. What is shown of it belongs to its end, but for sums of work and
iterations, and means of power and of what acts on bodies. What is left at the end of a piece acts through the
next one, or the next whole tick.

The algorithmic mass: what the joints carry of a soft side that is heavy for the flange.

What is carried: a small motion xi of the flange takes the film along rigidly, which strains nothing, but the
film lags behind by X = K^-1 c m E xi: K the tangent of the step, E the rigid motions of the nodes m, c the
weight of inertia in the step's scheme. Within the tick the wrench on the flange changes by
-c E^T m (E - X) xi; in a slow motion it ends up changed by -c E^T m E xi, as that of a rigid body. Carried:

    M_a = s_0 (E^T m E - (1 - b) E^T m X),    b = min(1, 1 / r^2),

r the stability ratio, s_0 = c h^2 the first of `answer_weights`. The whole mass, b = 1, leaves slow motions
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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array
from cosim.coupling import half_ticks
from cosim.coupling.contact.levers import rigid_motions
from cosim.coupling.schemes.interface import Coupling, Interface, InterfaceState
from cosim.coupling.schemes.ledger import TickPieces
from cosim.coupling.soft_sides import lumped_arm, soft_side
from cosim.coupling.ticks import CarriedInertia, Servos, TicksTaken
from cosim.errors import InstabilityError
from cosim.rigid.scene.scene import RigidScene
from cosim.soft.body.loads import Loads
from cosim.soft.contact.obstacle_contact import ContactPlanes

_FAR_M: Final = 3e-4  # way in a tick of the clock from which on it is a fine one
_SETTLED: Final = 0.5  # share of it below which a tick is calm
_CALM_TICKS: Final = 10  # of such in a row, after which ticks are whole again
_TICKS_MAX: Final = 64  # in one call


@final
class FineTicks:
    """Takes ticks of the clock in pieces while what the film touches moves far in one.

    `left` says how many ticks from the next one on are such ones at least.

    Args:
        interface: between the sides.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface, self.left = interface, 0
        scene = interface.scene
        known = interface.contact is not None and scene.substeps > 1
        self._fast_m_s = _FAR_M / scene.tick_s if known else np.inf

    @property
    def fast_m_s(self) -> float:
        """Speed from which on ticks are fine ones; endless where no film is stepped."""
        soft = self._interface.soft
        return self._fast_m_s if isinstance(soft, lumped_arm.SoftArm) else np.inf

    def look(self) -> None:
        """Decide on the next tick, after one."""
        interface = self._interface
        if self.fast_m_s < np.inf and interface.contact is not None:
            bound = (_SETTLED if self.left else 1.0) * self.fast_m_s
            moves = interface.contact.fastest_m_s(interface.soft.state) > bound
            self._go(_CALM_TICKS if moves else max(0, self.left - 1))

    def restore(self, left: int) -> None:
        """Be where a saved state was, whose scene and soft side have been restored before."""
        interface, self.left = self._interface, left
        scene = interface.scene
        scene.go_finely(scene.substeps if left else None)
        if interface.light is not None:
            interface.light.begin_ticks_of(scene.tick_s)

    def take(self, rigid: half_ticks.RigidSide, servos: Servos, loads: Loads, taken: TicksTaken) -> None:
        """Take one tick of the clock.

        Args:
            rigid: side.
            servos: what they are asked for in it.
            loads: on the soft body at its end.
            taken: its row is filled.
        """
        interface = self._interface
        scene, soft = interface.scene, interface.soft
        assert isinstance(soft, lumped_arm.SoftArm), "no other soft side takes fine ticks"
        count, ticks, begin, before = scene.substeps, interface.ticks, soft.loads, soft.state
        fine, shapes = interface.begin(count), []
        for k in range(count):
            scene.go_finely(count - k)
            asked = servos._replace(position=servos.position + k * scene.tick_s * servos.velocity)
            interface.step_rigid(rigid, asked, fine)
            reply = interface.advance_soft(begin.interpolated(loads, (k + 1) / count))
            interface.take_reply(fine, reply)
            shapes.append(soft.state.positions)
        taken.pieces[taken.done] = TickPieces(np.array(shapes), fine.ticks.twist, fine.ticks.origin[1:])
        self._condense(fine, taken)
        interface.ticks = ticks + 1
        self.look()
        if not self.left:  # the next one looks back over this one
            soft.state = replace(soft.state, earlier=(before.positions, before.velocities))

    def _go(self, left: int) -> None:
        if bool(left) == bool(self.left):
            self.left = left
            return
        self.restore(left)
        self._interface.soft.restart()

    def _condense(self, fine: TicksTaken, taken: TicksTaken) -> None:
        """Fill the row of the tick in progress with what its pieces have left."""
        k, to, of, soft = taken.done, taken.ticks, fine.ticks, self._interface.soft
        for name in ("figures", "origin", "axes", "handed"):
            getattr(to, name)[k + 1] = getattr(of, name)[-1]
        for name in ("twist", "joints", "joint_speed", "servo_torque", "places", "quaternions", "residual",
                     "contacts", "contact", "self_contact"):  # fmt: skip
            getattr(to, name)[k] = getattr(of, name)[-1]
        to.touch[k], to.mounted[k] = of.touch[-1], of.mounted.mean(0)
        to.touch[k, :, 0] = of.touch[:, :, 0].mean(0)
        to.momentum_error[k], to.iterations[k] = of.momentum_error.max(), of.iterations.sum()
        to.power[k], to.work[k], to.body_force[k] = of.power.mean(0), of.work.sum(0), of.body_force.mean(0)
        to.contact[k, 0] = of.contact[:, 0].mean()
        to.hit[k] = max(of.hit.tolist(), key=lambda hit: hit[0] / hit[1] if hit[2] >= 0 else 0.0)
        taken.pressure_Pa[k], taken.stability_ratio[k] = fine.pressure_Pa[-1], fine.stability_ratio[-1]
        taken.parts.append([soft.shape_now()])
        taken.done += 1


def rigid_share(ratio: float) -> float:
    """Return b, how much of what the film lags behind within a tick is carried all the same.

    Args:
        ratio: r, stability ratio of the flange.
    """
    return 1.0 if ratio <= 1.0 else 1.0 / ratio**2


def riding_along(weights: tuple[float, ...], ratio: float) -> tuple[float, Array]:
    """Return the share of the algorithmic mass that rides along, and what of it is given back.

    The latter are the weights (2,) of the last accelerations in the expected one, last first.

    Args:
        weights: s, of `answer_weights`.
        ratio: r, stability ratio of the flange.
    """
    if weights == soft_side.IMPLICIT_EULER:
        return 1.0, np.array([1.0, 0.0])
    change = 1.2 / max(ratio, 1.2)
    return min(1.0, 0.5 * ratio), np.array([1.0 + change, -change])


def algorithmic_mass(
    soft: soft_side.SoftSide, origin: Array, ratio: float, contact: ContactPlanes | None, step_s: float
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


_NOTHING_GIVEN_BACK: Final = np.zeros(2)


@final
@dataclass(frozen=True)
class StaggeredState:
    """Where a `StaggeredCoupling` is.

    Args:
        interface: what it acts on.
        added: (joints, joints) [kg m^2], carried algorithmic mass.
        past: (2, joints) [rad/s^2], accelerations while it was carried.
        fine: how many ticks from the next one on are fine ones at least.
    """

    interface: InterfaceState
    added: Array
    past: Array
    fine: int


@final
class StaggeredCoupling(Coupling):
    """Advances by one step of each side, in turn.

    Args:
        interface: between the sides.
        ratio_bound: stability ratio above which the algorithmic mass is carried.
    """

    def __init__(self, interface: Interface, ratio_bound: float = 0.5) -> None:
        super().__init__(interface)
        self._ratio_bound = ratio_bound
        joints = len(interface.scene.joint_acceleration)
        self._added = np.zeros((joints, joints))
        self._past = np.zeros((2, joints))
        self._carries = False
        self._fine = FineTicks(interface)
        self._begun: TicksTaken | None = None

    def begin(self) -> None:
        """Load the rigid side for a tick whose rigid step somebody else takes; then comes `advance`."""
        taken = self._begun = self._room(1)
        self._update_when_due()
        half_ticks.load_rigid_side(self._rigid(), taken.ticks, 0)

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        begun, self._begun = self._begun, None
        taken = self._room(len(loads)) if begun is None else begun
        try:
            for k in range(len(taken.trials)):
                if begun is None:
                    self._update_when_due()
                taken.algorithmic_mass[k] = self._carries
                with self.interface.soft.work:
                    self._tick(servos.some(k, k + 1), loads[k], taken)
        except BaseException as error:  # whatever it is, the ticks before it are to be shown first
            self._advise(error)
            if not taken.done:
                raise
            taken.error = error
        return taken

    def _tick(self, servos: Servos, loads: Loads, taken: TicksTaken) -> None:
        """Take one tick of the clock: the rigid step under the last wrench, then the soft step."""
        if self._fine.left:
            self._fine.take(self._rigid(), servos, loads, taken)
            return
        interface = self.interface
        interface.step_rigid(self._rigid(), servos, taken)
        interface.take_reply(taken, interface.advance_soft(loads))
        self._fine.look()

    def _advise(self, error: BaseException) -> None:
        """Add to an instability the scheme that helps where the soft robot is heavy for the arm."""
        ratio, scene = self.interface.ratio, self.interface.scene
        own = isinstance(scene, RigidScene)  # scenes that cosim does not step alone cannot repeat a tick
        if own and ratio > self._ratio_bound and isinstance(error, InstabilityError):
            error.args = (
                f"{error} The soft robot is heavy for the arm (stability ratio {ratio:.2g}): set "
                "coupling.scheme = 'iterated'.",
            )

    def _room(self, count: int) -> TicksTaken:
        """Return room for some of so many ticks, with the state before the first of them."""
        self.interface.scene.check()
        return self.interface.begin(min(count, _TICKS_MAX))

    def _update_when_due(self) -> None:
        if self.interface.ratio_is_due:
            self._update_stability_ratio()

    def _rigid(self) -> half_ticks.RigidSide:
        """Return the rigid side with the inertia that the joints carry until the ratio is due again."""
        joints = len(self._added) if self._carries else 0
        carried = CarriedInertia(self._added[:joints, :joints].copy(), self._given_back, self._past)
        return self.interface.rigid(carried)

    def carried(self) -> CarriedInertia:
        """Return a copy of what rides on the joints."""
        added = self._added if self._carries else np.zeros((0, 0))
        return CarriedInertia(added.copy(), self._given_back, self._past.copy())

    @property
    def _given_back(self) -> Array:
        if not self._carries:
            return _NOTHING_GIVEN_BACK
        return riding_along(self.interface.soft.answer_weights, self.interface.ratio)[1]

    @property
    def fine(self) -> FineTicks:
        """What takes ticks in pieces."""
        return self._fine

    def save_state(self) -> StaggeredState:
        return StaggeredState(self.interface.save_state(), self._added, self._past.copy(), self._fine.left)

    def restore_state(self, state: StaggeredState) -> None:
        self._begun = None
        self._fine.restore(state.fine)
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
            share, _ = riding_along(interface.soft.answer_weights, interface.ratio)
            added = share * (jacobian.T @ mass @ jacobian)
        if carries or self._carries:
            scene.bodies.carried.carry_on_arm(added)
        if carries and not self._carries:
            self._past[:] = scene.joint_acceleration
        if self._carries and not carries:
            scene.apply_joint_torque(np.zeros(len(added)))
        self._added, self._carries = added, carries
