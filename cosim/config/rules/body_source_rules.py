"""Rules on what draws the film of a soft robot, and on what names its nodes and triangles."""

from __future__ import annotations

from pathlib import Path

from cosim.base.resources import is_file
from cosim.config.rules.stack_rules import check_cable, check_losses, check_stack
from cosim.config.schema.body_source import BodySourceTable, MeshTable
from cosim.config.schema.soft_robot import SoftRobotTable
from cosim.config.schema.stack import CableTable
from cosim.config.toml.faults import Faults
from cosim.config.toml.registered_kinds import check_registered
from cosim.config.toml.suggestions import unknown_name_message
from cosim.errors import ScenarioError


def check_source(robot: SoftRobotTable, path: str, faults: Faults) -> None:
    """Check that a robot's film is drawn by a stack or something else, and its cables run along it.

    Args:
        robot: may hold UNKNOWN.
        path: of its table.
        faults: gets the rules that are broken.

    Raises:
        ScenarioError: nothing draws the film, or two things do.
    """
    if robot.stack is not None and robot.body is not None:
        raise ScenarioError(f"{path}.body", "cannot stand beside stack; one draws the film")
    if robot.stack is not None:
        _check_stacked(robot, path, faults)
    elif robot.body is not None:
        _check_drawn_otherwise(robot, robot.body, path, faults)
    else:
        raise ScenarioError(f"{path}.stack", "is missing; give [stack], or [body] with what draws the film")


def _check_stacked(robot: SoftRobotTable, path: str, faults: Faults) -> None:
    assert robot.stack is not None
    with faults:
        check_stack(robot.stack, f"{path}.stack")
    with faults:
        if robot.groups:
            raise ScenarioError(f"{path}.group", "a stack of units has no named groups of triangles")
    for cable in robot.cables:
        with faults:
            check_cable(cable, robot.stack, f"{path}.cable.{cable.name}", faults)


def _check_drawn_otherwise(robot: SoftRobotTable, body: BodySourceTable, path: str, faults: Faults) -> None:
    check_registered(body, f"{path}.body")
    with faults:
        if robot.stiffener.kind != "none":
            raise ScenarioError(f"{path}.stiffener.kind", "is of stacks of units: they have outer rings")
    with faults:
        if robot.mass.seam_mass_kg:
            raise ScenarioError(f"{path}.mass.seam_mass_kg", "is of stacks of units: they have outer rings")
    if isinstance(body, MeshTable):
        with faults:
            _check_mesh(body, f"{path}.body", faults)
    names = body.set_names()
    for cable in robot.cables:
        with faults:
            _check_line(cable, names, f"{path}.cable.{cable.name}")


def _check_mesh(body: MeshTable, path: str, faults: Faults) -> None:
    with faults:
        if not is_file(Path(body.file)):
            raise ScenarioError(f"{path}.file", f"no file {body.file!r} beside the one that names it")
    names = body.set_names()
    with faults:
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ScenarioError(f"{path}.set.{twice[0]}", "stands twice; names must differ")
    with faults:
        if body.tip not in names:
            raise ScenarioError(f"{path}.tip", unknown_name_message("set", body.tip, names))
    for entry in body.sets:
        with faults:
            plane = (entry.axis is not None, entry.at_m is not None)
            if [plane, bool(entry.points_m), entry.group is not None] not in (
                [(True, True), False, False], [(False, False), True, False], [(False, False), False, True]
            ):  # fmt: skip
                raise ScenarioError(
                    f"{path}.set.{entry.name}", "give axis and at_m, or points_m, or group, and one of these"
                )


def _check_line(cable: CableTable, names: tuple[str, ...], path: str) -> None:
    if cable.line is None or cable.corner is not None or cable.units is not None:
        raise ScenarioError(path, "runs along no stack of units: give line, without corner and units")
    if cable.line not in names:
        raise ScenarioError(f"{path}.line", unknown_name_message("set", cable.line, names))
    check_losses(cable, path)
