"""Describes the fidelity of a scenario's soft robot, and its section model, in words and figures."""

import math
from typing import Any

import numpy as np

from cosim.config.schema.given_body import GivenBodyTable
from cosim.config.schema.scenario import Scenario
from cosim.reduced.section_model import STRAINS, SectionModel


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
