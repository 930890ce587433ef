"""Sag compensation: the flange pose, or the cable tensions, that bring the deformed tip to a target.

Gauss-Newton on the tip's pose, with the derivative of the *deformed* tip. Moving the flange by a
translation d and a rotation w (world axes, about its origin o) carries the tip p rigidly and turns
gravity by -w seen from the flange:
    dp = d + w x (p - o) + (dp/dgravity) (gravity x w)     (both with w also turned on the direction).
Source: implicit function theorem; DESIGN section 4 for the exact tangent.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, final

import numpy as np
from scipy.optimize import lsq_linear

from cosim.errors import ConvergenceError, UnreachableError
from cosim.frames import Array, Pose, cross_matrix, rotation_from_vector, vector_from_rotation
from cosim.soft.body import Loads, SoftBody
from cosim.soft.equilibrium import Equilibrium, EquilibriumSolver
from cosim.soft.sensitivity import Sensitivity, TipFrame

_LARGEST_TURN_RAD = 0.8
_LARGEST_TENSION_CHANGE_N = 10.0


@final
@dataclass(frozen=True)
class TipTarget:
    """Where the deformed tip shall be; give what matters, leave out what does not.

    Args:
        position: (3,) [m], world.
        direction: (3,), unit normal of the tip ring, world.
        rotation: (3, 3), the whole tip frame; replaces `direction`.
        height: [m], world z alone; replaces `position`.
    """

    position: Array | None = None
    direction: Array | None = None
    rotation: Array | None = None
    height: float | None = None

    def error(self, tip: TipFrame) -> tuple[Array, Array]:
        """Return (rows, error): rows (m, 6) select from the tip's motion, error (m,) is what is missing."""
        rows, errors = [], []
        if self.position is not None:
            rows.append(np.eye(6)[:3])
            errors.append(self.position - tip.position)
        elif self.height is not None:
            rows.append(np.eye(6)[2:3])
            errors.append(np.array([self.height - tip.position[2]]))
        if self.rotation is not None:
            rows.append(np.eye(6)[3:])
            errors.append(vector_from_rotation(self.rotation @ tip.rotation.T))
        elif self.direction is not None:
            wanted = self.direction / np.linalg.norm(self.direction)
            # only the rotation about the two axes across the direction counts
            across = tip.rotation[:, :2].T
            rows.append(np.concatenate([np.zeros((2, 3)), across], axis=1))
            errors.append(across @ shortest_turn(tip.direction, wanted))
        return np.concatenate(rows), np.concatenate(errors)

    def distance(self, tip: TipFrame) -> tuple[float, float]:
        """Return how far off the tip is: (position [m], angle [rad])."""
        position = angle = 0.0
        if self.position is not None:
            position = float(np.linalg.norm(self.position - tip.position))
        elif self.height is not None:
            position = abs(self.height - float(tip.position[2]))
        if self.rotation is not None:
            angle = float(np.linalg.norm(vector_from_rotation(self.rotation @ tip.rotation.T)))
        elif self.direction is not None:
            angle = float(np.linalg.norm(shortest_turn(tip.direction, self.direction)))
        return position, angle


@final
@dataclass(frozen=True)
class TargetOptions:
    """Bounds of the search.

    Args:
        position_tolerance_m: accepted distance of the tip.
        angle_tolerance_rad: accepted angle of the tip.
        iterations_max: sensitivities before giving up.
        lever_m: length that weighs a flange rotation against a translation (the smaller motion is chosen).
        tension_max_N: largest cable tension allowed.
    """

    position_tolerance_m: float = 1e-5
    angle_tolerance_rad: float = 1e-4
    iterations_max: int = 20
    lever_m: float = 0.5
    tension_max_N: float = 100.0


@final
@dataclass(frozen=True)
class TargetSolution:
    """A flange pose and loads whose equilibrium has the tip on target.

    Args:
        equilibrium: with its flange pose and loads.
        position_error_m: distance of the tip from the target.
        angle_error_rad: angle of the tip from the target.
        iterations: sensitivities computed.
    """

    equilibrium: Equilibrium
    position_error_m: float
    angle_error_rad: float
    iterations: int


class TipSensitivity(Protocol):
    """How a tip moves: see `cosim.soft.sensitivity.Sensitivity`."""

    tip: TipFrame

    def to_gravity(self) -> Array:
        """Return d(tip motion)/d(gravity) (6, 3); the flange stays."""

    def to_tension(self) -> Array:
        """Return d(tip motion)/d(cable tension) (6, cables); the flange stays."""


class Follower(Protocol):
    """What follows equilibria of a body and knows how its tip moves, by whatever model."""

    @property
    def body(self) -> SoftBody:
        """Whose tip it is."""

    def follow(self, begin: Equilibrium, world_from_flange: Pose, loads: Loads) -> Equilibrium:
        """Follow an equilibrium to another flange pose and other loads."""

    def sensitivity(self, here: Equilibrium) -> TipSensitivity:
        """Return how the tip moves at an equilibrium.

        Raises:
            ConvergenceError: it is not stable there.
        """


@final
class _FilmFollower:
    """The film itself."""

    def __init__(self, solver: EquilibriumSolver) -> None:
        self.follow = solver.follow
        self._solver = solver.solver

    @property
    def body(self) -> SoftBody:
        """Whose tip it is."""
        return self._solver.system.body

    def sensitivity(self, here: Equilibrium) -> Sensitivity:
        """Return how the tip moves at an equilibrium."""
        return Sensitivity(self._solver, here)


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
        UnreachableError: not met within the iterations; `closest` is the best TargetSolution.
        ConvergenceError: the equilibrium was lost on the way.
    """
    options = options or TargetOptions()
    follower = _follower(solver)

    def improve(here: Equilibrium) -> Equilibrium:
        sensitivity = follower.sensitivity(here)
        tip = sensitivity.tip
        gravity = np.array(here.loads.gravity)
        lever = cross_matrix(tip.position - here.world_from_flange.translation)
        motion = np.zeros((6, 6))
        motion[:3, :3] = np.eye(3)
        motion[:3, 3:] = -lever
        motion[3:, 3:] = np.eye(3)
        motion[:, 3:] += sensitivity.to_gravity() @ cross_matrix(gravity)
        rows, missing = target.error(tip)
        scale = np.array([1.0, 1.0, 1.0, *([1.0 / options.lever_m] * 3)])
        step = scale * np.linalg.lstsq(rows @ motion * scale, missing, rcond=1e-9)[0]
        step *= min(1.0, _LARGEST_TURN_RAD / max(float(np.linalg.norm(step[3:])), 1e-12))
        pose = here.world_from_flange
        moved = Pose(rotation_from_vector(step[3:]) @ pose.rotation, pose.translation + step[:3])
        return follower.follow(here, moved, here.loads)

    return _iterate(follower.body, begin, target, options, improve, "flange pose")


def find_tensions(
    solver: EquilibriumSolver | Follower,
    begin: Equilibrium,
    target: TipTarget,
    options: TargetOptions | None = None,
) -> TargetSolution:
    """Find the cable tensions, none negative, that bring the sagging tip to the target; the flange stays.

    Args:
        solver: follows equilibria of the body.
        begin: present equilibrium.
        target: of the tip, world; a point or only a height.
        options: bounds.

    Raises:
        UnreachableError: not met within the iterations; `closest` is the best TargetSolution.
        ConvergenceError: the equilibrium was lost on the way.
    """
    options = options or TargetOptions()
    follower = _follower(solver)

    def improve(here: Equilibrium) -> Equilibrium:
        sensitivity = follower.sensitivity(here)
        rows, missing = target.error(sensitivity.tip)
        matrix = rows @ sensitivity.to_tension()
        tension = np.array(here.loads.cable_tension_N)
        # a slight preference for the smallest change decides among equivalent tensions
        keep = 1e-6 * np.linalg.norm(matrix) * np.eye(len(tension))
        lower = np.maximum(-tension, -_LARGEST_TENSION_CHANGE_N)
        upper = np.minimum(options.tension_max_N - tension, _LARGEST_TENSION_CHANGE_N)
        problem = np.concatenate([matrix, keep]), np.concatenate([missing, np.zeros(len(tension))])
        change = lsq_linear(*problem, bounds=(lower - 1e-12, upper + 1e-12)).x
        pulled = np.maximum(tension + change, 0.0)
        loads = replace(here.loads, cable_tension_N=tuple(pulled.tolist()))
        return follower.follow(here, here.world_from_flange, loads)

    return _iterate(follower.body, begin, target, options, improve, "cable tension")


def _follower(solver: EquilibriumSolver | Follower) -> Follower:
    return _FilmFollower(solver) if isinstance(solver, EquilibriumSolver) else solver


def _iterate(
    body: SoftBody,
    begin: Equilibrium,
    target: TipTarget,
    options: TargetOptions,
    improve: Callable[[Equilibrium], Equilibrium],
    what: str,
) -> TargetSolution:
    here = begin
    best = TargetSolution(begin, np.inf, np.inf, 0)
    for iteration in range(options.iterations_max + 1):
        tip = TipFrame.of(body, here.state.positions)
        position, angle = target.distance(tip)
        found = TargetSolution(here, position, angle, iteration)
        if position <= options.position_tolerance_m and angle <= options.angle_tolerance_rad:
            return found
        lever = options.lever_m
        if position + lever * angle < best.position_error_m + lever * best.angle_error_rad:
            best = found
        if iteration < options.iterations_max:
            try:
                here = improve(here)
            except ConvergenceError as error:
                raise UnreachableError(_closest(best, what) + f"; {error}", best) from error
    raise UnreachableError(_closest(best, what), best)


def _closest(best: TargetSolution, what: str) -> str:
    tip = best.equilibrium
    return (
        f"no {what} found that brings the tip to the target in {best.iterations} iterations; the closest is "
        f"{1e3 * best.position_error_m:.2f} mm and {np.degrees(best.angle_error_rad):.2f} degrees off, with "
        f"the flange at {np.round(tip.world_from_flange.translation, 4).tolist()} m and tensions "
        f"{np.round(tip.loads.cable_tension_N, 2).tolist()} N; give a target closer to it"
    )


def shortest_turn(begin: Array, end: Array) -> Array:
    """Return the rotation vector [rad] that turns one direction into another the shortest way."""
    begin, end = begin / np.linalg.norm(begin), end / np.linalg.norm(end)
    axis = np.cross(begin, end)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.zeros(3) if begin @ end > 0.0 else np.pi * _any_normal(begin)
    return np.asarray(np.arctan2(sine, begin @ end) / sine * axis)


def _any_normal(direction: Array) -> Array:
    normal = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    return np.asarray(normal / np.linalg.norm(normal))
