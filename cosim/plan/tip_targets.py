"""Finds the flange's motion, or the cable tensions, that bring the tip to a target, on the statics."""

import numpy as np

from cosim.config.schema.phase import TipTargetTable
from cosim.coupling.robots.soft_robot import SoftRobot
from cosim.errors import InputError, UnreachableError
from cosim.plan.flange_motion import FlangeMotion
from cosim.plan.straight_arm import StraightArm
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.solve import tip_target as search
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tip_target import TargetOptions, TargetSolution

# Load steps if the loads change; they suffice to stay on the branch of a slow motion.
_LOAD_PIECES = 4
_FINER = (1, 8)  # factors on the load steps, the next one if the motion ends off its target
_SEARCHES = 3
_ON_TARGET = TargetOptions(position_tolerance_m=1e-4, angle_tolerance_rad=1e-3)


def walk(soft: SoftRobot, begin: Equilibrium, way: FlangeMotion, loads: Loads, finer: int = 1) -> Equilibrium:
    """Return the equilibrium at the end of a slow motion.

    Args:
        soft: soft side whose equilibria are solved.
        begin: equilibrium at the start.
        way: motion of the flange.
        loads: at the end; they change linearly.
        finer: factor on the number of load steps.

    Raises:
        ConvergenceError: the equilibrium was lost during the motion.
    """
    count = finer * max(way.pieces, _LOAD_PIECES if loads is not begin.loads else 0)
    here = begin
    for k in range(1, count + 1):
        load = begin.loads.interpolated(loads, k / count)
        here = soft.follow(here, way.at(k / count), load)
    return here


def reach(
    soft: SoftRobot, begin: Equilibrium, loads: Loads, target: TipTargetTable
) -> tuple[FlangeMotion, Equilibrium]:
    """Return the flange's motion to a target, and the equilibrium at its end.

    Args:
        soft: soft side whose equilibria are solved.
        begin: equilibrium at the start.
        loads: at the end of the phase.
        target: of the tip.

    Raises:
        UnreachableError: no equilibrium has the tip on the target, or none at the end of a motion from here.
        ConvergenceError: the equilibrium was lost during the motion.
    """
    still = FlangeMotion.to(begin.world_from_flange, begin.world_from_flange)
    here, wanted = walk(soft, begin, still, loads), wanted_tip(target)
    # with sliding friction each path has a different end, which smaller load steps do not change
    slides = any(cable.remembers for cable in soft.body.cables)
    for _ in range(_SEARCHES):
        found = _search(soft, here, target, wanted)
        way = FlangeMotion.to(begin.world_from_flange, found.world_from_flange)
        # the search may have found an equilibrium on another branch than this motion's
        for finer in _FINER[: 1 if slides else None]:
            here = walk(soft, begin, way, found.loads, finer)
            tip = TipFrame.of(soft.body, here.state.positions)
            missed = TargetSolution(here, *wanted.distance(tip), 0)
            if target.reach_with == "none" or _ON_TARGET.met(missed):
                return way, here
    raise UnreachableError(
        "there are equilibria with the tip on the target, but the motion to them ends in others, the last "
        f"one {missed.off()} off; reach the target in several phases, with targets in between",
        missed,
    )


def wanted_tip(target: TipTargetTable) -> search.TipTarget:
    """Return the tip target of a scenario's table."""
    return search.TipTarget(
        position=None if target.position_m is None else np.array(target.position_m),
        direction=None if target.direction is None else np.array(target.direction),
        height=target.height_m,
    )


def _search(
    soft: SoftRobot, here: Equilibrium, target: TipTargetTable, wanted: search.TipTarget
) -> Equilibrium:
    if target.reach_with == "cables":
        return soft.find_tensions(here, wanted)
    if target.reach_with == "flange":
        return soft.find_flange_pose(here, wanted)
    if wanted.position is None:
        raise InputError("a target without position_m needs reach_with = 'cables'")
    straight = StraightArm.of(soft.body, here.state.positions)
    guess = straight.pose(here.world_from_flange, wanted.position, wanted.direction)
    return walk(soft, here, FlangeMotion.to(here.world_from_flange, guess), here.loads)
