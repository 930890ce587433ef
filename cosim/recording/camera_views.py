"""Writes the pictures of cameras to a Rerun recording: colours, depths and segments, with the pose and the
field of view of each camera in the scene.
"""

from typing import Final, final

import numpy as np
import rerun as rr

from cosim.recording.entity_paths import TICKS, TIMELINE
from cosim.telemetry import cameras
from cosim.telemetry.camera_image import CameraImage
from cosim.telemetry.run_info import RunInfo

_JPEG: Final = 90
_DRAWN_AT_M: Final = 0.15
"""Distance from a camera at which its picture is drawn, the end of its drawn field of view."""


def camera_paths(name: str) -> tuple[str, str, str]:
    """Return the entities of a camera's colours, depths and segments; the first is below its pose."""
    part = rr.escape_entity_path_part(name)
    return f"/world/cameras/{part}/rgb", f"/cameras/{part}/depth", f"/cameras/{part}/segments"


@final
class CameraViews:
    """Writes the pictures of cameras.

    Args:
        stream: to write to.
        stage: constants of the run.
        tick_ns: length of a tick [ns].
    """

    def __init__(self, stream: rr.RecordingStream, stage: RunInfo, tick_ns: int) -> None:
        self._stream, self._tick_ns = stream, tick_ns
        names = list(cameras.segment_names(stage.body_names).items())
        for camera in stage.cameras:
            rgb, _, segments = camera_paths(camera.name)
            width, height = camera.size
            pinhole = rr.Pinhole(
                focal_length=camera.focal_length, width=width, height=height,
                camera_xyz=rr.ViewCoordinates.RUB, image_plane_distance=_DRAWN_AT_M,
            )  # fmt: skip
            stream.log(rgb.removesuffix("/rgb"), pinhole, static=True)
            stream.log(segments, rr.AnnotationContext(names), static=True)

    def send(self, tick: int, image: CameraImage) -> None:
        """Write a picture that was taken after a tick."""
        stream, (rgb, depth, segments) = self._stream, camera_paths(image.camera)
        stream.set_time(TIMELINE, duration=np.timedelta64(tick * self._tick_ns, "ns"))
        stream.set_time(TICKS, sequence=tick)
        placed = rr.Transform3D(translation=image.position, mat3x3=image.rotation)
        stream.log(rgb.removesuffix("/rgb"), placed)
        stream.log(rgb, rr.Image(image.rgb).compress(jpeg_quality=_JPEG))
        stream.log(depth, rr.DepthImage(np.where(np.isfinite(image.depth_m), image.depth_m, 0.0), meter=1.0))
        stream.log(segments, rr.SegmentationImage(image.segments.astype(np.uint16)))
        stream.reset_time()
