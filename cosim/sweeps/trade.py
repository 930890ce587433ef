"""`cosim trade`: a sweep of candidates, each compared with a reference run; a table, a picture, a choice.

The speed is simulated time over CPU time of the loop (not wall time, so that other work on the machine does
not count as waiting), with a recording inside, as `cosim run` makes one.

Tip, objects and contact forces are compared at common times. The flange force is compared by its moving mean:
from tick to tick it chatters, and its values do not converge with the tick. What it passes on over some time
does converge.
"""

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import shorten
from typing import Any, Final, final
from uuid import uuid4

import numpy as np

from cosim.app.driver import rerun_recorder
from cosim.app.output_directory import OutputDirectory
from cosim.app.preparation import build_simulation
from cosim.app.run_files import RECORDING, SCENARIO
from cosim.base.frames import Array, Pose
from cosim.config import loading, studies
from cosim.config.schema.phase import FlangePoseTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import RecordingTable
from cosim.errors import CosimError, ScenarioError
from cosim.plan.flange_motion import rotation_from_direction
from cosim.recording.recorder import RecordingPart
from cosim.results.result import figure_kind
from cosim.sweeps.candidates import Candidate
from cosim.sweeps.engines import Engine
from cosim.sweeps.sweeping import JOURNAL, Journal, StudyRun, Tell
from cosim.sweeps.table import TABLE, Design, Row, write_table
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.summary import reason_of
from cosim.telemetry.tick_batch import TickBatch

REPORT, PLOT = "trade.md", "trade.png"
RESERVE: Final = 0.15
"""Share of a budget by which a candidate is to be faster, as the speed of a machine varies."""
SAMPLE_S: Final = 0.02
FORCE_WINDOW_S: Final = 0.04
"""Time over which the flange force is averaged: two of the longest ticks."""
FORCE_MEAN: Final = f"{1e3 * FORCE_WINDOW_S:g} ms mean"
STRETCH_S: Final = 0.2
"""Simulated time over which a run must not be slower than its bound."""
_COLUMNS: Final = "time_s", "tip_position", "flange_force", "contact_force_N", "phase", "newton_iterations"


@final
@dataclass
class Tracer:
    """Follows a candidate's run: measures its cost and keeps the curves that are compared.

    Args:
        slowest: real-time factor below which the run is stopped; 0: none.
        movable: names of the objects that can move.
        recording: how the run is recorded; the recording is thrown away.
    """

    slowest: float
    movable: tuple[str, ...]
    recording: RecordingTable

    def open(self, stage: RunInfo) -> None:
        """Start the clock: the state at rest has been found."""
        self._stage, self._batches = stage, list[tuple[Array, ...]]()
        self._bodies = [k for k, name in enumerate(stage.body_names) if name in self.movable]
        self._folder = TemporaryDirectory()
        path = Path(self._folder.name) / RECORDING
        self._recorder = rerun_recorder(path, self.recording, RecordingPart(uuid4().hex))
        self._recorder.open(stage)
        self._began = self._stretch_began = time.process_time()
        self._stretch_from_s = self._cpu_s = 0.0

    def observe(self, batch: TickBatch) -> None:
        """Record and keep some ticks."""
        self._recorder.record(batch)
        columns = (getattr(batch, name) for name in _COLUMNS)
        self._batches.append((batch.body_position[:, self._bodies], *columns))

    def stop(self) -> str | None:
        """Return where the run has been slower than its bound; None where it is not."""
        phase, time_s = (self._batches[-1][k][-1] for k in (5, 1))
        now, stretch_s = time.process_time(), time_s - self._stretch_from_s
        if self.slowest * (now - self._stretch_began) > max(stretch_s, STRETCH_S):
            where = f"{time_s:.2f} s, in '{self._stage.phase_names[phase]}'"
            return f"slower than x{self.slowest:g} real time at {where}"
        if stretch_s >= STRETCH_S:
            self._stretch_from_s, self._stretch_began = time_s, now
        return None

    def close(self) -> None:
        """Stop the clock, once the recording is written."""
        self._recorder.close("", "completed")
        self._cpu_s = time.process_time() - self._began
        self._folder.cleanup()

    def figures(self) -> dict[str, Any]:
        """Return speed, Newton iterations a tick, and the curves at common times; see `sampled`."""
        objects, time_s, tip, force, contact, phase, iterations = map(
            np.concatenate, zip(*self._batches, strict=True)
        )
        last = len(phase) - 1
        ends = [k for k in range(1, last + 1) if k == last or phase[k + 1] != phase[k]]
        curves = {"tip_m": tip, "contact_N": contact, **({"objects_m": objects} if self._bodies else {})}
        found = {**sampled(time_s, curves, force), "end_tip_m": tip[ends]}
        return {
            "real_time_factor": float(time_s[-1]) / self._cpu_s,
            "iterations": int(iterations[1:].sum()) / max(1, last),
            "curves": {name: values.tolist() for name, values in found.items()},
        }


def sampled(time_s: Array, curves: Mapping[str, Array], force: Array) -> dict[str, Array]:
    """Return curves every 20 ms, linear between ticks, and as `force_N` the force's mean over 40 ms around.

    The window is centred on each time and moved into the run at its ends. Of a shorter run it is all of it.

    Args:
        time_s: (k,).
        curves: (k, ...) each.
        force: (k, 3) [N].
    """
    last_s = float(time_s[-1])
    times = np.arange(0.0, last_s + 0.5 * SAMPLE_S, SAMPLE_S)
    window_s = min(FORCE_WINDOW_S, last_s)
    begin_s = np.clip(times - 0.5 * window_s, 0.0, last_s - window_s)
    found = {name: _at(times, time_s, values) for name, values in curves.items()}
    # the force is linear between ticks, so a window need not begin or end with one
    all_s = np.unique(np.concatenate([time_s, begin_s, begin_s + window_s]))
    fine = _at(all_s, time_s, force)
    each = 0.5 * (fine[1:] + fine[:-1]) * np.diff(all_s)[:, None]
    impulse = np.concatenate([np.zeros((1, 3)), np.cumsum(each, axis=0)])
    ends = impulse[np.searchsorted(all_s, begin_s + window_s)] - impulse[np.searchsorted(all_s, begin_s)]
    return {**found, "force_N": ends / window_s}


def _at(times: Array, time_s: Array, values: Array) -> Array:
    columns = [np.interp(times, time_s, column) for column in values.reshape(len(values), -1).T]
    return np.array(columns).T.reshape(len(times), *values.shape[1:])


@final
@dataclass(frozen=True)
class Measured:
    """A candidate's cost and errors; errors are NaN where there is nothing to measure against.

    Args:
        candidate: which.
        real_time_factor: simulated time over CPU time of the loop.
        iterations: Newton iterations a tick.
        tip_error_m: largest distance from the reference's tip over the run.
        tip_rms_m: root mean square of it.
        end_error_m: largest at the ends of phases.
        object_error_m: largest distance of an object that can move from where it is in the reference.
        force_error_N: largest difference over the run of the flange force's mean over 40 ms.
        contact_error_N: root mean square difference of the sum of normal contact forces over the run.
        failure: why it did not finish; empty if it did.
        reference: whether the others were measured against it.
    """

    candidate: Candidate
    real_time_factor: float = np.nan
    iterations: float = np.nan
    tip_error_m: float = np.nan
    tip_rms_m: float = np.nan
    end_error_m: float = np.nan
    object_error_m: float = np.nan
    force_error_N: float = np.nan
    contact_error_N: float = np.nan
    failure: str = ""
    reference: bool = False

    @property
    def position_error_m(self) -> float:
        """Largest error of the tip, and of what can move."""
        return float(np.fmax(self.tip_error_m, self.object_error_m))

    @property
    def comparable(self) -> bool:
        """Whether it has finished and was measured against another one."""
        return not self.failure and not self.reference and bool(np.isfinite(self.tip_error_m))


def measure(
    scenario: Scenario,
    candidates: Sequence[Candidate],
    directory: OutputDirectory,
    engine: Engine,
    modules: Sequence[str],
    tell: Tell,
) -> list[Measured]:
    """Run all candidates as the designs of a study, and compare each with the reference.

    The directory gets the scenario, the rows as they come, so that the same call continues, and a table.

    Args:
        scenario: that they change.
        candidates: the reference before the others.
        directory: of the results, entered.
        engine: that runs them; with one worker they do not slow each other down.
        modules: with custom kinds, for the worker to import.
        tell: told of the progress after every candidate.
    """
    commands, fault = dict[str, Any](), ""
    try:
        if any(each.commanded for each in candidates):
            commands = commands_of(scenario)
    except CosimError as error:
        fault = reason_of(error)
    runs = [each for each in candidates if not (fault and each.commanded)]
    directory.make()
    directory.claim(SCENARIO, JOURNAL, TABLE, REPORT, PLOT)
    directory.write(SCENARIO, loading.scenario_text(scenario))
    designs = tuple({**(commands if each.commanded else {}), **each.changes} for each in runs)
    study = studies.StudyTable(str(directory.path / SCENARIO), design=designs)
    movable = tuple(entry.name for entry in scenario.objects if entry.mass_kg is not None)
    tracers = [Tracer(each.slowest, movable, scenario.recording) for each in runs]
    with Journal(directory.path / JOURNAL).open() as journal:
        run = StudyRun(study, directory.path, journal, None, tuple(modules), tell, tracers)
        run.fan_out(engine)
    found = {each.name: design for each, design in zip(runs, run.designs(), strict=True)}
    refused = Design({}, "", Row("refused", fault))
    done = [(each, found.get(each.name, refused)) for each in candidates]
    results = compare([(each, design.row) for each, design in done])
    keys = list(dict.fromkeys(key for each in candidates for key in each.changes))
    shown = [_with_errors(design, result) for (_, design), result in zip(done, results, strict=True)]
    write_table(directory.path / TABLE, keys, shown)
    return results


def _with_errors(design: Design, result: Measured) -> Design:
    """Return what the table shows of a candidate."""
    numbers = {
        entry.name: value
        for entry in fields(result)
        if isinstance(value := getattr(result, entry.name), float) and math.isfinite(value)
    }
    candidate, row = result.candidate, replace(design.row, reason=result.failure or None)
    names = {"candidate": candidate.name, "reference": result.reference}
    return Design(candidate.changes, design.identity, replace(row, figures={**names, **numbers}))


def compare(rows: Sequence[tuple[Candidate, Row]]) -> list[Measured]:
    """Return the figures of candidates, measured against the first reference that has finished."""
    reference: dict[str, Array] | None = None
    results = []
    for candidate, row in rows:
        if row.status != "completed" or row.figures is None:
            ended = "stopped: " if row.status == "interrupted" else "failed: "
            results.append(Measured(candidate, failure=f"{ended}{row.reason or row.status}"))
            continue
        curves = {name: np.array(values) for name, values in row.figures["curves"].items()}
        first = candidate.reference and reference is None
        reference = curves if first else reference
        errors = {} if reference is None else _errors(curves, reference)
        cost = Measured(candidate, row.figures["real_time_factor"], row.figures["iterations"])
        results.append(replace(cost, **errors, reference=first))
    return results


def _errors(here: Mapping[str, Array], there: Mapping[str, Array]) -> dict[str, Any]:
    tip, contact = _distances(here, there, "tip_m"), _difference(here, there, "contact_N")
    moved = (
        {"object_error_m": float(_distances(here, there, "objects_m").max())} if "objects_m" in here else {}
    )
    return {
        **moved,
        "tip_error_m": float(tip.max()),
        "tip_rms_m": float(np.sqrt((tip**2).mean())),
        "end_error_m": float(_distances(here, there, "end_tip_m").max()),
        "force_error_N": float(_distances(here, there, "force_N").max()),
        "contact_error_N": float(np.sqrt((contact**2).mean())),
    }


def _difference(here: Mapping[str, Array], there: Mapping[str, Array], name: str) -> Array:
    count = min(len(here[name]), len(there[name]))
    return np.asarray(here[name][:count] - there[name][:count])


def _distances(here: Mapping[str, Array], there: Mapping[str, Array], name: str) -> Array:
    return np.asarray(np.linalg.norm(_difference(here, there, name), axis=-1))


def commands_of(scenario: Scenario) -> dict[str, Any]:
    """Return as a change the phases with tensions or flange poses in place of the tip's targets, if any.

    Meshes would each find their own commands for a target: their errors would be those of the targets.

    Raises:
        InputError: a target cannot be reached, or the tip follows a path.
    """
    for phase in scenario.phases:
        if phase.tip_path is not None:
            raise ScenarioError(
                f"phase.{phase.name}.tip_path",
                "each candidate would plan the path for itself, so that its errors would not be compared; "
                "compare models on phases with flange poses",
            )
    if all(phase.tip_target is None for phase in scenario.phases):
        return {}
    phases = []
    for planned in build_simulation(scenario).plan.phases:
        phase, target = planned.phase, planned.phase.tip_target
        if target is not None and target.reach_with == "cables":
            phase = replace(phase, cable_tension_N=tuple(map(float, planned.end.cable_tension_N)))
        elif target is not None:
            phase = replace(phase, flange=flange_pose(planned.flange))
        phases.append(replace(phase, tip_target=None))
    return {"phase": loading.to_table(tuple(phases))}


def flange_pose(pose: Pose) -> FlangePoseTable:
    """Return a pose, world from flange, as a scenario's `flange` table describes it."""
    direction = pose.rotation[:, 2]
    turned = rotation_from_direction(direction).T @ pose.rotation  # about the flange's z axis
    x, y, z = (float(value) for value in pose.translation)
    a, b, c = (float(value) for value in direction / np.linalg.norm(direction))
    return FlangePoseTable((x, y, z), (a, b, c), math.atan2(turned[1, 0], turned[0, 0]))


@final
@dataclass(frozen=True)
class Requirement:
    """What a candidate shall meet; None: anything will do.

    Args:
        budget: least real-time factor.
        tolerance_m: largest error of the tip, and of objects that can move.
        force_N: largest error of the flange force's moving mean.
    """

    budget: float | None = None
    tolerance_m: float | None = None
    force_N: float | None = None

    def met_by(self, result: Measured, reserve: float = 0.0) -> bool:
        """Whether a candidate meets all of it, the budget with a reserve: speeds vary from run to run."""
        return (
            (self.budget is None or result.real_time_factor >= (1.0 + reserve) * self.budget)
            and (self.tolerance_m is None or result.position_error_m <= self.tolerance_m)
            and (self.force_N is None or result.force_error_N <= self.force_N)
        )

    @property
    def words(self) -> str:
        """The requirement in words."""
        parts = {
            f"budget real-time factor {self.budget or 0.0:g}": self.budget,
            f"tolerance tip error {1e3 * (self.tolerance_m or 0.0):g} mm": self.tolerance_m,
            f"tolerance flange force ({FORCE_MEAN}) {self.force_N or 0.0:g} N": self.force_N,
        }
        return ", ".join(text for text, given in parts.items() if given is not None)


def pareto_front(results: Sequence[Measured]) -> list[Measured]:
    """Return those that no other one beats in both position error and real-time factor, fastest first."""
    ordered = sorted(
        (result for result in results if result.comparable),
        key=lambda result: (-result.real_time_factor, result.position_error_m),
    )
    front: list[Measured] = []
    for result in ordered:
        if not front or result.position_error_m < front[-1].position_error_m:
            front.append(result)
    return front


def pick(results: Sequence[Measured], requirement: Requirement) -> Measured | None:
    """Return the candidate that meets a requirement best, or None if none meets it.

    With a budget the least position error is best; without, the greatest speed. Where none meets a budget
    with the reserve, the fastest of those that meet it without is taken.
    """
    comparable = [result for result in results if result.comparable]
    safe = [result for result in comparable if requirement.met_by(result, RESERVE)]
    if requirement.budget is not None and safe:
        return min(safe, key=lambda result: (result.position_error_m, -result.real_time_factor))
    able = [result for result in comparable if requirement.met_by(result)]
    return max(able, key=lambda result: (result.real_time_factor, -result.position_error_m), default=None)


def choice_line(results: Sequence[Measured], requirement: Requirement) -> str:
    """Return which candidate meets a requirement, and how to run it."""
    found = pick(results, requirement)
    if found is None:
        return f"No candidate meets {requirement.words}."
    return (
        f"For {requirement.words}: {found.candidate.name} (x{found.real_time_factor:.2f} real time, "
        f"{1e3 * found.position_error_m:.3g} mm, force, {FORCE_MEAN}, {found.force_error_N:.3g} N). "
        f"Run it with: {found.candidate.words}"
    )


_ERRORS: Final = {
    "tip, largest [mm]": ("tip_error_m", 1e3),
    "tip, rms [mm]": ("tip_rms_m", 1e3),
    "tip, phase ends [mm]": ("end_error_m", 1e3),
    "objects, largest [mm]": ("object_error_m", 1e3),
    f"force, {FORCE_MEAN}, largest [N]": ("force_error_N", 1.0),
    "contact, rms [N]": ("contact_error_N", 1.0),
}
"""Columns of errors by their heads: the figure, and the factor from SI units."""


def markdown(title: str, results: Sequence[Measured]) -> str:
    """Return the table; candidates on the Pareto front have a star."""
    shown = {
        head: column
        for head, column in _ERRORS.items()
        if column[0] != "object_error_m" or any(math.isfinite(each.object_error_m) for each in results)
    }
    heads = ["", "candidate", "real-time factor", *shown, "iterations a tick"]
    front = pareto_front(results)
    lines = [
        f"# Speed against accuracy: {title}", "",
        "Errors are against the reference (marked ref), sampled every 20 ms of the run; of the flange force,",
        f"of its moving mean ({FORCE_MEAN}). The real-time factor is simulated time over CPU time of the",
        "loop, recording included. A star: no other candidate is both faster and nearer to it.", "",
        _line(heads),
        _line(["---", "---", *["---:"] * (len(shown) + 2)]),
    ]  # fmt: skip
    for result in results:
        mark = "ref" if result.reference else "*" if result in front else ""
        cells = [f"{result.real_time_factor:.2f}", *(_cell(result, *column) for column in shown.values())]
        if result.failure:  # its first clause: a table has no room for more
            reason = shorten(result.failure.split(";")[0].replace("|", "/"), 160, placeholder=" ...")
            cells = [reason, *[""] * len(shown)]
        iterations = "" if result.failure else f"{result.iterations:.2f}"
        lines.append(_line([mark, result.candidate.name, *cells, iterations]))
    return "\n".join([*lines, *_own_error(results)]) + "\n"


def _cell(result: Measured, name: str, factor: float) -> str:
    value = factor * float(getattr(result, name))
    return f"{value:.3g}" if math.isfinite(value) and not result.reference else ""


def _own_error(results: Sequence[Measured]) -> list[str]:
    """Return how far a reference is from converged, as far as the next best one, unless that is the same."""
    for result in results:
        if result.candidate.reference and result.comparable and result.tip_error_m > 0.0:
            error = f'{1e3 * result.tip_error_m:.3g} mm, its distance from "{result.candidate.name}"'
            return ["", f"The reference itself has an error of about {error}."]
    return []


def _line(cells: Sequence[str]) -> str:
    return "|" + "|".join(cell if cell.startswith("---") else f" {cell.strip()} " for cell in cells) + "|"


def draw(title: str, results: Sequence[Measured], path: Path) -> None:
    """Draw the errors of the candidates over their speed into a PNG file.

    Positions with the Pareto front, the flange force's moving mean, and contact forces where there are any.

    Raises:
        InputError: matplotlib is not installed.
    """
    figure_class = figure_kind()
    from matplotlib.ticker import LogLocator, NullLocator

    shown = [result for result in results if result.comparable]
    moving = any(math.isfinite(result.object_error_m) for result in shown)
    position = "largest error of tip and objects [mm]" if moving else "largest tip error [mm]"
    panels = {
        position: [1e3 * result.position_error_m for result in shown],
        f"largest error of the flange force, {FORCE_MEAN} [N]": [result.force_error_N for result in shown],
    }
    if any(result.contact_error_N > 0.0 for result in shown):
        panels["rms error of the sum of contact forces [N]"] = [result.contact_error_N for result in shown]
    figure = figure_class(figsize=(5.5 * len(panels), 4.8), layout="constrained")
    for axes, (label, errors) in zip(figure.subplots(1, len(panels)), panels.items(), strict=True):
        _scatter(axes, shown, errors)
        axes.set(xscale="log", ylabel=label, xlabel="real-time factor (CPU time of one core, recording on)")
        axes.axvline(1.0, color="0.7", lw=0.8)
        axes.grid(alpha=0.3)
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_scale() == "log":
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
    front = pareto_front(shown)
    figure.axes[0].plot(
        [result.real_time_factor for result in front],
        [1e3 * result.position_error_m for result in front],
        "k--", lw=0.8, label="Pareto front",
    )  # fmt: skip
    figure.axes[0].legend(fontsize=7)
    figure.suptitle(title, fontsize=10)
    figure.savefig(path, dpi=110)


def _scatter(axes: Any, results: Sequence[Measured], errors: Sequence[float]) -> None:
    """Draw a point with its tick for each candidate; those that differ in the tick alone share a colour."""
    families: dict[str, list[tuple[float, float]]] = {}
    for result, error in zip(results, errors, strict=True):
        tick = f"{1e3 * float(result.candidate.changes['clock.tick_s']):g} ms"
        point = result.real_time_factor, error
        axes.annotate(tick, point, fontsize=6, xytext=(4, 3), textcoords="offset points")
        family = result.candidate.name.replace(f", {tick}", "")
        in_time = family != result.candidate.name
        families.setdefault(family if in_time else "other models", []).append(point)
    for (family, points), marker in zip(families.items(), "o^vDPx", strict=False):
        axes.plot(*zip(*points, strict=True), marker=marker, ls="", label=family)
    if errors and min(errors) > 0.0:
        axes.set_yscale("log")
