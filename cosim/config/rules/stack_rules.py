"""Rules on stacks of polygonal units and the cables along them."""

from __future__ import annotations

from cosim.config.schema.stack import CableTable, StackTable
from cosim.config.toml.faults import Faults
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
