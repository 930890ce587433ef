"""The commands that a scenario's plan finds, in place of the targets that it was asked for.

Candidates that differ in what is modelled would each find their own tensions and flange poses for a target of
the tip: their errors would be those of the targets, not of the models.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cosim.base.frames import Pose
from cosim.config.loading import resolve
from cosim.config.schema.phase import FlangePoseTable
from cosim.config.schema.scenario import Scenario
from cosim.errors import ScenarioError
from cosim.plan.flange_path import rotation_from_direction
from cosim.plan.plan import PhasePlan
from cosim.stepping.stepped_run import SteppedRun
from cosim.trade.simulation import Build


def with_commands(scenario: Scenario, build: Build) -> Scenario:
    """Return the scenario with every target of the tip replaced by the tensions or the flange pose found.

    Args:
        scenario: checked.
        build: makes a simulation; one without a plan leaves the scenario as it is.

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
    simulation = build(scenario)
    if not isinstance(simulation, SteppedRun):
        return scenario
    phases = []
    for planned in simulation.plan.phases:
        phase, target = planned.phase, planned.phase.tip_target
        if target is not None:
            found = _tensions(planned) if target.reach_with == "cables" else _flange(planned)
            phase = replace(phase, tip_target=None, **found)
        phases.append(phase)
    return resolve(replace(scenario, phases=tuple(phases)))


def _tensions(planned: PhasePlan) -> dict[str, tuple[float, ...]]:
    return {"cable_tension_N": tuple(planned.end.cable_tension_N)}


def _flange(planned: PhasePlan) -> dict[str, FlangePoseTable]:
    return {"flange": flange_pose(planned.flange)}


def flange_pose(pose: Pose) -> FlangePoseTable:
    """Return a pose, world from flange, as a scenario's `flange` table describes it."""
    direction = pose.rotation[:, 2]
    turned = rotation_from_direction(direction).T @ pose.rotation  # about the flange's z axis
    x, y, z = (float(value) for value in pose.translation)
    a, b, c = (float(value) for value in direction / np.linalg.norm(direction))
    return FlangePoseTable((x, y, z), (a, b, c), math.atan2(turned[1, 0], turned[0, 0]))
