"""Viewpoints of the viewer, from which arm and soft robot fill their views at the start of a run."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from cosim.base.frames import Array, rotation_from_quaternion
from cosim.soft.geometry.surface import triangle_area
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot

_UP: Final = np.array([0.0, 0.0, 1.0])
_HALF_VIEW: Final = np.radians(25.5)
"""A little less than half of the viewer's field of view."""
_FLOOR_M: Final = 2.0
"""Larger shapes are surroundings, which need not fit into the view."""
_SCENE_TURN: Final = np.radians(32.0)
_SCENE_ELEVATION: Final = np.radians(14.0)
_CLOSE_TURN: Final = np.radians(18.0)
_CLOSE_ELEVATION: Final = np.radians(8.0)


@dataclass(frozen=True)
class Eye:
    """A viewpoint: position and target, (3,) each [m]."""

    position: Array
    target: Array

    @property
    def direction(self) -> Array:
        """Unit vector (3,) from the target towards the eye."""
        sight = self.position - self.target
        return np.asarray(sight / np.linalg.norm(sight))

    @property
    def left(self) -> Array:
        """Unit vector (3,) to the left in the picture, level."""
        sideways = np.cross(self.direction, _UP)
        return np.asarray(sideways / np.linalg.norm(sideways))


def soft_size(stage: RunInfo, first: Snapshot) -> float:
    """Return the square root of the film's area [m], which bounds the size of the soft robot at any shape."""
    return float(np.sqrt(triangle_area(first.node_position, stage.soft_triangles).sum()))


def scene_eye(stage: RunInfo, first: Snapshot) -> Eye:
    """Return a viewpoint of the arm and of the space that the soft robot will need.

    It is to the right of the line from the arm's base to its flange, turned towards the front.

    Args:
        stage: constants of the run.
        first: the first snapshot.
    """
    points = _points_to_show(stage, first)
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    eye = Eye(target + _direction(first, _SCENE_TURN, _SCENE_ELEVATION), target)
    ahead, left = (points - target) @ eye.direction, (points - target) @ eye.left
    up = (points - target) @ np.cross(eye.left, -eye.direction)
    aside = np.maximum(np.abs(left), np.abs(up))
    distance = float((aside / np.tan(_HALF_VIEW) + ahead).max())
    return Eye(target + distance * eye.direction, target)


def _points_to_show(stage: RunInfo, first: Snapshot) -> Array:
    """Return points (n, 3) [m]: nodes, corners of bodies but the floor, reach of the soft robot."""
    reach = soft_size(stage, first)
    flange = first.world_from_flange
    swing = flange.translation + reach * np.array(
        [[1, 0, 0], [-1, 0, 0], [0, 0, -1], [0, 0, 0.5], flange.rotation[:, 2]]
    )
    points = [first.node_position, swing]
    for shape in stage.shapes:
        rotation = rotation_from_quaternion(first.body_quaternion[shape.body])
        if np.ptp(shape.vertices, axis=0).max() < _FLOOR_M:
            points.append(shape.vertices @ rotation.T + first.body_position[shape.body])
    return np.concatenate(points)


def close_eye(stage: RunInfo, first: Snapshot) -> Eye:
    """Return a viewpoint of the soft robot, in a frame that moves with it without turning.

    Args:
        stage: constants of the run.
        first: the first snapshot.
    """
    distance = 1.25 * soft_size(stage, first)
    return Eye(distance * _direction(first, _CLOSE_TURN, _CLOSE_ELEVATION), np.zeros(3))


def _direction(first: Snapshot, turn: float, elevation: float) -> Array:
    """Return the unit vector from the target to the eye."""
    forward = first.world_from_flange.translation * (1.0, 1.0, 0.0)
    length = np.linalg.norm(forward)
    forward = forward / length if length > 1e-3 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, _UP)
    level = np.cos(turn) * right + np.sin(turn) * forward
    return np.asarray(np.cos(elevation) * level + np.sin(elevation) * _UP)
