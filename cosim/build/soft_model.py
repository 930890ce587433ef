"""The model that represents the soft robot of a scenario: its fidelity, its body, its section model.

The ladder of fidelities: which model represents the soft robot in a run.

Section models of soft robots, built once and kept on disk.

What represents the soft robot of a scenario: its body, its section model, and soft sides made of them.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import final

from cosim.base import caches, kept_parts, state_file
from cosim.build import options, soft_body
from cosim.config.rules import file_of
from cosim.config.schema.body_sources import BodySourceTable, MeshTable
from cosim.config.schema.given_body import AnySoftRobot, GivenBodyTable
from cosim.config.schema.pattern import PatternTable
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.coupling.soft_sides import frozen_body, lumped_arm, section_arm, soft_side
from cosim.errors import ConvergenceError, ScenarioError
from cosim.plan.motion import pose_of
from cosim.reduced.fitting import METHOD, LARGEST_PRESSURE_Pa, build_model
from cosim.reduced.section_model import SectionBody, SectionModel
from cosim.soft.body.body import SoftBody
from cosim.soft.elements.cable import Cable
from cosim.soft.elements.hinge import CLOSED_FRACTION
from cosim.soft.solve.self_contact import FilmContactLaw
from cosim.stepping.parts import film_law, meetings

_SHORT, _SHORT_SEARCH = 40, 600  # iterations from a shape nearby: what needs more is not near
_MOST_OFF = 0.05  # of the length, of the tip from the film's where both have an equilibrium
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
        ScenarioError: the film has no smooth states to condense, or its model is far off or loses equilibria.
    """
    robot = file_of(scenario, "a section model")
    if body is None or robot.copies is not None:  # copies share the model of one of them
        body = soft_body.build_soft_body(replace(robot, copies=None, palm=None), scenario.model)
    body, largest, films = _one_way(body), largest_covered(scenario), film_law(scenario)
    if films is not None:  # friction has no energy; most samples have units that press
        films = (
            replace(films, friction=0.0, throughout=True, inside=robot.copies is None)
            if meetings(body)
            else None
        )
    fold = "_folds" if robot.copies is not None else ""

    def built() -> SectionModel:
        tell(f"Building the section model of {robot.name}: up to two minutes, once (see cosim cache)")
        return _built(scenario, body, largest, films)

    name = f"{content_hash(body, largest, films)}{fold}"
    model = state_file.kept_or_made(caches.SECTION_MODELS, name, SectionModel, built)
    if math.isinf(model.tip_error):
        raise ScenarioError(
            "fidelity",
            f"the section model of '{robot.name}' does not hold: within its range it loses its equilibrium "
            "at loads at which its film has one; take fidelity = 'lumped'",
        )
    off = max((away / length for _, away, length in model.tips.tolist() if math.isfinite(away)), default=0.0)
    if off > _MOST_OFF:
        raise ScenarioError(
            "fidelity",
            f"the section model of '{robot.name}' is too far off its film: by up to {off:.0%} of its length, "
            f"more than {_MOST_OFF:.0%}, at loads that it was not built from; take fidelity = 'lumped'",
        )
    return model


def _built(
    scenario: Scenario, body: SoftBody, largest_Pa: float, films: FilmContactLaw | None
) -> SectionModel:
    """Return the section model of a body; of a refined stack, with the help of one refinement less.

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
        # fingers fold around what they hold
        return build_model(body, largest_Pa, films, coarse, None, fingers)
    except ConvergenceError as error:
        raise ScenarioError(
            "fidelity",
            f"no section model of '{robot.name}': straight, up to {1e-3 * largest_Pa:g} kPa and "
            f"pulled, its film loses its equilibrium, as where thin stiffeners buckle ({error}); "
            "take fidelity = 'lumped', or a larger section of the stiffener",
        ) from error


def _one_way(body: SoftBody) -> SoftBody:
    """Return a body whose cables lose one way: energies are condensed along one way of loading."""
    cables = (replace(cable, directed=False, loss_N=0.0) for cable in body.cables)
    return body.with_other(Cable, *cables)


def largest_covered(scenario: Scenario) -> float:
    """Return the pressure [Pa] up to which a scenario's section model is built."""
    given = [scenario.start.pressure_Pa, *(phase.pressure_Pa for phase in scenario.phases)]
    given += [p for phase in scenario.phases for p in (phase.pump_pressure_Pa or {}).values()]
    values = [p.values() if isinstance(p, Mapping) else p if isinstance(p, tuple) else (p,) for p in given]
    return max(LARGEST_PRESSURE_Pa, *(_MARGIN * p for row in values for p in row if p is not None))


def content_hash(body: SoftBody, largest_Pa: float, films: FilmContactLaw | None = None) -> str:
    """Return a short name of everything that a section model depends on."""
    return kept_parts.content_name(METHOD, CLOSED_FRACTION, largest_Pa, body, films)


@final
class SoftModel:
    """The model of a scenario's soft robot.

    Attributes: `kept`, parts that may be used again; `body`, in the flange frame; `section`, None unless that
    is the fidelity; `body_name`, `statics_name` and `name`, of all that the body, its equilibria and the soft
    sides depend on; `lasting`, whether these names tell it from all others in other processes too: where
    users' own code has a part in it, they do not.

    Args:
        scenario: checked.
        kept: parts that may be used again.
        given: the soft body, where the scenario's is given as arrays.
        tell: told in one sentence what takes long, and what soft sides that search for long try.

    Raises:
        ScenarioError: the geometry gives degenerate triangles.
    """

    def __init__(
        self,
        scenario: Scenario,
        kept: kept_parts.KeptParts,
        given: SoftBody | None = None,
        tell: Callable[[str], None] = lambda _text: None,
    ) -> None:
        self._scenario, self._tell, self.kept = scenario, tell, kept
        self._flange = pose_of(scenario.start.flange)
        self._statics, self._dynamics = options.static_options(scenario), options.dynamic_options(scenario)
        self._films = film_law(scenario)
        self.body_name, self.lasting = body_name(scenario), _is_lasting(scenario.soft_robot)
        self.body = kept.made(
            "body", self.body_name, lambda: options.fidelity_body(scenario) if given is None else given
        )
        self.section, largest = None, 0.0
        if scenario.fidelity == "section":
            largest = largest_covered(scenario)
            self.section = kept.made(
                "section model", kept_parts.name_of(self.body_name, largest, self._films),
                lambda: section_model(scenario, tell, self.body),
            )  # fmt: skip
        self.statics_name = kept_parts.name_of(
            self.body_name, scenario.fidelity, largest, self._flange, self._statics, self._films
        )
        self.name = kept_parts.name_of(self.statics_name, self._dynamics)

    def trial(self) -> soft_side.SoftSide:
        """Return a soft side to plan phases on.

        It is of the model that runs, but that a rigid one is planned on the lumped one: tensions and flange
        poses are then those of the run that it represents.
        """
        return self._flexible()

    @property
    def largest_pressure_Pa(self) -> float | None:
        """Pressure [Pa] at which a section model ends; None where none does."""
        return None if self.section is None else self.section.spline.largest_Pa

    def chain(self) -> section_arm.SectionArm:
        """Return the chain of the section model, which there is."""
        assert self.section is not None, "of a scenario whose fidelity is another"
        section = SectionBody(self.body, self.section)
        return section_arm.SectionArm(section, self._flange, self._statics, self._dynamics)

    def _flexible(self) -> soft_side.SoftSide:
        """Return a new soft side, of a section model where that is the fidelity, else of the film."""
        if self.section is not None:
            return self.chain()
        arm = lumped_arm.SoftArm(self.body, self._flange, self._statics, self._dynamics, self._films)
        arm.effort.tell = self._tell
        return arm

    @property
    def finer(self) -> Callable[[int], lumped_arm.SoftArm] | str:
        """What returns the film at a number of refinements; or why it cannot be refined."""
        scenario = self._scenario
        if scenario.fidelity == "rigid":
            return "the shape is frozen"
        if isinstance(scenario.soft_robot, GivenBodyTable):
            return "the soft robot is given as arrays, which cannot be refined"
        return self.refined

    def refined(self, levels: int) -> lumped_arm.SoftArm:
        """Return the film with every triangle divided into four so many times; searches are short."""
        short = replace(
            self._statics, iterations_max=_SHORT, search_iterations_max=_SHORT_SEARCH,
            reuse_max=options.REUSE_MAX, reuse_below_N=options.STATIC_REUSE_BELOW_N,
        )  # fmt: skip
        body = options.fidelity_body(self._scenario, levels)
        return lumped_arm.SoftArm(body, self._flange, short, self._dynamics, self._films)

    def side(self) -> soft_side.SoftSide:
        """Return a soft side to run."""
        flexible = self._flexible()
        if self._scenario.fidelity == "rigid":
            return frozen_body.FrozenBody(flexible, self._scenario.solver.air_drag_per_s)
        return flexible


def body_name(scenario: Scenario) -> str:
    """Return a name of all that a scenario's soft body is made of, files of meshes among it."""
    sources = tuple(_sources(scenario.soft_robot))
    if not all(isinstance(source, MeshTable | PatternTable) for source in sources):
        return kept_parts.nameless()  # what other kinds of sources read is not known
    names = [source.file for source in sources if isinstance(source, MeshTable | PatternTable)]
    files = kept_parts.stamps(Path(name) for name in names if name is not None)
    return kept_parts.name_of(scenario.soft_robot, scenario.model, scenario.fidelity == "refined", files)


def _is_lasting(robot: AnySoftRobot) -> bool:
    """Return whether all kinds of parts that a soft robot has are those of cosim."""
    if not isinstance(robot, SoftRobotTable):
        return False
    own = (type(entry).__module__.startswith("cosim.") for entry in robot.elements)
    return all(own) and all(_is_lasting(part.robot) for part in robot.attachments)


def _sources(robot: AnySoftRobot) -> Iterator[BodySourceTable]:
    if not isinstance(robot, SoftRobotTable):
        return
    if robot.body is not None:
        yield robot.body
    for part in robot.attachments:
        yield from _sources(part.robot)
