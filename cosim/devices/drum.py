"""Motors of winches, each with the cables that it winds by the same length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

from cosim.base.frames import Array
from cosim.config.schema.devices import WinchTable
from cosim.devices.cable_drive import CableDrive
from cosim.errors import InputError

_ALIKE_STEPS: Final = 0.5
"""Largest difference of commanded lengths of cables on one drum, in steps."""


@final
@dataclass(frozen=True)
class Drum:
    """One motor with the cables that it winds, all by the same length.

    Args:
        winch: table of the winch.
        drives: of its cables.
    """

    winch: WinchTable
    drives: tuple[CableDrive, ...]

    def turn(self, positions: Array, step_s: float) -> None:
        """Turn for one tick towards the commanded length of its cables.

        Args:
            positions: (n, 3) [m], at the start of the tick.
            step_s: length of the tick.

        Raises:
            InputError: its cables are commanded differently.
        """
        states = [drive.state for drive in self.drives]
        wound = [state.winch for state in states if state.winch is not None]
        if not wound:
            return
        steps = [
            (winch.unwound_m - state.wanted) / self.winch.step_m
            for state, winch in zip(states, wound, strict=False)
        ]
        if len(wound) < len(states) or max(steps) - min(steps) > _ALIKE_STEPS:
            raise InputError(
                f"winch '{self.winch.name}': one motor winds its {len(states)} cables, which are commanded "
                "differently; command the same shortening of all of them"
            )
        tension = sum(drive.tension_N(positions) for drive in self.drives)
        stiffness = sum(drive.cable.stiffness_N_m * drive.spring[0] for drive in self.drives)
        turned = wound[0].advanced(self.winch, states[0].wanted, tension, stiffness, step_s)
        for drive, own in zip(self.drives, wound, strict=True):
            after = replace(turned, unwound_m=own.unwound_m)
            drive.state = replace(drive.state, length_m=after.length_m(self.winch), winch=after)


def drums_of(winches: Sequence[WinchTable], drives: Mapping[str, CableDrive]) -> tuple[Drum, ...]:
    """Return the motors of winches.

    Args:
        winches: tables of the scenario.
        drives: of all cables, by name.
    """
    groups = (
        (winch, names)
        for winch in winches
        for names in ([winch.cables] if winch.one_motor else [(name,) for name in winch.cables])
    )
    return tuple(Drum(winch, tuple(drives[name] for name in names)) for winch, names in groups)
