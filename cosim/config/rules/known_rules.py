"""Rules on what a soft robot's file says of how its values are known."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields, is_dataclass
from typing import Any

from cosim.config.schema.soft_robot import KnownTable, SoftRobotTable
from cosim.config.toml.faults import Faults
from cosim.config.toml.key_paths import key_of
from cosim.errors import ScenarioError


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
