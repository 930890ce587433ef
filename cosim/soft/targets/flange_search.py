"""Sag compensation by the arm: the flange pose that brings the deformed tip to a target.

Moving the flange by a translation d and a rotation w (world axes, about its origin o) carries the tip p
rigidly and turns gravity by -w seen from the flange:
    dp = d + w x (p - o) + (dp/dgravity) (gravity x w)     (both with w also turned on the direction).
Source: implicit function theorem; DESIGN section 4 for the exact tangent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix, rotation_from_vector
from cosim.errors import UnreachableError
from cosim.soft.body.loads import Loads
from cosim.soft.body.tip_frame import TipFrame
from cosim.soft.solve.equilibrium import EquilibriumSolver
from cosim.soft.solve.state import Equilibrium
from cosim.soft.targets.target_solution import TargetOptions, TargetSolution
from cosim.soft.targets.tip_follower import Follower, follower_of
from cosim.soft.targets.tip_search import TipSearch
from cosim.soft.targets.tip_target import TipTarget

_LARGEST_TURN_RAD = 0.8
_LARGEST_SHIFT_M = 5.0  # a shift hardly bends the law: only a search that is held back feels it


@final
@dataclass(frozen=True)
class _FlangeMotion:
    """A small motion of the flange (6,): translation [m] and rotation [rad], world axes."""

    follower: Follower
    lever_m: float

    def jacobian(self, here: Equilibrium) -> tuple[TipFrame, Array]:
        sensitivity = self.follower.sensitivity(here)
        tip = sensitivity.tip
        gravity = np.array(here.loads.gravity)
        motion = np.eye(6)
        motion[:3, 3:] = -cross_matrix(tip.position - here.world_from_flange.translation)
        motion[:, 3:] += sensitivity.to_gravity() @ cross_matrix(gravity)
        return tip, motion

    def step(self, here: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        scale = np.array([1.0, 1.0, 1.0, *([1.0 / self.lever_m] * 3)])
        change = scale * np.linalg.lstsq(matrix * scale, missing, rcond=1e-9)[0]
        return np.asarray(change * min(1.0, bound / max(self.size(change), 1e-12)))

    def size(self, change: Array) -> float:
        shift, turn = float(np.linalg.norm(change[:3])), float(np.linalg.norm(change[3:]))
        return max(shift / _LARGEST_SHIFT_M, turn / _LARGEST_TURN_RAD)

    def moved(self, here: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        pose = here.world_from_flange
        turned = rotation_from_vector(change[3:]) @ pose.rotation
        return Pose(turned, pose.translation + change[:3]), here.loads


def find_flange_pose(
    solver: EquilibriumSolver | Follower,
    begin: Equilibrium,
    target: TipTarget,
    options: TargetOptions | None = None,
) -> TargetSolution:
    """Find the flange pose for which the deformed tip meets the target; loads stay.

    Args:
        solver: follows equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world.
        options: bounds.

    Raises:
        UnreachableError: not found; `closest` is the best TargetSolution.
    """
    options, follower = options or TargetOptions(), follower_of(solver)
    ended = TipSearch(follower, target, options, _FlangeMotion(follower, options.lever_m)).run(begin)
    if not ended.why_not:
        return ended.nearest
    nearest = ended.nearest
    place = np.round(nearest.equilibrium.world_from_flange.translation, 4).tolist()
    raise UnreachableError(
        f"no flange pose found that brings the tip to the target; the nearest, after {nearest.iterations} "
        f"iterations, is {nearest.off()} off, with the flange at {place} m: {ended.why_not}",
        nearest,
    )
