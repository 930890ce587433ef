"""What bounds the commands of `Simulation.step`: whatever cannot be is refused before anything moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, final

from cosim.config.schema.scenario import Scenario
from cosim.devices.command_values import numbers
from cosim.devices.controller import Command
from cosim.devices.live.live_values import WHO, LiveValues
from cosim.errors import InputError

if TYPE_CHECKING:  # a scene without an arm waits for neither engine
    from cosim.kinematics.arm import Arm
    from cosim.plan.arm_limits import ArmLimits

_MOTIONS: Final = ("flange", "flange_twist", "joint_position")


@final
@dataclass(frozen=True)
class LiveBounds:
    """What of a scenario bounds its commands.

    Args:
        arm: kinematics; None where the base is held.
        limits: of its joints.
        section_Pa: largest pressure of a section model; None: another model.
        out_of_reach_Pa: largest planned pressure where contact is left out, as nothing is within reach of the
            plan; None otherwise.
    """

    arm: Arm | None = None
    limits: ArmLimits | None = None
    section_Pa: float | None = None
    out_of_reach_Pa: float | None = None

    def check(self, command: Command, values: LiveValues, scenario: Scenario) -> list[str]:
        """Return the keys of a command that move the flange.

        Args:
            command: see there.
            values: that it names.
            scenario: checked.

        Raises:
            InputError: it asks for what cannot be.
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
        numbers(
            command.joint_position, 0 if self.arm is None else self.arm.joint_count, WHO, "joint_position"
        )
        if values.drives_cables and scenario.fidelity == "rigid":
            raise InputError(f"{WHO} commands cable lengths, while fidelity = 'rigid' keeps its shape")
        self._check_range(values, moves, scenario.soft_robot.chamber_names())
        return moves

    def _check_range(self, values: LiveValues, moves: list[str], chambers: Sequence[str]) -> None:
        """Refuse what lies beyond a section model, or beyond what was looked at for contact."""
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
                "left out as nothing is within reach of the planned way; set contact.only_in_reach = false, "
                "or contact.enabled = false if nothing is to be touched"
            )
