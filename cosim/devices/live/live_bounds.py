"""Bounds of live commands; a command beyond them is refused before anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

from cosim.config.schema.scenario import Scenario
from cosim.devices.command_checks import numbers
from cosim.devices.controller import Command
from cosim.devices.live.live_values import WHO, LiveValues
from cosim.errors import InputError

if TYPE_CHECKING:
    from cosim.kinematics.arm import Arm
    from cosim.plan.arm_limits import ArmLimits

_MOTIONS: Final = ("flange", "flange_twist", "joint_position")


@final
@dataclass(frozen=True)
class LiveBounds:
    """Bounds of the live commands of a scenario.

    Args:
        arm: of Pinocchio; None if the base is held.
        limits: of its joints.
        section_Pa: largest pressure of a section model; None: another model.
        out_of_reach_Pa: largest planned pressure, if contact is left out because nothing is within reach;
            None otherwise.
    """

    arm: Arm | None = None
    limits: ArmLimits | None = None
    section_Pa: float | None = None
    out_of_reach_Pa: float | None = None

    def check(self, command: Command, values: LiveValues, scenario: Scenario) -> list[str]:
        """Check a command, and return its keys that move the flange.

        Args:
            command: the command.
            values: its values.
            scenario: checked.

        Raises:
            InputError: a value is not allowed.
            InstabilityError: a number is not finite.
        """
        if scenario.mode != "dynamic":
            raise InputError(
                f"{WHO}: commands act in time: needs mode = 'dynamic', this is a quasistatic run"
            )
        moves = [key for key in _MOTIONS if getattr(command, key) is not None]
        if len(moves) > 1:
            raise InputError(f"{WHO} commands {' and '.join(moves)}, which all move the flange; give one")
        if moves and self.arm is None:
            raise InputError(
                f"{WHO} commands {moves[0]}, but robot = 'none' has no joints to move the flange"
            )
        numbers(command.flange_twist, 6, WHO, "flange_twist")
        joints = 0 if self.arm is None else self.arm.joint_count
        numbers(command.joint_position, joints, WHO, "joint_position")
        numbers(command.joint_velocity, joints, WHO, "joint_velocity")
        if command.joint_velocity is not None and command.joint_position is None:
            raise InputError(f"{WHO} commands joint_velocity, which is that at joint_position; give both")
        if values.drives_cables and scenario.fidelity == "rigid":
            raise InputError(f"{WHO} commands cable lengths, while fidelity = 'rigid' keeps its shape")
        self._check_range(values, moves, scenario.soft_robot.chamber_names())
        return moves

    def _check_range(self, values: LiveValues, moves: list[str], chambers: Sequence[str]) -> None:
        """Check pressures against the section model's range, and commands against the film's checked reach.

        Raises:
            InputError: one is beyond.
        """
        for name, pressure in zip(chambers, values.pressure_Pa, strict=True):
            if pressure is not None and self.section_Pa is not None and pressure > self.section_Pa:
                raise InputError(
                    f"{WHO}: pressure_Pa of '{name}' is {pressure:g}; the section model ends at "
                    f"{self.section_Pa:g}: at 45 kPa, or 1.1 times the largest one of start and phases"
                )
        most = self.out_of_reach_Pa
        beyond = most is not None and any(p is not None and p > most for p in values.pressure_Pa)
        if most is not None and (moves or beyond):
            raise InputError(
                f"{WHO} commands {moves[0] if moves else 'a pressure beyond the plan'}, while contact is "
                "left out as nothing is within reach of the planned path; set contact.only_in_reach = false, "
                "or contact.enabled = false if nothing is to be touched"
            )
