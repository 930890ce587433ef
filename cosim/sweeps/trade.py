"""Runs the candidates of a trade between speed and accuracy, and compares each with a reference run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any, Final

import numpy as np

from cosim.app.output_directory import OutputDirectory
from cosim.app.preparation import build_simulation
from cosim.app.run_files import SCENARIO
from cosim.base.frames import Array, Pose
from cosim.config import loading, studies
from cosim.config.schema.phase import FlangePoseTable
from cosim.config.schema.scenario import Scenario
from cosim.errors import CosimError, ScenarioError
from cosim.plan.flange_motion import rotation_from_direction
from cosim.sweeps.candidates import Candidate
from cosim.sweeps.designs import Design, Row
from cosim.sweeps.engines import Engine
from cosim.sweeps.journal import JOURNAL, Journal
from cosim.sweeps.study_run import StudyRun, Tell
from cosim.sweeps.table import TABLE, write_table
from cosim.sweeps.tracer import Tracer
from cosim.sweeps.trade_results import Measured
from cosim.sweeps.worker import run_task, warm_up
from cosim.telemetry.summary import reason_of

REPORT: Final = "trade.md"
PLOT: Final = "trade.png"


def measure(
    scenario: Scenario,
    candidates: Sequence[Candidate],
    directory: OutputDirectory,
    engine: Engine,
    modules: Sequence[str],
    tell: Tell,
) -> list[Measured]:
    """Run all candidates as the designs of a study, and compare each with the reference.

    The scenario, the rows and a table are written to the directory; the same call continues after an
    interruption.

    Args:
        scenario: that the candidates change.
        candidates: the reference before the others.
        directory: of the results, entered.
        engine: runs the candidates; with one worker they do not slow each other down.
        modules: with custom kinds; imported by the worker.
        tell: called with the progress after every candidate.
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
        run.compute(engine, run_task, warm_up)
    by_name = {each.name: design for each, design in zip(runs, run.designs(), strict=True)}
    refused = Design({}, "", Row("refused", fault))
    done = [by_name.get(each.name, refused) for each in candidates]
    results = compare(candidates, [design.row for design in done])
    keys = list(dict.fromkeys(key for each in candidates for key in each.changes))
    shown = [_with_errors(design, result) for design, result in zip(done, results, strict=True)]
    write_table(directory.path / TABLE, keys, shown)
    return results


def _with_errors(design: Design, result: Measured) -> Design:
    """Return a candidate's row of the table."""
    numbers = {
        entry.name: value
        for entry in fields(result)
        if isinstance(value := getattr(result, entry.name), float) and math.isfinite(value)
    }
    candidate, row = result.candidate, replace(design.row, reason=result.failure or None)
    names = {"candidate": candidate.name, "reference": result.reference}
    return Design(candidate.changes, design.identity, replace(row, figures={**names, **numbers}))


def compare(candidates: Sequence[Candidate], rows: Sequence[Row]) -> list[Measured]:
    """Return the figures of candidates, compared with the first reference that has finished."""
    reference: dict[str, Array] | None = None
    results = []
    for candidate, row in zip(candidates, rows, strict=True):
        if row.status != "completed" or row.figures is None:
            ended = "stopped: " if row.status == "interrupted" else "failed: "
            results.append(Measured(candidate, failure=f"{ended}{row.reason or row.status}"))
            continue
        curves = {name: np.array(values) for name, values in row.figures["curves"].items()}
        first = candidate.reference and reference is None
        reference = curves if first else reference
        errors = {} if reference is None else _errors(curves, reference)
        cost = {name: row.figures[name] for name in ("real_time_factor", "loop_factor", "iterations")}
        results.append(Measured(candidate, **cost, **errors, reference=first))
    return results


def _errors(curves: Mapping[str, Array], reference: Mapping[str, Array]) -> dict[str, Any]:
    def difference(name: str) -> Array:
        count = min(len(curves[name]), len(reference[name]))
        return np.asarray(curves[name][:count] - reference[name][:count])

    def distances(name: str) -> Array:
        return np.asarray(np.linalg.norm(difference(name), axis=-1))

    tip, contact = distances("tip_m"), difference("contact_N")
    objects = {"object_error_m": float(distances("objects_m").max())} if "objects_m" in curves else {}
    return {
        **objects,
        "tip_error_m": float(tip.max()),
        "tip_rms_m": float(np.sqrt((tip**2).mean())),
        "end_error_m": float(distances("end_tip_m").max()),
        "force_error_N": float(distances("force_N").max()),
        "contact_error_N": float(np.sqrt((contact**2).mean())),
    }


def commands_of(scenario: Scenario) -> dict[str, Any]:
    """Return a change that replaces the tip's targets, if any, by tensions or flange poses of the plan.

    Otherwise each mesh would have different commands for a target, which would hide its errors.

    Raises:
        InputError: a target cannot be reached, or the tip follows a path.
    """
    for phase in scenario.phases:
        if phase.tip_path is not None:
            raise ScenarioError(
                f"phase.{phase.name}.tip_path",
                "each candidate would plan the path separately, so its errors would not be compared; "
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
