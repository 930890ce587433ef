"""Rules on what holds and loads a soft robot: rings, supports, forces, with and without an arm."""

from __future__ import annotations

from collections.abc import Iterable

from cosim.config.schema.given_body import AnySoftRobot
from cosim.config.schema.name_patterns import matching
from cosim.config.schema.phase import ForceTable, PhaseTable, SupportTable
from cosim.config.schema.scenario import NO_ARM, Scenario
from cosim.config.toml.faults import Faults
from cosim.config.toml.suggestions import listing, unknown_name_message
from cosim.errors import ScenarioError

_MOTIONS = ("flange", "flange_turn", "flange_shift_m", "tip_path")


def check_holding(scenario: Scenario, faults: Faults) -> None:
    """Check rings, supports and forces of all phases, and what a scenario without an arm cannot have.

    Args:
        scenario: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    with faults:
        if scenario.robot == NO_ARM and scenario.objects:
            raise ScenarioError("object", f"needs an arm; robot is '{NO_ARM}'")
    for key in ("scene", "arm_base"):
        with faults:
            if scenario.robot == NO_ARM and getattr(scenario, key) is not None:
                raise ScenarioError(key, f"needs an arm; robot is '{NO_ARM}'")
    for phase in scenario.phases:
        with faults:
            _check_named(phase, scenario.soft_robot, f"phase.{phase.name}", faults)
        with faults:
            _check_carrier(phase, scenario.robot, f"phase.{phase.name}", faults)
    robot = scenario.soft_robot
    held, supported = expanded(robot.base, robot), False
    for phase in scenario.phases:
        path = f"phase.{phase.name}"
        with faults:
            _check_release(phase, held, robot, path)
        held = held - expanded(phase.release, robot) | expanded(phase.clamp, robot)
        supported = supported or bool(phase.supports)
        if not held and not supported:
            raise ScenarioError(f"{path}.release", "lets go of all that holds the soft robot; support it")


def _check_named(phase: PhaseTable, robot: AnySoftRobot, path: str, faults: Faults) -> None:
    """Check that the rings and corners that a phase names exist."""
    for key in ("release", "clamp"):
        with faults:
            check_rings(getattr(phase, key), robot, f"{path}.{key}")
    for key, groups in (("support", "supports"), ("force", "forces")):
        with faults:
            for place, group in enumerate(getattr(phase, groups), start=1):
                with faults:
                    _check_group(group, robot, f"{path}.{key}.{place}")


def check_rings(rings: Iterable[str], robot: AnySoftRobot, path: str) -> None:
    """Check that rings, or patterns of rings, exist.

    Raises:
        ScenarioError: one does not; the message lists those that do.
    """
    known = robot.ring_names()
    for ring in rings:
        if not matching(ring, known):
            raise ScenarioError(path, unknown_name_message("ring", ring, known))


def expanded(rings: Iterable[str], robot: AnySoftRobot) -> set[str]:
    """Return the names of the rings that names and patterns stand for."""
    known = robot.ring_names()
    return {name for ring in rings for name in matching(ring, known)}


def _check_group(group: SupportTable | ForceTable, robot: AnySoftRobot, path: str) -> None:
    check_rings(group.rings, robot, f"{path}.rings")
    if group.corners is None:
        return
    if not group.corners:
        raise ScenarioError(f"{path}.corners", "is empty; leave it out for all nodes of the rings")
    sides = min(robot.sides_of(ring) for ring in expanded(group.rings, robot))
    if not sides:
        raise ScenarioError(f"{path}.corners", "are of stacks of units; name a ring of these nodes alone")
    for corner in group.corners:
        if not 0 <= corner < sides:
            raise ScenarioError(f"{path}.corners", f"{corner} does not exist; corners 0 to {sides - 1} do")


def _check_carrier(phase: PhaseTable, robot: str, path: str, faults: Faults) -> None:
    """Check that a phase asks for motion only of an arm, and for supports only without one."""
    if robot != NO_ARM:
        if phase.supports:
            raise ScenarioError(
                f"{path}.support",
                f"needs robot = '{NO_ARM}'; on an arm, use clamp",
            )
        return
    for key in _MOTIONS:
        with faults:
            if getattr(phase, key) is not None:
                raise ScenarioError(
                    f"{path}.{key}", f"needs an arm; robot is '{NO_ARM}', which holds the base"
                )
    if phase.tip_target is not None and phase.tip_target.reach_with != "cables":
        raise ScenarioError(
            f"{path}.tip_target.reach_with", f"must be 'cables': robot is '{NO_ARM}', which holds the base"
        )


def _check_release(phase: PhaseTable, held: set[str], robot: AnySoftRobot, path: str) -> None:
    for ring in phase.release:
        if not expanded([ring], robot) <= held:
            raise ScenarioError(f"{path}.release", f"'{ring}' is not held; held are: {listing(sorted(held))}")
