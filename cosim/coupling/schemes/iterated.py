"""The iterated exchange: a tick is repeated until the loads that act on the rigid side are the soft side's.

Unknown l: the loads on the flange, and on all bodies that can be touched and can move, at the end of the
tick. One trial, from the start of the tick: MuJoCo steps under l, contacts are found at the new poses, the
soft side steps with the new pose of the flange and answers with the loads g(l). The root of
r(l) = g(l) + u - l, u what the tick before left over (so no impulse is lost), is found by quasi-Newton steps.
They begin with the inverse -(1 + h^2 S W)^-1: S how the soft side's loads answer motion, W the mobility of
flange and bodies. It is kept from tick to tick, and made anew where bodies are touched. No algorithmic mass
is carried: at the root, this is implicit Euler for both sides together.

Quasi-Newton: with the pairs (dl, dr) of the present tick as columns of L and V, and H the approximate inverse
of dr/dl at its start, the inverse is H + (L - H V) V^+ (V^+: least squares), and the step is -(that) r.
Sources: Degroote, Bathe, Vierendeels, Computers and Structures 87 (2009) 793 (IQN-ILS);
Bogaers, Kok, Reddy, Franz, CMAME 279 (2014) 113 (the inverse is kept: MVQN).

S: a small motion xi of the bodies moves their contact points by G xi and loads the film with P xi,
P = W^T C G (W: weights of the contact points, C: stiffness of each contact). The film follows by
X = K^-1 P, K the tangent of the step. What the film answers on the bodies is -(G^T C G - P^T X) xi; what
of it arrives at the flange is, by the balance of the whole film, E^T (P - W^T C W X - c m X) xi, E its
rigid motions, c the weight of inertia in the step's scheme: 1 / h^2 with implicit Euler, 9 / (4 h^2) with
BDF2, damping besides. The flange's own part is that of a rigid soft side, c E^T m E.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np

from cosim.base.frames import Array, IntArray, SixNumbers, Wrench, cross
from cosim.coupling.contact.added_mass import rigid_motions, spread
from cosim.coupling.contact.contact_exchange import ContactExchange
from cosim.coupling.half_ticks import LEVER_M, take_rigid_half
from cosim.coupling.schemes.interface import (
    Coupling,
    Interface,
    InterfaceState,
    received_bodies,
    received_flange,
    six_numbers,
)
from cosim.coupling.soft_sides.soft_side import SoftReply, SoftSide
from cosim.coupling.ticks import CarriedInertia, Servos
from cosim.coupling.ticks_taken import TicksTaken
from cosim.errors import ConvergenceError, SolverError
from cosim.reduced.sections.assembly import CENTER, WRENCH
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import StepAim

_INDEPENDENT = 1e-8  # singular values of V, over the largest, below which secants say nothing
_LEARNT = 1e-6  # secants below this share of the interface's load are rounding, and are not kept


@final
class QuasiNewton:
    """Steps towards the root; all vectors are in comparable units.

    Args:
        inverse: (n, n), approximate inverse of dr/dl.
    """

    def __init__(self, inverse: Array) -> None:
        self._inverse = np.array(inverse)
        self._loads: list[Array] = []
        self._residuals: list[Array] = []

    def step(self, load: Array, residual: Array) -> Array:
        """Take in r (n,) at l (n,), and return the step (n,) to where the root should be."""
        self._loads.append(load)
        self._residuals.append(residual)
        return -(self._updated(0.0) @ residual)

    def inverse(self, scale: float) -> Array:
        """Return the inverse (n, n) with what was learnt, above the rounding of loads of a size."""
        return self._updated(_LEARNT * scale)

    def _updated(self, smallest: float) -> Array:
        moved = np.diff(np.array(self._loads), axis=0).T if len(self._loads) > 1 else None
        if moved is None:
            return self._inverse
        changed = np.diff(np.array(self._residuals), axis=0).T
        length = np.linalg.norm(changed, axis=0)
        kept = length > max(smallest, 1e-300)
        if not kept.any():
            return self._inverse
        # of unit length: a late, short secant counts as much as an early one
        moved, changed = moved[:, kept] / length[kept], changed[:, kept] / length[kept]
        solved = np.linalg.pinv(changed, rcond=_INDEPENDENT)
        return np.asarray(self._inverse + (moved - self._inverse @ changed) @ solved)


UNIT = np.array([1.0, 1.0, 1.0, LEVER_M, LEVER_M, LEVER_M])


@final
class InterfaceLoads:
    """Reads and writes the loads of an interface, about points that stay where they were when a tick began.

    A vector holds (force, torque / lever), world axes, of the flange about its origin, then of each body that
    can be touched and can move about its centre of mass. `points` (1 + b, 3) [m] are those places.

    Args:
        interface: between the sides.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface = interface
        bodies, contact = interface.scene.bodies, interface.contact
        touchable = np.zeros(0, np.int64) if contact is None else np.unique(contact.query.body)
        self.bodies = touchable[bodies.movable(touchable)]
        self.points = np.zeros((1 + len(self.bodies), 3))

    def __len__(self) -> int:
        return 6 * len(self.points)

    def begin(self) -> None:
        """Take the present places as points of reference."""
        scene = self._interface.scene
        self.points[0] = scene.flange_pose.translation
        self.points[1:] = scene.bodies.centers(self.bodies)

    def answered(self) -> Array:
        """Return the loads (n,) with which the soft side has answered in its last step."""
        loads = np.zeros((1 + len(self.bodies), 6))
        origin = self._interface.scene.flange_pose.translation
        wrench = self._interface.wrench.moved(self.points[0] - origin)
        loads[0, :3], loads[0, 3:] = wrench.force, wrench.torque
        touched = self._interface.touched
        if len(touched.bodies):
            mine = np.isin(touched.bodies, self.bodies)
            place = 1 + np.searchsorted(self.bodies, touched.bodies[mine])
            loads[place, :3] = touched.force[mine]
            loads[place, 3:] = touched.torque[mine] - cross(self.points[place], touched.force[mine])
        return np.asarray((loads / UNIT).reshape(-1))

    def apply(self, vector: Array) -> None:
        """Let loads (n,) act on the rigid side in the step in progress."""
        scene, loads = self._interface.scene, UNIT * vector.reshape(-1, 6)
        scene.apply_flange_wrench(Wrench(loads[0, :3], loads[0, 3:]))
        world = self.about_world(vector)[1:]
        scene.bodies.apply(self.bodies, world[:, :3], world[:, 3:])

    def flange_wrench(self, vector: Array) -> Wrench:
        """Return what of loads (n,) acts on the flange, at its present origin, world axes."""
        wrench = Wrench(vector[:3], LEVER_M * vector[3:6])
        return wrench.moved(self._interface.scene.flange_pose.translation - self.points[0])

    def about_world(self, vector: Array) -> Array:
        """Return loads (n,) as (1 + b, 6): forces, and torques about the world's origin."""
        loads = UNIT * vector.reshape(-1, 6)
        loads[:, 3:] += cross(self.points, loads[:, :3])
        return np.asarray(loads)

    def from_world(self, loads: Array) -> Array:
        """Return the vector (n,) of loads (1 + b, 6) about the world's origin."""
        moved = np.array(loads)
        moved[:, 3:] -= cross(self.points, moved[:, :3])
        return np.asarray((moved / UNIT).reshape(-1))

    def held_fast(self) -> Array:
        """Return the load (6,) on touched bodies that cannot move, about the world's origin."""
        touched = self._interface.touched
        fast = ~np.isin(touched.bodies, self.bodies)
        return np.concatenate([touched.force[fast].sum(axis=0), touched.torque[fast].sum(axis=0)])


def contact_tangent(
    exchange: ContactExchange, soft: SoftSide, bodies: IntArray, points: Array, step_s: float
) -> Array | None:
    """Return S (6 + 6 b, 6 + 6 b) with change of loads = -S xi, the flange's own block left zero.

    Args:
        exchange: with the planes of the step just taken.
        soft: after that step.
        bodies: (b,) that can move.
        points: (1 + b, 3) [m], that wrenches are about: of the flange, then of each body.
        step_s: h [s].

    Returns:
        None where nothing that can move is touched, or the soft side's tangent is indefinite.
    """
    planes, x = exchange.planes, soft.state.positions
    if planes is None:
        return None
    owner = planes.body
    stiffness = planes.stiffnesses(x)
    mine = np.flatnonzero(np.isin(owner, bodies) & (np.abs(stiffness).max(axis=(1, 2), initial=0.0) > 0.0))
    if not len(mine):
        return None
    nodes, weights = planes.nodes[mine], planes.weights[mine]
    point = np.einsum("ka,kar->kr", weights, x[nodes])
    place = np.searchsorted(bodies, owner[mine])
    touched = np.unique(place)
    size = 6 * (1 + len(bodies))
    columns = (6 + 6 * touched[:, None] + np.arange(6)).ravel()
    moved = np.zeros((len(mine), 3, len(touched), 6))
    moved[np.arange(len(mine)), :, np.searchsorted(touched, place)] = rigid_motions(point, points[1 + place])
    motion = moved.reshape(len(mine), 3, -1)
    push = np.einsum("krs,ksj->krj", stiffness[mine], motion)
    forces = spread(nodes, weights, push, len(x))
    following = soft.response(forces, planes, step_s)
    if following is None:
        return None
    tangent = np.zeros((size, size))
    own_block = np.einsum("kri,krj->ij", motion, push) - np.einsum("inr,jnr->ij", forces, following)
    tangent[np.ix_(columns, columns)] = own_block
    all_nodes, all_weights = planes.nodes, planes.weights
    followed = np.einsum("ka,jkar->krj", all_weights, following[:, all_nodes])
    held = spread(all_nodes, all_weights, np.einsum("krs,ksj->krj", stiffness, followed), len(x))
    kept = forces - held - soft.inertia_weight(step_s) * soft.body.node_mass[:, None] * following
    arriving = np.einsum("nri,jnr->ij", rigid_motions(x, points[0]), kept)
    tangent[:6, columns] = -arriving
    tangent[columns, :6] = -arriving.T
    return tangent


_SOFT_SHARE = 0.1  # of the interface's residual: what the soft step's own may be
_SMALLEST_N = 1.0  # loads below it count as this large: rounding of the film's forces is far below 1e-9 N
_RENEWED_AFTER = 6  # trials; the contacts are others by then than those the inverse was made for


@final
@dataclass(frozen=True)
class IterationOptions:
    """When the loads between both sides agree.

    Args:
        tolerance: largest residual over the size of the loads.
        iterations_max: trials of a tick before it counts as failed.
    """

    tolerance: float = 1e-9
    iterations_max: int = 30


@final
@dataclass(frozen=True)
class Trial:
    """One trial of a tick.

    Args:
        load: (n,) that acted on the rigid side.
        answered: (n,) by the soft side.
        residual: (n,), what has not acted yet.
        size: of the residual over that of the loads.
        reply: of the soft side.
        received: read back from MuJoCo: on the flange, on bodies, about the world's origin.
    """

    load: Array
    answered: Array
    residual: Array
    size: float
    reply: SoftReply
    received: tuple[SixNumbers, SixNumbers]


@final
class InterfaceSearch:
    """Trials of one tick; after `run`, both sides stand at its end.

    Args:
        interface: at the start of the tick, servos commanded.
        vector: how loads are read and written, begun for this tick.
        rigid_half: takes that of the tick, with a wrench (6,) at the flange's origin.
        loads: on the soft body at the end of the tick.
        options: when loads agree.
        inverse: of dr/dl, as the last tick left it; None for none.
    """

    def __init__(
        self,
        interface: Interface,
        vector: InterfaceLoads,
        rigid_half: Callable[[Array], None],
        loads: Loads,
        options: IterationOptions,
        inverse: Array | None,
    ) -> None:
        self._interface, self._vector, self._soft_loads = interface, vector, loads
        self._rigid_half, self._options, self.inverse = rigid_half, options, inverse
        self._rigid, self._before = interface.scene.save_state(), interface.soft.state
        self._contact = None if interface.contact is None else interface.contact.save_state()
        self._mobility = interface.scene.mobility(vector.bodies)
        self._scale = _SMALLEST_N
        self._reached: Array | None = None
        self.trials = self.newton_iterations = 0

    def run(self, guess: Array, fallback: Array, owed: Array) -> Trial:
        """Return the trial in which the loads agree.

        Args:
            guess: (n,), loads to begin with.
            fallback: (n,), those where the guess has no solution.
            owed: u (n,), that acts besides what the soft side answers.

        Raises:
            ConvergenceError: the loads do not agree after all trials; both sides stand at the start.
            InstabilityError: the rigid side is not finite under the loads of the start either.
        """
        best, load, quasi_newton, error = None, guess, None, None
        while self.trials < self._options.iterations_max:
            try:
                trial = self._take(load, owed)
            except SolverError as failure:
                error = failure
                load = fallback if best is None else 0.5 * (load + best.load)
                continue
            if trial.size <= self._options.tolerance:
                self._learn(quasi_newton)
                return trial
            if best is None or trial.size < best.size:
                best = trial
            if quasi_newton is None or self.trials % _RENEWED_AFTER == 0:
                quasi_newton = QuasiNewton(self._inverse_here())
            load = load + quasi_newton.step(load, trial.residual)
        self._go_back()
        if best is None and error is not None:
            raise error
        size = np.inf if best is None else best.size
        raise ConvergenceError(
            f"the loads between both sides do not agree after {self.trials} trials of a tick: they differ by "
            f"{size:.3g} of their size, above coupling.tolerance = {self._options.tolerance:g}; try a "
            "shorter tick, or coupling.scheme = 'staggered'",
            size * self._scale,
            self.newton_iterations,
        )

    def _take(self, load: Array, owed: Array) -> Trial:
        """Take the tick under loads (n,)."""
        interface, vector, scene = self._interface, self._vector, self._interface.scene
        if self.trials:
            self._go_back()
        self.trials += 1
        vector.apply(load)
        received = received_flange(scene), received_bodies(scene)
        self._rigid_half(UNIT * load[:6])
        aim = StepAim(_SOFT_SHARE * self._options.tolerance * self._scale, self._reached)
        reply = interface.advance_soft(self._soft_loads, aim)
        self._reached = interface.soft.state.positions
        self.newton_iterations += reply.iterations
        answered = vector.answered()
        residual = answered + owed - load
        sizes = (float(np.abs(answered).max()), interface.touched.normal_force_N, _SMALLEST_N)
        self._scale = max(sizes)
        size = float(np.abs(residual).max()) / self._scale
        return Trial(load, answered, residual, size, reply, received)

    def _go_back(self) -> None:
        """Return both sides to the start of the tick; the soft side keeps its factorisation."""
        interface = self._interface
        interface.scene.restore_state(self._rigid)
        interface.soft.restore(self._before)
        if interface.contact is not None and self._contact is not None:
            interface.contact.restore_state(self._contact)

    def _learn(self, quasi_newton: QuasiNewton | None) -> None:
        """Keep for the next tick what the secants of this one have shown."""
        if quasi_newton is not None:
            self.inverse = quasi_newton.inverse(self._scale)

    def _inverse_here(self) -> Array:
        """Return -(1 + h^2 S W)^-1 (n, n); that of the tick before where no body that can move is touched."""
        interface, vector = self._interface, self._vector
        step_s = interface.scene.tick_s
        touching = None
        if interface.contact is not None:
            touching = contact_tangent(
                interface.contact, interface.soft, vector.bodies, vector.points, step_s
            )
        if touching is None and self.inverse is not None and self.trials < _RENEWED_AFTER:
            return self.inverse
        mass = np.zeros((len(vector), len(vector))) if touching is None else step_s**2 * touching
        weight = step_s**2 * interface.soft.inertia_weight(step_s)
        mass[:6, :6] = weight * interface.soft.mass_properties().spatial(vector.points[0])
        unit = np.tile(UNIT, len(vector) // 6)
        product = (mass @ self._mobility) * (unit / unit[:, None])
        return -np.linalg.inv(np.eye(len(vector)) + product)


@final
@dataclass(frozen=True)
class IteratedState:
    """Where an `IteratedCoupling` is.

    Args:
        interface: what it acts on.
        history: loads (1 + b, 6) about the world's origin of up to two iterated ticks, last first.
        left_over: (1 + b, 6), what has not acted yet, about the world's origin.
        inverse: of the quasi-Newton steps; None before the first.
    """

    interface: InterfaceState
    history: tuple[Annotated[Array, ("b", 6)], ...]
    left_over: Annotated[Array, ("b", 6)]
    inverse: Annotated[Array, ("n", "n")] | None


@final
class IteratedCoupling(Coupling):
    """Repeats each tick until both sides agree on the loads between them.

    Args:
        interface: between the sides.
        options: when they agree.
    """

    def __init__(self, interface: Interface, options: IterationOptions | None = None) -> None:
        super().__init__(interface)
        self._options = options or IterationOptions()
        self._vector = InterfaceLoads(interface)
        self._inverse: Array | None = None
        self._history: tuple[Array, ...] = ()
        self._left_over = np.zeros((1 + len(self._vector.bodies), 6))

    def begin_again(self) -> None:
        """Forget what the last ticks were like; another scheme has advanced both sides since."""
        self._history, self._left_over = (), np.zeros_like(self._left_over)

    def advance(self, servos: Servos, loads: Sequence[Loads]) -> TicksTaken:
        interface, vector = self.interface, self._vector
        if interface.to_be_weighed:
            interface.update_stability_ratio()
        taken, joints = interface.begin(1), len(servos.position[0])
        carried = CarriedInertia(np.zeros((0, 0)), np.ones(1), np.zeros((1, joints)))

        def rigid_half(wrench: Array) -> None:
            taken.ticks.figures[0, WRENCH:CENTER] = wrench
            if not take_rigid_half(interface.rigid(carried), servos, taken.ticks, 0):
                interface.scene.check()
            interface.scene.stepped(taken.ticks.flange(0))

        vector.begin()
        last, owed = vector.answered(), vector.from_world(self._left_over)
        search = InterfaceSearch(interface, vector, rigid_half, loads[0], self._options, self._inverse)
        found = search.run(self._expected(last) + owed, last, owed)
        acted = vector.flange_wrench(found.load)
        interface.take_reply(taken, found.reply, np.concatenate([acted.force, acted.torque]))
        taken.ticks.momentum_error[0] = self._account(found)
        self._inverse = search.inverse
        self._history = (vector.about_world(found.answered), *self._history[:1])
        if interface.body_mass is not None:
            interface.body_mass.update(carry=False)
            taken.ticks.contact[0, 2] = interface.contact_ratio
        taken.ticks.iterations[0], taken.trials[0] = search.newton_iterations, search.trials
        taken.scheme, taken.interface_residual[0] = "iterated", found.size
        return taken

    def save_state(self) -> IteratedState:
        return IteratedState(self.interface.save_state(), self._history, self._left_over, self._inverse)

    def restore_state(self, state: IteratedState) -> None:
        self.interface.restore_state(state.interface)
        self._history, self._left_over, self._inverse = state.history, state.left_over, state.inverse
        bodies = len(self._vector.bodies)
        if len(state.left_over) != 1 + bodies:  # contact begins: bodies bear nothing yet
            self._history, self._inverse = (), None
            self._left_over = np.zeros((1 + bodies, 6))
            self._left_over[0] = state.left_over[0]

    def _expected(self, last: Array) -> Array:
        """Return loads (n,) that go on as they have come."""
        if len(self._history) < 2:
            return last
        now, before = (self._vector.from_world(loads) for loads in self._history)
        return np.asarray(2.0 * now - before)

    def _account(self, found: Trial) -> float:
        """Take note of what is left over; return the error of momentum."""
        left_over = self._vector.about_world(found.residual)
        due = self._left_over - left_over
        self._left_over = left_over
        bodies = due[1:].sum(axis=0) - self._vector.held_fast()
        return self.interface.handed.plus(six_numbers(due[0]), six_numbers(bodies)).error(*found.received)
