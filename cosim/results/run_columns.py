"""Tables of columns of a result: one row per tick, per frame of the film, or per image of a camera."""

from typing import Final

import numpy as np

from cosim.base.column import Column, Columns, columns_of
from cosim.base.columns import RunColumns


class ImageColumns(Columns):
    """The columns of the images of a camera."""

    tick = Column("pictures", "1", "tick of the image.", fill=np.int64(0))
    time_s = Column("pictures", "s", "simulated time.")
    rgb = Column(
        "pictures, height, width, 3", "1", "colours from 0 to 255, from the upper left corner.",
        fill=np.uint8(0),
    )  # fmt: skip
    depth_m = Column(
        "pictures, height, width", "m", "along the camera's line of sight; infinite where nothing is.",
        fill=np.float32(0.0),
    )  # fmt: skip
    segments = Column(
        "pictures, height, width", "1", "0: nothing, 1: film, 2 + k: body k of `RunInfo.body_names`.",
        fill=np.int16(0),
    )  # fmt: skip
    position = Column("pictures, 3", "m", "of the camera, world.")
    rotation = Column(
        "pictures, 3, 3", "1", "world from camera: x to the right, y up, z against the line of sight."
    )


class FrameColumns(Columns):
    """The columns of frames, at which the film's node positions are recorded."""

    frame_tick = Column("frames", "1", "tick of the frame.", fill=np.int64(0))
    frame_time_s = Column("frames", "s", "simulated time of the frame.")
    node_position = Column("frames, nodes, 3", "m", "of the film, world.")


COLUMNS: Final = columns_of(RunColumns)
"""Columns with a row per tick, by name."""
FRAME_COLUMNS: Final = columns_of(FrameColumns)
"""Columns with a row per frame, by name."""
IMAGE_COLUMNS: Final = columns_of(ImageColumns)
"""Columns with a row per image, by name."""
