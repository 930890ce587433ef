"""Rules on what draws the film of a soft robot, on its stacks, and on how its values are known.

Rules on stacks of polygonal units and the cables along them.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final

from cosim.base.resources import is_file
from cosim.config.schema.scenario import GivenBodyTable, Scenario
from cosim.config.schema.soft_robot import (
    BodySourceTable,
    CableTable,
    KnownTable,
    MeshTable,
    SoftRobotTable,
    StackTable,
)
from cosim.config.toml.keys import key_of, unknown_name_message
from cosim.config.toml.parsing import check_registered
from cosim.config.toml.reading import Faults
from cosim.errors import ScenarioError


def check_stack(stack: StackTable, path: str) -> None:
    """Check that the holes, and the films fused around them, fit into all units.

    Args:
        stack: may hold UNKNOWN.
        path: of its table.

    Raises:
        ScenarioError: they do not.
    """
    if stack.smallest_radius_m <= stack.hole_radius_m:
        raise ScenarioError(
            f"{path}.hole_radius_m",
            f"{stack.hole_radius_m:g} must be below the last unit's corner radius, "
            f"{stack.smallest_radius_m:.4g}",
        )
    if stack.neck is None:
        return
    fused, least, most = stack.neck.fused_radius_m, stack.hole_radius_m, stack.neck_bound_m
    if not least < fused < most:
        raise ScenarioError(
            f"{path}.neck.fused_radius_m",
            f"{fused:g} must lie between hole_radius_m, {least:g}, and the mid rings, whose edges are "
            f"{most:.4g} from the axis at the least",
        )
    if not stack.refine_holes:
        raise ScenarioError(
            f"{path}.refine_holes", "is 0; a neck needs 1 or 2, which put nodes where the fused films end"
        )


def check_cable(cable: CableTable, stack: StackTable, path: str, faults: Faults) -> None:
    """Check that a cable runs along the stack, with one law of its losses.

    Args:
        cable: may hold UNKNOWN.
        stack: along which it runs; may hold UNKNOWN.
        path: of the cable's table.
        faults: gets the rules that are broken.

    Raises:
        ScenarioError: the cable has no law of its losses, or two.
    """
    if cable.corner is None or cable.units is None or cable.line is not None:
        raise ScenarioError(path, "runs along a stack of units: give corner and units, and no line")
    with faults:
        if cable.corner >= stack.sides:
            raise ScenarioError(
                f"{path}.corner", f"{cable.corner} does not exist; corners 0 to {stack.sides - 1} do"
            )
    with faults:
        (first, last), units = cable.units, stack.units
        if last > units:
            raise ScenarioError(f"{path}.units", f"unit {last} does not exist; units 1 to {units} do")
        if first >= last:
            raise ScenarioError(f"{path}.units", f"[{first}, {last}] must run from a unit to a later one")
    check_losses(cable, path)


def check_losses(cable: CableTable, path: str) -> None:
    """Check that a cable has one law of its losses.

    Raises:
        ScenarioError: it has none, or two.
    """
    if (cable.capstan_factor is None) == (cable.friction_coefficient is None):
        given = "neither" if cable.capstan_factor is None else "both"
        raise ScenarioError(path, f"give capstan_factor or friction_coefficient; {given} is given")


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


def check_known(robot: SoftRobotTable, path: str, faults: Faults) -> None:
    """Check that each key that `known` names is one of the robot's, and named once.

    Args:
        robot: may hold UNKNOWN.
        path: of its `known`.
        faults: gets the rules that are broken.
    """
    known, seen = robot.known, Counter[str]()
    for entry in fields(KnownTable):
        with faults:
            for key in getattr(known, entry.name):
                seen[key] += 1
                with faults:
                    _check_key(key, robot, f"{path}.{entry.name}")
    with faults:
        twice = [key for key, count in seen.items() if count > 1]
        if twice:
            raise ScenarioError(path, f"names '{twice[0]}' more than once")


def _check_key(key: str, robot: SoftRobotTable, path: str) -> None:
    here: Any = robot
    for part in key.split("."):
        if isinstance(here, tuple):
            here = here[0] if here else None
        if here is None:
            return  # of a table that this robot leaves out
        names = {key_of(entry): entry.name for entry in fields(here)} if is_dataclass(here) else {}
        if part not in names:
            raise ScenarioError(path, f"names '{key}'; the robot has no such key")
        here = getattr(here, names[part])


_NEEDS: Final = {
    "section": "a stack of units",
    "refined": "a geometry that can be drawn finer",
    "auto": "to choose among models of a soft robot's file",
}


def check_given_body(body: GivenBodyTable, scenario: Scenario, faults: Faults) -> None:
    """Check that a scenario asks nothing of a given body that only a soft robot's file can tell.

    Args:
        body: in place of the scenario's soft robot.
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        check_not_a_stack(body.name, "given as arrays", scenario)
    if scenario.model.closed != body.closed:
        raise ScenarioError(
            "model.closed",
            f"is {str(scenario.model.closed).lower()}; the soft body '{body.name}' is given with "
            f"closed = {body.closed}",
        )


def check_not_a_stack(name: str, drawn: str, scenario: Scenario) -> None:
    """Check that a scenario asks nothing of a soft body that only a stack of units has.

    Args:
        name: of the body.
        drawn: how it is, for messages.
        scenario: may hold UNKNOWN.

    Raises:
        ScenarioError: it does.
    """
    if scenario.fidelity in _NEEDS:
        raise ScenarioError(
            "fidelity",
            f"'{scenario.fidelity}' needs {_NEEDS[scenario.fidelity]}; the soft body '{name}' is {drawn}: "
            "take 'lumped' or 'rigid'",
        )
    if scenario.model.published:
        raise ScenarioError(
            "model.published", f"is true; the paper's model is one of stacks of units, '{name}' is {drawn}"
        )
    if not scenario.model.all_hinges:
        raise ScenarioError(
            "model.all_hinges", f"is false; the published hinges are those of stacks, '{name}' is {drawn}"
        )


def file_of(scenario: Scenario, what: str) -> SoftRobotTable:
    """Return the soft robot of a scenario as its file has it.

    Args:
        scenario: checked.
        what: needs it, for the message.

    Raises:
        ScenarioError: its soft body is given as arrays.
    """
    robot = scenario.soft_robot
    if isinstance(robot, GivenBodyTable):
        raise ScenarioError(
            "soft_robot", f"'{robot.name}' is given as arrays; {what} needs a soft robot's file"
        )
    return robot


def check_in_file(soft_robot: object) -> None:
    """Refuse a soft robot's table that a run with a body given from Python has written.

    Args:
        soft_robot: as in a scenario's file.

    Raises:
        ScenarioError: it is one.
    """
    if isinstance(soft_robot, dict) and "arrays" in soft_robot:
        raise ScenarioError(
            "soft_robot",
            f"'{soft_robot.get('name')}' was given as arrays, which are in no file: run this from Python, "
            "cosim.run(..., body=...), or go on with cosim.Simulation(..., body=..., start=...)",
        )
