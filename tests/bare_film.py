"""Scenarios with bare film of a given law: no stiffeners, necks or finer holes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from cosim.build.paper_model import published_robot
from cosim.config.loading import load_scenario
from cosim.config.schema.film import FilmTable
from cosim.config.schema.scenario import Scenario


def bare_film(name: str, law: str, overrides: Mapping[str, Any] | None = None) -> Scenario:
    """Return a scenario whose robot is the paper's but for its film's law.

    Args:
        name: of a scenario that comes with cosim.
        law: of the film.
        overrides: values by key path.
    """
    scenario = load_scenario(name, {**(overrides or {}), "model.published": False})
    robot = published_robot(scenario.soft_robot)
    film: FilmTable = replace(robot.film, law=law)
    return replace(scenario, soft_robot=replace(robot, film=film, hinge=scenario.soft_robot.hinge))
