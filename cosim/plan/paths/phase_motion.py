"""The flange's motion through one phase, and the equilibrium that it ends in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias, final

import numpy as np

from cosim.base.frames import Pose
from cosim.config.schema.phase import PhaseTable
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import ScenarioError, SolverError, UnreachableError
from cosim.plan.flange_path import FlangeWay, pose_of
from cosim.plan.paths.pose_track import PoseTrack
from cosim.plan.paths.tip_path import PlannedTipPath
from cosim.plan.paths.tip_path_motion import follow_path
from cosim.plan.shake import Shake
from cosim.plan.target_motion import reach, walk
from cosim.soft.body.loads import Loads
from cosim.soft.solve.state import Equilibrium

AnyWay: TypeAlias = FlangeWay | PoseTrack


@final
@dataclass(frozen=True)
class PhaseMotion:
    """A motion of the flange, tried on the statics.

    Args:
        way: of the flange.
        end: equilibrium at its end.
        path: of the tip, where one is followed.
    """

    way: AnyWay
    end: Equilibrium
    path: PlannedTipPath | None = None


def solved_phase(
    soft: SoftSide, here: Equilibrium, phase: PhaseTable, loads: Loads, damping_per_s: float | None
) -> PhaseMotion:
    """Return the flange's way through a phase and the equilibrium at its end.

    Args:
        soft: follows equilibria.
        here: equilibrium at the phase's begin.
        phase: of the scenario.
        loads: at its end.
        damping_per_s: of a soft body that moves; None in statics.

    Raises:
        ScenarioError: it cannot be passed.
    """
    try:
        if phase.tip_path is not None:
            found = follow_path(soft, here, loads, phase.tip_path, damping_per_s)
            return PhaseMotion(found.way, found.end, found.planned)
        if phase.tip_target is None:
            way = given_way(here.world_from_flange, phase)
            return PhaseMotion(way, walk(soft, here, way, loads))
        way, end = reach(soft, here, loads, phase.tip_target)
        return PhaseMotion(replace(way, even=phase.ramp == "linear"), end)
    except (UnreachableError, SolverError) as error:
        raise ScenarioError(flange_key(phase), f"the static plan fails: {error}") from error


def given_way(here: Pose, phase: PhaseTable) -> FlangeWay:
    """Return the flange's way through a phase that says where it goes."""
    if phase.flange is not None:
        way = FlangeWay.to(here, pose_of(phase.flange))
    else:
        shift = None if phase.flange_shift_m is None else np.array(phase.flange_shift_m)
        way = FlangeWay.relative(here, phase.flange_turn, shift, Shake.of(phase))
    return replace(way, even=phase.ramp == "linear")


def flange_key(phase: PhaseTable) -> str:
    """Return the key that moves the flange in a phase."""
    for key in ("flange", "flange_turn", "flange_shift_m", "flange_shake", "tip_target", "tip_path"):
        if getattr(phase, key) is not None:
            return f"phase.{phase.name}.{key}"
    return f"phase.{phase.name}"
