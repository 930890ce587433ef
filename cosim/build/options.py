"""Converts a scenario's tables to the options of the solvers, the contact law and the soft body, and
describes its fidelity in words.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from cosim.build.soft_body import build_soft_body
from cosim.config.rules import file_of
from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.settings import ModelTable
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.toml.rules import errors_at
from cosim.reduced.section_model import STRAINS, SectionModel
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


def fidelity_report(scenario: Scenario, section: SectionModel | None) -> str:
    """Return text on the model of the soft robot, and on the error of its section model, if any."""
    paper = "; the paper's lumped model (model.published)" if scenario.model.published else ""
    return _rung(scenario, section) + paper


def _section_rung(model: SectionModel) -> str:
    built = (
        f"section: {model.length.shape[1] + 1} rigid frames, energies condensed from the film at "
        f"{model.samples} poses up to {1e-3 * model.spline.largest_Pa:g} kPa; {_forces_off(model)}"
    )
    if not len(model.tips):
        return built + "its range holds none of the loads at which its tip is compared with the film's"
    if not math.isfinite(model.tip_error):
        return built + "it has no equilibrium at some loads it was not built from, at which the film has one"
    return built + (
        f"its tip is within {1e3 * model.tip_error_m:.1f} mm ({1e2 * model.tip_error:.2f} % of the length) "
        f"of the film's at loads it was not built from, {1e3 * float(np.median(model.tips[:, 1])):.1f} mm in "
        "the median"
    )


def _forces_off(model: SectionModel) -> str:
    """Return text on the error of a section model's forces at poses that were not fitted, by strain."""
    middle, most = (model.held_out[:, first::2] for first in (1, 2))
    parts = []
    for k, strain in enumerate(STRAINS):
        worst = int(np.nanargmax(most[:, k]))
        parts.append(
            f"{strain} {1e2 * float(np.nanmedian(middle[:, k])):.1f} % ({1e2 * most[worst, k]:.0f} % at "
            f"{1e-3 * model.held_out[worst, 0]:.2g} kPa)"
        )
    return f"its forces at poses held out are off in the median (at most) by {', '.join(parts)}; "


def _rung(scenario: Scenario, section: SectionModel | None) -> str:
    targets = [phase.name for phase in scenario.phases if phase.tip_key is not None]
    if scenario.fidelity == "rigid":
        planned = f"; the targets of {', '.join(targets)} are planned on the lumped model" if targets else ""
        return f"rigid: the shape of the start is kept, weight and inertia only{planned}"
    if section is not None:
        return _section_rung(section)
    if scenario.fidelity == "refined":
        return "refined: every triangle divided into four"
    if isinstance(scenario.soft_robot, GivenBodyTable):
        return "lumped: the mesh that is given as arrays"
    return "lumped: the mesh of the soft robot's file"


def contact_law(scenario: Scenario) -> ContactLaw:
    """Return the law of contact with the scene."""
    given = scenario.contact
    return ContactLaw(given.stiffness_N_m3, given.smoothing_m, given.stick_m)


def section_figures(model: SectionModel | None) -> dict[str, Any] | None:
    """Return the figures of a section model for the summary; None without one."""
    if model is None:
        return None
    tips = {float(p): model.tips[model.tips[:, 0] == p, 1] for p in np.unique(model.tips[:, 0])}
    pairs = [(row[0], zip(row[1::2], row[2::2], strict=True)) for row in model.held_out.tolist()]
    return {
        "tip_error_m": model.tip_error_m,
        "tip_error": model.tip_error,
        "frames": model.length.shape[1] + 1,
        "samples": model.samples,
        "failures": model.failures,
        "largest_pressure_Pa": model.spline.largest_Pa,
        "tip_by_pressure": [
            {"pressure_Pa": p, "median_m": float(np.median(each)), "largest_m": float(each.max())}
            for p, each in tips.items()
        ],
        "held_out": [
            {"pressure_Pa": p} | {name: list(pair) for name, pair in zip(STRAINS, of, strict=True)}
            for p, of in pairs
        ],
    }
