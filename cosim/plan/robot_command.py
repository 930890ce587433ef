"""What is asked of the robot at a tick or increment, always complete; and the loads that follow from it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Final, final

from cosim.base.frames import Array
from cosim.plan.joint_path import JointReference
from cosim.soft.body.loads import Loads, force_between
from cosim.soft.elements.gas import SealedGas

_RAMPED: Final = ("pressure_Pa", "cable_tension_N", "nodal_force")


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

    def unsealed(self) -> SoftCommand:
        """Return the same with its pressures given, whatever gas is sealed."""
        return self if not any(self.gas) else replace(self, gas=(None,) * len(self.gas))


@final
@dataclass(frozen=True, eq=False)
class RobotCommand:
    """What is asked of the whole robot in one tick or increment; a controller's `Command` names a part of it.

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
    asked = vars(command) | {
        "gas": gas if gas.count(None) < len(gas) else (),
        "cable_length_m": lengths if lengths.count(None) < len(lengths) else (),
    }
    return Loads(gravity=gravity, **asked)


@final
class CommandRamp:
    """Planned commands over the progress of a phase.

    Args:
        begin: at its start, all pressures and tensions given.
        end: at its end, the same.
    """

    def __init__(self, begin: SoftCommand, end: SoftCommand) -> None:
        self.begin, self.end = begin, end
        self._as_end = {name: value for name, value in vars(end).items() if name not in _RAMPED}
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
        return type(end)(
            pressure_Pa=_between(begin.pressure_Pa, end.pressure_Pa, load_factor),
            cable_tension_N=_between(begin.cable_tension_N, end.cable_tension_N, load_factor),
            nodal_force=force,
            **self._as_end,
        )


def _between(begin: tuple[float, ...], end: tuple[float, ...], load_factor: float) -> tuple[float, ...]:
    return tuple([(1.0 - load_factor) * a + load_factor * b for a, b in zip(begin, end, strict=True)])
