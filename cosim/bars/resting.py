"""The states at rest at the ends of phases, on the run's mesh and on that refined once.

Rings that a phase holds are held where the refined mesh has them when they are first held: that state is
solved before. Where no state at rest is found near that of the run, it is followed from the end of the phase
before. A section model is compared with the film that it was condensed from, which is brought to rest first.
"""

from dataclasses import replace
from typing import Final, final

from cosim.bars.budget import Budget
from cosim.bars.finer_mesh import (
    ITERATIONS_MAX,
    NOTHING_PRESSES,
    PATIENCE,
    FinerMesh,
    Pair,
    least_out_of_balance,
)
from cosim.bars.source_film import SourceFilm
from cosim.build.soft_model import SoftModel
from cosim.coupling.robots.beam_robot import BeamRobotState
from cosim.coupling.robots.film_robot import FilmRobot, FilmRobotState
from cosim.errors import ConvergenceError, InputError
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState
from cosim.telemetry.phase_ends import PhaseEnd

_SHORT: Final = 60
"""Iterations of each try on the refined mesh unasked: where a state is near, it is found in some ten."""


def at_rest(side: FilmRobot, state: FilmRobotState, start: SoftState | None = None) -> Equilibrium:
    """Return where a body that has stopped at a state of its run comes to rest; it is held as there then.

    Args:
        side: the body.
        state: of the run.
        start: near it; None: the state itself.

    Raises:
        ConvergenceError: no equilibrium was found near it.
    """
    if not state.clamp.holds_as(side.clamp):
        side.hold(state.clamp)
    soft = SoftState.at_rest(state.soft.positions, state.soft.memory, state.soft.touching)
    return side.find_rest(start or soft, state.flange, state.loads, ITERATIONS_MAX, PATIENCE)


@final
class RestingStates:
    """Finds the states at rest at the ends of a run's phases, each once.

    Attributes: `side`, the film on the run's mesh; `source`, of a run with a section model that film and the
    chain, else None; `pairs`, what is known.

    Args:
        model: of the run's soft robot.
        ends: of its phases.
        budget: of the searches.
        thorough: whether the refined mesh is searched for long where no state at rest is near.

    Raises:
        InputError: the ends are of another soft robot.
    """

    def __init__(
        self, model: SoftModel, ends: tuple[PhaseEnd, ...], budget: Budget, *, thorough: bool
    ) -> None:
        self._model, self.ends, self._budget, self._thorough = model, ends, budget, thorough
        self.source = None if model.section is None else SourceFilm(model.chain(), model.refined(0))
        self.side = self._film_side()
        self.side.effort.check = budget.check
        self.pairs: dict[int, Pair] = {}
        self._mesh: FinerMesh | None = None
        self._films: dict[int, FilmRobotState] = {}
        self._check()

    def _check(self) -> None:
        """Check that the phase ends are of the model.

        Raises:
            InputError: they are not.
        """
        chain = None if self.source is None else self.source.chain
        kind = FilmRobotState if chain is None else BeamRobotState
        for end in self.ends:
            if not isinstance(end.state, kind):
                raise InputError(f"the phase ends are of a {type(end.state).__name__}, not a {kind.__name__}")
            end.state.check(self.side.body.nodes if chain is None else len(chain.section.frames))

    def _film_side(self) -> FilmRobot:
        if self.source is not None:
            return self.source.film
        side = self._model.side()
        assert isinstance(side, FilmRobot), "nothing else has a refined mesh"
        return side

    @property
    def mesh(self) -> FinerMesh:
        """The refined mesh, built when it is first asked for.

        Raises:
            MeshError: it is not that of the same body.
        """
        if self._mesh is None:
            most = ITERATIONS_MAX if self._thorough else _SHORT
            self._mesh = FinerMesh(self.side.body, self._model.refined(1), most)
            self._mesh.side.effort.check = self._budget.check
        return self._mesh

    @property
    def iterations(self) -> int:
        """Of Newton's method on the refined mesh."""
        return 0 if self._mesh is None else self._mesh.iterations

    def film(self, place: int) -> FilmRobotState:
        """Return the film at a phase end; that of a section model in the shape of its chain."""
        state = self.ends[place].state
        if isinstance(state, BeamRobotState):
            assert self.source is not None, "only a run with a section model has such states"
            if place not in self._films:
                self._films[place] = self.source.state(state)
            return self._films[place]
        assert isinstance(state, FilmRobotState), "other models keep none"
        return state

    def pair(self, place: int) -> Pair | None:
        """Return the states at rest at a phase end; None where it is not known how it is held.

        Raises:
            ConvergenceError: no equilibrium was found near that of the run.
            TooDearError: it is not there yet, and all that it may cost is spent.
        """
        if place not in self.pairs:
            self._budget.check()
            held = self._held(place)
            if held is None:
                return None
            self.pairs[place] = self._solved(place, *held)
        return self.pairs[place]

    def _held(self, place: int) -> tuple[Clamp, Pair | None] | None:
        """Return what holds the refined mesh at a phase end, and a pair whose difference may be taken along.

        None where that is not known. What an earlier phase began to hold is held where that phase began.
        """
        film = self.film(place)
        if film.clamp.holds_as(Clamp.of_base(self.side.body)):
            return self.mesh.clamp(film.clamp), None
        others = (k for k in range(place, -1, -1) if not self.film(k).clamp.holds_as(film.clamp))
        since = next(others, -1)
        before = self.pair(since) if since >= 0 and not self.ends[since].why_not else None
        if before is None:
            return None
        along = before if self.ends[place - 1].why_not else self.pair(place - 1)
        return self.mesh.clamp(film.clamp, before), along

    def _solved(self, place: int, clamp: Clamp, along: Pair | None) -> Pair:
        rest = self._at_rest(place)
        try:
            finer = self.mesh.at_rest(clamp, rest, along)
        except ConvergenceError:
            earlier = self._earlier(place)
            if earlier is None:
                raise
            finer = self.mesh.followed(clamp, rest, earlier.finer)
        return Pair(rest, finer, clamp)

    def _at_rest(self, place: int) -> Equilibrium:
        """Return the film at rest at a phase end.

        The film that a bent chain draws may have folds that no film has: then it is followed there.

        Raises:
            ConvergenceError: no equilibrium was found near that of the run.
        """
        side, film = self.side, self.film(place)
        try:
            return at_rest(side, film, self._start(place))
        except ConvergenceError:
            earlier = None if self.source is None else self._earlier(place)
            if earlier is None:
                raise
            side.commit(earlier.rest)
            return side.follow(earlier.rest, film.flange, film.loads)

    def _start(self, place: int) -> SoftState | None:
        """Return where a film that a chain has drawn begins; None of a run with a film.

        What the film at rest was off the chain one phase earlier may be taken along.
        """
        if self.source is None:
            return None
        side, film, earlier = self.side, self.film(place), self.pairs.get(place - 1)
        if not film.clamp.holds_as(side.clamp):
            side.hold(film.clamp)
        starts = [film.soft]
        if earlier is not None:
            before = self.film(place - 1)
            turn = film.flange.rotation @ before.flange.rotation.T
            away = (earlier.rest.state.positions - before.soft.positions) @ turn.T
            starts.append(SoftState.at_rest(film.soft.positions + away, earlier.rest.state.memory))
        start = least_out_of_balance(side, starts, film.flange, film.loads)
        presses = side.films is not None and side.films.press_at_rest(start.positions)
        return replace(start, touching=NOTHING_PRESSES) if presses else start

    def _earlier(self, place: int) -> Pair | None:
        """Return the states at rest one phase earlier, if the film was held in the same way."""
        if not place or self.ends[place - 1].why_not:
            return None
        if not self._thorough and place - 1 not in self.pairs:
            return None
        clamps = [self.film(k).clamp for k in (place - 1, place)]
        return self.pair(place - 1) if clamps[0].holds_as(clamps[1]) else None
