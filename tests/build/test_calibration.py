"""Calibration of a coarse mesh to its refined model, and what becomes of it in the robot's file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cosim.base.resources import soft_robot_path
from cosim.build.calibration import CalibrationReport, calibrate, largest_errors, load_cases
from cosim.build.soft_body import build_soft_body
from cosim.cli.calibrate import table_text, write_table
from cosim.config.loading import load_scenario, load_soft_robot
from cosim.config.schema.soft_robot import CalibrationTable
from cosim.config.schema.solver import ModelTable
from cosim.errors import ScenarioError

VALUES = CalibrationTable(film_modulus_factor=0.5, compressive_fraction=0.25, hinge_factor=2.0)


@pytest.fixture(scope="module")
def report() -> CalibrationReport:
    """One framed unit against four times the triangles: small, and free of wrinkling branches."""
    return calibrate(load_soft_robot("framed_hexagon_arm"), refine=1, units=1)


def test_extension_under_unfitted_loads_comes_within_two_percent(report: CalibrationReport) -> None:
    straight = np.array([case.lateral == 0.0 for case in report.cases])
    checked = straight & (np.arange(len(report.cases)) >= report.fitted)
    before = np.abs(report.coarse / report.refined - 1.0)[checked]
    after = np.abs(report.calibrated / report.refined - 1.0)[checked]
    assert checked.sum() >= 3
    # three parameters against a smooth response: what is left is well below the error of the coarse mesh
    assert after.max() < 0.02
    assert after.max() < before.max()


def test_largest_errors_are_over_fitted_and_checked_loads(report: CalibrationReport) -> None:
    fit, check = load_cases(5e3, 40e3)
    for worst in range(len(fit) + len(check)):  # wherever the worst load stands, fitted ones included
        errors = np.full(len(fit) + len(check), 0.01)
        errors[worst] = -0.115
        lateral = (*fit, *check)[worst].lateral != 0.0
        assert largest_errors((*fit, *check), errors) == ((0.01, 0.115) if lateral else (0.115, 0.01))
    found = largest_errors(report.cases, report.calibrated / report.refined - 1.0)
    assert found == (report.calibration.largest_error, report.calibration.largest_lateral_error)


def test_a_calibration_changes_film_and_hinges() -> None:
    robot = replace(load_soft_robot("hexagon_arm"), calibration=VALUES)
    plain = build_soft_body(robot, ModelTable())
    fitted = build_soft_body(robot, ModelTable(calibrated=True))
    film = plain.membranes.film
    assert fitted.membranes.film.law == "tension_field"
    assert fitted.membranes.film.compressive_fraction == 0.25
    assert fitted.membranes.film.young_modulus_Pa == 0.5 * film.young_modulus_Pa
    # relative to the real film, whatever the effective modulus
    assert fitted.hinges.stiffness == pytest.approx(2.0 * film.bending_stiffness_Nm)


def test_the_table_is_written_and_replaced_and_the_rest_stays(tmp_path: Path) -> None:
    path = tmp_path / "arm.toml"
    original = soft_robot_path("square_core").read_text(encoding="utf-8").rstrip("\n")
    path.write_text(original + "\n", encoding="utf-8")
    write_table(path, table_text(replace(VALUES, hinge_factor=7.0)))
    write_table(path, table_text(VALUES))
    assert path.read_text(encoding="utf-8") == f"{original}\n\n{table_text(VALUES)}"
    assert load_soft_robot(path).calibration == VALUES


def test_a_scenario_cannot_use_what_is_not_there() -> None:
    with pytest.raises(ScenarioError, match=r"model.calibrated: .*square_core.* cosim calibrate"):
        load_scenario("ur5e_hexagon_arm", {"model.calibrated": True, "soft_robot": "square_core"})
    with pytest.raises(ScenarioError, match=r"model.calibrated: .*unrefined"):
        load_scenario("ur5e_hexagon_arm", {"model.calibrated": True, "soft_robot.stack.refine": 1})
