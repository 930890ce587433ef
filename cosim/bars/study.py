"""How far the figures at the ends of a finished run's phases may be off, by mesh, tick and solver.

Mesh: the state at rest under the loads of the phase's end is found on the run's mesh and on that refined
once; their difference, times a factor that was calibrated (docs/run_error.md). Tensions that a target was
reached with are searched for again on both. Section models: besides, the difference of the chain at rest to
the film that it was condensed from; what follows is of that film, and of no ticks. Tick: see `Swings`.
Solver: a residual of the tolerance in each component, independent of one another, moves the tip by
tolerance |K^-1 g|, g the tip's gradient.
"""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final, final

import numpy as np

from cosim.bars.budget import Budget, TooDearError
from cosim.bars.calibration import (
    FIGURES,
    TICK_FACTOR,
    apart,
    calibration_of,
    tension_apart,
    tension_difference,
)
from cosim.bars.finer_mesh import Pair
from cosim.bars.resting import RestingStates
from cosim.bars.source_film import SourceFilm
from cosim.bars.swings import Modes, Swings, tip_pulls
from cosim.base.kept_parts import KeptParts
from cosim.build.options import dynamic_options
from cosim.build.soft_model import SoftModel
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.coupling.robots.beam_robot import BeamRobotState
from cosim.coupling.robots.film_robot import FilmRobot, FilmRobotState
from cosim.errors import ConvergenceError, MeshError, OutOfRangeError, UnreachableError
from cosim.plan.tip_targets import wanted_tip
from cosim.soft.beams.beam_rings import stiffener_strain
from cosim.soft.solve import tip_target
from cosim.soft.solve.state import Equilibrium
from cosim.telemetry.phase_ends import PhaseEnd, PhaseEnds
from cosim.telemetry.run_errors import RunErrors

SHARE: Final = 0.25
"""Of the run's processor time, that of all phases at most; else it is the last one alone."""
_MOST: Final = 4.0
"""Times as much, that of the last phase at most."""
LEAST_s: Final = 3.0
"""That may be spent on any run."""
_SECTION_s: Final = 15.0
"""The same of a section model, which always takes less than its film."""
FILM_NODES_MAX: Final = 2500
"""Of the film of a section model: with more, a phase takes 10 s and longer, a run a second or two."""
_USUAL_s: Final = 2e-4
"""Processor time of a phase end, for each node of the run's mesh."""
_TOLD_ABOVE_s: Final = 1.0
_ELSEWHERE: Final = 0.6
"""Of the length: farther away, the refined mesh is on another branch."""
_NOT_AT_REST: Final = "no state at rest was found near its end, on the run's mesh or on the refined one"
_HELD: Final = "rings are held where the run's mesh had them, which on the refined mesh is not known"
_ONLY_LAST: Final = "only of the last phase and those it needs, as more would cost over a quarter of the run"
_TOO_DEAR: Final = "it would cost more than the run; --error works it out all the same"


def shape_figures(side: FilmRobot, shape: Any, flange: tuple[Any, Any]) -> dict[str, Any]:
    """Return tip (3,) [m], sag, length [m], volume [m^3], largest strain of the stiffeners, None without.

    Args:
        side: whose body it is.
        shape: (n, 3) [m].
        flange: its origin (3,) [m] and z axis (3,).
    """
    found = side.shape_reader().figures([shape])
    strain = stiffener_strain(side.body, shape)
    return {
        "tip_m": found.tip_position[0],
        "sag_m": float(found.sag_m(flange[0][None], flange[1][None])[0]),
        "length_m": float(found.center_line_m[0]),
        "volume_m3": float(found.volumes_m3[0].sum()),
        "peak_strain": None if strain is None else strain.peak,
    }


def differences(one: dict[str, Any], other: dict[str, Any]) -> dict[str, float]:
    """Return how far the figures of two shapes are apart, those that both have."""
    return {
        key: float(np.linalg.norm(np.subtract(value, other[key])))
        for key, value in one.items()
        if value is not None and other[key] is not None
    }


def find_bars(
    scenario: Scenario,
    kept: PhaseEnds,
    tell: Callable[[str], None],
    *,
    everywhere: bool,
    parts: KeptParts | None = None,
) -> RunErrors:
    """Return the error bars of a run: at all phase ends, or at the last where that would cost much of it.

    Args:
        scenario: of the run.
        kept: of the run.
        tell: told in a sentence if it takes more than a second.
        everywhere: at all phase ends, whatever it costs.
        parts: that may be used again.

    Raises:
        InputError: the phase ends are of another soft robot.
    """
    began, share_s = time.perf_counter(), SHARE * kept.cpu_s
    if isinstance(scenario.soft_robot, GivenBodyTable):
        return RunErrors(reason="the soft robot is given as arrays, which cannot be refined")
    if scenario.fidelity == "rigid" or not kept.ends:
        frozen = scenario.fidelity == "rigid"
        return RunErrors(reason="the shape is frozen" if frozen else "the run ended before a phase did")
    model = SoftModel(scenario, KeptParts() if parts is None else parts, None, tell)
    if not everywhere and (why := _too_dear(model, share_s)):
        return RunErrors(reason=why)
    least_s = LEAST_s if model.section is None else _SECTION_s
    budget = Budget(math.inf if everywhere else max(_MOST * share_s, least_s))
    study, reason = ErrorStudy(scenario, model, kept, budget), None
    if len(kept.ends) * _USUAL_s * model.body.nodes > _TOLD_ABOVE_s:
        tell("Working out how far the figures may be off")
    try:
        reason = study.find(math.inf if everywhere else share_s)
    except MeshError as error:
        reason = str(error)
    return RunErrors(study.found, reason, study.states.iterations, time.perf_counter() - began)


def _too_dear(model: SoftModel, share_s: float) -> str:
    """Return why even one phase end is too dear unasked; empty if it is not.

    Args:
        model: of the soft robot.
        share_s: processor time that all phase ends may take.
    """
    nodes = model.body.nodes
    if model.section is None:
        return _TOO_DEAR if _USUAL_s * nodes > max(_MOST * share_s, LEAST_s) else ""
    if nodes <= FILM_NODES_MAX:
        return ""
    return f"with a film of {nodes} nodes it takes 10 s and longer; --error works it out all the same"


@final
class ErrorStudy:
    """Works out the error bars of a finished run.

    Attributes: `states`, those at rest; `found`, the bars by the phase's index, see `RunErrors`.

    Args:
        scenario: of the run.
        model: of its soft robot, which has a refined mesh.
        kept: of the run.
        budget: of all searches.
    """

    def __init__(self, scenario: Scenario, model: SoftModel, kept: PhaseEnds, budget: Budget) -> None:
        self._scenario, self._budget = scenario, budget
        self.states = RestingStates(model, kept.ends, budget, thorough=math.isinf(budget.most_s))
        self.found: dict[int, dict[str, Any]] = {}
        self._swings: Swings | None = None
        if len(kept.moments):
            body, options = self.states.side.body, dynamic_options(scenario)
            self._swings = Swings(body, kept.moments, scenario.clock.tick_s, options)

    def find(self, share_s: float) -> str | None:
        """Find the bars from the last phase to the first; return why phases are left out, None: none is.

        Args:
            share_s: processor time that all phases may take; else it is the last alone, with those it needs.

        Raises:
            MeshError: the refined mesh is not that of the same body.
        """
        ends, states, dear = self.states.ends, self.states, False
        for place in reversed(range(len(ends))):
            if len(self.found) == 1:
                dear = self._budget.spent_s / max(1, len(states.pairs)) * len(ends) > share_s
            if not dear or place in states.pairs:  # what the last one has needed is there
                self.found[ends[place].phase] = self._of(place)
        return _ONLY_LAST if len(self.found) < len(ends) else None

    def _of(self, place: int) -> dict[str, Any]:
        """Return the bars of a phase's end with their parts, or the reason why the end has no bar."""
        none: dict[str, Any] = dict.fromkeys(FIGURES)
        try:
            parts, why_not = self._compared(place)
        except ConvergenceError:
            parts, why_not = {}, _NOT_AT_REST
        except TooDearError:
            parts, why_not = {}, _TOO_DEAR
        if why_not:
            return none | {"reason": why_not}
        bars = {key: sum(part.get(key, 0.0) for part in parts.values()) for key in parts["of_mesh"]}
        return none | bars | parts | {"reason": None}

    def _compared(self, place: int) -> tuple[dict[str, Any], str]:
        """Return the parts of the bars; or why there are none.

        Raises:
            ConvergenceError: there is no state at rest near that of the run.
            TooDearError: all that it may cost is spent before.
        """
        end, states = self.states.ends[place], self.states
        pair = None if end.why_not else states.pair(place)
        if pair is None:
            return {}, end.why_not or _HELD
        side, mesh, film = states.side, states.mesh, states.film(place)
        if not film.clamp.holds_as(side.clamp):
            side.hold(film.clamp)
        mesh.hold(pair.clamp)
        frame = (film.flange.translation, film.flange.rotation[:, 2])
        here = shape_figures(side, pair.rest.state.positions, frame)
        away = differences(here, shape_figures(mesh.side, pair.finer.state.positions, frame))
        if pair.rest.negative_pivots or pair.finer.negative_pivots:
            return {}, "the state at rest near its end is unstable"
        if away["tip_m"] > _ELSEWHERE * here["length_m"]:
            return {}, "the refined mesh comes to rest on another branch, far away"
        wanted, calibration = self._wanted(end), calibration_of(self._scenario)
        away = apart(away, here, calibration) | self._of_tension(wanted, pair, away["tip_m"])
        parts: dict[str, Any] = {}
        if states.source is not None:
            parts["of_section"] = self._of_section(states.source, end.state, here, wanted, pair)
        return parts | {
            "of_mesh": {key: calibration.factors[key] * value for key, value in away.items()},
            "of_tick": {} if self._swings is None else self._of_tick(self._swings, end.tick, film, pair.rest),
            "of_solver": dict.fromkeys(("tip_m", "sag_m", "length_m"), self._of_solver(side, pair.rest)),
        }, ""

    def _wanted(self, end: PhaseEnd) -> tip_target.TipTarget | None:
        """Return the target that cables bring the tip to in a phase, if there is one."""
        target = self._scenario.phases[end.phase].tip_target
        return wanted_tip(target) if target is not None and target.reach_with == "cables" else None

    def _of_tension(self, wanted: tip_target.TipTarget | None, pair: Pair, tip_m: float) -> dict[str, float]:
        """Return how far the tensions are apart that a phase's target is reached with on both meshes."""
        if wanted is None:
            return {}
        side, finer = self.states.side, self.states.mesh.side
        with suppress(UnreachableError, ConvergenceError, OutOfRangeError):
            here = side.find_tensions(pair.rest, wanted).loads
            there = finer.find_tensions(pair.finer, wanted).loads
            slope = side.tension_slope(pair.rest, wanted)
            most_N, away_N = max(here.cable_tension_N), tension_difference(here, there)
            return {"cable_tension_N": tension_apart(most_N, away_N, slope * tip_m)}
        return {}

    def _of_section(
        self,
        source: SourceFilm,
        state: BeamRobotState,
        here: dict[str, Any],
        wanted: tip_target.TipTarget | None,
        pair: Pair,
    ) -> dict[str, float]:
        """Return how far the chain of a section model is off its film, where both are at rest."""
        rest, side = source.chain_at_rest(state), self.states.side
        frame = (state.flange.translation, state.flange.rotation[:, 2])
        own = shape_figures(side, rest.state.positions, frame)
        away = differences(own | {"volume_m3": sum(source.chain.volumes_m3)}, here)
        if wanted is not None:
            with suppress(UnreachableError, ConvergenceError, OutOfRangeError):
                pulled = source.chain.find_tensions(rest, wanted), side.find_tensions(pair.rest, wanted)
                away["cable_tension_N"] = tension_difference(*(each.loads for each in pulled))
        return away

    def _of_solver(self, side: FilmRobot, rest: Equilibrium) -> float:
        """Return how far what the solver leaves moves the tip [m]."""
        solver, options = side.equilibrium_solver.solver, self._scenario.solver
        statics = self._scenario.mode == "quasistatic"
        tolerance_N = options.residual_tolerance_N if statics else options.dynamic_tolerance_N
        state, frame = rest.state, rest.world_from_flange.rotation
        if not solver.factorise(state.positions, state.memory, rest.loads, None, frame):
            return math.inf
        return tolerance_N * float(np.linalg.norm(solver.linear.solve_all(tip_pulls(side.body))))

    def _of_tick(
        self, swings: Swings, tick: int, film: FilmRobotState, rest: Equilibrium
    ) -> dict[str, float]:
        """Return how far ticks may have brought the figures off, besides those at rest."""
        side, shape = self.states.side, film.soft.positions
        modes = Modes.of(side, rest)
        if modes is None:
            return dict.fromkeys(FIGURES, math.inf)
        frame = (film.flange.translation, film.flange.rotation[:, 2])
        now = shape_figures(side, shape, frame)
        off = [differences(now, shape_figures(side, shape + by, frame)) for by in swings.apart(modes, tick)]
        return {key: TICK_FACTOR * math.hypot(*(each[key] for each in off)) for key in off[0]}
