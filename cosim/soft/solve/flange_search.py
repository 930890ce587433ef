"""Search for the flange pose that brings the deformed tip to a target.

Moving the flange by a translation d and a rotation w (world axes, about its origin o) carries the tip p
rigidly, and turns gravity by -w as seen from the flange:
    dp = d + w x (p - o) + (dp/dgravity) (gravity x w)     (both w terms also turn the direction).
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, Pose, cross_matrix, rotation_from_vector
from cosim.errors import UnreachableError
from cosim.soft.body.loads import Loads
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.state import Equilibrium
from cosim.soft.solve.tip_search import Follower, TipSearch
from cosim.soft.solve.tip_target import TargetOptions, TargetSolution, TipTarget

_LARGEST_TURN_RAD = 0.8
_LARGEST_SHIFT_M = 5.0  # large, as the tip moves linearly with a translation


@final
@dataclass(frozen=True)
class _FlangeMotion:
    """A small motion of the flange (6,): translation [m] and rotation [rad], world axes."""

    follower: Follower
    lever_m: float

    def jacobian(self, equilibrium: Equilibrium) -> tuple[TipFrame, Array]:
        sensitivity = self.follower.sensitivity(equilibrium)
        tip = sensitivity.tip
        gravity = np.array(equilibrium.loads.gravity)
        motion = np.eye(6)
        motion[:3, 3:] = -cross_matrix(tip.position - equilibrium.world_from_flange.translation)
        motion[:, 3:] += sensitivity.to_gravity() @ cross_matrix(gravity)
        return tip, motion

    def step(self, equilibrium: Equilibrium, matrix: Array, missing: Array, bound: float) -> Array:
        scale = np.array([1.0, 1.0, 1.0, *([1.0 / self.lever_m] * 3)])
        change = scale * np.linalg.lstsq(matrix * scale, missing, rcond=1e-9)[0]
        return np.asarray(change * min(1.0, bound / max(self.size(change), 1e-12)))

    def size(self, change: Array) -> float:
        shift, turn = float(np.linalg.norm(change[:3])), float(np.linalg.norm(change[3:]))
        return max(shift / _LARGEST_SHIFT_M, turn / _LARGEST_TURN_RAD)

    def moved(self, equilibrium: Equilibrium, change: Array) -> tuple[Pose, Loads]:
        pose = equilibrium.world_from_flange
        turned = rotation_from_vector(change[3:]) @ pose.rotation
        return Pose(turned, pose.translation + change[:3]), equilibrium.loads


def find_flange_pose(
    follower: Follower, begin: Equilibrium, target: TipTarget, options: TargetOptions | None = None
) -> TargetSolution:
    """Find the flange pose that brings the deformed tip to the target; loads are constant.

    Args:
        follower: of equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world.
        options: bounds.

    Raises:
        UnreachableError: not found; `closest` is the best TargetSolution.
    """
    options = options or TargetOptions()
    search_end = TipSearch(follower, target, options, _FlangeMotion(follower, options.lever_m)).run(begin)
    if not search_end.reason:
        return search_end.nearest
    nearest = search_end.nearest
    flange_m = np.round(nearest.equilibrium.world_from_flange.translation, 4).tolist()
    raise UnreachableError(
        f"no flange pose found that brings the tip to the target; the nearest, after {nearest.iterations} "
        f"iterations, is {nearest.off()} off, with the flange at {flange_m} m: {search_end.reason}",
        nearest,
    )
