"""What is asked of the robot at a tick or increment, always complete; and the loads that follow from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, final

from cosim.base.frames import Array
from cosim.config.schema.per_chamber import as_load
from cosim.plan.joint_path import JointReference
from cosim.soft.body.loads import Loads, force_between
from cosim.soft.elements.gas import SealedGas


@final
@dataclass(frozen=True, eq=False)
class SoftCommand:
    """What is asked of a soft robot at one instant.

    Args:
        pressure_Pa: gauge, of each chamber; without meaning where gas is sealed.
        gas: sealed in each chamber; None where its pressure is given.
        cable_tension_N: of each cable at its base end; without meaning where its length is commanded.
        cable_length_m: unstretched, of each cable; None where its tension is commanded.
        nodal_force: (nodes, 3) [N], dead load that a phase puts on it, world axes; None for none.
    """

    pressure_Pa: Annotated[tuple[float, ...], ("chambers",)]
    gas: Annotated[tuple[SealedGas | None, ...], ("chambers",)]
    cable_tension_N: Annotated[tuple[float, ...], ("cables",)]
    cable_length_m: Annotated[tuple[float | None, ...], ("cables",)]
    nodal_force: Annotated[Array, ("nodes", 3)] | None = None

    @classmethod
    def planned(cls, loads: Loads, chambers: int) -> SoftCommand:
        """Return the pressures, tensions and forces of loads on a body with so many chambers."""
        tension = loads.cable_tension_N
        return cls(
            loads.pressures(chambers), (None,) * chambers, tension, (None,) * len(tension), loads.nodal_force
        )


@final
@dataclass(frozen=True, eq=False)
class RobotCommand:
    """What is asked of the whole robot in one tick or increment.

    Args:
        joints: what the servos follow.
        soft: what the soft robot is asked for at its end.
    """

    joints: JointReference
    soft: SoftCommand


def loads_of(command: SoftCommand, gravity: tuple[float, float, float]) -> Loads:
    """Return what acts on a soft body that is asked for something; contact is found as it moves.

    Args:
        command: to it.
        gravity: (3,) [m/s^2], world.

    Raises:
        InputError: a negative tension, or a length that is not above 0.
    """
    gas, lengths = command.gas, command.cable_length_m
    return Loads(
        as_load(command.pressure_Pa),
        command.cable_tension_N,
        gravity,
        command.nodal_force,
        as_load(gas) if gas.count(None) < len(gas) else None,
        None,
        lengths if lengths.count(None) < len(lengths) else (),
    )


@final
class CommandRamp:
    """Planned commands over the progress of a phase.

    Args:
        begin: at its start, all pressures and tensions given.
        end: at its end, the same.
    """

    def __init__(self, begin: SoftCommand, end: SoftCommand) -> None:
        self.begin, self.end = begin, end
        self._pushed_otherwise = begin.nodal_force is not end.nodal_force
        self._changes = (
            self._pushed_otherwise
            or begin.pressure_Pa != end.pressure_Pa
            or begin.cable_tension_N != end.cable_tension_N
        )

    def at(self, load_factor: float) -> SoftCommand:
        """Return what is asked for at a load factor, 0 to 1: the end itself there, or if nothing changes."""
        begin, end = self.begin, self.end
        if load_factor >= 1.0 or not self._changes:
            return end
        force = end.nodal_force
        if self._pushed_otherwise:
            force = force_between(begin.nodal_force, force, load_factor)
        return SoftCommand(
            _between(begin.pressure_Pa, end.pressure_Pa, load_factor),
            end.gas,
            _between(begin.cable_tension_N, end.cable_tension_N, load_factor),
            end.cable_length_m,
            force,
        )


def _between(begin: tuple[float, ...], end: tuple[float, ...], load_factor: float) -> tuple[float, ...]:
    return tuple([(1.0 - load_factor) * a + load_factor * b for a, b in zip(begin, end, strict=True)])
