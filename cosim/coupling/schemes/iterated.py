"""The iterated exchange: a tick is repeated until the wrench that acts on the flange is the soft side's.

Unknown l: the wrench at the end of the tick. One trial, from the start of the tick: MuJoCo steps under l,
contacts are found at the new poses, the soft side steps with the new pose of the flange, touched bodies give
way within its step (`light_bodies`), and it answers with g(l). The root of r(l) = g(l) + u - l, u what the tick
before left over (so no impulse is lost), is found by quasi-Newton steps. They begin with the inverse
-(1 + h^2 c m W)^-1: W the mobility of the flange, c m the soft side's inertia in its step as a rigid body. It
is kept from tick to tick. No algorithmic mass is carried: at the root, this is implicit Euler for both sides
together.

Quasi-Newton: with the pairs (dl, dr) of the present tick as columns of L and V, and H the approximate inverse
of dr/dl at its start, the inverse is H + (L - H V) V^+ (V^+: least squares), and the step is -(that) r.
Sources: Degroote, Bathe, Vierendeels, Computers and Structures 87 (2009) 793 (IQN-ILS);
Bogaers, Kok, Reddy, Franz, CMAME 279 (2014) 113 (the inverse is kept: MVQN).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, final

import numpy as np

from cosim.base.frames import Array, SixNumbers, Wrench
from cosim.base.state import restore_states, states_of
from cosim.coupling import ticks
from cosim.coupling.robots.soft_robot import SoftReply
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.transfer import LEVER_M, six_numbers
from cosim.errors import ConvergenceError, SolverError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import StepAccuracy

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


_UNIT = np.array([1.0, 1.0, 1.0, LEVER_M, LEVER_M, LEVER_M])


@final
class FlangeLoad:
    """Reads and writes the wrench on the flange, about the point where its origin was when a tick began.

    A vector (6,) holds force and torque / lever, world axes.

    Args:
        interface: between the sides, at the start of the tick.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface = interface
        self.point: Array = interface.scene.flange_pose.translation

    def answered(self) -> Array:
        """Return the vector (6,) with which the soft side has answered in its last step."""
        origin = self._interface.scene.flange_pose.translation
        wrench = self._interface.wrench.moved(self.point - origin)
        return np.concatenate([wrench.force, wrench.torque]) / _UNIT

    def wrench(self, vector: Array) -> Wrench:
        """Return what of a vector (6,) acts on the flange, at its present origin, world axes."""
        wrench = Wrench(vector[:3], LEVER_M * vector[3:])
        return wrench.moved(self._interface.scene.flange_pose.translation - self.point)

    def about_world(self, vector: Array) -> Array:
        """Return a vector (6,) as force, and torque about the world's origin."""
        wrench = Wrench(vector[:3], LEVER_M * vector[3:]).moved(-self.point)
        return np.concatenate([wrench.force, wrench.torque])

    def from_world(self, load: Array) -> Array:
        """Return the vector (6,) of a force, and a torque about the world's origin."""
        wrench = Wrench(load[:3], load[3:]).moved(self.point)
        return np.concatenate([wrench.force, wrench.torque]) / _UNIT


_SOFT_SHARE = 0.1  # of the interface's residual: what the soft step's own may be
_SMALLEST_N = 1.0  # loads below it count as this large: rounding of the film's forces is far below 1e-9 N
_RENEWED_AFTER = 6  # trials


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
        load: (6,) that acted on the rigid side.
        answered: (6,) by the soft side.
        residual: (6,), what has not acted yet.
        size: of the residual over that of the loads.
        reply: of the soft side.
        received: read back from MuJoCo: on the flange, about the world's origin.
        on_bodies: how far what acts on them is from what was transferred over.
    """

    load: Array
    answered: Array
    residual: Array
    size: float
    reply: SoftReply
    received: SixNumbers
    on_bodies: float


@final
class InterfaceIteration:
    """Trials of one tick; after `run`, both sides stand at its end.

    Args:
        interface: at the start of the tick, servos commanded.
        vector: how the wrench is read and written, begun for this tick.
        step_rigid: takes the rigid step of the tick.
        loads: on the soft body at the end of the tick.
        options: when loads agree.
        inverse: of dr/dl, as the last tick left it; None for none.
    """

    def __init__(
        self,
        interface: Interface,
        vector: FlangeLoad,
        step_rigid: Callable[[], None],
        loads: Loads,
        options: IterationOptions,
        inverse: Array | None,
    ) -> None:
        self._interface, self._vector, self._soft_loads = interface, vector, loads
        self._step_rigid, self._options, self.inverse = step_rigid, options, inverse
        self._parts: dict[str, Any] = {"scene": interface.scene, **interface.contacts()}
        self._begin, self._before = states_of(self._parts), interface.soft.state
        self._mobility = interface.scene.mobility()
        self._scale = _SMALLEST_N
        self._reached: Array | None = None
        self.trials = self.newton_iterations = 0

    def run(self, guess: Array, fallback: Array, owed: Array) -> Trial:
        """Return the trial in which the loads agree.

        Args:
            guess: (6,), loads to begin with.
            fallback: (6,), those where the guess has no solution.
            owed: u (6,), that acts besides what the soft side answers.

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
        """Take the tick under a load (6,)."""
        interface, vector, scene = self._interface, self._vector, self._interface.scene
        if self.trials:
            self._go_back()
        self.trials += 1
        interface.load_flange(Wrench(load[:3], LEVER_M * load[3:]))
        received = scene.received_wrench()
        self._step_rigid()
        on_bodies = interface.error_on_bodies()
        accuracy = StepAccuracy(_SOFT_SHARE * self._options.tolerance * self._scale, self._reached)
        reply = interface.advance_soft(self._soft_loads, accuracy)
        self._reached = interface.soft.state.positions
        self.newton_iterations += reply.iterations
        answered = vector.answered()
        residual = answered + owed - load
        sizes = (float(np.abs(answered).max()), interface.touched.normal_force_N, _SMALLEST_N)
        self._scale = max(sizes)
        size = float(np.abs(residual).max()) / self._scale
        return Trial(load, answered, residual, size, reply, received, on_bodies)

    def _go_back(self) -> None:
        """Return both sides to the start of the tick; the soft side keeps its factorisation."""
        self._interface.soft.restore(self._before)
        restore_states(self._parts, self._begin)

    def _learn(self, quasi_newton: QuasiNewton | None) -> None:
        """Keep for the next tick what the secants of this one have shown."""
        if quasi_newton is not None:
            self.inverse = quasi_newton.inverse(self._scale)

    def _inverse_here(self) -> Array:
        """Return -(1 + h^2 c m W)^-1 (6, 6), or that of the tick before."""
        if self.inverse is not None and self.trials < _RENEWED_AFTER:
            return self.inverse
        interface, step_s = self._interface, self._interface.scene.tick_s
        weight = step_s**2 * interface.soft.inertia_weight(step_s)
        mass = weight * interface.soft.mass_properties().spatial(self._vector.point)
        return -np.linalg.inv(np.eye(6) + (mass @ self._mobility) * (_UNIT / _UNIT[:, None]))


@final
@dataclass(frozen=True)
class IteratedState:
    """Where an `IteratedCoupling` is.

    Args:
        history: wrenches (6,) about the world's origin of up to two iterated ticks, last first.
        left_over: (6,), what has not acted yet, about the world's origin.
        inverse: of the quasi-Newton steps; None before the first.
    """

    history: tuple[Annotated[Array, (6,)], ...] = ()
    left_over: Annotated[Array, (6,)] = field(default_factory=lambda: np.zeros(6))
    inverse: Annotated[Array, (6, 6)] | None = None


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
        self.state = IteratedState()
        """What the next tick depends on besides the interface."""

    def advance(self, servos: ticks.ServoCommands, loads: Sequence[Loads]) -> ticks.TickLog:
        interface, vector = self.interface, FlangeLoad(self.interface)
        if interface.ratio_is_due:
            interface.update_stability_ratio()
        taken = interface.room(1)

        def step_rigid() -> None:
            interface.step_rigid(servos.row(0), taken)

        last, owed = vector.answered(), vector.from_world(self.state.left_over)
        inverse = self.state.inverse
        search = InterfaceIteration(interface, vector, step_rigid, loads[0], self._options, inverse)
        with interface.soft.work:
            found = search.run(self._expected(vector, last) + owed, last, owed)
        interface.transfer_loads(found.reply, taken, vector.wrench(found.load))
        left_over, history = vector.about_world(found.residual), self.state.history[:1]
        taken.momentum_error[0] = self._momentum_error(left_over, found)
        self.state = IteratedState((vector.about_world(found.answered), *history), left_over, search.inverse)
        taken.newton_iterations[0], taken.trials[0] = search.newton_iterations, search.trials
        taken.scheme[0], taken.interface_residual[0] = "iterated", found.size
        return taken

    def _expected(self, vector: FlangeLoad, last: Array) -> Array:
        """Return a load (6,) that continues as it has come."""
        if len(self.state.history) < 2:
            return last
        now, before = (vector.from_world(loads) for loads in self.state.history)
        return np.asarray(2.0 * now - before)

    def _momentum_error(self, left_over: Array, found: Trial) -> float:
        """Return the error of momentum of a tick that leaves (6,) over, about the world's origin."""
        due = six_numbers(self.state.left_over - left_over)
        return max(self.interface.transferred.error(due, found.received), found.on_bodies)
