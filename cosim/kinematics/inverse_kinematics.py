"""Inverse kinematics by Levenberg-Marquardt steps with random restarts, and a home configuration, far from
singularities and joint limits, for arms whose files give none.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from cosim.base.frames import Array, Pose, vector_from_rotation
from cosim.errors import UnreachableError
from cosim.kinematics.arm import Arm

_FULL_TURN = 2.0 * np.pi
_CONVERGED = 1e-18  # squared error; steps converge quadratically, so the last digits are cheap
_LARGEST_STEP_rad = 0.5  # of a joint from one pose of a path to the next
_MARGIN = 1e-9  # rad, rounding of a limit
_TOLERANCE = 1e-6  # accepted error of position [m] and rotation [rad]
_DAMPING = 0.03  # factor c of lambda = c |error|^2
_ITERATIONS = 60  # at most, per start
_PATIENCE = 12  # a start is given up when the squared error has not fallen to 0.3 of its value so long ago
_NEAR_rad = 0.5  # a solution no joint of which is farther from the seed is taken at once
RESTARTS = 200  # at most, beyond the start from the seed
_SLOWED = 0.1  # of a joint's range: nearer to a limit than that, other joints take over

PoseError = Callable[[Array], tuple[Array, Array]]
_DRAWN = 1000
_MIDDLE = 0.8  # of the joint ranges
_SHORTEST_M = 1e-3  # of an arm
_HIGH = 0.25  # of the reach: how far the flange is to be above the base


@dataclass(frozen=True)
class Solution:
    """A configuration whose flange is at the wanted pose.

    Args:
        q: (joints,) [rad], within the limits.
        position_error_m: distance of the flange origin from the wanted one [m].
        rotation_error_rad: angle between the flange and the wanted one [rad].
        iterations: over all starts.
        restarts: starts beyond the one from the seed.
    """

    q: Array
    position_error_m: float
    rotation_error_rad: float
    iterations: int
    restarts: int


@dataclass
class _Search:
    """What has been found so far, with joints at places asked for (joints,), nan where they are free."""

    solutions: list[Array]
    best: Array
    prescribed: Array | None = None
    best_error: float = np.inf
    iterations: int = 0


def solve(
    arm: Arm,
    target: Pose,
    seed: Array,
    candidates: int = 4,
    restarts: int = RESTARTS,
    prescribed: Array | None = None,
) -> Solution:
    """Return a configuration near the seed whose flange is at a pose.

    Steps dq = -W J^T (J W J^T + lambda I)^-1 e with e = log(flange_from_target) and lambda = c |e|^2
    (Levenberg-Marquardt, damping after Sugihara, IEEE Trans. Robotics 27, 2011), from the seed and then
    from points scattered around it ever more widely. Joints that can make a full turn are left free
    meanwhile and brought into their limits, as near to the seed as these allow, afterwards.

    Of an arm with more joints than the pose needs, the step is the least one, weighed by the diagonal W: 1,
    and for a joint that moves towards a limit falling to 0 as a square over the last tenth of its range
    (after Chan and Dubey, IEEE Trans. Robotics and Automation 11, 1995). Otherwise W = 1.

    Args:
        arm: the arm.
        target: world_from_flange.
        seed: (joints,) [rad].
        candidates: solutions that are compared, unless one is near the seed; the nearest is taken.
        restarts: at most, beyond the start from the seed; equal ones each time.
        prescribed: (joints,) [rad], where some joints are to be; nan of the others.

    Raises:
        UnreachableError: nothing found; `closest` holds the closest pose.
    """
    start = np.array(seed, dtype=np.float64)
    error = arm.error_towards(target)
    rng = np.random.default_rng(0)
    search = _Search([], start, prescribed)
    in_reach = bool(np.linalg.norm(target.translation - arm.shoulder) <= arm.reach + _TOLERANCE)
    # Out of reach, a few starts serve to name the closest pose.
    attempt = 0
    for attempt in range((restarts if in_reach else min(4, restarts)) + 1):
        guess = _scattered(arm, start, min(np.pi, 0.4 * attempt), rng) if attempt else start
        found = _descend(arm, error, np.clip(guess, arm.lower, arm.upper), search)
        if found is not None:
            search.solutions.append(_nearest_turn(arm, found, start))
            near = np.max(np.abs(search.solutions[-1] - start)) <= _NEAR_rad
            if near or len(search.solutions) >= candidates:
                break
    if not search.solutions:
        # The starts are given up early; finish the best one, which also makes the pose named the closest.
        found = _descend(arm, error, search.best, search, thorough=True)
        if found is None:
            raise _unreachable(arm, target, search, _reason(arm, target, attempt, in_reach))
        search.solutions.append(_nearest_turn(arm, found, start))
    q = min(search.solutions, key=lambda candidate: float(np.linalg.norm(candidate - start)))
    position, rotation = _distance(arm, q, target)
    return Solution(q, position, rotation, search.iterations, attempt)


def follow(arm: Arm, path: Sequence[Pose], start: Array, prescribed: Array | None = None) -> Array:
    """Return configurations (poses, joints) [rad] along a path, without a change of branch.

    Args:
        arm: the arm.
        path: world_from_flange, closely spaced.
        start: (joints,) [rad], at or near the first pose.
        prescribed: (poses, joints) [rad], where some joints are to be; nan of the others.

    Raises:
        UnreachableError: the branch ends (singularity or joint limit) or a joint would have to jump.
    """
    q, configurations = start, []
    for index, target in enumerate(path):
        seed = np.array(q, dtype=np.float64)
        error = arm.error_towards(target)
        search = _Search([], seed, None if prescribed is None else prescribed[index])
        found = _descend(arm, error, seed, search)
        if found is None:
            reason = f"the branch followed ends before pose {index} of the path"
            raise _unreachable(arm, target, search, reason)
        step = np.abs(found - seed)
        worst = int(np.argmax(step))
        outside = (found < arm.lower - _MARGIN) | (found > arm.upper + _MARGIN)
        if step[worst] > _LARGEST_STEP_rad or np.any(outside):
            joint = worst if step[worst] > _LARGEST_STEP_rad else int(np.argmax(outside))
            raise UnreachableError(
                f"pose {index} of the path: joint {arm.joint_names[joint]} would have to go from "
                f"{seed[joint]:.3f} to {found[joint]:.3f} rad (limits {arm.lower[joint]:.3f} to "
                f"{arm.upper[joint]:.3f}, largest step {_LARGEST_STEP_rad:.3f}); "
                "use a finer path or another start",
                closest=arm.forward(seed),
            )
        configurations.append(found)
        q = found
    return np.array(configurations)


def _descend(
    arm: Arm, error: PoseError, start: Array, search: _Search, *, thorough: bool = False
) -> Array | None:
    """Return where the steps from a start converge to, or None; the best point goes into `search`."""
    q, history, prescribed = start, [], search.prescribed
    if prescribed is not None:
        q = np.where(np.isnan(prescribed), q, prescribed)
    limited = np.flatnonzero(~arm.turns_fully)
    iterations = _ITERATIONS * (2 if thorough else 1)
    patience = iterations if thorough else _PATIENCE
    for _ in range(iterations):
        deviation, derivative = error(q)
        squared = float(deviation @ deviation)
        search.iterations += 1
        if squared < search.best_error:
            search.best, search.best_error = q, squared
        history.append(squared)
        stalled = len(history) > patience and squared > 0.3 * history[-1 - patience]
        if squared < _CONVERGED or stalled:
            break
        damping = _DAMPING * squared
        step = _step(deviation, derivative, damping)
        if arm.has_spare_joints:
            weights = _weights(arm, q, step, prescribed)
            step = weights * _step(deviation, derivative * weights, damping)
        q = q + step
        if limited.size:
            q[limited] = np.clip(q[limited], arm.lower[limited], arm.upper[limited])
    position, rotation = np.linalg.norm(deviation[:3]), np.linalg.norm(deviation[3:])
    return q if position <= _TOLERANCE and rotation <= _TOLERANCE else None


def _step(deviation: Array, derivative: Array, damping: float) -> Array:
    # The small form: rows of a pose, whatever the number of joints. By numpy, as SciPy takes long to load.
    normal = derivative @ derivative.T
    normal.flat[:: len(deviation) + 1] += damping + 1e-12
    try:
        return -derivative.T @ np.linalg.solve(normal, deviation)
    except np.linalg.LinAlgError:
        return np.zeros(derivative.shape[1])


def _weights(arm: Arm, q: Array, step: Array, prescribed: Array | None) -> Array:
    """Return the square roots (joints,) of a step's weights: 0 of prescribed joints, smaller near a limit.

    With J times them, and the step times them, the least step is the weighted one.
    """
    ahead = np.where(step > 0.0, arm.upper - q, q - arm.lower)
    limited = ~arm.turns_fully & np.isfinite(ahead)
    fraction = np.ones(len(q))
    fraction[limited] = ahead[limited] / (_SLOWED * (arm.upper - arm.lower)[limited])
    weights = np.clip(fraction, 0.0, 1.0)
    return weights if prescribed is None else np.where(np.isnan(prescribed), weights, 0.0)


def _scattered(arm: Arm, start: Array, spread: float, rng: np.random.Generator) -> Array:
    """Return a start near another one; a joint thrown out of its limits falls anywhere within them."""
    guess = start + spread * rng.standard_normal(arm.joint_count)
    inside = (guess >= arm.lower) & (guess <= arm.upper)
    return np.where(inside, guess, rng.uniform(*arm.drawn_from))


def _nearest_turn(arm: Arm, q: Array, seed: Array) -> Array:
    """Return q with full turns added so that it lies in the limits, as near to the seed as possible."""
    lowest = np.ceil((arm.lower - _MARGIN - q) / _FULL_TURN)
    highest = np.floor((arm.upper + _MARGIN - q) / _FULL_TURN)
    turns = np.clip(np.round((seed - q) / _FULL_TURN), lowest, highest)
    shifted = q + _FULL_TURN * np.where(arm.turns_fully, turns, 0.0)
    return np.asarray(np.clip(shifted, arm.lower, arm.upper))


def _distance(arm: Arm, q: Array, target: Pose) -> tuple[float, float]:
    """Return how far the flange is from a pose, [m] and [rad]; a roll that is free does not count."""
    if arm.free_roll:
        deviation = arm.error_towards(target)(q)[0]
        return float(np.linalg.norm(deviation[:3])), float(np.linalg.norm(deviation[3:]))
    pose = arm.forward(q)
    position = float(np.linalg.norm(pose.translation - target.translation))
    return position, float(np.linalg.norm(vector_from_rotation(pose.rotation.T @ target.rotation)))


def _reason(arm: Arm, target: Pose, restarts: int, in_reach: bool) -> str:
    if in_reach:
        return f"{restarts + 1} starts found no configuration within the joint limits"
    far = np.linalg.norm(target.translation - arm.shoulder)
    return f"it is {far:.3f} m from the first joint, the arm's reach is {arm.reach:.3f} m"


def _unreachable(arm: Arm, target: Pose, search: _Search, reason: str) -> UnreachableError:
    closest = arm.forward(search.best)
    position, rotation = _distance(arm, search.best, target)
    if arm.free_roll:
        reason += f" ({arm.joint_count} joints: place and direction, whatever the roll)"
    return UnreachableError(
        f"arm {arm.name!r} cannot bring its flange to {_text(target)}: {reason}; the closest pose found is "
        f"{_text(closest)}, {1e3 * position:.3g} mm and {np.rad2deg(rotation):.3g} deg away",
        closest=closest,
    )


def _text(pose: Pose) -> str:
    position = ", ".join(f"{value:.4f}" for value in pose.translation)
    quaternion = ", ".join(f"{value:.4f}" for value in pose.quaternion)
    return f"({position}) m, quaternion ({quaternion})"


def far_from_singularities(arm: Arm) -> Array:
    """Return the joint angles (joints,) with the largest smallest singular value of J among many drawn ones.

    Lengths in J are in units of the reach. The flange is above the base by a quarter of the reach, where it
    can be.

    Args:
        arm: standing upright, whatever way it is mounted.
    """
    rng = np.random.default_rng(0)
    lower, upper = arm.drawn_from
    turning = ~arm.prismatic
    lower, upper = (
        np.where(turning, np.maximum(lower, -np.pi), lower),
        np.where(turning, np.minimum(upper, np.pi), upper),
    )
    middle, half = 0.5 * (lower + upper), 0.5 * _MIDDLE * (upper - lower)
    scale = np.repeat([1.0 / max(arm.reach, _SHORTEST_M), 1.0], 3)[:, None]
    best, best_score = middle, -np.inf
    for _ in range(_DRAWN):
        q = middle + half * rng.uniform(-1.0, 1.0, arm.joint_count)
        above = float(arm.forward(q).translation[2] - arm.shoulder[2])
        least = float(np.linalg.svd(scale * arm.jacobian(q), compute_uv=False)[-1])
        score = least if above > _HIGH * arm.reach else least - 1.0
        if score > best_score:
            best, best_score = q, score
    return best
