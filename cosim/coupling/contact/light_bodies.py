"""Implicit contact with light bodies, which a late contact force would make unstable.

Over a tick h, a motion xi of a body changes its contact loads by -S xi, with S the stiffness of contacts and
film in series, film inertia included. A load moves the body by C = h^2 J M^-1 J^T; M includes J_a^T D J_a of
MuJoCo's active constraints, so a body on a table does not move into it. A force that acts one tick late is
unstable if the contact ratio, the largest eigenvalue of S C, is above 1: it throws bodies that are lighter
than the film's effective mass. Therefore the film's contacts with such a body are computed for its pose at
the end of MuJoCo's next step, in which the load F of this very soft step acts: x + h (v + h a(F)), with
accelerations a from MuJoCo, relative to the flange. This is implicit Euler for film and body together, stable
for every mass. MuJoCo's step applies F, so impulses are exact. The unknown is l = F - F', with F' the assumed
load, extrapolated from the last ticks. Newton's steps dl = (1 + S C)^-1 (F - F' - l) find the root of the
monotone residual; a step that goes too far is cut by the secant of the residual's work along C dl. Bodies of
a contact ratio below 0.5 are heavy: they take the load one tick later, as do bodies below 2.5 if something
else holds them. A load that acts during n steps of MuJoCo acts h (n - 1) / (2 n) late in the mean, so
contacts with heavy bodies are computed for their poses at that time; at the present poses they would gain
energy.
"""

from dataclasses import dataclass
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose
from cosim.coupling.contact.contact_exchange import (
    POSITION_TOLERANCE_M,
    TURN_LEVER_M,
    UNKNOWN,
    ContactExchange,
)
from cosim.coupling.contact.implicit_contact import (
    VERY_LIGHT,
    ContactTrial,
    ImplicitContactStep,
    contact_ratio,
    search_along,
)
from cosim.coupling.contact.levers import Levers, SoftStepper
from cosim.coupling.robots.soft_step import SoftReply
from cosim.errors import ConvergenceError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.step_scheme import StepAccuracy

RATIO_BOUND: Final = 0.5
"""Contact ratio above which contact is implicit.

A node, a spring and a body with the load one tick late: stable up to 1 with implicit Euler, 0.5 with BDF2.
"""
RENEW_ABOVE: Final = 1.2
"""Growth of the contacts' stiffness above which heavy bodies are updated; the film's grows no faster."""
_HELD_RATIO = 2.5  # bound of the ratio of bodies that something else holds
_TRIALS_MAX = 60
_LOOSER: Final = ((0, 1.0), (10, 10.0), (20, 100.0))
"""Trials, and the factor of the tolerance after them: films that snap do not reach the tolerance."""
_STALE = 1.3  # change of the contacts' stiffness, as a factor, above which S is recomputed
_FALLS_FAST = 0.25  # fraction of the residual after a step below which S stays in use
_RENEW_AFTER_S, _FEWEST_TICKS, _MOST_TICKS = 0.1, 10, 50


@final
@dataclass(frozen=True)
class LightBodiesState:
    """State of `LightBodies`.

    Args:
        heavy: (movable bodies,), 1 for those with explicit contact.
        stiffness_bound: (movable bodies,) [N/m], contact stiffness above which heavy bodies are updated,
            over `RENEW_ABOVE`.
        ratio: largest contact ratio at the last update.
        bodies: (b,) of the last S.
        stiffness: S (6 b, 6 b).
        contact_N_m: trace of the contacts' stiffness for which S was computed.
        stiffening: factor by which contacts may stiffen until heavy bodies are updated.
        age: ticks of contact with light bodies since their update.
    """

    heavy: Annotated[IntArray, ("k",)]
    stiffness_bound: Annotated[Array, ("k",)]
    ratio: float
    bodies: Annotated[IntArray, ("b",)]
    stiffness: Annotated[Array, ("n", "n")]
    contact_N_m: float
    stiffening: float
    age: int


@final
class LightBodies:
    """Decides which bodies are light, and takes the soft step in implicit contact with them.

    Args:
        exchange: contacts.
        soft: soft robot.
        tick_s: h [s].
    """

    def __init__(self, exchange: ContactExchange, soft: SoftStepper, tick_s: float) -> None:
        self._exchange, self._soft, self._tick_s = exchange, soft, tick_s
        self._movable, count = exchange.movable, len(exchange.movable)
        self._heavy, self._stiffness_bound = np.zeros(count, np.int64), np.zeros(count)
        self._bodies: IntArray = np.zeros(0, np.int64)
        self._stiffness, self._contact_stiffness = np.zeros((0, 0)), 0.0
        self._ticks = min(max(_FEWEST_TICKS, round(_RENEW_AFTER_S / tick_s)), _MOST_TICKS)
        self.ratio, self._stiffening, self.trials = 0.0, RENEW_ABOVE, 1
        self._initial_state = self.state
        self._set_predicted()

    def advance(self, flange: Pose, loads: Loads, accuracy: StepAccuracy | None = None) -> SoftReply:
        """Take the soft step with contacts, and load the bodies.

        Args:
            flange: its pose at the end.
            loads: at the end, without contacts.
            accuracy: of the step; None for an ordinary step.

        Raises:
            ConvergenceError: the film's step has no solution, or bodies and film do not agree.
        """
        reply = self._advance_once(flange, loads) if accuracy is None else None
        if reply is not None:
            return reply
        tick = flange, loads, self._tick_s
        step = ImplicitContactStep(self._exchange, self._soft, tick, accuracy)
        light = self.ratio > VERY_LIGHT or not np.isin(step.bodies, self._bodies).all()
        try:
            trial = step.take(step.guess() if light else None)
        except ConvergenceError:
            if not light:
                raise
            trial = step.take()
        if len(step.bodies):
            touched = step.touched
            self._exchange.light_ticks += len(touched) > 0
            # a body that was light may be held by something else now
            new = not np.isin(touched, self._bodies).all()
            if len(touched) and new:
                self._update_stiffness(step)
                self._exchange.light_ticks = 0
                if self._are_heavy(self._stiffness, self._exchange.bodies.mobilities(self._bodies)):
                    self._heavy[np.isin(self._movable, touched)] = 1
                    self._set_predicted()
                    self._soft.restore(step.before)
                    step = ImplicitContactStep(self._exchange, self._soft, tick, accuracy)
                    trial = step.take()
                else:
                    self._update_compliance()
            if len(step.bodies):
                trial = self._iterate(step, trial)
        assert trial.reply is not None, "the film has stepped"
        self.trials = step.trials
        self._exchange.commit(step.before.positions, self._soft.state.positions)
        self.update()
        return trial.reply

    def _advance_once(self, flange: Pose, loads: Loads) -> SoftReply | None:
        """Take the soft step once; None if the predicted poses are not accurate enough."""
        exchange, soft, before, tick_s = self._exchange, self._soft, self._soft.state, self._tick_s
        planes = exchange.find(before, tick_s)
        light, compliance_known = exchange.light_bodies_near()
        if not compliance_known:
            return None
        try:
            with_contacts = loads if planes is None else loads.touching(planes)
            reply = soft.advance(flange, with_contacts, tick_s)
        except ConvergenceError:
            if light:
                return None
            raise
        x = soft.state.positions
        if light and not exchange.mismatch(x, reply.residual_N, tick_s) <= 1.0:
            soft.restore(before)
            return None
        exchange.commit(before.positions, x)
        self.update()
        return reply

    def set_tick_length(self, tick_s: float) -> None:
        """Set the length of ticks; the state is reset, as it depends on the length."""
        self._tick_s = tick_s
        self.state = self._initial_state

    def update(self) -> None:
        """Update which bodies are heavy, if due after the last tick."""
        if self._heavy_due():
            self._update_heavy()
        elif self._exchange.light_ticks >= self._ticks:
            self._update_light()

    def _heavy_due(self) -> bool:
        """Return whether heavy bodies must be updated: after a release, after a time, or in a firmer grip."""
        if not np.count_nonzero(self._heavy):
            return False
        heavy = self._heavy != 0
        released = self._exchange.loads.loaded[self._movable] == 0
        firmer = self._exchange.stiffness_N_m[self._movable] > RENEW_ABOVE * self._stiffness_bound
        return bool((heavy & (released | firmer | (self._exchange.age >= self._ticks))).any())

    def _update_heavy(self) -> None:
        exchange = self._exchange
        present, planes = exchange.stiffness_N_m[self._movable], exchange.sticking
        loaded = exchange.bodies.bearing[self._movable] != 0
        if self._heavy[~loaded].any():  # released bodies count as light until the next contact
            self._bodies, self._stiffness = np.zeros(0, np.int64), np.zeros((0, 0))
        self._heavy[~loaded] = 0
        # S stays valid while contacts are as stiff as when it was computed; newly heavy bodies have a new one
        before = self._stiffness_bound * RENEW_ABOVE / self._stiffening
        before = np.where(before > 0.0, before, present)
        exchange.age = 0
        heavy = self._heavy != 0
        touched, stiffer = self._movable[heavy], (present > RENEW_ABOVE * before)[heavy].any()
        if planes is not None and len(touched):
            if stiffer or not np.isin(touched, self._bodies).all():
                x = self._soft.state.positions
                levers = Levers.of(planes, touched, exchange.loads.centers[touched], x)
                stiffness = levers.stiffness(planes, planes.at(x).tangent, self._soft, self._tick_s)
                self._bodies, self._stiffness, self._contact_stiffness = touched, stiffness, 0.0
                before = present
            if not self._are_heavy(self._stiffness_of(touched), exchange.bodies.mobilities(touched)):
                self._heavy[:] = 0
        self._stiffness_bound[:] = np.where(self._heavy, before * self._stiffening / RENEW_ABOVE, 0.0)
        self._set_predicted()

    def _update_light(self) -> None:
        """Update whether light bodies are still light: something else may hold them now."""
        exchange, bodies, x = self._exchange, self._bodies, self._soft.state.positions
        planes, exchange.light_ticks = exchange.planes, 0
        touched = bodies[exchange.bodies.bearing[bodies] != 0]
        if planes is None or not len(touched):
            return
        levers = Levers.of(planes, bodies, exchange.loads.centers[bodies], x)
        tangents = planes.at(x).tangent
        present = float(np.einsum("kii->", tangents[levers.contacts]))
        if not self._contact_stiffness / _STALE < present < self._contact_stiffness * _STALE:
            self._stiffness = levers.stiffness(planes, tangents, self._soft, self._tick_s)
            self._contact_stiffness = present
        mobilities = exchange.bodies.mobilities(bodies)
        if self._are_heavy(self._stiffness, mobilities):
            self._heavy[np.isin(self._movable, touched)] = 1
            self._set_predicted()
        else:
            self._update_compliance(mobilities[1])

    @property
    def state(self) -> LightBodiesState:
        """State of the light bodies; restore the scene before it."""
        return LightBodiesState(
            self._heavy.copy(), self._stiffness_bound.copy(), self.ratio, self._bodies, self._stiffness,
            self._contact_stiffness, self._stiffening, self._exchange.light_ticks,
        )  # fmt: skip

    @state.setter
    def state(self, saved: LightBodiesState) -> None:
        self._heavy[:], self._stiffness_bound[:] = saved.heavy, saved.stiffness_bound
        self.ratio, self._bodies, self._stiffness = saved.ratio, saved.bodies, saved.stiffness
        self._contact_stiffness, self._stiffening = saved.contact_N_m, saved.stiffening
        self._exchange.light_ticks = saved.age
        self._set_predicted()

    def _set_predicted(self) -> None:
        self._exchange.bodies.prediction.ahead[self._movable] = 1 - 2 * self._heavy
        self._update_compliance()

    def _update_compliance(self, free: Array | None = None) -> None:
        """Update the exchange's compliance of the bodies of S, as if nothing else held them.

        Other constraints only make the compliance smaller.

        Args:
            free: (6 b, 6 b), mobility of these bodies without other constraints; None to compute it.
        """
        compliance = self._exchange.compliance
        compliance[:] = UNKNOWN
        if not len(self._bodies) or self.ratio > VERY_LIGHT:
            return
        bodies = self._exchange.bodies
        if free is None:
            free = bodies.mobility(self._bodies, held=False)
        mobility = bodies.way_s2(self._tick_s) * free
        for k, body in enumerate(self._bodies.tolist()):
            rows = slice(6 * k, 6 * k + 3)
            alone = np.zeros_like(mobility[rows])
            alone[:, rows] = mobility[6 * k, 6 * k] * np.eye(3)
            # a body on joints, or one of several that are connected, does not move independently
            if np.abs(mobility[rows] - alone).max() < 1e-9 * mobility[6 * k, 6 * k]:
                turn = mobility[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6]
                largest = float(np.linalg.eigvalsh(turn)[-1])
                compliance[body] = (
                    mobility[6 * k, 6 * k] / POSITION_TOLERANCE_M,
                    TURN_LEVER_M * largest / POSITION_TOLERANCE_M,
                )

    def _are_heavy(self, stiffness: Array, mobilities: tuple[Array, Array]) -> bool:
        """Return whether bodies are heavy, by S and their mobilities (6 b, 6 b) with and without constraints.

        A constraint may release them, so the ratio without constraints is bounded as well.
        """
        constrained_ratio, free_ratio = (
            contact_ratio(stiffness, self._tick_s**2 * mobility) for mobility in mobilities
        )
        self.ratio = free_ratio
        stiffening = min(RATIO_BOUND / max(constrained_ratio, 1e-9), _HELD_RATIO / max(free_ratio, 1e-9))
        self._stiffening = max(RENEW_ABOVE, stiffening)
        return constrained_ratio <= RATIO_BOUND and free_ratio <= _HELD_RATIO

    def _update_stiffness(self, step: ImplicitContactStep) -> None:
        """Compute S at the end of the last trial."""
        self._bodies, self._stiffness = step.bodies, step.stiffness(self._soft.state.positions)
        self._contact_stiffness = step.stiffness_N_m()
        self._update_compliance()

    def _iterate(self, step: ImplicitContactStep, trial: ContactTrial) -> ContactTrial:
        """Repeat the step until the predicted poses are accurate."""
        mismatch, renewed = step.mismatch(trial), False
        while mismatch > max(factor for after, factor in _LOOSER if step.trials >= after):
            if step.trials >= _TRIALS_MAX:
                raise self._error(step, trial.error_m)
            contact_N_m = step.stiffness_N_m()
            if not step.presses():  # they have separated: return them to the film
                trial = step.take(step.loads_at(self._soft.state.positions, trial.change))
                mismatch = step.mismatch(trial)
                continue
            if not self._contact_stiffness / _STALE < contact_N_m < self._contact_stiffness * _STALE:
                self._update_stiffness(step)
                renewed = True
            stiffness = self._stiffness_of(step.bodies)
            change = step.newton_step(stiffness, trial.residual)
            trial = search_along(step, step.take, trial, change)
            last_mismatch, mismatch = mismatch, step.mismatch(trial)
            if renewed and mismatch > 0.5 * last_mismatch and trial.error_m < 10.0 * POSITION_TOLERANCE_M:
                break  # the film's residual limits the accuracy
            renewed = False
            if mismatch > _FALLS_FAST * last_mismatch:
                self._contact_stiffness = 0.0
        return trial

    def _stiffness_of(self, bodies: IntArray) -> Array:
        """Return S (6 b, 6 b) of bodies (b,), zero for bodies without a known S."""
        with_stiffness = np.flatnonzero(np.isin(bodies, self._bodies))
        stored_index = np.searchsorted(self._bodies, bodies[with_stiffness])
        rows, rows_of_s = (
            (6 * body_index[:, None] + np.arange(6)).ravel() for body_index in (with_stiffness, stored_index)
        )
        stiffness = np.zeros((6 * len(bodies), 6 * len(bodies)))
        stiffness[np.ix_(rows, rows)] = self._stiffness[np.ix_(rows_of_s, rows_of_s)]
        return stiffness

    def _error(self, step: ImplicitContactStep, error_m: float) -> ConvergenceError:
        bodies, touched = self._exchange.bodies, step.touched if len(step.touched) else step.bodies
        names = ", ".join(bodies.names(touched))
        heavier = max(self.ratio, RATIO_BOUND) / RATIO_BOUND
        least_masses = ", ".join(f"{heavier * mass:.3g} kg" for mass in bodies.masses_kg(touched))
        return ConvergenceError(
            f"film and touched bodies ({names}) do not agree after {step.trials} trials of a tick: these "
            f"would be {1e3 * error_m:.3g} mm from their predicted poses; try a shorter clock.tick_s, or "
            f"give them at least {least_masses}, which needs no trials",
            error_m,
            step.iterations,
        )
