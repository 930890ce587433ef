"""Every state of the commands of a run is saved with it: it is among their parts."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from cosim.app.preparation import build_simulation
from tests.devices import device_parts

ROOMS = "cosim.devices", "cosim.plan"
"""Whose objects are among the parts of the commands."""


def within(owner: Any) -> dict[int, Any]:
    """Return the objects of cosim within one, by identity."""
    found: dict[int, Any] = {}
    waiting = [owner]
    while waiting:
        here = waiting.pop()
        if isinstance(here, Mapping):
            waiting += here.values()
        elif isinstance(here, list | tuple):
            waiting += here
        elif type(here).__module__.startswith("cosim.") and id(here) not in found:
            found[id(here)] = here
            waiting += vars(here).values() if hasattr(here, "__dict__") else ()
    return found


def leaves(parts: Any) -> list[Any]:
    """Return the parts in a dictionary or sequence of them."""
    if isinstance(parts, Mapping):
        parts = [*parts.values()]
    return [leaf for part in parts for leaf in leaves(part)] if isinstance(parts, list) else [parts]


def test_every_state_of_the_commands_is_among_their_parts(tmp_path: Path) -> None:
    sensor = '[[sensor]]\nname = "angle"\nkind = "bending_angle"\n'
    devices = device_parts.PUMP, device_parts.WINCH, device_parts.CONTROLLER, sensor
    run = build_simulation(device_parts.scenario(tmp_path, *devices, device_parts.INFLATE))
    commands, parts = run._parts.commands, leaves(run._parts.commands.parts())
    named, kinds = {id(part) for part in parts}, {type(part).__name__ for part in parts}
    having = [each for each in within(commands).values() if type(each).__module__.startswith(ROOMS)]
    missing = [type(each).__name__ for each in having if hasattr(each, "state") and id(each) not in named]
    assert not missing
    assert kinds == {
        "ChamberGas", "CableDrive", "PumpDrive", "ZeroOrderHold", "Actuation", "FlangeOffset", "Sensors",
        "LiveCommands",
    }  # fmt: skip
