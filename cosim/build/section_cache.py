"""Section models of soft robots, built once and kept on disk."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np

from cosim.base.identity import content_name
from cosim.base.whole_files import cache_directory, keep, kept
from cosim.build.soft_body import build_soft_body
from cosim.config.rules.given_body_rules import file_of
from cosim.config.schema.scenario import Scenario
from cosim.errors import ConvergenceError, ScenarioError
from cosim.reduced.fit.building import METHOD, LARGEST_PRESSURE_Pa, build_model
from cosim.reduced.section_model import SectionModel
from cosim.reduced.sections.pressure_spline import PressureSpline
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.hinge_gradient import CLOSED_FRACTION

_ARRAYS = ("energy", "length", "gas", "nodes", "force_error")
_MARGIN = 1.1  # of the range of pressure over the largest that a scenario gives


def section_model(
    scenario: Scenario, tell: Callable[[str], None] = lambda text: None, body: SoftBody | None = None
) -> SectionModel:
    """Return the section model of a scenario's soft robot, from disk or newly built.

    Args:
        scenario: checked, of a soft robot that has one.
        tell: told in one sentence what takes long.
        body: of that soft robot, if it has been built already.

    Raises:
        ScenarioError: the film has no smooth states to condense.
    """
    if body is None:
        body = build_soft_body(file_of(scenario, "a section model"), scenario.model)
    largest = largest_covered(scenario)
    path = cache_directory() / f"section_{content_hash(body, largest)}.kept"
    found = kept(path, _unpacked)
    if found is not None:
        return found
    tell(f"Building the section model of {scenario.soft_robot.name}: up to a minute, once; kept in {path}")
    try:
        model = build_model(body, largest)
    except ConvergenceError as error:
        raise ScenarioError(
            "fidelity",
            f"no section model of '{scenario.soft_robot.name}': straight, up to {1e-3 * largest:g} kPa and "
            f"pulled, its film loses its equilibrium, as where thin stiffeners buckle ({error}); "
            "take fidelity = 'lumped', or a larger section of the stiffener",
        ) from error
    keep(path, _packed(model))
    return model


def section_figures(model: SectionModel | None) -> dict[str, float] | None:
    """Return the figures of a section model as a summary has them; None without one."""
    if model is None:
        return None
    return {
        "tip_error_m": model.tip_error_m,
        "tip_error": model.tip_error,
        "frames": model.length.shape[1] + 1,
        "samples": model.samples,
        "failures": model.failures,
        "largest_pressure_Pa": model.spline.largest_Pa,
    }


def largest_covered(scenario: Scenario) -> float:
    """Return the pressure [Pa] up to which a scenario's section model is built."""
    given = [scenario.start.pressure_Pa, *(phase.pressure_Pa for phase in scenario.phases)]
    given += [p for phase in scenario.phases for p in (phase.pump_pressure_Pa or {}).values()]
    # a stack of units is one chamber; where several are named, there is no section model
    single = [float(p) for p in given if isinstance(p, int | float)]
    return max(LARGEST_PRESSURE_Pa, *(_MARGIN * p for p in single))


def content_hash(body: SoftBody, largest_Pa: float) -> str:
    """Return a short name of everything that a section model depends on."""
    return content_name(METHOD, CLOSED_FRACTION, largest_Pa, body)


def _packed(model: SectionModel) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        spline=np.array([model.spline.largest_Pa, model.spline.intervals]),
        counts=np.array([model.samples, model.failures]),
        tip_error=np.array(model.tip_error),
        tip_error_m=np.array(model.tip_error_m),
        **{name: getattr(model, name) for name in _ARRAYS},
    )
    return stream.getvalue()


def _unpacked(data: bytes) -> SectionModel:
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        arrays = {name: stored[name] for name in _ARRAYS}
        largest, intervals = stored["spline"].tolist()
        samples, failures = stored["counts"].tolist()
        error, error_m = float(stored["tip_error"]), float(stored["tip_error_m"])
    return SectionModel(
        PressureSpline(largest, int(intervals)),
        **arrays,
        samples=int(samples),
        failures=int(failures),
        tip_error=error,
        tip_error_m=error_m,
    )
