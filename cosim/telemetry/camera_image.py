"""Describes the cameras of a run and their images."""

import math
from dataclasses import dataclass
from typing import Annotated, final

import numpy as np
from numpy.typing import NDArray

from cosim.base.frames import Array, Shown


@final
@dataclass(frozen=True)
class CameraInfo:
    """A camera.

    Args:
        name: of the camera.
        size: (2,) width and height in pixels.
        fov_rad: from the lower to the upper edge.
        rate_Hz: images per second.
    """

    name: str
    size: tuple[int, int]
    fov_rad: float
    rate_Hz: float

    @property
    def focal_length(self) -> float:
        """In pixels."""
        return 0.5 * self.size[1] / math.tan(0.5 * self.fov_rad)


@final
@dataclass(frozen=True, eq=False)
class CameraImage(Shown):
    """An image of a camera.

    Args:
        camera: its name.
        rgb: (height, width, 3), from the upper left corner.
        depth_m: (height, width), along the camera's line of sight; infinite for the background.
        segments: (height, width), 0: nothing, 1: film, 2 + k: body k of `RunInfo.body_names`.
        position: (3,) [m] of the camera, world.
        rotation: (3, 3), world from camera: x to the right, y up, z against the line of sight.
    """

    camera: str
    rgb: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    segments: NDArray[np.int16]
    position: Annotated[Array, (3,)]
    rotation: Annotated[Array, (3, 3)]
