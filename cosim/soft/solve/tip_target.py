"""The target of a search for the deformed tip, its options, and its solution."""

from dataclasses import dataclass
from typing import final

import numpy as np

from cosim.base.frames import Array, vector_from_rotation
from cosim.soft.body.places import TipFrame
from cosim.soft.solve.state import Equilibrium


@final
@dataclass(frozen=True)
class TipTarget:
    """Target of the deformed tip; components that are None are free.

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
        """Return (rows, error): rows (m, 6) select from the tip's motion, error (m,) is the remaining one."""
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
            target_direction = self.direction / np.linalg.norm(self.direction)
            # rotation about the direction does not count
            cross_axes = tip.rotation[:, :2].T
            rows.append(np.concatenate([np.zeros((2, 3)), cross_axes], axis=1))
            errors.append(cross_axes @ shortest_turn(tip.direction, target_direction))
        return np.concatenate(rows), np.concatenate(errors)

    def distance(self, tip: TipFrame) -> tuple[float, float]:
        """Return the errors of the tip: (position [m], angle [rad])."""
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


def shortest_turn(begin: Array, end: Array) -> Array:
    """Return the shortest rotation vector [rad] that turns one direction into another."""
    begin, end = begin / np.linalg.norm(begin), end / np.linalg.norm(end)
    axis = np.cross(begin, end)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.zeros(3) if begin @ end > 0.0 else np.pi * _any_normal(begin)
    return np.asarray(np.arctan2(sine, begin @ end) / sine * axis)


def _any_normal(direction: Array) -> Array:
    normal = np.cross(direction, np.eye(3)[int(np.argmin(np.abs(direction)))])
    return np.asarray(normal / np.linalg.norm(normal))


@final
@dataclass(frozen=True)
class TargetOptions:
    """Bounds of the search.

    Args:
        position_tolerance_m: accepted distance of the tip.
        angle_tolerance_rad: accepted angle of the tip.
        iterations_max: sensitivities before giving up.
        lever_m: length that weights rotations of the flange relative to translations.
        tension_max_N: largest cable tension allowed.
    """

    position_tolerance_m: float = 1e-5
    angle_tolerance_rad: float = 1e-4
    iterations_max: int = 20
    lever_m: float = 0.5
    tension_max_N: float = 100.0

    def met(self, solution: "TargetSolution") -> bool:
        """Return whether a solution is within the tolerances."""
        return (
            solution.position_error_m <= self.position_tolerance_m
            and solution.angle_error_rad <= self.angle_tolerance_rad
        )


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

    def off(self) -> str:
        """Return the errors of the tip, for a message."""
        angle = f" and {np.degrees(self.angle_error_rad):.2f} degrees" if self.angle_error_rad else ""
        return f"{1e3 * self.position_error_m:.2f} mm{angle}"
