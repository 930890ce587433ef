"""Converts a scenario's tables to the options of the solvers, the contact law and the soft body, and names
the soft body for caches.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from cosim.base import kept_parts
from cosim.build.soft_body import build_soft_body
from cosim.config.rules import file_of
from cosim.config.schema.body_sources import BodySourceTable, MeshTable
from cosim.config.schema.given_body import AnySoftRobot
from cosim.config.schema.pattern import PatternTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import ModelTable
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.rules import errors_at
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.solve import newton_options, step_scheme

EQUILIBRIUM_ITERATIONS_MAX = 100
REUSE_MAX = 12  # iterations with a reused factorisation; after that a new one is faster
STATIC_REUSE_BELOW_N = 1e-2  # residual; above it, in statics, new tangents select the equilibrium


def fidelity_body(scenario: Scenario, finer: int = 0) -> SoftBody:
    """Return the soft body of a scenario, with the mesh of its fidelity, in the flange frame.

    Args:
        scenario: checked.
        finer: additional refinements, each of which divides every triangle into four.

    Raises:
        ScenarioError: the geometry gives degenerate triangles.
    """
    refined = finer + (scenario.fidelity == "refined")
    return described_body(file_of(scenario, "its mesh"), scenario.model, refined)


def described_body(robot: SoftRobotTable, model: ModelTable, finer: int = 0) -> SoftBody:
    """Return the soft body of a robot's table, in the flange frame.

    Raises:
        ScenarioError: it cannot be built; see `build_soft_body`.
    """
    with errors_at("soft_robot.body" if robot.stack is None else "soft_robot.stack"):
        return build_soft_body(robot, model, finer=finer)


def static_options(scenario: Scenario) -> newton_options.NewtonOptions:
    """Return the options of a scenario's equilibria."""
    return newton_options.NewtonOptions(
        tolerance_N=scenario.solver.residual_tolerance_N,
        start_tolerance_N=scenario.solver.residual_tolerance_N,
        iterations_max=EQUILIBRIUM_ITERATIONS_MAX,
        search_iterations_max=scenario.solver.search_iterations_max,
        reuse_max=REUSE_MAX if scenario.mode == "quasistatic" else 0,
        reuse_below_N=STATIC_REUSE_BELOW_N,
        switches_branches=not scenario.solver.follow_unstable,
    )


def dynamic_options(scenario: Scenario) -> step_scheme.StepOptions:
    """Return the options of a scenario's time steps."""
    return step_scheme.StepOptions(
        integrator=scenario.solver.integrator,
        tolerance_N=scenario.solver.dynamic_tolerance_N,
        iterations=scenario.solver.dynamic_newton_iterations,
        newton=replace(static_options(scenario), reuse_max=REUSE_MAX, reuse_below_N=math.inf),
        damping_per_s=scenario.solver.damping_per_s,
        air_drag_per_s=scenario.solver.air_drag_per_s,
    )


def contact_law(scenario: Scenario) -> ContactLaw:
    """Return the law of contact with the scene."""
    given = scenario.contact
    return ContactLaw(given.stiffness_N_m3, given.smoothing_m, given.stick_m)


def body_name(scenario: Scenario) -> str:
    """Return a cache name of a scenario's soft body, from its tables and its mesh files."""
    sources = tuple(_sources(scenario.soft_robot))
    if not all(isinstance(source, MeshTable | PatternTable) for source in sources):
        return kept_parts.nameless()  # the files of other kinds of sources are unknown
    names = [source.file for source in sources if isinstance(source, MeshTable | PatternTable)]
    files = kept_parts.stamps(Path(name) for name in names if name is not None)
    return kept_parts.name_of(scenario.soft_robot, scenario.model, scenario.fidelity == "refined", files)


def _sources(robot: AnySoftRobot) -> Iterator[BodySourceTable]:
    if not isinstance(robot, SoftRobotTable):
        return
    if robot.body is not None:
        yield robot.body
    for part in robot.attachments:
        yield from _sources(part.robot)
