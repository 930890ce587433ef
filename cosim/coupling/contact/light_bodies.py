"""Bodies that the film can move: they give way to it within its own step.

A force that acts one tick late throws a body that is lighter than the film's effective mass. Over a tick h, a
motion xi of the body changes the contacts' loads by -S xi, S the stiffness of contacts and film in series,
film inertia included. The body answers a load by C = h^2 J M^-1 J^T. A late exchange grows where the largest
eigenvalue of S C (the contact ratio) is above 1.

So the film meets such a body at the end of the body's next step, in which the load of this very step acts:
at x + h (v + h a(F)), a the accelerations that MuJoCo finds for a load, with all that touches and holds the
body. That is implicit Euler for film and body together, stable for every mass. The body bears F in MuJoCo's
step, so impulses are exact. Seen from the film it is one tick ahead, in a frame that moves with the flange.

Unknown is l = F - F', F' the load that is assumed: that of the last step, changed further as it has changed
before, of all bodies that the film may touch. The film's step with its planes where a(F' + l) brings them
answers with F. Newton's steps dl = (1 + S C)^-1 (F - F' - l) find the root of the monotone residual. A step
beyond it is cut by the secant of the residual's work along C dl.

In C, M has J_a^T D J_a of MuJoCo's active constraints on it: a body on a table does not give way into it.
Bodies of a contact ratio below 0.5 bear the load one tick later; so do those of one below 2.5 while something
else holds them. A load that acts through n steps of MuJoCo acts h (n - 1) / (2 n) late in the mean, so they
are met where they will be by then. Met where they are, they would gain energy, as from any late spring.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Final, final

import numpy as np

from cosim.base.frames import Array, IntArray, Pose, cross
from cosim.coupling.contact.contact_exchange import (
    POSITION_TOLERANCE_M,
    TURN_LEVER_M,
    UNKNOWN,
    ContactExchange,
)
from cosim.coupling.contact.levers import Levers, SoftStepper
from cosim.coupling.robots.soft_robot import SoftReply
from cosim.errors import ConvergenceError
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import StepAccuracy

RATIO_BOUND: Final = 0.5
"""Contact ratio from which on bodies give way within the film's step.

A node, a spring and a body, the load a tick late: stable up to 1 with implicit Euler, 0.5 with BDF2.
"""
RENEW_ABOVE: Final = 1.2
"""Growth of the contacts' own stiffness beyond which bodies are weighed: the film's grows at most as much."""
_HELD_RATIO = 2.5  # the same, of bodies that something holds besides
_TRIALS_MAX, _GUESSES, _CUTS = 60, 20, 12
_LOOSER: Final = ((0, 1.0), (10, 10.0), (20, 100.0))
"""Trials after which film and bodies may be how many times as far apart: films that snap stay apart."""
_NEAR_M, _VERY_LIGHT = 2e-4, 30.0  # push that moves a film little; contact ratio of bodies first pushed out
_SHARE = 3.0  # of the film's residual in a step that is to be taken closely: what of loads may be left
_LEFT = 0.3  # share of a residual's work that a step may leave
_UNIT = np.array([1.0, 1.0, 1.0, TURN_LEVER_M, TURN_LEVER_M, TURN_LEVER_M])
_OTHER = 1.3  # the stiffness of contacts over that with which S was found, beyond which it is found anew
_FALLS_FAST = 0.25  # share of the residual that a step with a known S leaves, below which S serves
_RENEW_AFTER_S, _FEWEST_TICKS, _MOST_TICKS = 0.1, 10, 50


@final
@dataclass(frozen=True)
class LightBodiesState:
    """Where `LightBodies` are: the arguments are its attributes of these names.

    Args:
        heavy: (bodies that can be moved,), 1 for those that are met where they are.
        touching: (the same,) [N/m], stiffness of their contacts when they were weighed.
        ratio: largest contact ratio when they were.
        known: (b,) bodies of the last S.
        stiffness: S (6 b, 6 b).
        held_N_m: trace of the stiffness of the contacts with which it was found.
        room: how much stiffer their contacts may get until heavy bodies are weighed again.
        age: ticks of contact since that says who has to give way.
    """

    heavy: Annotated[IntArray, ("k",)]
    touching: Annotated[Array, ("k",)]
    ratio: float
    known: Annotated[IntArray, ("b",)]
    stiffness: Annotated[Array, ("n", "n")]
    held_N_m: float
    room: float
    age: int


@final
@dataclass(frozen=True)
class _Trial:
    """The film's step with bodies that give way to a change of their loads.

    Args:
        change: l (6 b,), assumed.
        residual: (6 b,), of the loads.
        away_m: how far it lets bodies go from where the film has met them.
        reply: of the soft side; None where it has not stepped.
    """

    change: Array
    residual: Array
    away_m: float
    reply: SoftReply | None


@final
class _Step:
    """The film's step of one tick, taken again with bodies that give way.

    `bodies` (b,) are those that may, `touched` (t,) those of them that bear a load in the last trial.

    Args:
        exchange: contacts; where they are now is where they are found.
        soft: soft side.
        tick: pose of the flange and loads at the end of the step, without contacts; its length [s].
        accuracy: how closely; as an ordinary step unless given.
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
            near = np.unique(self._planes.body)
            self.bodies = near[exchange.bodies.prediction.ahead[near] > 0]
        if self._planes is not None and len(self.bodies):
            self._centers = exchange.loads.centers[self.bodies]
            self._levers = Levers.of(self._planes, self.bodies, self._centers, self.before.positions)
            self._shift = np.zeros_like(self._levers.arm)
            self._assumed = exchange.assumed[self.bodies].ravel()
            self._ahead = exchange.bodies.prediction.lead[self.bodies]
            self._change = np.zeros_like(self._assumed)
            self._mobility: Array | None = None
            self._moved = np.zeros_like(self._ahead)
            most = self.mismatch_m(np.ones(6 * len(self.bodies)) * np.tile(_UNIT, len(self.bodies)))
            self._tolerance_N = 0.25 * POSITION_TOLERANCE_M / most
            if accuracy is not None:
                self._tolerance_N = min(self._tolerance_N, accuracy.tolerance_N)

    def take(self, change: Array | None = None) -> _Trial:
        """Take the step with bodies that give way to a change of their loads; to none unless given."""
        accuracy = self._accuracy
        if change is None:
            change = np.zeros(6 * len(self.bodies))
        moved = 0.0
        if len(self.bodies):
            moved = self._meet(change)
            start = None if accuracy is None else accuracy.start
            accuracy = StepAccuracy(self._tolerance_N, start, afresh=bool(self._shift.any()))
        if self.trials:
            # from where the film was pressed hard it may not come back
            reached = self._soft.state.positions if moved < _NEAR_M else None
            self._soft.restore(self.before)
            accuracy = StepAccuracy(self._tolerance_N, reached)
        loads = self._loads if self._planes is None else self._loads.touching(self._planes)
        self.trials += 1
        if accuracy is None:
            reply = self._soft.advance(self._flange, loads, self.tick_s)
        else:
            reply = self._soft.advance_accurately(self._flange, loads, self.tick_s, accuracy)
        self.iterations += reply.iterations
        reply = replace(reply, iterations=self.iterations)
        if not len(self.bodies):
            return _Trial(change, change, 0.0, reply)
        return self._tried(change, self._soft.state.positions, reply)

    def guess(self) -> Array:
        """Return the change of loads (6 b,) with which bodies give way to a film that keeps its velocity.

        A body of next to no mass hardly changes that; where none is, or none is pressed deep: zero.
        """
        change = np.zeros(6 * len(self.bodies))
        if self._planes is None or not len(change):
            return change
        x = self.before.positions + self.tick_s * self.before.velocities
        if self._planes.at(x).depth_m < _NEAR_M:
            return change
        if _ratio(self.stiffness(x, alone=True), self.mobility) < _VERY_LIGHT:
            return change
        return self.rest_on(x, change)

    def rest_on(self, x: Array, change: Array) -> Array:
        """Return the change of loads (6 b,) with which bodies give way to a film that stays at x (n, 3) [m].

        Args:
            x: of the film's nodes.
            change: to begin with.
        """

        def rests(change: Array) -> _Trial:
            self._meet(change)
            return self._tried(change, x, None)

        trial = rests(change)
        for _ in range(_GUESSES):
            step = self.newton_step(self.stiffness(x, alone=True), trial.residual)
            trial = _search(self, rests, trial, step)
            if self.mismatch_m(step) < _NEAR_M:
                break
        return trial.change

    def _tried(self, change: Array, x: Array, reply: SoftReply | None) -> _Trial:
        """Return the trial of a film at x (n, 3) [m] that has met bodies by a change (6 b,) of loads."""
        loads = self.answered(x)
        self.touched = self.bodies[loads.reshape(-1, 6).any(axis=1)]
        residual = loads - self._assumed - change
        if not residual.any():
            return _Trial(change, residual, 0.0, reply)
        further = self._motion(self._exchange.ahead(self.bodies, loads, self.tick_s)) - self._moved
        return _Trial(change, residual, _farthest_m(further), reply)

    @property
    def mobility(self) -> Array:
        """C (6 b, 6 b), how bodies give way under the loads that were last assumed."""
        if self._mobility is None:
            loads = self._assumed + self._change
            self._mobility = self._exchange.held_way(self.bodies, loads, self.tick_s)
        return self._mobility

    def newton_step(self, stiffness: Array, residual: Array) -> Array:
        """Return the change of loads (6 b,) that should take a residual away."""
        return np.asarray(np.linalg.solve(np.eye(len(residual)) + stiffness @ self.mobility, residual), float)

    def presses(self) -> bool:
        """Return whether the film presses on bodies where the last trial has ended."""
        assert self._planes is not None, "there are bodies"
        pressing = self._planes.at(self._soft.state.positions).normal_force > 0.0
        return bool((pressing | self._planes.glued)[self._levers.mine].any())

    def held_N_m(self) -> float:
        """Return the trace of the stiffness of the contacts where the last trial has ended."""
        assert self._planes is not None, "there are bodies"
        tangents = self._planes.at(self._soft.state.positions).tangent[self._levers.mine]
        return float(np.einsum("kii->", tangents))

    def mismatch_m(self, residual: Array) -> float:
        """Return how far a small residual of loads lets bodies go from where the film has met them."""
        return _farthest_m((self.mobility @ residual).reshape(-1, 6))

    def disagreement(self, trial: _Trial) -> float:
        """Return how far film and bodies are from agreeing, over what is good enough."""
        most = trial.away_m / POSITION_TOLERANCE_M
        if self._accuracy is not None:
            forces = np.abs(trial.residual.reshape(-1, 6) / _UNIT).max()
            most = max(most, float(forces) / (_SHARE * self._accuracy.tolerance_N))
        return most

    def stiffness(self, x: Array, *, alone: bool = False) -> Array:
        """Return S (6 b, 6 b) at nodes (n, 3) [m], where the last trial has ended; or of contacts alone."""
        assert self._planes is not None, "there are bodies"
        tangents, soft = self._planes.at(x).tangent, None if alone else self._soft
        return self._levers.stiffness(self._planes, tangents, soft, self.tick_s)

    def answered(self, x: Array) -> Array:
        """Return the loads (6 b,) of a film with nodes (n, 3) [m] on the bodies, about their centres."""
        assert self._planes is not None, "there are bodies"
        return self._levers.loads(self._planes.at(x).gradient[self._levers.mine])

    def _motion(self, ahead: Array) -> Array:
        """Return by what bodies that are ahead (b, 6) have moved (b, 6), at their centres of mass."""
        moved = ahead - self._ahead
        moved[:, :3] += cross(moved[:, 3:], self._centers)
        return moved

    def _meet(self, change: Array) -> float:
        """Let the film meet bodies where a change (6 b,) of loads brings them; return how far they go."""
        if np.array_equal(change, self._change):
            return 0.0
        self._change, self._mobility = change, None
        ahead = self._exchange.ahead(self.bodies, self._assumed + change, self.tick_s)
        self._moved = moved = self._motion(ahead)
        shift = self._levers.shift(moved)
        further, self._shift = shift - self._shift, shift
        if not further.any():
            return 0.0
        self._planes = self._exchange.move(self._levers.mine, further)
        self._exchange.loads.centers[self.bodies] = self._centers + moved[:, :3]
        return float(np.abs(further).max())


@final
class LightBodies:
    """Lets the bodies that the film can move give way to it.

    Args:
        exchange: contacts.
        soft: soft side.
        tick_s: h [s].
    """

    def __init__(self, exchange: ContactExchange, soft: SoftStepper, tick_s: float) -> None:
        self._exchange, self._soft, self._tick_s = exchange, soft, tick_s
        self._movable, count = exchange.movable, len(exchange.movable)
        self._heavy, self._touching = np.zeros(count, np.int64), np.zeros(count)
        self._known: IntArray = np.zeros(0, np.int64)
        self._stiffness, self._held = np.zeros((0, 0)), 0.0
        self._ticks = min(max(_FEWEST_TICKS, round(_RENEW_AFTER_S / tick_s)), _MOST_TICKS)
        self.ratio, self._room, self.trials = 0.0, RENEW_ABOVE, 1
        self._first = self.state
        self._meet_ahead()

    def advance(self, flange: Pose, loads: Loads, accuracy: StepAccuracy | None = None) -> SoftReply:
        """Take the soft step with the contacts that are there, and load the bodies.

        Args:
            flange: its pose at the end.
            loads: then, contacts not counted.
            accuracy: how closely; as an ordinary step unless given.

        Raises:
            ConvergenceError: the film's step has no solution, or bodies and film do not agree.
        """
        agreed = self._advance_as_met(flange, loads) if accuracy is None else None
        if agreed is not None:
            return agreed
        tick = flange, loads, self._tick_s
        step = _Step(self._exchange, self._soft, tick, accuracy)
        light = self.ratio > _VERY_LIGHT or not np.isin(step.bodies, self._known).all()
        try:
            trial = step.take(step.guess() if light else None)
        except ConvergenceError:
            if not light:
                raise
            trial = step.take()
        if len(step.bodies):
            touched = step.touched
            self._exchange.met += len(touched) > 0
            # what has been light may be held by something else by now
            new = not np.isin(touched, self._known).all()
            if len(touched) and new:
                self._learn(step)
                self._exchange.met = 0
                if self._are_heavy(self._stiffness, self._exchange.bodies.mobilities(self._known)):
                    self._heavy[np.isin(self._movable, touched)] = 1
                    self._meet_ahead()
                    self._soft.restore(step.before)
                    step = _Step(self._exchange, self._soft, tick, accuracy)
                    trial = step.take()
                else:
                    self._tell_exchange()
            if len(step.bodies):
                trial = self._agree(step, trial)
        assert trial.reply is not None, "the film has stepped"
        self.trials = step.trials
        self._exchange.commit(step.before.positions, self._soft.state.positions)
        self.update()
        return trial.reply

    def _advance_as_met(self, flange: Pose, loads: Loads) -> SoftReply | None:
        """Take the soft step once, for bodies that go where the film meets them; None: they may not."""
        exchange, soft, before, tick_s = self._exchange, self._soft, self._soft.state, self._tick_s
        planes = exchange.find(before, tick_s)
        gives_way, known = exchange.may_give_way()
        if not known:
            return None
        try:
            acting = loads if planes is None else loads.touching(planes)
            reply = soft.advance(flange, acting, tick_s)
        except ConvergenceError:
            if gives_way:
                return None
            raise
        x = soft.state.positions
        if gives_way and not exchange.disagreement(x, reply.residual_N, tick_s) <= 1.0:
            soft.restore(before)
            return None
        exchange.commit(before.positions, x)
        self.update()
        return reply

    def begin_ticks_of(self, tick_s: float) -> None:
        """Take ticks of another length from now on; what was weighed in others is forgotten."""
        self._tick_s = tick_s
        self.state = self._first

    def update(self) -> None:
        """Find again which bodies are heavy, where the last tick asks for it."""
        if self._heavy_are_due():
            self._weigh_heavy()
        elif self._exchange.met >= self._ticks:
            self._weigh_light()

    def _heavy_are_due(self) -> bool:
        """Return whether heavy bodies are to be weighed: released ones, and after a time or a firmer grip."""
        if not np.count_nonzero(self._heavy):
            return False
        heavy = self._heavy != 0
        released = self._exchange.loads.loaded[self._movable] == 0
        firmer = self._exchange.held_N_m[self._movable] > RENEW_ABOVE * self._touching
        return bool((heavy & (released | firmer | (self._exchange.age >= self._ticks))).any())

    def _weigh_heavy(self) -> None:
        exchange = self._exchange
        held, planes = exchange.held_N_m[self._movable], exchange.sticking
        loaded = exchange.bodies.bearing[self._movable] != 0
        if self._heavy[~loaded].any():  # whoever touches them next finds out again
            self._known, self._stiffness = np.zeros(0, np.int64), np.zeros((0, 0))
        self._heavy[~loaded] = 0
        # where contacts are as stiff as when S was found, that serves; bodies just found heavy have it
        before = self._touching * RENEW_ABOVE / self._room
        before = np.where(before > 0.0, before, held)
        exchange.age = 0
        heavy = self._heavy != 0
        touched, stiffer = self._movable[heavy], (held > RENEW_ABOVE * before)[heavy].any()
        if planes is not None and len(touched):
            if stiffer or not np.isin(touched, self._known).all():
                x = self._soft.state.positions
                levers = Levers.of(planes, touched, exchange.loads.centers[touched], x)
                found = levers.stiffness(planes, planes.at(x).tangent, self._soft, self._tick_s)
                self._known, self._stiffness, self._held, before = touched, found, 0.0, held
            if not self._are_heavy(self._known_stiffness(touched), exchange.bodies.mobilities(touched)):
                self._heavy[:] = 0
        self._touching[:] = np.where(self._heavy, before * self._room / RENEW_ABOVE, 0.0)
        self._meet_ahead()

    def _weigh_light(self) -> None:
        """Find again whether bodies that give way are light: something else may hold them by now."""
        exchange, known, x = self._exchange, self._known, self._soft.state.positions
        planes, exchange.met = exchange.planes, 0
        touched = known[exchange.bodies.bearing[known] != 0]
        if planes is None or not len(touched):
            return
        levers = Levers.of(planes, known, exchange.loads.centers[known], x)
        tangents = planes.at(x).tangent
        held = float(np.einsum("kii->", tangents[levers.mine]))
        if not self._held / _OTHER < held < self._held * _OTHER:
            self._stiffness = levers.stiffness(planes, tangents, self._soft, self._tick_s)
            self._held = held
        mobilities = exchange.bodies.mobilities(known)
        if self._are_heavy(self._stiffness, mobilities):
            self._heavy[np.isin(self._movable, touched)] = 1
            self._meet_ahead()
        else:
            self._tell_exchange(mobilities[1])

    @property
    def state(self) -> LightBodiesState:
        """What the next tick depends on."""
        return LightBodiesState(
            self._heavy.copy(), self._touching.copy(), self.ratio, self._known, self._stiffness, self._held,
            self._room, self._exchange.met,
        )  # fmt: skip

    @state.setter
    def state(self, found: LightBodiesState) -> None:
        # the scene has been restored before
        self._heavy[:], self._touching[:], self.ratio = found.heavy, found.touching, found.ratio
        self._known, self._stiffness, self._held = found.known, found.stiffness, found.held_N_m
        self._room, self._exchange.met = found.room, found.age
        self._meet_ahead()

    def _meet_ahead(self) -> None:
        self._exchange.bodies.prediction.ahead[self._movable] = 1 - 2 * self._heavy
        self._tell_exchange()

    def _tell_exchange(self, free: Array | None = None) -> None:
        """Let the exchange know how known bodies go from where the film has met them, unless held.

        What else holds them only makes them go less far.

        Args:
            free: (6 b, 6 b), mobility of the known bodies where nothing else holds them, where it is known.
        """
        gives = self._exchange.gives
        gives[:] = UNKNOWN
        if not len(self._known) or self.ratio > _VERY_LIGHT:
            return
        bodies = self._exchange.bodies
        if free is None:
            free = bodies.mobility(self._known, held=False)
        mobility = bodies.way_s2(self._tick_s) * free
        for k, body in enumerate(self._known.tolist()):
            own = slice(6 * k, 6 * k + 3)
            alone = np.zeros_like(mobility[own])
            alone[:, own] = mobility[6 * k, 6 * k] * np.eye(3)
            # on joints, or as one of several, it goes where others go
            if np.abs(mobility[own] - alone).max() < 1e-9 * mobility[6 * k, 6 * k]:
                turn = mobility[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6]
                largest = float(np.linalg.eigvalsh(turn)[-1])
                gives[body] = (
                    mobility[6 * k, 6 * k] / POSITION_TOLERANCE_M,
                    TURN_LEVER_M * largest / POSITION_TOLERANCE_M,
                )

    def _are_heavy(self, stiffness: Array, mobilities: tuple[Array, Array]) -> bool:
        """Return whether bodies need not give way, by S and both mobilities (6 b, 6 b), held and free.

        What holds them may let go of them: so they need some mass of their own.
        """
        held, free = (_ratio(stiffness, self._tick_s**2 * mobility) for mobility in mobilities)
        self.ratio = free
        most = min(RATIO_BOUND / max(held, 1e-9), _HELD_RATIO / max(free, 1e-9))
        self._room = max(RENEW_ABOVE, most)
        return held <= RATIO_BOUND and free <= _HELD_RATIO

    def _learn(self, step: _Step) -> None:
        """Find S where the last trial has ended."""
        self._known, self._stiffness = step.bodies, step.stiffness(self._soft.state.positions)
        self._held = step.held_N_m()
        self._tell_exchange()

    def _agree(self, step: _Step, trial: _Trial) -> _Trial:
        """Let bodies give way until they go where the film has met them."""
        left, fresh = step.disagreement(trial), False
        while left > max(share for after, share in _LOOSER if step.trials >= after):
            if step.trials >= _TRIALS_MAX:
                raise self._error(step, trial.away_m)
            held = step.held_N_m()
            if not step.presses():  # they have come off: back to where the film is now
                trial = step.take(step.rest_on(self._soft.state.positions, trial.change))
                left = step.disagreement(trial)
                continue
            if not self._held / _OTHER < held < self._held * _OTHER:
                self._learn(step)
                fresh = True
            stiffness = self._known_stiffness(step.bodies)
            change = step.newton_step(stiffness, trial.residual)
            trial = _search(step, step.take, trial, change)
            before, left = left, step.disagreement(trial)
            if fresh and left > 0.5 * before and trial.away_m < 10.0 * POSITION_TOLERANCE_M:
                break  # what the film's own residual leaves
            fresh = False
            if left > _FALLS_FAST * before:
                self._held = 0.0
        return trial

    def _known_stiffness(self, bodies: IntArray) -> Array:
        """Return S of bodies (b,), where it is known."""
        known = np.flatnonzero(np.isin(bodies, self._known))
        found = np.searchsorted(self._known, bodies[known])
        mine, rows = ((6 * places[:, None] + np.arange(6)).ravel() for places in (known, found))
        stiffness = np.zeros((6 * len(bodies), 6 * len(bodies)))
        stiffness[np.ix_(mine, mine)] = self._stiffness[np.ix_(rows, rows)]
        return stiffness

    def _error(self, step: _Step, away: float) -> ConvergenceError:
        bodies, touched = self._exchange.bodies, step.touched if len(step.touched) else step.bodies
        names = ", ".join(bodies.names(touched))
        heavier = max(self.ratio, RATIO_BOUND) / RATIO_BOUND
        least = ", ".join(f"{heavier * mass:.3g} kg" for mass in bodies.masses_kg(touched))
        return ConvergenceError(
            f"film and touched bodies ({names}) do not agree after {step.trials} trials of a tick: these "
            f"would be {1e3 * away:.3g} mm from where the film meets them; try a shorter clock.tick_s, or "
            f"give them at least {least}, which needs no trials",
            away,
            step.iterations,
        )


def _search(step: _Step, take: Callable[[Array], _Trial], trial: _Trial, change: Array) -> _Trial:
    """Return a trial along a change (6 b,) of what was assumed, cut where it goes too far.

    The work of the residual along the motion falls through zero; where it is, is bracketed (Illinois method).
    """
    motion = step.mobility @ change
    work = low_work = float(trial.residual @ motion)
    low, high, high_work, here = 0.0, 0.0, 0.0, 1.0
    for cuts in range(_CUTS):
        try:
            found = take(trial.change + here * change)
        except ConvergenceError:
            if cuts == _CUTS - 1:
                raise
            here = 0.5 * (low + here)  # too deep in the film
            continue
        now = float(found.residual @ motion)
        if abs(now) <= _LEFT * work or step.disagreement(found) < 1.0:
            break
        if now < 0.0:
            high, high_work, low_work = here, now, low_work if high == 0.0 or here > high else 0.5 * low_work
        elif high == 0.0:
            break
        else:
            low, low_work, high_work = here, now, 0.5 * high_work
        share = low_work / (low_work - high_work)
        here = low + (high - low) * min(max(share, 0.05), 0.95)
    return found


def _farthest_m(motion: Array) -> float:
    """Return the largest part of motions (b, 6), turns at a lever."""
    away = np.abs(motion)
    return float(max(away[:, :3].max(), TURN_LEVER_M * away[:, 3:].max()))


def _ratio(stiffness: Array, mobility: Array) -> float:
    """Return the largest eigenvalue of S C."""
    return float(np.linalg.eigvals(stiffness @ mobility).real.max(initial=0.0))
