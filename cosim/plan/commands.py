"""Commands to the robot at an instant, always complete: joint references, and pressures, gases, tensions and
lengths of the soft robot; the loads that follow from them; ramps between commands.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Final, final

from cosim.base.frames import Array
from cosim.plan.joint_path import JointReference
from cosim.soft.body.loads import Loads, between, force_between
from cosim.soft.elements.gas import SealedGas

_RAMPED: Final = ("pressure_Pa", "cable_tension_N", "nodal_force")


@final
@dataclass(frozen=True, eq=False)
class SoftCommand:
    """Command to a soft robot at one instant.

    Args:
        pressure_Pa: gauge, of each chamber; without effect in a chamber with sealed gas.
        gas: sealed gas in each chamber; None: its pressure is given.
        cable_tension_N: of each cable at its base end; without effect if its length is commanded.
        cable_length_m: unstretched, of each cable; None: its tension is commanded.
        nodal_force: (nodes, 3) [N], dead load of a phase, world axes; None for none.
        cable_stiffening: q of each cable in a step, see `cable`; empty: 1 for all.
    """

    pressure_Pa: Annotated[tuple[float, ...], ("chambers",)]
    gas: Annotated[tuple[SealedGas | None, ...], ("chambers",)]
    cable_tension_N: Annotated[tuple[float, ...], ("cables",)]
    cable_length_m: Annotated[tuple[float | None, ...], ("cables",)]
    nodal_force: Annotated[Array, ("nodes", 3)] | None = None
    cable_stiffening: tuple[float, ...] = ()

    def unsealed(self) -> "SoftCommand":
        """Return the command with given pressures in place of sealed gas."""
        return self if not any(self.gas) else replace(self, gas=(None,) * len(self.gas))


@final
@dataclass(frozen=True, eq=False)
class RobotCommand:
    """Command to the whole robot in one tick or increment; a controller's `Command` changes a part of it.

    Args:
        joints: reference of the servos.
        soft: command to the soft robot at the end of the tick or increment.
    """

    joints: JointReference
    soft: SoftCommand


def loads_of(command: SoftCommand, gravity: tuple[float, float, float]) -> Loads:
    """Return the loads on a soft body that follow from a command, without contact.

    Args:
        command: to the soft robot.
        gravity: (3,) [m/s^2], world.

    Raises:
        InputError: a tension is negative, or a length is not above 0.
    """
    gas, lengths = command.gas, command.cable_length_m
    commanded = vars(command) | {
        "gas": gas if gas.count(None) < len(gas) else (),
        "cable_length_m": lengths if lengths.count(None) < len(lengths) else (),
    }
    return Loads(gravity=gravity, **commanded)


@final
class CommandRamp:
    """Planned commands over the progress of a phase.

    Args:
        begin: command at the start, with all pressures and tensions given.
        end: command at the end, likewise.
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
        """Return the command at a load factor, 0 to 1; at 1, or if nothing changes, the object `end`."""
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
    return tuple([between(a, b, load_factor) for a, b in zip(begin, end, strict=True)])
