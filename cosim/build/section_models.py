"""Builds the section model of a soft robot, or reads it from the package or the cache, and checks its error
against the film. The package has those of the scenarios in `SHIPPED`, in files named by what the robot's file
says: `python benchmarks/section_models.py` makes them again.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final

from cosim.base import caches, identity, state_file
from cosim.build import soft_body
from cosim.config.rules import file_of
from cosim.config.schema.scenario import Scenario
from cosim.errors import ConvergenceError, InputError, ScenarioError
from cosim.reduced.fitting import METHOD, LARGEST_PRESSURE_Pa, build_model
from cosim.reduced.section_model import SectionModel
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.hinge import CLOSED_FRACTION
from cosim.soft.solve.self_contact import FilmContactLaw
from cosim.stepping.film_contact import film_law, film_pairs

SHIPPED: Final = ("ur5e_hexagon_arm",)
"""Scenarios whose section model comes with cosim."""
FOLDER: Final = Path(__file__).resolve().parents[1] / "section_models"
"""Of the section models that come with cosim."""
_MOST_OFF = 0.05  # largest distance of the model's tip from the film's, as a fraction of the length
_MARGIN = 1.1  # of the model's largest pressure over that of the scenario


def section_model(
    scenario: Scenario, tell: Callable[[str], None] = lambda text: None, body: SoftBody | None = None
) -> SectionModel:
    """Return the section model of a scenario's soft robot, from the package, from disk or newly built.

    Args:
        scenario: checked, with fidelity = "section".
        tell: gets a progress message before a long computation.
        body: of the soft robot; None: it is built here.

    Raises:
        ScenarioError: the film has no smooth states to condense, or the model's error is too large, or it
            loses equilibria that the film has.
    """
    robot = file_of(scenario, "a section model")
    if body is None or robot.copies is not None:  # all copies have the same section model
        body = soft_body.build_soft_body(replace(robot, copies=None, palm=None), scenario.model)
    body, largest, films = _one_way(body), largest_covered(scenario), film_law(scenario)
    if films is not None:  # friction has no energy; units touch in most samples
        films = (
            replace(films, friction=0.0, throughout=True, inside=robot.copies is None)
            if film_pairs(body)
            else None
        )
    fold = "_folds" if robot.copies is not None else ""

    def built() -> SectionModel:
        tell(f"Building the section model of {robot.name}: up to two minutes, once (see cosim cache)")
        return _built(scenario, body, largest, films)

    name = f"{content_hash(body, largest, films)}{fold}"
    model = _shipped(scenario) or state_file.load_or_make(caches.SECTION_MODELS, name, SectionModel, built)
    if math.isinf(model.tip_error):
        raise ScenarioError(
            "fidelity",
            f"the section model of '{robot.name}' is not valid: within its range it loses its equilibrium "
            "at loads at which its film has one; use fidelity = 'lumped'",
        )
    off = max((away / length for _, away, length in model.tips.tolist() if math.isfinite(away)), default=0.0)
    if off > _MOST_OFF:
        raise ScenarioError(
            "fidelity",
            f"the section model of '{robot.name}' is too far off its film: its tip by up to {off:.0%} of the "
            f"length, more than {_MOST_OFF:.0%}, at loads that were not fitted; use fidelity = 'lumped'",
        )
    return model


def shipped_path(scenario: Scenario) -> Path:
    """Return where the package has the section model of a scenario's soft robot, if it has it.

    The name is a digest of the robot's table and of all options that the model depends on, not of computed
    numbers, which other machines round in another way.

    Raises:
        TypeError: the table has values of a user's code.
    """
    robot = file_of(scenario, "a section model")
    table, folds = replace(robot, copies=None, palm=None), robot.copies is not None
    name = identity.content_name(
        METHOD, CLOSED_FRACTION, largest_covered(scenario), table, scenario.model, film_law(scenario), folds
    )
    return FOLDER / f"{name}.npz"


def _shipped(scenario: Scenario) -> SectionModel | None:
    """Return the section model that the package has for a scenario's soft robot; None if it has none."""
    with suppress(TypeError, InputError):  # a user's code, or another version of cosim
        path = shipped_path(scenario)
        model = state_file.load(path) if path.is_file() else None
        return model if isinstance(model, SectionModel) else None
    return None


def _built(
    scenario: Scenario, body: SoftBody, largest_Pa: float, films: FilmContactLaw | None
) -> SectionModel:
    """Return the section model of a body; that of a refined stack starts from one refinement less.

    Raises:
        ScenarioError: the film has no smooth states to condense.
    """
    robot, coarse = file_of(scenario, "a section model"), None
    fingers = robot.copies is not None
    if robot.stack is not None and robot.stack.refine:
        stack = replace(robot.stack, refine=robot.stack.refine - 1)
        robot = replace(robot, stack=stack, copies=None, palm=None)
        coarse = _one_way(soft_body.build_soft_body(robot, scenario.model))
    try:
        # fingers fold around the held object
        return build_model(body, largest_Pa, films, coarse, None, fingers)
    except ConvergenceError as error:
        raise ScenarioError(
            "fidelity",
            f"no section model of '{robot.name}': straight, up to {1e-3 * largest_Pa:g} kPa and "
            f"pulled, its film loses its equilibrium, as where thin stiffeners buckle ({error}); "
            "use fidelity = 'lumped', or a larger section of the stiffener",
        ) from error


def _one_way(body: SoftBody) -> SoftBody:
    """Return a body with cable losses "one_way": the energies are condensed along one loading path."""
    cables = (replace(cable, directed=False, loss_N=0.0) for cable in body.cables)
    return body.with_other(Cable, *cables)


def largest_covered(scenario: Scenario) -> float:
    """Return the largest pressure [Pa] of a scenario's section model."""
    given = [scenario.start.pressure_Pa, *(phase.pressure_Pa for phase in scenario.phases)]
    given += [p for phase in scenario.phases for p in (phase.pump_pressure_Pa or {}).values()]
    values = [p.values() if isinstance(p, Mapping) else p if isinstance(p, tuple) else (p,) for p in given]
    return max(LARGEST_PRESSURE_Pa, *(_MARGIN * p for row in values for p in row if p is not None))


def content_hash(body: SoftBody, largest_Pa: float, films: FilmContactLaw | None = None) -> str:
    """Return a cache name of a section model, a digest of all that it depends on."""
    return identity.content_name(METHOD, CLOSED_FRACTION, largest_Pa, body, films)
