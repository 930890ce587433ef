"""What stands for the soft robot of a scenario: its body, its section model, and soft sides made of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import final

from cosim.base.kept_parts import KeptParts, name_of, nameless, stamps
from cosim.build.fidelity import dynamic_options, fidelity_body, static_options
from cosim.build.section_cache import largest_covered, section_model
from cosim.config.schema.body_source import BodySourceTable, MeshTable
from cosim.config.schema.given_body import AnySoftRobot
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.coupling.soft_sides.frozen_body import FrozenBody
from cosim.coupling.soft_sides.lumped_arm import SoftArm
from cosim.coupling.soft_sides.section_arm import SectionArm
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import ScenarioError
from cosim.plan.flange_path import pose_of
from cosim.reduced.section_model import SectionBody
from cosim.soft.body.body import SoftBody
from cosim.stepping.parts import film_law


@final
class SoftModel:
    """The model of a scenario's soft robot.

    Attributes: `body`, in the flange frame; `section`, None unless that is the fidelity; `body_name` and
    `name`, of all that the body, and the soft sides, depend on; `lasting`, whether these names tell it from
    all others in other processes too: where users' own code has a part in it, they do not.

    Args:
        scenario: checked.
        kept: parts that may serve again.
        given: the soft body, where the scenario's is given as arrays.
        tell: told in one sentence what takes long, and what soft sides that search for long try.

    Raises:
        ScenarioError: the fidelity is still to be chosen, or the geometry gives degenerate triangles.
    """

    def __init__(
        self,
        scenario: Scenario,
        kept: KeptParts,
        given: SoftBody | None = None,
        tell: Callable[[str], None] = lambda _text: None,
    ) -> None:
        if scenario.fidelity == "auto":
            raise ScenarioError("fidelity", "'auto' is settled before a run is built; see cosim.trade.auto")
        self._scenario, self._tell = scenario, tell
        self._flange = pose_of(scenario.start.flange)
        self._statics, self._dynamics = static_options(scenario), dynamic_options(scenario)
        self._films = film_law(scenario)
        self.body_name, self.lasting = body_name(scenario), _is_lasting(scenario.soft_robot)
        self.body = kept.made(
            "body", self.body_name, lambda: fidelity_body(scenario) if given is None else given
        )
        self.section, largest = None, 0.0
        if scenario.fidelity == "section":
            largest = largest_covered(scenario)
            self.section = kept.made(
                "section model", name_of(self.body_name, largest),
                lambda: section_model(scenario, tell, self.body),
            )  # fmt: skip
        self.name = name_of(
            self.body_name, scenario.fidelity, largest, self._flange, self._statics, self._dynamics,
            self._films,
        )  # fmt: skip

    def trial(self) -> SoftSide:
        """Return a soft side to plan phases on.

        It is of the model that runs, but that a rigid one is planned on the lumped one: tensions and flange
        poses are then those of the run that it stands for.
        """
        if self.section is not None:
            section = SectionBody(self.body, self.section)
            return SectionArm(section, self._flange, self._statics, self._dynamics)
        arm = SoftArm(self.body, self._flange, self._statics, self._dynamics, self._films)
        arm.effort.tell = self._tell
        return arm

    def side(self) -> SoftSide:
        """Return a soft side to run."""
        flexible = self.trial()
        if self._scenario.fidelity == "rigid":
            return FrozenBody(flexible, self._scenario.solver.damping_per_s)
        return flexible


def body_name(scenario: Scenario) -> str:
    """Return a name of all that a scenario's soft body is made of, files of meshes among it."""
    sources = tuple(_sources(scenario.soft_robot))
    if not all(isinstance(source, MeshTable) for source in sources):
        return nameless()  # what other kinds of sources read is not known
    files = stamps(Path(source.file) for source in sources if isinstance(source, MeshTable))
    return name_of(scenario.soft_robot, scenario.model, scenario.fidelity == "refined", files)


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
