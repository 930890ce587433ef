"""Soft robots as the paper models them: bare film, as stiff in compression as in tension."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from cosim.config.schema.film import FilmTable, StiffenerTable
from cosim.config.schema.soft_robot import SoftRobotTable

TAKEN_AWAY: Final = (
    "stack.refine_holes", "stack.neck", "film.law", "film.wrinkle_panel_m", "hinge.rule", "stiffener",
)  # fmt: skip
"""Keys of a robot's file that the paper's model does not look at."""


def published_robot(robot: SoftRobotTable) -> SoftRobotTable:
    """Return a robot in the paper's lumped model: what its file adds to that is taken away.

    Hinges keep their factor and barrier. What the robot carries is left as it is.
    Source: "cable pneumatic soft robots" and its code, Sim-FAST by Y. Zhu.
    """
    stack = None if robot.stack is None else replace(robot.stack, refine_holes=0, neck=None)
    groups = tuple(replace(entry, film=_published_film(entry.film)) for entry in robot.groups)
    return replace(
        robot,
        stack=stack,
        film=_published_film(robot.film),
        groups=groups,
        hinge=replace(robot.hinge, rule="uniform"),
        stiffener=StiffenerTable(),
    )


def _published_film(film: FilmTable) -> FilmTable:
    """Return a film with the paper's law: bars along the edges where they are asked for, plain otherwise."""
    law = film.law if film.law == "edge_strain" else "plain"
    return replace(film, law=law, wrinkle_panel_m=None)
