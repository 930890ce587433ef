"""Section models of small arms, built once for all tests and all their processes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import pytest

from cosim.base.caches import SECTION_MODELS
from cosim.base.identity import code_identity, content_name
from cosim.base.state_file import load_or_make
from cosim.build.soft_body import build_soft_body
from cosim.config.loading import load_scenario
from cosim.config.rules import file_of
from cosim.reduced.fitting import Effort, build_model
from cosim.reduced.section_model import SectionBody, SectionModel
from cosim.soft.body.body import SoftBody
from cosim.soft.contact.contact_law import ContactLaw
from cosim.soft.solve.self_contact import FilmContactLaw

FOLDER = Path(__file__).resolve().parents[1] / "build"
UNITS = 3
ROBOT = (
    f'{{ file = "hexagon_arm", stack = {{ units = {UNITS} }}, cable = ['
    f'{{ name = "right", corner = 0, units = [1, {UNITS}], capstan_factor = 0.8 }}, '
    f'{{ name = "left", corner = 1, units = [1, {UNITS}], capstan_factor = 0.8 }}] }}'
)
"""The same arm in a scenario file."""


def on_a_ur5e(pressure_Pa: float, phases: str, robot: str = ROBOT, published: bool = True) -> str:
    """Return the text of a scenario in which it hangs from a UR5e, and starts at a pressure."""
    return f"""
schema = 2
title = "Three units on a UR5e"
robot = "ur5e"
soft_robot = {robot}
model.published = {str(published).lower()}
fidelity = "section"

[start]
flange = {{ position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }}
pressure_Pa = {pressure_Pa}
{phases}"""


def kept_model(
    of: SoftBody, largest_Pa: float, films: FilmContactLaw | None, effort: Effort, folds: bool = False
) -> SectionModel:
    """Return a section model from disk, or newly built by the same program; see `build_model`."""
    name = content_name(of, largest_Pa, films, effort, folds, code_identity())
    built = partial(build_model, of, largest_Pa, films, effort=effort, folds=folds)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(FOLDER))
        return load_or_make(SECTION_MODELS, name, SectionModel, built)


@cache
def body() -> SoftBody:
    """Return the arm."""
    scenario = load_scenario("ur5e_hexagon_arm", {"model.published": True})
    robot = scenario.soft_robot
    cables = tuple(replace(cable, units=(1, UNITS)) for cable in robot.cables)
    small = replace(robot, stack=replace(robot.stack, units=UNITS), cables=cables)
    return build_soft_body(small, scenario.model)


@cache
def section() -> SectionBody:
    """Return its section model, up to 40 kPa."""
    effort = Effort(levels=12, samples=24, intervals=7)
    return SectionBody(body(), kept_model(body(), 40e3, None, effort))


FRAMED = """{ file = "hexagon_arm", stack = { units = 2 }, cable = [
  { name = "right", corner = 0, units = [1, 2], capstan_factor = 0.8 },
  { name = "left", corner = 1, units = [1, 2], capstan_factor = 0.8 }] }"""
"""Two units of the default arm; at 30 kPa they press on one another where they bend."""
LAW = FilmContactLaw(ContactLaw(3e8), 0.0, throughout=False, inside=False)


@cache
def framed_section() -> SectionBody:
    """Return their section model, up to 33 kPa."""
    scenario = load_scenario("ur5e_hexagon_arm")
    robot = file_of(scenario, "units")
    cables = tuple(replace(cable, units=(1, 2)) for cable in robot.cables)
    small = replace(robot, stack=replace(robot.stack, units=2), cables=cables)
    film = build_soft_body(small, scenario.model)
    effort = Effort(levels=8, samples=24, intervals=4)
    return SectionBody(film, kept_model(film, 33e3, LAW, effort))
