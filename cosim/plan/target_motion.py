"""The motion that brings the tip to a target, found on the statics before anything runs."""

from __future__ import annotations

import numpy as np

from cosim.base.frames import Pose, rotation_from_vector
from cosim.config.schema.phase import TipTargetTable
from cosim.coupling.soft_sides.soft_side import SoftSide
from cosim.errors import InputError, UnreachableError
from cosim.plan.flange_path import FlangeWay
from cosim.soft.body.body import SoftBody
from cosim.soft.body.center_line import center_line_length, center_rings
from cosim.soft.body.loads import Loads
from cosim.soft.body.tip_frame import TipFrame
from cosim.soft.solve.state import Equilibrium
from cosim.soft.targets import tip_target as search
from cosim.soft.targets.target_solution import TargetOptions, TargetSolution

# A static path is cut finer than the joint path only where loads change much: these pieces suffice
# for the branch to be the one that a slow motion follows.
_LOAD_PIECES = 4
_FINER = (1, 8)  # how much finer it is cut where it ends beside its target
_SEARCHES = 3
_ON_TARGET = TargetOptions(position_tolerance_m=1e-4, angle_tolerance_rad=1e-3)


def walk(soft: SoftSide, begin: Equilibrium, way: FlangeWay, loads: Loads, finer: int = 1) -> Equilibrium:
    """Return the equilibrium at the end of a slow motion.

    Args:
        soft: follows equilibria.
        begin: where the motion starts.
        way: of the flange.
        loads: at the end; they change evenly.
        finer: into how many times more pieces the motion is cut.

    Raises:
        ConvergenceError: the equilibrium was lost on the way.
    """
    count = finer * max(way.pieces, _LOAD_PIECES if loads is not begin.loads else 0)
    here = begin
    for k in range(1, count + 1):
        load = begin.loads.interpolated(loads, k / count)
        here = soft.follow(here, way.at(k / count), load)
    return here


def reach(
    soft: SoftSide, begin: Equilibrium, loads: Loads, target: TipTargetTable
) -> tuple[FlangeWay, Equilibrium]:
    """Return the flange's way to a target, and the equilibrium that this motion ends in.

    Args:
        soft: follows equilibria.
        begin: where the motion starts.
        loads: that the phase asks for besides.
        target: of the tip.

    Raises:
        UnreachableError: it cannot be met, or not by a motion from here.
        ConvergenceError: the equilibrium was lost on the way.
    """
    still = FlangeWay.to(begin.world_from_flange, begin.world_from_flange)
    here, wanted = walk(soft, begin, still, loads), _wanted(target)
    for _ in range(_SEARCHES):
        found = _search(soft, here, target, wanted)
        way = FlangeWay.to(begin.world_from_flange, found.world_from_flange)
        # the search may have ended in an equilibrium that this motion does not lead to
        for finer in _FINER:
            here = walk(soft, begin, way, found.loads, finer)
            tip = TipFrame.of(soft.body, here.state.positions)
            missed = TargetSolution(here, *wanted.distance(tip), 0)
            if target.reach_with == "none" or _ON_TARGET.met(missed):
                return way, here
    raise UnreachableError(
        "there are equilibria with the tip on the target, but the motion to them ends in others, the last "
        f"one {missed.off()} off",
        missed,
    )


def _wanted(target: TipTargetTable) -> search.TipTarget:
    return search.TipTarget(
        position=None if target.position_m is None else np.array(target.position_m),
        direction=None if target.direction is None else np.array(target.direction),
        height=target.height_m,
    )


def _search(
    soft: SoftSide, here: Equilibrium, target: TipTargetTable, wanted: search.TipTarget
) -> Equilibrium:
    if target.reach_with == "cables":
        return soft.find_tensions(here, wanted)
    if target.reach_with == "flange":
        return soft.find_flange_pose(here, wanted)
    guess = _rigid_guess(soft.body, here, wanted)
    return walk(soft, here, FlangeWay.to(here.world_from_flange, guess), here.loads)


def _rigid_guess(body: SoftBody, here: Equilibrium, target: search.TipTarget) -> Pose:
    """Return the flange pose that would meet the target if the arm were straight along the flange's axis."""
    if target.position is None:
        raise InputError("a target without position_m needs reach_with = 'cables'")
    rotation = here.world_from_flange.rotation
    axis = rotation[:, 2]
    if target.direction is not None:
        turn = search.shortest_turn(axis, target.direction)
        rotation = rotation_from_vector(turn) @ rotation
        axis = rotation[:, 2]
    return Pose(
        rotation, target.position - center_line_length(center_rings(body), here.state.positions) * axis
    )
