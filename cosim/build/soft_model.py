"""Builds the model of a scenario's soft robot: its body, its section model, and the soft sides that plan and
run it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, final

from cosim.base import kept_parts
from cosim.build import options
from cosim.config.schema.given_body import AnySoftRobot
from cosim.config.schema.scenario import Scenario
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.coupling.robots import film_robot, frozen_robot, soft_robot
from cosim.plan.flange_motion import pose_of
from cosim.soft.body.body import SoftBody
from cosim.stepping.film_contact import film_law

if TYPE_CHECKING:
    from cosim.coupling.robots import beam_robot

_SHORT, _SHORT_SEARCH = 40, 600  # iterations of a solution that starts from a nearby shape


@final
class SoftModel:
    """The model of a scenario's soft robot.

    Attributes: `kept`, cache of parts; `body`, in the flange frame; `section`, the section model, None with
    another fidelity; `body_name`, `statics_name` and `name`, cache names of the body, its equilibria and the
    soft sides; `lasting`, whether these names are valid in other processes too: they are not if the soft
    robot has elements of a user's code.

    Args:
        scenario: checked.
        kept: cache of parts.
        given: the soft body, if the scenario's is given as arrays.
        tell: gets progress messages of long computations and searches.

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
        self.body_name, self.lasting = options.body_name(scenario), _is_lasting(scenario.soft_robot)
        self.body = kept.made(
            "body", self.body_name, lambda: options.fidelity_body(scenario) if given is None else given
        )
        self.section, largest = None, 0.0
        if scenario.fidelity == "section":
            # imported here because few runs need it
            from cosim.build.section_models import largest_covered, section_model

            largest = largest_covered(scenario)
            self.section = kept.made(
                "section model", kept_parts.name_of(self.body_name, largest, self._films),
                lambda: section_model(scenario, tell, self.body),
            )  # fmt: skip
        self.statics_name = kept_parts.name_of(
            self.body_name, scenario.fidelity, largest, self._flange, self._statics, self._films
        )
        self.name = kept_parts.name_of(self.statics_name, self._dynamics)

    @property
    def largest_pressure_Pa(self) -> float | None:
        """Largest pressure [Pa] of the section model; None without one."""
        return None if self.section is None else self.section.spline.largest_Pa

    def chain(self) -> beam_robot.BeamRobot:
        """Return the section model as a soft side; only with fidelity = "section"."""
        from cosim.coupling.robots import beam_robot  # here, as above
        from cosim.reduced.section_model import SectionBody

        assert self.section is not None, "needs fidelity = 'section'"
        section = SectionBody(self.body, self.section)
        return beam_robot.BeamRobot(section, self._flange, self._statics, self._dynamics)

    def flexible(self) -> soft_robot.SoftRobot:
        """Return a new soft side, of the section model if there is one, else of the film."""
        if self.section is not None:
            return self.chain()
        arm = film_robot.FilmRobot(self.body, self._flange, self._statics, self._dynamics, self._films)
        arm.effort.report = self._tell
        return arm

    def refined(self, levels: int) -> film_robot.FilmRobot:
        """Return the film with additional refinements; its solutions have few iterations."""
        short = replace(
            self._statics, iterations_max=_SHORT, search_iterations_max=_SHORT_SEARCH,
            reuse_max=options.REUSE_MAX, reuse_below_N=options.STATIC_REUSE_BELOW_N,
        )  # fmt: skip
        body = options.fidelity_body(self._scenario, levels)
        return film_robot.FilmRobot(body, self._flange, short, self._dynamics, self._films)

    def side(self) -> soft_robot.SoftRobot:
        """Return the soft side of the run."""
        flexible = self.flexible()
        if self._scenario.fidelity == "rigid":
            return frozen_robot.FrozenRobot(flexible, self._scenario.solver.air_drag_per_s)
        return flexible


def _is_lasting(robot: AnySoftRobot) -> bool:
    """Return whether all elements of a soft robot are of kinds that cosim defines."""
    if not isinstance(robot, SoftRobotTable):
        return False
    of_cosim = (type(entry).__module__.startswith("cosim.") for entry in robot.elements)
    return all(of_cosim) and all(_is_lasting(part.robot) for part in robot.attachments)
