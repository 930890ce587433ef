"""The states at rest at the ends of phases, on the run's mesh and on the mesh refined once. Held rings have
the positions of the refined mesh at the time when they are first held. If no state at rest is found near that
of the run, it is found by continuation from the phase before. A section model is compared with its film at
rest.
"""

from dataclasses import replace
from typing import Final, final

from cosim.bars.budget import Budget
from cosim.bars.finer_mesh import ITERATIONS_MAX, NO_FILM_CONTACT, PATIENCE, FinerMesh, Pair, better_start
from cosim.bars.source_film import SourceFilm
from cosim.build.soft_model import SoftModel
from cosim.coupling.robots.beam_robot import BeamRobotState
from cosim.coupling.robots.film_robot import FilmRobot, FilmRobotState
from cosim.errors import ConvergenceError, InputError
from cosim.soft.solve.clamp import Clamp
from cosim.soft.solve.state import Equilibrium, SoftState
from cosim.telemetry.phase_ends import PhaseEnd

_SHORT: Final = 60
"""Iterations of each search on the refined mesh by default: a state that is near is found in about ten."""


def at_rest(side: FilmRobot, state: FilmRobotState, start: SoftState | None = None) -> Equilibrium:
    """Return the equilibrium near a state of the run, and set its clamp.

    Args:
        side: the body.
        state: of the run.
        start: near that state; None: the state itself.

    Raises:
        ConvergenceError: no equilibrium was found near it.
    """
    if not state.clamp.holds_as(side.clamp):
        side.hold(state.clamp)
    soft = SoftState.at_rest(state.soft.positions, state.soft.memory, state.soft.touching)
    return side.find_rest(start or soft, state.flange, state.loads, ITERATIONS_MAX, PATIENCE)


@final
class RestingStates:
    """Solves the states at rest at the ends of a run's phases, each once.

    Attributes: `side`, the film on the run's mesh; `source`, film and chain of a run with a section model,
    otherwise None; `pairs`, the known states at rest, by phase end.

    Args:
        model: of the run's soft robot.
        ends: of its phases.
        budget: of the searches.
        thorough: whether searches on the refined mesh may take many iterations.

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
        """The refined mesh, built on first access.

        Raises:
            MeshError: it is not a mesh of the same body.
        """
        if self._mesh is None:
            most = ITERATIONS_MAX if self._thorough else _SHORT
            self._mesh = FinerMesh(self.side.body, self._model.refined(1), most)
            self._mesh.side.effort.check = self._budget.check
        return self._mesh

    @property
    def iterations(self) -> int:
        """Iterations of Newton's method on the refined mesh."""
        return 0 if self._mesh is None else self._mesh.iterations

    def film(self, index: int) -> FilmRobotState:
        """Return the film at a phase end, for a section model in the shape of its chain."""
        state = self.ends[index].state
        if isinstance(state, BeamRobotState):
            assert self.source is not None, "only a run with a section model has such states"
            if index not in self._films:
                self._films[index] = self.source.state(state)
            return self._films[index]
        assert isinstance(state, FilmRobotState), "other models have no such states"
        return state

    def pair(self, index: int) -> Pair | None:
        """Return the states at rest at a phase end; None if the clamp of the refined mesh is unknown.

        Raises:
            ConvergenceError: no equilibrium was found near that of the run.
            TooDearError: the processor time is spent.
        """
        if index not in self.pairs:
            self._budget.check()
            held = self._held(index)
            if held is None:
                return None
            self.pairs[index] = self._solved(index, *held)
        return self.pairs[index]

    def _held(self, index: int) -> tuple[Clamp, Pair | None] | None:
        """Return the clamp of the refined mesh at a phase end, and a pair whose difference may be added.

        None if the clamp is unknown. Nodes are held at their positions when they were first held.
        """
        film = self.film(index)
        if film.clamp.holds_as(Clamp.of_base(self.side.body)):
            return self.mesh.clamp(film.clamp), None
        others = (k for k in range(index, -1, -1) if not self.film(k).clamp.holds_as(film.clamp))
        since = next(others, -1)
        before = self.pair(since) if since >= 0 and not self.ends[since].why_not else None
        if before is None:
            return None
        other = before if self.ends[index - 1].why_not else self.pair(index - 1)
        return self.mesh.clamp(film.clamp, before), other

    def _solved(self, index: int, clamp: Clamp, other: Pair | None) -> Pair:
        rest = self._at_rest(index)
        try:
            finer = self.mesh.at_rest(clamp, rest, other)
        except ConvergenceError:
            earlier = self._earlier(index)
            if earlier is None:
                raise
            finer = self.mesh.followed(clamp, rest, earlier.finer)
        return Pair(rest, finer, clamp)

    def _at_rest(self, index: int) -> Equilibrium:
        """Return the film at rest at a phase end.

        The shape of a bent chain may have folds of the film; then it is found by continuation.

        Raises:
            ConvergenceError: no equilibrium was found near that of the run.
        """
        side, film = self.side, self.film(index)
        try:
            return at_rest(side, film, self._start(index))
        except ConvergenceError:
            earlier = None if self.source is None else self._earlier(index)
            if earlier is None:
                raise
            side.commit(earlier.rest)
            return side.follow(earlier.rest, film.flange, film.loads)

    def _start(self, index: int) -> SoftState | None:
        """Return the start of a film in the shape of a chain; None for a run with a film.

        The difference of film and chain one phase earlier may be added.
        """
        if self.source is None:
            return None
        side, film, earlier = self.side, self.film(index), self.pairs.get(index - 1)
        if not film.clamp.holds_as(side.clamp):
            side.hold(film.clamp)
        starts = [film.soft]
        if earlier is not None:
            before = self.film(index - 1)
            turn = film.flange.rotation @ before.flange.rotation.T
            difference = (earlier.rest.state.positions - before.soft.positions) @ turn.T
            starts.append(SoftState.at_rest(film.soft.positions + difference, earlier.rest.state.memory))
        start = better_start(side, starts, film.flange, film.loads)
        presses = side.films is not None and side.films.presses_at_rest(start.positions)
        return replace(start, touching=NO_FILM_CONTACT) if presses else start

    def _earlier(self, index: int) -> Pair | None:
        """Return the states at rest one phase earlier, if the film had the same clamp."""
        if not index or self.ends[index - 1].why_not:
            return None
        if not self._thorough and index - 1 not in self.pairs:
            return None
        clamps = [self.film(k).clamp for k in (index - 1, index)]
        return self.pair(index - 1) if clamps[0].holds_as(clamps[1]) else None
