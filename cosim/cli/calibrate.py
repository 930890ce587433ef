"""`cosim calibrate`: fits a soft robot's coarse mesh to its refined model."""

from __future__ import annotations

import re
from pathlib import Path

from cosim.base.resources import soft_robot_path
from cosim.build.calibration import CalibrationReport, calibrate
from cosim.cli.screen import printable, tell
from cosim.config.loading import load_soft_robot
from cosim.config.schema.soft_robot import CalibrationTable
from cosim.soft.solve.compilation import compile_kernels

_SECTION = re.compile(r"\n*^\[calibration\].*?(?=^\[|\Z)", re.MULTILINE | re.DOTALL)


def calibrate_command(name: str, refine: int, units: int, *, write: bool) -> int:
    """Fit, print the loads and the table, and return the exit code.

    Args:
        name: of the soft robot, or a path.
        refine: refinement of the model that is taken as truth.
        units: of the specimen.
        write: put the table into the robot's file.

    Raises:
        InputError: no such soft robot, or a wrong file.
        ConvergenceError: the refined model has no equilibrium under one of the loads.
    """
    robot = load_soft_robot(name)
    compile_kernels(tell)
    report = calibrate(robot, refine=refine, units=units, tell=tell)
    print("\n".join(_lines(report)))
    text = table_text(report.calibration)
    print(text)
    if write:
        path = soft_robot_path(name)
        write_table(path, text)
        print(printable(f"written to {path}; a scenario uses it with model.calibrated = true"))
    return 0


def _lines(report: CalibrationReport) -> list[str]:
    lines = ["load                                      refined [mm]    coarse        calibrated"]
    rows = zip(report.cases, report.refined, report.coarse, report.calibrated, strict=True)
    for index, (case, truth, coarse, fitted) in enumerate(rows):
        kind = "lateral" if case.lateral else "axial" if case.axial else ""
        use = "fitted" if index < report.fitted else "checked"
        lines.append(
            f"{1e-3 * case.pressure_Pa:6.2f} kPa {kind:<8} {use:<8} {1e3 * truth:18.3f}"
            f"   {100 * (coarse / truth - 1):+8.1f} %   {100 * (fitted / truth - 1):+8.1f} %"
        )
    lines.append(f"the refined model costs {report.speedup:.0f} times the CPU time of the coarse mesh\n")
    return lines


def table_text(calibration: CalibrationTable) -> str:
    """Return the calibration as the TOML table of a soft robot's file."""
    low, high = calibration.pressure_range_Pa
    return (
        "[calibration]                   # made by cosim calibrate\n"
        f"film_modulus_factor = {calibration.film_modulus_factor:.5g}\n"
        f"compressive_fraction = {calibration.compressive_fraction:.5g}\n"
        f"hinge_factor = {calibration.hinge_factor:.5g}\n"
        f"reference_refine = {calibration.reference_refine}\n"
        f"pressure_range_Pa = [{low:.6g}, {high:.6g}]\n"
        f"largest_error = {calibration.largest_error:.3g}\n"
        f"largest_lateral_error = {calibration.largest_lateral_error:.3g}\n"
    )


def write_table(path: Path, text: str) -> None:
    """Put a calibration table into a soft robot's file, in place of an older one; the rest stays as it is."""
    content = path.read_text(encoding="utf-8")
    content = _SECTION.sub("\n\n", content).rstrip("\n")
    path.write_text(f"{content}\n\n{text}", encoding="utf-8")
