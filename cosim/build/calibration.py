"""Calibration: the few parameters of a coarse mesh that make it answer like its own refined model.

A coarse mesh cannot wrinkle, so it is too stiff. Three numbers mend most of that: a factor on the film's
modulus, the compressive fraction of a tension field, and a factor on the hinges. They are fitted on a short
stack of the robot's own units, closed, without weight, to a model with a finer mesh whose film obeys the
plain law and bends as a shell. Loads: pressure alone, and with axial and lateral forces at the tip ring.
Cables are left out on purpose: a cable pulls single nodes, and how far a node gives way depends on the mesh
without limit; on the real device an eyelet sits on a frame.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np
from scipy.optimize import least_squares

from cosim.base.frames import Array, Pose
from cosim.build.soft_body import build_soft_body, calibrated_model
from cosim.config.schema.soft_robot import CalibrationTable, SoftRobotTable
from cosim.config.schema.solver import ModelTable
from cosim.errors import ConvergenceError
from cosim.soft.body.body import SoftBody
from cosim.soft.body.loads import Loads
from cosim.soft.solve.assembly import SoftSystem
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.newton import NewtonSolver
from cosim.soft.solve.newton_options import NewtonOptions
from cosim.soft.solve.state import Clamp, Equilibrium, SoftState

_PIECES = 4
# logarithm of the modulus factor, compressive fraction, hinge factor
_STARTS = ((0.0, 0.2, 1.0), (-1.0, 0.5, 1.0))
_BOUNDS = ((-4.0, 1e-3, 0.0), (2.0, 1.0, 30.0))
_SCALE = (0.5, 0.2, 1.0)
_LATERAL_WEIGHT = 0.2  # decides between parameters that serve pressure and axial loads equally well
_PRESSURE_RANGE_Pa = (5e3, 40e3)
_FAILED = 1.0  # relative error that a set of parameters without equilibrium is charged with


@final
@dataclass(frozen=True)
class LoadCase:
    """One load on the specimen.

    Args:
        pressure_Pa: gauge pressure.
        axial: force at the tip ring along the axis, as a share of pressure times unit area.
        lateral: the same across the axis.
    """

    pressure_Pa: float
    axial: float = 0.0
    lateral: float = 0.0


def load_cases(lowest_Pa: float, highest_Pa: float) -> tuple[tuple[LoadCase, ...], tuple[LoadCase, ...]]:
    """Return the loads to fit and the loads to check, both over the same range of pressure."""
    low, high = np.log(lowest_Pa), np.log(highest_Pa)
    fit, check = np.exp(np.linspace(low, high, 4)), np.exp(np.linspace(low, high, 7)[1::2])
    middle = float(np.exp(0.5 * (low + high)))
    fitted = [LoadCase(float(p)) for p in fit]
    fitted += [
        LoadCase(middle, axial=-0.002),
        LoadCase(lowest_Pa, lateral=4e-4),
        LoadCase(highest_Pa, lateral=4e-4),
    ]
    checked = [LoadCase(float(p)) for p in check]
    checked += [LoadCase(float(check[0]), axial=-0.003), LoadCase(middle, lateral=5e-4)]
    return tuple(fitted), tuple(checked)


@final
@dataclass(frozen=True)
class CalibrationReport:
    """A calibration and what it was judged by.

    Args:
        calibration: the fitted parameters, with their largest errors over fitted and checked loads.
        cases: loads, fitted ones first.
        fitted: how many of the cases were fitted.
        refined: response of the refined model to each case [m].
        coarse: of the coarse mesh as it is.
        calibrated: of the calibrated coarse mesh.
        speedup: CPU time of the refined model over that of the coarse one, same cases.
    """

    calibration: CalibrationTable
    cases: tuple[LoadCase, ...]
    fitted: int
    refined: Array
    coarse: Array
    calibrated: Array
    speedup: float


def calibrate(
    robot: SoftRobotTable,
    *,
    refine: int = 2,
    units: int = 2,
    tell: Callable[[str], None] = lambda _text: None,
) -> CalibrationReport:
    """Fit the coarse mesh of a robot to its refined model.

    Args:
        robot: its description; an existing calibration is ignored.
        refine: refinement of the model that is taken as truth.
        units: of the specimen, at most those of the robot.
        tell: told what is being done.

    Raises:
        ConvergenceError: the refined model has no equilibrium under one of the loads.
    """
    specimen = _specimen(robot, units)
    fit, check = load_cases(*_PRESSURE_RANGE_Pa)
    cases = (*fit, *check)
    tell(f"solving the refined model ({4**refine} times the triangles) under {len(cases)} loads")
    refined, refined_s = _timed(refined_model(specimen, refine), cases)
    coarse, coarse_s = _timed(specimen, cases)
    parameters = _fit(specimen, fit, refined[: len(fit)], tell)
    calibrated = (1.0 + _error(specimen, parameters, cases, refined)) * refined
    straight, lateral = largest_errors(cases, calibrated / refined - 1.0)
    calibration = replace(
        _calibration(parameters),
        reference_refine=refine,
        pressure_range_Pa=_PRESSURE_RANGE_Pa,
        largest_error=straight,
        largest_lateral_error=lateral,
    )
    speedup = refined_s / max(coarse_s, 1e-9)
    return CalibrationReport(calibration, cases, len(fit), refined, coarse, calibrated, speedup)


def largest_errors(cases: Sequence[LoadCase], errors: Array) -> tuple[float, float]:
    """Return the largest absolute error without lateral force and with it, fitted and checked loads alike.

    Args:
        cases: loads.
        errors: (cases,) relative error under each.
    """
    lateral = np.array([case.lateral != 0.0 for case in cases])
    size = np.abs(errors)
    return float(size[~lateral].max()), float(size[lateral].max())


def _fit(
    specimen: SoftRobotTable, cases: Sequence[LoadCase], truth: Array, tell: Callable[[str], None]
) -> Array:
    """Return the parameters (3,) that serve the cases best, from two starts."""
    weight = np.array([_LATERAL_WEIGHT if case.lateral else 1.0 for case in cases])

    def cost(parameters: Array) -> Array:
        return weight * _error(specimen, parameters, cases, truth)

    fits = []
    for start in _STARTS:
        tell(f"fitting from compressive fraction {start[1]:g}")
        fits.append(
            least_squares(cost, start, bounds=_BOUNDS, x_scale=_SCALE, diff_step=1e-3, ftol=1e-5, xtol=1e-5)
        )
    return np.asarray(min(fits, key=lambda found: float(found.cost)).x)


def _error(specimen: SoftRobotTable, parameters: Array, cases: Sequence[LoadCase], truth: Array) -> Array:
    """Return the relative errors of the calibrated coarse mesh."""
    try:
        return responses(calibrated_model(specimen, _calibration(parameters)), cases) / truth - 1.0
    except ConvergenceError:
        return np.full(len(cases), _FAILED)


def _calibration(parameters: Array) -> CalibrationTable:
    logarithm, fraction, hinge = (float(value) for value in parameters)
    return CalibrationTable(
        film_modulus_factor=float(np.exp(logarithm)), compressive_fraction=fraction, hinge_factor=hinge
    )


def _specimen(robot: SoftRobotTable, units: int) -> SoftRobotTable:
    stack = robot.stack.shortened(units)
    return replace(robot, stack=stack, cables=(), elements=(), base=("unit_1.hole",), calibration=None)


def refined_model(robot: SoftRobotTable, refine: int) -> SoftRobotTable:
    """Return the robot with a finer mesh, a plain film and hinges that bend like the film."""
    return replace(
        robot,
        stack=replace(robot.stack, refine=refine),
        film=replace(robot.film, law="plain", compressive_fraction=0.0),
        hinge=replace(robot.hinge, rule="shell", stiffness_factor=1.0),
        calibration=None,
    )


def _timed(robot: SoftRobotTable, cases: Sequence[LoadCase]) -> tuple[Array, float]:
    began = time.process_time()
    return responses(robot, cases), time.process_time() - began


def responses(robot: SoftRobotTable, cases: Sequence[LoadCase]) -> Array:
    """Return what the tip does under each case [m]: its deflection under a lateral force, else its extension.

    Args:
        robot: the specimen, without weight.
        cases: loads.

    Raises:
        ConvergenceError: no equilibrium under one of the loads.
    """
    body = build_soft_body(robot, ModelTable())
    clamp = Clamp.of_base(body)
    options = NewtonOptions(iterations_max=300, step_max_m=0.01)
    newton = NewtonSolver(SoftSystem(body), clamp.mask(body.nodes))
    solver = EquilibriumSolver(newton, clamp, options, slides_max=0)
    inflated = _inflated(solver, body, sorted({case.pressure_Pa for case in cases}))
    area = np.pi * robot.stack.corner_radius_m**2
    result = []
    for case in cases:
        here = inflated[case.pressure_Pa]
        if case.axial or case.lateral:
            force = np.zeros((body.nodes, 3))
            force[body.tip] = (
                np.array([case.lateral, 0.0, case.axial]) * case.pressure_Pa * area / len(body.tip)
            )
            here = solver.follow(here, Pose(), replace(here.loads, nodal_force=force))
        moved = body.tip_position(here.state.positions) - body.tip_position(body.positions)
        result.append(moved[0] if case.lateral else moved[2])
    return np.array(result)


def _inflated(
    solver: EquilibriumSolver, body: SoftBody, pressures: Sequence[float]
) -> dict[float, Equilibrium]:
    """Return the equilibrium at each pressure, followed from the flat shape."""
    none = (0.0,) * len(body.cables)
    here, last, found = None, 0.0, {}
    for pressure in pressures:
        for value in np.linspace(last, pressure, _PIECES + 1)[1:]:
            loads = Loads(float(value), none, (0.0, 0.0, 0.0))
            if here is None:
                here = solver.solve(SoftState.drawn(body, Pose()), Pose(), loads)
            else:
                here = solver.follow(here, Pose(), loads)
        assert here is not None
        found[pressure], last = here, pressure
    return found
