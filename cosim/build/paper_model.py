"""Reduces a soft robot's table to the paper's lumped model (`model.published`): bare film, equally stiff in
compression and tension. Source: "cable pneumatic soft robots" and its code, Sim-FAST by Y. Zhu.
"""

from dataclasses import replace
from typing import Final

from cosim.config.schema import soft_robot
from cosim.config.schema.film import FilmTable

TAKEN_AWAY: Final = (
    "stack.mesh", "stack.refine_holes", "stack.neck", "film.law", "film.wrinkle_panel_m",
    "film.buckling_force_N_m", "film.stiffening", "hinge.rule", "stiffener", "cable.losses",
    "cable.eyelet_loss_N",
)  # fmt: skip
"""Keys of a robot's file that the paper's model ignores."""


def published_robot(robot: soft_robot.SoftRobotTable) -> soft_robot.SoftRobotTable:
    """Return a robot in the paper's lumped model, with the defaults of that model for keys in `TAKEN_AWAY`.

    Hinges keep their factor and barrier. Attachments are unchanged.
    """
    stack = None if robot.stack is None else replace(robot.stack, mesh="drawn", refine_holes=0, neck=None)
    groups = tuple(replace(entry, film=_published_film(entry.film)) for entry in robot.groups)
    return replace(
        robot,
        stack=stack,
        film=_published_film(robot.film),
        groups=groups,
        hinge=replace(robot.hinge, rule="uniform"),
        cables=tuple(replace(cable, losses="one_way", eyelet_loss_N=0.0) for cable in robot.cables),
        stiffener=soft_robot.StiffenerTable(),
    )


def _published_film(film: FilmTable) -> FilmTable:
    """Return a film with the paper's law: "edge_strain" if the film has it, otherwise "plain"."""
    law = film.law if film.law == "edge_strain" else "plain"
    return replace(film, law=law, wrinkle_panel_m=None, buckling_force_N_m=0.0, stiffening=0.0)
