"""Planned tip paths for the controllers of robots."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cosim.app.first_run import log, prepared
from cosim.config.loading import load_scenario
from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.results.joint_table import JointTable, sample_times

if TYPE_CHECKING:
    from cosim.plan.plan import PhasePlan
    from cosim.stepping.stepped_run import SteppedRun


def plan_path(
    scenario: str | Path | Scenario,
    *,
    phase: str | None = None,
    rate_Hz: float = 500.0,
    overrides: Mapping[str, Any] | None = None,
) -> JointTable:
    """Return the joint angles, tensions and pressures that lead the tip along a path; nothing is run.

    Args:
        scenario: name of a scenario that comes with cosim, path of a .toml file, or a scenario.
        phase: that has the path; None for the only one that has.
        rate_Hz: of the controller, rows per second.
        overrides: values by key path.

    Raises:
        InputError: the scenario is wrong, its path cannot be followed, or it has none, or several.
    """
    checked = load_scenario(scenario, overrides)
    names = [entry.name for entry in checked.phases if entry.tip_path is not None]
    if phase not in names and (phase is not None or len(names) != 1):
        which = (
            f"phase {phase!r} has no tip_path"
            if phase is not None
            else f"{len(names)} phases have a tip_path"
        )
        raise InputError(f"{checked.name}: {which}; name one that has: {', '.join(names) or 'there is none'}")
    simulation = _planned(prepared(checked, log, recording=False))
    wanted = phase or names[0]
    planned = next(entry for entry in simulation.plan.phases if entry.phase.name == wanted)
    cables, chambers = checked.soft_robot.cable_names(), simulation.stage.chamber_names
    return _table(planned, simulation, tuple(cables), chambers, rate_Hz)


def _planned(scenario: Scenario) -> SteppedRun:
    from cosim.build.simulation import build  # here: wrong input waits for no engine

    return build(scenario)


def _table(
    planned: PhasePlan, run: SteppedRun, cables: tuple[str, ...], chambers: tuple[str, ...], rate_Hz: float
) -> JointTable:
    from cosim.plan.ramp import progress
    from cosim.plan.robot_command import CommandRamp

    phase = planned.phase
    time_s = sample_times(phase.duration_s, rate_Hz)
    instants = [progress(phase.ramp, t, phase.duration_s) for t in time_s.tolist()]
    ramp = CommandRamp(planned.begin, planned.end)
    asked = [ramp.at(instant.value) for instant in instants]
    given = [k for k, rule in enumerate(planned.gas) if not rule.sealed]
    sliding = np.zeros(0, bool) if run.stage.arm is None else run.stage.arm.limits.prismatic
    units = ["m" if slides else "rad" for slides in sliding]
    joints = [f"{name}.position_{unit}" for name, unit in zip(run.stage.joint_names, units, strict=True)]
    values = [
        planned.joints.through(instants).position,
        np.array([command.cable_tension_N for command in asked]).reshape(len(asked), -1),
        np.array([[command.pressure_Pa[k] for k in given] for command in asked]).reshape(len(asked), -1),
    ]
    heads = [
        *joints,
        *(f"{name}.tension_N" for name in cables),
        *(f"{chambers[k]}.pressure_Pa" for k in given),
    ]
    return JointTable(phase.name, tuple(heads), time_s, np.concatenate(values, axis=1))
