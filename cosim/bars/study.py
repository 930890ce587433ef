"""Error bars of the figures at the ends of a finished run's phases, by mesh, tick and solver. Mesh:
difference of the states at rest on the run's mesh and on the mesh refined once, times a calibrated factor
(docs/run_error.md); tensions for a target are searched for on both. Section model: difference of the chain at
rest from its film, in addition. Tick: see `Swings`. Solver: independent residuals of the tolerance move the
tip by tolerance |K^-1 g|, with g the tip's gradient.
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
    bounded,
    bounded_tension,
    calibration_of,
    tension_difference,
)
from cosim.bars.finer_mesh import Pair
from cosim.bars.resting import RestingStates
from cosim.bars.shape_figures import differences, shape_figures
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
from cosim.soft.solve import tip_target
from cosim.soft.solve.state import Equilibrium
from cosim.telemetry.phase_ends import PhaseEnd, PhaseEnds
from cosim.telemetry.run_errors import RunErrors

FRACTION: Final = 0.25
"""Largest processor time of all phases over that of the run; if it takes more, only the last has bars."""
_MOST: Final = 4.0
"""Largest processor time of the last phase, over that of all phases."""
LEAST_s: Final = 3.0
"""Processor time that is allowed for any run."""
_SECTION_s: Final = 15.0
"""The same for a section model, whose run takes less than that of its film."""
FILM_NODES_MAX: Final = 2500
"""Nodes of a section model's film: with more, a phase takes at least 10 s, and the run a second or two."""
_USUAL_s: Final = 2e-4
"""Processor time of a phase end, for each node of the run's mesh."""
_TOLD_ABOVE_s: Final = 1.0
_OTHER_BRANCH: Final = 0.6
"""Distance of the tips over the length, above which the refined mesh is on another branch."""
_NOT_AT_REST: Final = "no state at rest was found near its end, on the run's mesh or on the refined one"
_HELD: Final = "rings are held where the run's mesh had them, which on the refined mesh is not known"
_ONLY_LAST: Final = "only of the last phase and those it needs, as more would cost over a quarter of the run"
_TOO_DEAR: Final = "it would cost more than the run; --error computes it nevertheless"


def find_bars(
    scenario: Scenario,
    phase_ends: PhaseEnds,
    tell: Callable[[str], None],
    *,
    everywhere: bool,
    parts: KeptParts | None = None,
) -> RunErrors:
    """Return the error bars of a run: at all phase ends, or only at the last if that would cost too much.

    Args:
        scenario: of the run.
        phase_ends: of the run.
        tell: called with a sentence if it takes more than a second.
        everywhere: whether all phase ends have bars, at any cost.
        parts: that may be used again.

    Raises:
        InputError: the phase ends are of another soft robot.
    """
    began, allowed_s = time.perf_counter(), FRACTION * phase_ends.cpu_s
    if isinstance(scenario.soft_robot, GivenBodyTable):
        return RunErrors(reason="the soft robot is given as arrays, which cannot be refined")
    if scenario.fidelity == "rigid" or not phase_ends.ends:
        frozen = scenario.fidelity == "rigid"
        return RunErrors(reason="the shape is frozen" if frozen else "the run ended before a phase did")
    model = SoftModel(scenario, KeptParts() if parts is None else parts, None, tell)
    if not everywhere and (why := _too_dear(model, allowed_s)):
        return RunErrors(reason=why)
    least_s = LEAST_s if model.section is None else _SECTION_s
    budget = Budget(math.inf if everywhere else max(_MOST * allowed_s, least_s))
    study, reason = ErrorStudy(scenario, model, phase_ends, budget), None
    if len(phase_ends.ends) * _USUAL_s * model.body.nodes > _TOLD_ABOVE_s:
        tell("Computing error bars")
    try:
        reason = study.find(math.inf if everywhere else allowed_s)
    except MeshError as error:
        reason = str(error)
    return RunErrors(study.bars, reason, study.states.iterations, time.perf_counter() - began)


def _too_dear(model: SoftModel, allowed_s: float) -> str:
    """Return why even one phase end takes too long by default; empty if it does not.

    Args:
        model: of the soft robot.
        allowed_s: processor time that all phase ends may take.
    """
    nodes = model.body.nodes
    if model.section is None:
        return _TOO_DEAR if _USUAL_s * nodes > max(_MOST * allowed_s, LEAST_s) else ""
    if nodes <= FILM_NODES_MAX:
        return ""
    return f"with a film of {nodes} nodes it takes 10 s and longer; --error computes it nevertheless"


@final
class ErrorStudy:
    """Computes the error bars of a finished run.

    Attributes: `states`, at rest; `bars`, by the phase's index, see `RunErrors`.

    Args:
        scenario: of the run.
        model: of its soft robot, which has a refined mesh.
        phase_ends: of the run.
        budget: of all searches.
    """

    def __init__(self, scenario: Scenario, model: SoftModel, phase_ends: PhaseEnds, budget: Budget) -> None:
        self._scenario, self._budget = scenario, budget
        self.states = RestingStates(model, phase_ends.ends, budget, thorough=math.isinf(budget.most_s))
        self.bars: dict[int, dict[str, Any]] = {}
        self._swings: Swings | None = None
        if len(phase_ends.moments):
            body, options = self.states.side.body, dynamic_options(scenario)
            self._swings = Swings(body, phase_ends.moments, scenario.clock.tick_s, options)

    def find(self, allowed_s: float) -> str | None:
        """Compute the bars from the last phase to the first; return why phases are left out; None if none is.

        Args:
            allowed_s: processor time of all phases; if they take more, only the last and those it needs have
                bars.

        Raises:
            MeshError: the refined mesh is not a mesh of the same body.
        """
        ends, states, dear = self.states.ends, self.states, False
        for index in reversed(range(len(ends))):
            if len(self.bars) == 1:
                dear = self._budget.spent_s / max(1, len(states.pairs)) * len(ends) > allowed_s
            if not dear or index in states.pairs:  # states that the last one needed are known
                self.bars[ends[index].phase] = self._of(index)
        return _ONLY_LAST if len(self.bars) < len(ends) else None

    def _of(self, index: int) -> dict[str, Any]:
        """Return the bars of a phase's end with their parts, or the reason why the end has no bar."""
        none: dict[str, Any] = dict.fromkeys(FIGURES)
        try:
            parts, why_not = self._compared(index)
        except ConvergenceError:
            parts, why_not = {}, _NOT_AT_REST
        except TooDearError:
            parts, why_not = {}, _TOO_DEAR
        if why_not:
            return none | {"reason": why_not}
        bars = {key: sum(part.get(key, 0.0) for part in parts.values()) for key in parts["of_mesh"]}
        return none | bars | parts | {"reason": None}

    def _compared(self, index: int) -> tuple[dict[str, Any], str]:
        """Return the parts of the bars, or why there are none.

        Raises:
            ConvergenceError: there is no state at rest near that of the run.
            TooDearError: the processor time is spent.
        """
        end, states = self.states.ends[index], self.states
        pair = None if end.why_not else states.pair(index)
        if pair is None:
            return {}, end.why_not or _HELD
        side, mesh, film = states.side, states.mesh, states.film(index)
        if not film.clamp.holds_as(side.clamp):
            side.hold(film.clamp)
        mesh.hold(pair.clamp)
        figures = shape_figures(side, pair.rest.state.positions, film.flange)
        difference = differences(figures, shape_figures(mesh.side, pair.finer.state.positions, film.flange))
        if pair.rest.negative_pivots or pair.finer.negative_pivots:
            return {}, "the state at rest near its end is unstable"
        if difference["tip_m"] > _OTHER_BRANCH * figures["length_m"]:
            return {}, "the refined mesh comes to rest on another branch, far away"
        target, calibration = self._target(end), calibration_of(self._scenario)
        of_tension = self._of_tension(target, pair, difference["tip_m"])
        difference = bounded(difference, figures, calibration) | of_tension
        parts: dict[str, Any] = {}
        if states.source is not None:
            parts["of_section"] = self._of_section(states.source, end.state, figures, target, pair)
        return parts | {
            "of_mesh": {key: calibration.factors[key] * value for key, value in difference.items()},
            "of_tick": {} if self._swings is None else self._of_tick(self._swings, end.tick, film, pair.rest),
            "of_solver": dict.fromkeys(("tip_m", "sag_m", "length_m"), self._of_solver(side, pair.rest)),
        }, ""

    def _target(self, end: PhaseEnd) -> tip_target.TipTarget | None:
        """Return the tip's target of a phase, if cables reach it."""
        target = self._scenario.phases[end.phase].tip_target
        return wanted_tip(target) if target is not None and target.reach_with == "cables" else None

    def _of_tension(self, target: tip_target.TipTarget | None, pair: Pair, tip_m: float) -> dict[str, float]:
        """Return the difference of the tensions that reach a phase's target on both meshes."""
        if target is None:
            return {}
        side, finer = self.states.side, self.states.mesh.side
        with suppress(UnreachableError, ConvergenceError, OutOfRangeError):
            loads = side.find_tensions(pair.rest, target).loads
            on_finer = finer.find_tensions(pair.finer, target).loads
            slope = side.tension_slope(pair.rest, target)
            most_N, difference_N = max(loads.cable_tension_N), tension_difference(loads, on_finer)
            return {"cable_tension_N": bounded_tension(most_N, difference_N, slope * tip_m)}
        return {}

    def _of_section(
        self,
        source: SourceFilm,
        state: BeamRobotState,
        figures: dict[str, Any],
        target: tip_target.TipTarget | None,
        pair: Pair,
    ) -> dict[str, float]:
        """Return the difference of the chain of a section model from its film, both at rest.

        Args:
            source: film and chain.
            state: of the chain at the phase end.
            figures: of the film at rest.
            target: of the tip, if cables reach it.
            pair: states at rest of the film.
        """
        rest, side = source.chain_at_rest(state), self.states.side
        of_chain = shape_figures(side, rest.state.positions, state.flange)
        difference = differences(of_chain | {"volume_m3": sum(source.chain.volumes_m3)}, figures)
        if target is not None:
            difference["cable_tension_N"] = math.inf  # unknown, unless both models reach the target
            with suppress(UnreachableError, ConvergenceError, OutOfRangeError):
                pulled = source.chain.find_tensions(rest, target), side.find_tensions(pair.rest, target)
                difference["cable_tension_N"] = tension_difference(*(each.loads for each in pulled))
        return difference

    def _of_solver(self, side: FilmRobot, rest: Equilibrium) -> float:
        """Return the motion of the tip by residuals of the tolerance [m]."""
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
        """Return the errors of ticks."""
        side, shape = self.states.side, film.soft.positions
        modes = Modes.of(side, rest)
        if modes is None:
            return dict.fromkeys(FIGURES, math.inf)
        figures = shape_figures(side, shape, film.flange)
        errors = [
            differences(figures, shape_figures(side, shape + error, film.flange))
            for error in swings.apart(modes, tick)
        ]
        return {key: TICK_FACTOR * math.hypot(*(each[key] for each in errors)) for key in errors[0]}
