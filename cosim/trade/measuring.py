"""Runs the candidates of a trade and measures each against the reference of its group.

What a trade needs of a simulation.

What one way to run a scenario costs, and how far it is from the reference.

Compiles what any candidate of a trade needs, so that no candidate's time holds a compilation.

What a candidate of a trade does, tick by tick, and what that costs.

The speed is simulated time over CPU time of the loop (not wall time, so that other work on the machine does
not count as waiting), with whatever follows the run inside: `cosim run` records.

The commands that a scenario's plan finds, in place of the targets that it was asked for.

Candidates that differ in what is modelled would each find their own tensions and flange poses for a target of
the tip: their errors would be those of the targets, not of the models.

Tip position, objects and contact forces are sampled at common times. The flange force is compared by its
moving mean: from tick to tick it chatters, and its values do not converge with the tick; what it passes on
over some time does.
"""

import math
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from types import ModuleType
from typing import Final, TypeAlias, final

import numpy as np

from cosim.base.frames import Array, Pose
from cosim.build.kernel_modules import compile_kernels, contact_modules, kernel_modules
from cosim.config.loading import load_scenario, resolve
from cosim.config.schema.phase import FlangePoseTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.errors import CosimError, ScenarioError
from cosim.plan.motion import rotation_from_direction
from cosim.stepping.stepped_run import SteppedRun
from cosim.telemetry.snapshot import RunInfo
from cosim.telemetry.tick_batch import TickBatch
from cosim.trade.candidates import Candidate

Build: TypeAlias = Callable[[Scenario], SteppedRun]


FORCE_WINDOW_S: Final = 0.04
"""Time over which the flange force is averaged: two of the longest ticks."""

FORCE_MEAN: Final = f"{1e3 * FORCE_WINDOW_S:g} ms mean"
"""What of the flange force is compared, in words."""


@final
@dataclass(frozen=True)
class Measured:
    """A candidate's cost and errors; errors are NaN where there is nothing to measure against.

    Args:
        candidate: which.
        real_time_factor: simulated time over CPU time of the loop.
        tip_error_m: largest distance from the reference's tip over the run.
        tip_rms_m: root mean square of it.
        end_error_m: largest at the ends of phases.
        force_error_N: largest difference over the run of the flange force's mean over 40 ms.
        contact_error_N: root mean square difference of the sum of normal contact forces over the run.
        iterations: Newton iterations a tick.
        object_error_m: largest distance of an object that can move from where it is in the reference.
        base_error_m: largest distance from the tip of the model as it is, over the run (statics: at the
            ends of phases); NaN where that is the reference.
        failure: why it did not finish; empty if it did.
        reference: whether the others of its group were measured against it.
    """

    candidate: Candidate
    real_time_factor: float = np.nan
    tip_error_m: float = np.nan
    tip_rms_m: float = np.nan
    end_error_m: float = np.nan
    force_error_N: float = np.nan
    contact_error_N: float = np.nan
    iterations: float = np.nan
    object_error_m: float = np.nan
    base_error_m: float = np.nan
    failure: str = ""
    reference: bool = False

    @classmethod
    def numbers(cls) -> tuple[str, ...]:
        """Return the names of its figures."""
        return tuple(entry.name for entry in fields(cls) if entry.type is float)

    @property
    def position_error_m(self) -> float:
        """Largest error of the tip, and of what can move."""
        return float(np.fmax(self.tip_error_m, self.object_error_m))

    @property
    def comparable(self) -> bool:
        """Whether it has finished and was measured against another one."""
        return not self.failure and not self.reference and bool(np.isfinite(self.tip_error_m))


def compile_for_trade(
    scenario: Scenario, tell: Callable[[str], None], more: tuple[ModuleType, ...] = ()
) -> None:
    """Compile the kernels of a scenario's lower fidelities and switches as well as its own.

    Args:
        scenario: checked.
        tell: told in one sentence, before the wait, when there is anything to compile.
        more: modules with kernels of what follows the runs.
    """
    films = replace(scenario, fidelity="lumped", contact=replace(scenario.contact, self_contact=True))
    sections = replace(scenario, fidelity="section")
    models = *kernel_modules(films), *kernel_modules(sections)
    contact = () if scenario.robot == NO_ARM else contact_modules()
    compile_kernels(tell, (*more, *models, *contact))


_COLUMNS = ("time_s", "tip_position", "flange_force", "contact_force_N", "phase", "newton_iterations")
STRETCH_S = 0.2
"""Simulated time over which a run must not be slower than its bound."""


Follow: TypeAlias = Callable[[Scenario, RunInfo], AbstractContextManager[Callable[[TickBatch], None]]]
"""Opens what follows a run; the context gives what is called with all ticks."""


class TooSlowError(Exception):
    """A run is slower than its bound; it has been ended."""


def unfollowed(_scenario: Scenario, _stage: RunInfo) -> AbstractContextManager[Callable[[TickBatch], None]]:
    """Follow a run with nothing."""
    return nullcontext(lambda _batch: None)


@final
@dataclass(frozen=True)
class Curve:
    """What a candidate did.

    Args:
        time_s: (k,).
        tip: (k, 3) [m].
        objects: (k, m, 3) [m], those that can move.
        force: (k, 3) [N], of the soft robot on the flange.
        contact: (k,) [N], sum of the normal forces of all contacts.
        phase_ends: (phases,) indices of the last snapshot of each phase.
        cpu_s: of the loop.
        iterations: Newton iterations a tick.
    """

    time_s: Array
    tip: Array
    objects: Array
    force: Array
    contact: Array
    phase_ends: tuple[int, ...]
    cpu_s: float
    iterations: float

    def at(self, times: Array) -> "Curve":
        """Return the curve at given times (n,), linear in between; without phase ends."""
        rows = [
            np.stack(
                [np.interp(times, self.time_s, column) for column in values.reshape(len(values), -1).T], 1
            )
            if values.size
            else np.zeros((len(times), 0))
            for values in (self.tip, self.objects, self.force, self.contact)
        ]
        objects = rows[1].reshape(len(times), -1, 3)
        return Curve(times, rows[0], objects, rows[2], rows[3][:, 0], (), self.cpu_s, self.iterations)

    def mean_force(self, begin_s: Array, end_s: Array) -> Array:
        """Return the mean of the flange force over windows of time, of all ticks in them.

        The force is linear between ticks, so a window need not begin or end with one.

        Args:
            begin_s: (n,), within the run.
            end_s: (n,), within the run, later than the beginnings.

        Returns:
            (n, 3) [N], axes as of `force`.
        """
        times = np.unique(np.concatenate([self.time_s, begin_s, end_s]))
        force = np.stack([np.interp(times, self.time_s, column) for column in self.force.T], 1)
        each = 0.5 * (force[1:] + force[:-1]) * np.diff(times)[:, None]
        impulse = np.concatenate([np.zeros((1, 3)), np.cumsum(each, axis=0)])
        gained = impulse[np.searchsorted(times, end_s)] - impulse[np.searchsorted(times, begin_s)]
        return np.asarray(gained / (end_s - begin_s)[:, None])

    @property
    def real_time_factor(self) -> float:
        """Simulated time over CPU time."""
        return float(self.time_s[-1]) / self.cpu_s if self.cpu_s > 0.0 else float("nan")


@final
@dataclass
class CurveBuilder:
    """Collects a curve from ticks.

    Args:
        scenario: that is run.
        stage: of the run.
    """

    scenario: Scenario
    stage: RunInfo
    _arrays: dict[str, list[Array]] = field(default_factory=lambda: {name: [] for name in _COLUMNS})
    _objects: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        can_move = {entry.name for entry in self.scenario.objects if entry.mass_kg is not None}
        self._bodies = [k for k, name in enumerate(self.stage.body_names) if name in can_move]

    def observe(self, batch: TickBatch) -> None:
        """Take in some ticks."""
        self._objects.append(batch.body_position[:, self._bodies])
        for name, found in self._arrays.items():
            found.append(getattr(batch, name))

    def curve(self, cpu_s: float) -> Curve:
        """Return what was collected, which took so much CPU time."""
        objects = np.concatenate(self._objects)
        time_s, tip, force, contact, phase, iterations = map(np.concatenate, self._arrays.values())
        last = len(phase) - 1
        ends = [k for k in range(1, last + 1) if k == last or phase[k + 1] != phase[k]]
        each = int(iterations[1:].sum()) / max(1, last)
        return Curve(time_s, tip, objects, force, contact, tuple(ends), cpu_s, each)


def trace(
    scenario: Scenario,
    build: Build,
    follow: Follow = unfollowed,
    *,
    slowest: float = 0.0,
    advance: Callable[[float], None] = lambda _share: None,
) -> Curve:
    """Run a scenario and keep its curves.

    Args:
        scenario: checked.
        build: makes its simulation.
        follow: what else sees all ticks, inside the measured time.
        slowest: real-time factor that every stretch of at least 0.2 s must reach; 0 for no bound.
        advance: told after every stretch how much of the run is done, from 0 to 1.

    Raises:
        CosimError: it cannot be built or solved.
        TooSlowError: a stretch is slower than the bound.
    """
    simulation = build(scenario)
    batches, stage = simulation.batches(), simulation.stage
    first = next(batches)  # before the clock starts: this one finds the start equilibrium
    builder = CurveBuilder(scenario, stage)
    bound = 1.0 / slowest if slowest > 0.0 else float("inf")
    stretch_from_s = 0.0
    with follow(scenario, stage) as observe:
        began = stretch_began = time.process_time()
        for batch in chain([first], batches):
            builder.observe(batch)
            observe(batch)
            now, time_s = time.process_time(), float(batch.time_s[-1])
            stretch_s = time_s - stretch_from_s
            if now - stretch_began > bound * max(stretch_s, STRETCH_S):
                where = f"{time_s:.2f} s, in '{stage.phase_names[batch.phase[-1]]}'"
                raise TooSlowError(f"slower than x{slowest:g} real time at {where}")
            if stretch_s >= STRETCH_S:
                advance(batch.tick[-1] / stage.ticks)
                stretch_from_s, stretch_began = time_s, now
    spent = time.process_time() - began  # with what the follower had still to write
    return builder.curve(spent)


def with_commands(scenario: Scenario, build: Build) -> Scenario:
    """Return the scenario with every target of the tip replaced by the tensions or the flange pose found.

    Args:
        scenario: checked.
        build: makes a simulation.

    Raises:
        InputError: a target cannot be reached.
    """
    for phase in scenario.phases:
        if phase.tip_path is not None:
            raise ScenarioError(
                f"phase.{phase.name}.tip_path",
                "each candidate would plan the path for itself, so that its errors would not be compared; "
                "compare models on phases with flange poses",
            )
    if all(phase.tip_target is None for phase in scenario.phases):
        return scenario
    phases = []
    for planned in build(scenario).plan.phases:
        phase, target = planned.phase, planned.phase.tip_target
        if target is not None:
            phase = replace(phase, tip_target=None)
            if target.reach_with == "cables":
                phase = replace(phase, cable_tension_N=tuple(planned.end.cable_tension_N))
            else:
                phase = replace(phase, flange=flange_pose(planned.flange))
        phases.append(phase)
    return resolve(replace(scenario, phases=tuple(phases)))


def flange_pose(pose: Pose) -> FlangePoseTable:
    """Return a pose, world from flange, as a scenario's `flange` table describes it."""
    direction = pose.rotation[:, 2]
    turned = rotation_from_direction(direction).T @ pose.rotation  # about the flange's z axis
    x, y, z = (float(value) for value in pose.translation)
    a, b, c = (float(value) for value in direction / np.linalg.norm(direction))
    return FlangePoseTable((x, y, z), (a, b, c), math.atan2(turned[1, 0], turned[0, 0]))


SAMPLE_S = 0.02


SLOWEST = 0.05
"""Real-time factor below which a candidate is stopped, unless told otherwise."""

_REFERENCE_SLOWEST = 0.1  # share of that bound which a reference has to keep: nothing is measured without it


@final
@dataclass(frozen=True)
class Telling:
    """Who is informed of candidates.

    Args:
        begin: of a candidate's place in the list, counted from 0, before it runs.
        advance: of the share of its run that is done, now and then.
        done: of its figures.
    """

    begin: Callable[[int, Candidate], None] = lambda _place, _candidate: None
    advance: Callable[[float], None] = lambda _share: None
    done: Callable[[Measured], None] = lambda _result: None


def measure(
    scenario: Scenario,
    candidates: Sequence[Candidate],
    build: Build,
    telling: Telling | None = None,
    *,
    follow: Follow = unfollowed,
    slowest: float = SLOWEST,
) -> list[Measured]:
    """Run all candidates, each group's reference before its others.

    Args:
        scenario: that they change.
        candidates: to run.
        build: makes a simulation.
        telling: who is informed of them.
        follow: what else sees every snapshot, inside the measured time.
        slowest: real-time factor below which a candidate is stopped, a reference at a tenth of it; 0: none.
    """
    telling = telling or Telling()
    comparison = _Comparison(scenario, build)
    results: list[Measured] = []
    for place, candidate in enumerate(candidates):
        telling.begin(place, candidate)
        least = slowest * (_REFERENCE_SLOWEST if candidate.reference else 1.0)
        try:
            changed = load_scenario(comparison.basis(candidate), candidate.changes)
            curve = trace(changed, build, follow, slowest=least, advance=telling.advance)
        except TooSlowError as error:
            result = Measured(candidate, failure=f"stopped: {error}")
        except CosimError as error:
            result = Measured(candidate, failure=f"failed: {type(error).__name__}: {error}")
        else:
            result = comparison.result(candidate, curve, statics=changed.mode == "quasistatic")
        results.append(result)
        telling.done(result)
    return results


class _Comparison:
    """What candidates start from and are measured against."""

    def __init__(self, scenario: Scenario, build: Build) -> None:
        self._scenario, self._build = scenario, build
        self._commanded: Scenario | None = None
        self._references: dict[str, Curve] = {}
        self._bases: dict[str, Curve] = {}

    def basis(self, candidate: Candidate) -> Scenario:
        """Return the scenario that a candidate changes."""
        if not candidate.commanded:
            return self._scenario
        if self._commanded is None:
            self._commanded = with_commands(self._scenario, self._build)
        return self._commanded

    def result(self, candidate: Candidate, curve: Curve, *, statics: bool) -> Measured:
        """Return a candidate's figures; it may be what others are measured against."""
        first = candidate.reference and candidate.group not in self._references
        if first:
            self._references[candidate.group] = curve
        if candidate.base:
            self._bases[candidate.group] = curve
        reference, base = self._references.get(candidate.group), self._bases.get(candidate.group)
        found = compared(candidate, curve, reference, None if base is reference else base, statics=statics)
        return replace(found, reference=first)


def compared(
    candidate: Candidate,
    curve: Curve,
    reference: Curve | None,
    base: Curve | None = None,
    *,
    statics: bool = False,
) -> Measured:
    """Return a candidate's figures; of statics, which have no time between phase ends, only those there.

    Args:
        candidate: which.
        curve: of it.
        reference: what it is measured against.
        base: the model as it is; None where that is the reference.
        statics: whether the candidate is quasistatic.
    """
    if reference is None:
        return Measured(candidate, curve.real_time_factor, iterations=curve.iterations)
    end_error = _end_distance(curve, reference)
    if statics:
        return Measured(
            candidate, curve.real_time_factor, end_error_m=end_error, iterations=curve.iterations,
            base_error_m=np.nan if base is None else _end_distance(curve, base),
        )  # fmt: skip
    times = np.arange(0.0, min(curve.time_s[-1], reference.time_s[-1]) + 0.5 * SAMPLE_S, SAMPLE_S)
    here, there = curve.at(times), reference.at(times)
    distance = _distances(here.tip, there.tip)
    moved = _distances(here.objects, there.objects)
    return Measured(
        candidate,
        curve.real_time_factor,
        tip_error_m=float(distance.max()),
        tip_rms_m=float(np.sqrt((distance**2).mean())),
        end_error_m=end_error,
        force_error_N=_force_error(curve, reference, times),
        contact_error_N=float(np.sqrt(((here.contact - there.contact) ** 2).mean())),
        iterations=curve.iterations,
        object_error_m=float(moved.max()) if moved.size else np.nan,
        base_error_m=np.nan if base is None else float(_distances(here.tip, base.at(times).tip).max()),
    )


def _force_error(curve: Curve, reference: Curve, times: Array) -> float:
    """Return the largest difference [N] of the flange force's moving mean.

    The window is centred on each compared time, and moved into the run at its ends; of a shorter run, it is
    all of it.

    Args:
        curve: of a candidate.
        reference: what it is measured against.
        times: (n,) [s], compared.
    """
    last_s = min(float(curve.time_s[-1]), float(reference.time_s[-1]))
    window_s = min(FORCE_WINDOW_S, last_s)
    begin_s = np.clip(times - 0.5 * window_s, 0.0, last_s - window_s)
    here, there = (each.mean_force(begin_s, begin_s + window_s) for each in (curve, reference))
    return float(_distances(here, there).max())


def _distances(here: Array, there: Array) -> Array:
    return np.asarray(np.linalg.norm(here - there, axis=-1))


def _end_distance(curve: Curve, other: Curve) -> float:
    ends = curve.tip[list(curve.phase_ends)], other.tip[list(other.phase_ends)]
    return float(_distances(*ends).max())
