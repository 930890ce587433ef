"""One step of the film in implicit contact with light bodies: Newton's method over the bodies' loads.

The film's step is solved with contact planes at the poses that the bodies will have at the end of MuJoCo's
next step under assumed loads; the scheme and the equations are those of `light_bodies`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, cross
from cosim.coupling.contact.contact_exchange import POSITION_TOLERANCE_M, TURN_LEVER_M, ContactExchange
from cosim.coupling.contact.levers import Levers, SoftStepper
from cosim.coupling.robots.soft_step import SoftReply
from cosim.errors import ConvergenceError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.step_scheme import StepAccuracy

VERY_LIGHT: Final = 30.0
"""Contact ratio above which a guess first moves bodies out of the film."""
_NEAR_M = 2e-4  # depth or displacement that counts as small
_RESIDUAL_FACTOR = 3.0  # tolerance of loads, relative to that of the film, in an accurate step
_GUESSES, _CUTS = 20, 12
_WORK_LEFT = 0.3  # fraction of a residual's work that a step may leave
_UNIT = np.array([1.0, 1.0, 1.0, TURN_LEVER_M, TURN_LEVER_M, TURN_LEVER_M])


@final
@dataclass(frozen=True)
class ContactTrial:
    """A trial of the film's step with bodies at the poses of changed loads.

    Args:
        change: l (6 b,), change of the assumed loads.
        residual: (6 b,), of the loads.
        error_m: largest error of the bodies' predicted poses.
        reply: of the soft robot; None if it has not stepped.
    """

    change: Array
    residual: Array
    error_m: float
    reply: SoftReply | None


@final
class ImplicitContactStep:
    """The film's step of one tick, repeated with changed poses of light bodies.

    `bodies` (b,) are the light bodies near the film, `touched` (t,) those with a load in the last trial.

    Args:
        exchange: contacts, which are found at the present poses.
        soft: soft robot.
        tick: pose of the flange and loads at the end of the step, without contacts; its length [s].
        accuracy: of the step; None for an ordinary step.
    """

    def __init__(
        self,
        exchange: ContactExchange,
        soft: SoftStepper,
        tick: tuple[Pose, Loads, float],
        accuracy: StepAccuracy | None,
    ) -> None:
        self._exchange, self._soft, self._accuracy = exchange, soft, accuracy
        self._flange, self._loads, self.tick_s = tick
        self.before, self._planes = soft.state, exchange.find(soft.state, self.tick_s)
        self.iterations = self.trials = 0
        self.bodies: IntArray = np.zeros(0, np.int64)
        self.touched: IntArray = self.bodies
        if self._planes is not None:
            near_bodies = np.unique(self._planes.body)
            self.bodies = near_bodies[exchange.bodies.prediction.ahead[near_bodies] > 0]
        if self._planes is not None and len(self.bodies):
            self._centers = exchange.loads.centers[self.bodies]
            self._levers = Levers.of(self._planes, self.bodies, self._centers, self.before.positions)
            self._shift = np.zeros_like(self._levers.arm)
            self._assumed = exchange.assumed[self.bodies].ravel()
            self._displacement = exchange.bodies.prediction.lead[self.bodies]
            self._change = np.zeros_like(self._assumed)
            self._compliance: Array | None = None
            self._motion_now = np.zeros_like(self._displacement)
            unit_pose_change_m = self.pose_change_m(
                np.ones(6 * len(self.bodies)) * np.tile(_UNIT, len(self.bodies))
            )
            self._tolerance_N = 0.25 * POSITION_TOLERANCE_M / unit_pose_change_m
            if accuracy is not None:
                self._tolerance_N = min(self._tolerance_N, accuracy.tolerance_N)

    def take(self, change: Array | None = None) -> ContactTrial:
        """Take the step with bodies at the poses of a change (6 b,) of the assumed loads, zero if None."""
        accuracy = self._accuracy
        if change is None:
            change = np.zeros(6 * len(self.bodies))
        shift_m = 0.0
        if len(self.bodies):
            shift_m = self._set_loads(change)
            start = None if accuracy is None else accuracy.start
            accuracy = StepAccuracy(self._tolerance_N, start)
        if self.trials:
            # from a hard pressed shape the film may not return
            trial_positions = self._soft.state.positions if shift_m < _NEAR_M else None
            self._soft.restore(self.before)
            accuracy = StepAccuracy(self._tolerance_N, trial_positions)
        loads = self._loads if self._planes is None else self._loads.touching(self._planes)
        self.trials += 1
        if accuracy is None:
            reply = self._soft.advance(self._flange, loads, self.tick_s)
        else:
            reply = self._soft.advance_accurately(self._flange, loads, self.tick_s, accuracy)
        self.iterations += reply.iterations
        reply = replace(reply, iterations=self.iterations)
        if not len(self.bodies):
            return ContactTrial(change, change, 0.0, reply)
        return self._evaluate(change, self._soft.state.positions, reply)

    def guess(self) -> Array:
        """Return the change of loads (6 b,) for which bodies follow a film that keeps its velocity.

        Bodies of very small mass hardly slow down the film. Zero if none is, or if none is pressed deep.
        """
        change = np.zeros(6 * len(self.bodies))
        if self._planes is None or not len(change):
            return change
        x = self.before.positions + self.tick_s * self.before.velocities
        if self._planes.at(x).depth_m < _NEAR_M:
            return change
        if contact_ratio(self.stiffness(x, alone=True), self.compliance) < VERY_LIGHT:
            return change
        return self.loads_at(x, change)

    def loads_at(self, x: Array, change: Array) -> Array:
        """Return the change of loads (6 b,) for which bodies touch a film that is fixed at x (n, 3) [m].

        Args:
            x: of the film's nodes.
            change: initial guess.
        """

        def fixed(change: Array) -> ContactTrial:
            self._set_loads(change)
            return self._evaluate(change, x, None)

        trial = fixed(change)
        for _ in range(_GUESSES):
            step = self.newton_step(self.stiffness(x, alone=True), trial.residual)
            trial = search_along(self, fixed, trial, step)
            if self.pose_change_m(step) < _NEAR_M:
                break
        return trial.change

    def _evaluate(self, change: Array, x: Array, reply: SoftReply | None) -> ContactTrial:
        """Return the trial of a film at x (n, 3) [m] with bodies at the poses of a change (6 b,) of loads."""
        loads = self.contact_loads(x)
        self.touched = self.bodies[loads.reshape(-1, 6).any(axis=1)]
        residual = loads - self._assumed - change
        if not residual.any():
            return ContactTrial(change, residual, 0.0, reply)
        error = self._motion_of(self._exchange.predict(self.bodies, loads, self.tick_s)) - self._motion_now
        return ContactTrial(change, residual, _largest_m(error), reply)

    @property
    def compliance(self) -> Array:
        """C (6 b, 6 b), compliance of the bodies in a tick under the last assumed loads."""
        if self._compliance is None:
            loads = self._assumed + self._change
            self._compliance = self._exchange.held_compliance(self.bodies, loads, self.tick_s)
        return self._compliance

    def newton_step(self, stiffness: Array, residual: Array) -> Array:
        """Return the Newton step (6 b,) of the change of loads."""
        return np.asarray(
            np.linalg.solve(np.eye(len(residual)) + stiffness @ self.compliance, residual), float
        )

    def presses(self) -> bool:
        """Return whether the film presses on bodies at the end of the last trial."""
        assert self._planes is not None, "there are bodies"
        pressing = self._planes.at(self._soft.state.positions).normal_force > 0.0
        return bool((pressing | self._planes.glued)[self._levers.contacts].any())

    def stiffness_N_m(self) -> float:
        """Return the trace of the contacts' stiffness at the end of the last trial."""
        assert self._planes is not None, "there are bodies"
        tangents = self._planes.at(self._soft.state.positions).tangent[self._levers.contacts]
        return float(np.einsum("kii->", tangents))

    def pose_change_m(self, residual: Array) -> float:
        """Return the largest change of a body's pose by a small residual of loads."""
        return _largest_m((self.compliance @ residual).reshape(-1, 6))

    def mismatch(self, trial: ContactTrial) -> float:
        """Return the error of a trial, relative to its tolerance."""
        relative_error = trial.error_m / POSITION_TOLERANCE_M
        if self._accuracy is not None:
            forces = np.abs(trial.residual.reshape(-1, 6) / _UNIT).max()
            relative_error = max(
                relative_error, float(forces) / (_RESIDUAL_FACTOR * self._accuracy.tolerance_N)
            )
        return relative_error

    def stiffness(self, x: Array, *, alone: bool = False) -> Array:
        """Return S (6 b, 6 b) at nodes (n, 3) [m] after the last trial; `alone`: of contacts without film."""
        assert self._planes is not None, "there are bodies"
        tangents, soft = self._planes.at(x).tangent, None if alone else self._soft
        return self._levers.stiffness(self._planes, tangents, soft, self.tick_s)

    def contact_loads(self, x: Array) -> Array:
        """Return the loads (6 b,) of a film with nodes (n, 3) [m] on the bodies, about their centres."""
        assert self._planes is not None, "there are bodies"
        return self._levers.loads(self._planes.at(x).gradient[self._levers.contacts])

    def _motion_of(self, displacement: Array) -> Array:
        """Return the motion (b, 6) at the centres of mass since the first prediction."""
        motion = displacement - self._displacement
        motion[:, :3] += cross(motion[:, 3:], self._centers)
        return motion

    def _set_loads(self, change: Array) -> float:
        """Move the contacts to the poses of a change (6 b,) of loads; return their largest shift [m]."""
        if np.array_equal(change, self._change):
            return 0.0
        self._change, self._compliance = change, None
        displacement = self._exchange.predict(self.bodies, self._assumed + change, self.tick_s)
        self._motion_now = motion = self._motion_of(displacement)
        shift = self._levers.shift(motion)
        further, self._shift = shift - self._shift, shift
        if not further.any():
            return 0.0
        self._planes = self._exchange.move(self._levers.contacts, further)
        self._exchange.loads.centers[self.bodies] = self._centers + motion[:, :3]
        return float(np.abs(further).max())


def search_along(
    step: ImplicitContactStep, take: Callable[[Array], ContactTrial], trial: ContactTrial, change: Array
) -> ContactTrial:
    """Return a trial along a change (6 b,) of the assumed loads, cut if it goes too far.

    The work of the residual along the motion falls through zero; the root is bracketed (Illinois method).
    """
    motion = step.compliance @ change
    work = low_work = float(trial.residual @ motion)
    low, high, high_work, fraction = 0.0, 0.0, 0.0, 1.0
    for cuts in range(_CUTS):
        try:
            cut_trial = take(trial.change + fraction * change)
        except ConvergenceError:
            if cuts == _CUTS - 1:
                raise
            fraction = 0.5 * (low + fraction)  # too deep in the film
            continue
        residual_work = float(cut_trial.residual @ motion)
        if abs(residual_work) <= _WORK_LEFT * work or step.mismatch(cut_trial) < 1.0:
            break
        if residual_work < 0.0:
            high, high_work, low_work = (
                fraction,
                residual_work,
                low_work if high == 0.0 or fraction > high else 0.5 * low_work,
            )
        elif high == 0.0:
            break
        else:
            low, low_work, high_work = fraction, residual_work, 0.5 * high_work
        secant = low_work / (low_work - high_work)
        fraction = low + (high - low) * min(max(secant, 0.05), 0.95)
    return cut_trial


def _largest_m(motion: Array) -> float:
    """Return the largest component [m] of motions (b, 6), rotations times a lever."""
    size = np.abs(motion)
    return float(max(size[:, :3].max(), TURN_LEVER_M * size[:, 3:].max()))


def contact_ratio(stiffness: Array, compliance: Array) -> float:
    """Return the contact ratio, the largest eigenvalue of S C."""
    return float(np.linalg.eigvals(stiffness @ compliance).real.max(initial=0.0))
