"""Rules on paths of the tip."""

from __future__ import annotations

import math
from typing import Final

from cosim.config.schema.phase import PhaseTable, TipPathTable
from cosim.config.toml.faults import Faults
from cosim.errors import InputError, ScenarioError

_BESIDE: Final = ("flange", "flange_turn", "flange_shift_m", "flange_shake", "tip_target")
_SAME: Final = 1e-6  # of a duration


def check_tip_path(phase: PhaseTable, faults: Faults) -> None:
    """Check the path of a phase, if it has one, and that nothing stands beside it that it decides.

    Args:
        phase: may hold UNKNOWN.
        faults: gets the rules that are broken.
    """
    path, key = phase.tip_path, f"phase.{phase.name}"
    if path is None:
        return
    for other in _BESIDE:
        with faults:
            if getattr(phase, other) is not None:
                raise ScenarioError(f"{key}.{other}", "cannot stand beside tip_path, which moves the flange")
    with faults:
        if phase.ramp != "linear":
            raise ScenarioError(
                f"{key}.ramp", f"is '{phase.ramp}'; a tip_path has ramps of its own (ramp_s): leave it out"
            )
    with faults:
        _check_course(phase, path, key)


def _check_course(phase: PhaseTable, path: TipPathTable, key: str) -> None:
    if path.file is not None:
        raise ScenarioError(f"{key}.tip_path.file", "is read where a scenario's file names it; give points_m")
    try:
        lasts_s = path.course().duration_s
    except InputError as error:
        raise ScenarioError(f"{key}.tip_path", str(error)) from error
    if not math.isclose(phase.duration_s, lasts_s, rel_tol=_SAME):
        raise ScenarioError(
            f"{key}.duration_s",
            f"is {phase.duration_s:g}, but the path takes {lasts_s:.6g} s at {path.speed_m_s:g} m/s; leave "
            "it out",
        )
