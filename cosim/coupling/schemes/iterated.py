"""The iterated exchange: a tick is repeated until the wrench on the flange equals the soft robot's reply.

The unknown l is the wrench at the end of the tick. One trial starts at the start of the tick: MuJoCo steps
under l, contacts are found at the new poses, the soft robot steps with the new pose of the flange, with
implicit contact of light bodies (`light_bodies`), and replies with g(l). The root of r(l) = g(l) + u - l is
found by quasi-Newton steps; u is the residual that the last tick left, so no impulse is lost. The initial
inverse Jacobian is -(1 + h^2 c m W)^-1, with W the mobility of the flange and c m the inertia of the soft
robot in its step as a rigid body. Later ticks start with the last tick's inverse. No algorithmic mass is
carried: at the root this is implicit Euler for arm and soft robot together. Quasi-Newton: with the pairs
(dl, dr) of the present tick as columns of L and V, and H the approximate inverse of dr/dl at its start, the
inverse is J = H + (L - H V) V^+ (V^+ by least squares), and the step is -J r.
Sources: Degroote, Bathe, Vierendeels, Computers and Structures 87 (2009) 793 (IQN-ILS);
Bogaers, Kok, Reddy, Franz, CMAME 279 (2014) 113 (the inverse is reused: MVQN).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, final

import numpy as np

from cosim.base.frames import Array, SixNumbers, Wrench
from cosim.base.state import restore_states, states_of
from cosim.coupling import ticks
from cosim.coupling.robots.soft_step import SoftReply
from cosim.coupling.schemes.coupling import Coupling
from cosim.coupling.schemes.interface import Interface
from cosim.coupling.schemes.transfer import LEVER_M, six_numbers
from cosim.errors import ConvergenceError, SolverError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.step_scheme import StepAccuracy

_INDEPENDENT = 1e-8  # smallest singular value of V that counts, relative to the largest
_LEARNT = 1e-6  # secants below this fraction of the interface's load are rounding, and are dropped
_UNIT = np.array([1.0, 1.0, 1.0, LEVER_M, LEVER_M, LEVER_M])
_SOFT_FRACTION = 0.1  # tolerance of the soft step's residual, relative to the interface's
_SMALLEST_N = 1.0  # smallest scale of loads: the rounding of the film's forces is far below 1e-9 N
_RENEWED_AFTER = 6  # trials


@final
class QuasiNewton:
    """Quasi-Newton steps towards the root; all vectors are in comparable units.

    Args:
        inverse: (n, n), approximate inverse of dr/dl.
    """

    def __init__(self, inverse: Array) -> None:
        self._inverse = np.array(inverse)
        self._loads: list[Array] = []
        self._residuals: list[Array] = []

    def step(self, load: Array, residual: Array) -> Array:
        """Add the residual r (n,) at l (n,), and return the step (n,) from there towards the root."""
        self._loads.append(load)
        self._residuals.append(residual)
        return -(self._updated(0.0) @ residual)

    def inverse(self, scale: float) -> Array:
        """Return the updated inverse (n, n), without secants that are rounding for loads of this scale."""
        return self._updated(_LEARNT * scale)

    def _updated(self, smallest: float) -> Array:
        load_changes = np.diff(np.array(self._loads), axis=0).T if len(self._loads) > 1 else None
        if load_changes is None:
            return self._inverse
        changes = np.diff(np.array(self._residuals), axis=0).T
        length = np.linalg.norm(changes, axis=0)
        valid = length > max(smallest, 1e-300)
        if not valid.any():
            return self._inverse
        # of unit length, so that a late, short secant counts as much as an early one
        load_changes, changes = load_changes[:, valid] / length[valid], changes[:, valid] / length[valid]
        pseudoinverse = np.linalg.pinv(changes, rcond=_INDEPENDENT)
        return np.asarray(self._inverse + (load_changes - self._inverse @ changes) @ pseudoinverse)


@final
class FlangeLoad:
    """Converts the wrench on the flange to and from a vector (6,): force, torque / lever, world axes.

    The vector is about the flange's origin at the start of the tick, a fixed point.

    Args:
        interface: between arm and soft robot, at the start of the tick.
    """

    def __init__(self, interface: Interface) -> None:
        self._interface = interface
        self.point: Array = interface.scene.flange_pose.translation

    def reply(self) -> Array:
        """Return the vector (6,) of the soft robot's wrench after its last step."""
        origin = self._interface.scene.flange_pose.translation
        wrench = self._interface.wrench.moved(self.point - origin)
        return np.concatenate([wrench.force, wrench.torque]) / _UNIT

    def wrench(self, vector: Array) -> Wrench:
        """Return the wrench of a vector (6,) at the flange's present origin, world axes."""
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


@final
@dataclass(frozen=True)
class IterationOptions:
    """Bounds of the iteration of a tick.

    Args:
        tolerance: largest residual, relative to the scale of the loads.
        iterations_max: trials of a tick before it counts as failed.
    """

    tolerance: float = 1e-9
    iterations_max: int = 30


@final
@dataclass(frozen=True)
class Trial:
    """One trial of a tick.

    Args:
        load: (6,) that acted on the arm.
        returned: (6,), load that the soft robot returned.
        residual: (6,), load that has not acted yet.
        size: of the residual, relative to the scale of the loads.
        reply: of the soft robot.
        received: load on the flange, read back from MuJoCo, about the world's origin.
        bodies_error: relative error of the loads on bodies.
    """

    load: Array
    returned: Array
    residual: Array
    size: float
    reply: SoftReply
    received: SixNumbers
    bodies_error: float


@final
class InterfaceIteration:
    """Iterates one tick; after `run`, arm and soft robot are at its end.

    Args:
        interface: at the start of the tick, servos commanded.
        vector: converts the wrench, made for this tick.
        step_rigid: takes the rigid step of the tick.
        loads: on the soft robot at the end of the tick.
        options: bounds.
        inverse: of dr/dl, from the last tick; None for none.
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

    def run(self, guess: Array, fallback: Array, left_over: Array) -> Trial:
        """Return the trial in which the loads agree.

        Args:
            guess: (6,), first load.
            fallback: (6,), first load if the guess has no solution.
            left_over: u (6,), residual of the last tick, which acts in addition to the soft robot's reply.

        Raises:
            ConvergenceError: the loads do not agree after all trials; arm and soft robot are at the start.
            InstabilityError: the arm's state is not finite, even under the first loads.
        """
        best, load, quasi_newton, error = None, guess, None, None
        while self.trials < self._options.iterations_max:
            try:
                trial = self._step_tick(load, left_over)
            except SolverError as failure:
                error = failure
                load = fallback if best is None else 0.5 * (load + best.load)
                continue
            if trial.size <= self._options.tolerance:
                self._store_inverse(quasi_newton)
                return trial
            if best is None or trial.size < best.size:
                best = trial
            if quasi_newton is None or self.trials % _RENEWED_AFTER == 0:
                quasi_newton = QuasiNewton(self._initial_inverse())
            load = load + quasi_newton.step(load, trial.residual)
        self._rewind()
        if best is None and error is not None:
            raise error
        size = np.inf if best is None else best.size
        raise ConvergenceError(
            f"the loads between arm and soft robot do not agree after {self.trials} trials of a tick: they "
            f"differ by {size:.3g} of their size, above coupling.tolerance = {self._options.tolerance:g}; "
            "try a shorter tick, or coupling.scheme = 'staggered'",
            size * self._scale,
            self.newton_iterations,
        )

    def _step_tick(self, load: Array, left_over: Array) -> Trial:
        """Take the tick under a load (6,)."""
        interface, vector, scene = self._interface, self._vector, self._interface.scene
        if self.trials:
            self._rewind()
        self.trials += 1
        interface.load_flange(Wrench(load[:3], LEVER_M * load[3:]))
        received = scene.received_wrench()
        self._step_rigid()
        bodies_error = interface.error_on_bodies()
        accuracy = StepAccuracy(_SOFT_FRACTION * self._options.tolerance * self._scale, self._reached)
        reply = interface.advance_soft(self._soft_loads, accuracy)
        self._reached = interface.soft.state.positions
        self.newton_iterations += reply.iterations
        returned = vector.reply()
        residual = returned + left_over - load
        sizes = (float(np.abs(returned).max()), interface.touched.normal_force_N, _SMALLEST_N)
        self._scale = max(sizes)
        size = float(np.abs(residual).max()) / self._scale
        return Trial(load, returned, residual, size, reply, received, bodies_error)

    def _rewind(self) -> None:
        """Return to the start of the tick; the soft robot keeps its factorisation."""
        self._interface.soft.restore(self._before)
        restore_states(self._parts, self._begin)

    def _store_inverse(self, quasi_newton: QuasiNewton | None) -> None:
        """Store the inverse, updated by this tick's secants, for the next tick."""
        if quasi_newton is not None:
            self.inverse = quasi_newton.inverse(self._scale)

    def _initial_inverse(self) -> Array:
        """Return the last tick's inverse (6, 6); -(1 + h^2 c m W)^-1 in a first tick or after many trials."""
        if self.inverse is not None and self.trials < _RENEWED_AFTER:
            return self.inverse
        interface, step_s = self._interface, self._interface.scene.tick_s
        weight = step_s**2 * interface.soft.inertia_weight(step_s)
        mass = weight * interface.soft.mass_properties().spatial(self._vector.point)
        return -np.linalg.inv(np.eye(6) + (mass @ self._mobility) * (_UNIT / _UNIT[:, None]))


@final
@dataclass(frozen=True)
class IteratedState:
    """State of an `IteratedCoupling`.

    Args:
        history: wrenches (6,) about the world's origin of up to two ticks, last first.
        left_over: (6,), residual of the last tick, about the world's origin.
        inverse: approximate inverse Jacobian; None before the first tick.
    """

    history: tuple[Annotated[Array, (6,)], ...] = ()
    left_over: Annotated[Array, (6,)] = field(default_factory=lambda: np.zeros(6))
    inverse: Annotated[Array, (6, 6)] | None = None


@final
class IteratedCoupling(Coupling):
    """Repeats each tick until arm and soft robot agree on the loads between them.

    Args:
        interface: between them.
        options: bounds.
    """

    def __init__(self, interface: Interface, options: IterationOptions | None = None) -> None:
        super().__init__(interface)
        self._options = options or IterationOptions()
        self.state = IteratedState()
        """State of the scheme, in addition to that of the interface."""

    def advance(self, servos: ticks.ServoCommands, loads: Sequence[Loads]) -> ticks.TickLog:
        interface, vector = self.interface, FlangeLoad(self.interface)
        if interface.ratio_is_due:
            interface.update_stability_ratio()
        log = interface.new_log(1)

        def step_rigid() -> None:
            interface.step_rigid(servos.row(0), log)

        last, left_over = vector.reply(), vector.from_world(self.state.left_over)
        inverse = self.state.inverse
        iteration = InterfaceIteration(interface, vector, step_rigid, loads[0], self._options, inverse)
        with interface.soft.work:
            trial = iteration.run(self._expected(vector, last) + left_over, last, left_over)
        interface.transfer_loads(trial.reply, log, vector.wrench(trial.load))
        left_over, history = vector.about_world(trial.residual), self.state.history[:1]
        log.momentum_error[0] = self._momentum_error(left_over, trial)
        self.state = IteratedState(
            (vector.about_world(trial.returned), *history), left_over, iteration.inverse
        )
        log.newton_iterations[0], log.trials[0] = iteration.newton_iterations, iteration.trials
        log.scheme[0], log.interface_residual[0] = "iterated", trial.size
        return log

    def _expected(self, vector: FlangeLoad, last: Array) -> Array:
        """Return the load (6,), extrapolated linearly from the last two ticks."""
        if len(self.state.history) < 2:
            return last
        newest, previous = (vector.from_world(loads) for loads in self.state.history)
        return np.asarray(2.0 * newest - previous)

    def _momentum_error(self, left_over: Array, trial: Trial) -> float:
        """Return the momentum error of a tick with a remaining residual (6,), about the world's origin."""
        due = six_numbers(self.state.left_over - left_over)
        return max(self.interface.transferred.error(due, trial.received), trial.bodies_error)
