"""Cameras of a run: their poses, the ticks of their images, and the images."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final, final

import numpy as np

from cosim.base.frames import Array, rotation_from_quaternion
from cosim.config.schema.sensors import CameraTable
from cosim.errors import InputError
from cosim.telemetry.camera_image import CameraImage
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

if TYPE_CHECKING:
    from cosim.rigid.scene.renderer import SceneRenderer

_PALM: Final = "palm"
_ROUNDING_S: Final = 1e-9


@final
class Cameras:
    """The cameras of a run; the renderer is made for the first image.

    Args:
        tables: of the scenario.
        stage: of the run.
    """

    def __init__(self, tables: Sequence[CameraTable], stage: RunInfo) -> None:
        self._tables, self._stage = tuple(tables), stage
        self._renderer: SceneRenderer | None = None

    def filmed(self, batch: TickBatch) -> TickBatch:
        """Return ticks with the images that are due in them.

        Raises:
            OutputError: no driver for drawing was found.
        """
        if not self._tables:
            return batch
        images: dict[int, tuple[CameraImage, ...]] = {}
        for row in np.flatnonzero(
            np.any([self._due(table, batch) for table in self._tables], axis=0)
        ).tolist():
            snapshot = batch.snapshot(row)
            due = [table for table in self._tables if self._due(table, batch)[row]]
            images[row] = tuple(self._image(table, snapshot) for table in due)
        return replace(batch, images=images) if images else batch

    def image(self, name: str, snapshot: Snapshot) -> CameraImage:
        """Return the image of a camera.

        Args:
            name: of the camera.
            snapshot: of the run.

        Raises:
            InputError: there is no such camera.
            OutputError: no driver for drawing was found.
        """
        for table in self._tables:
            if table.name == name:
                return self._image(table, snapshot)
        names = ", ".join(table.name for table in self._tables)
        raise InputError(f"there is no camera '{name}'; there are: {names or 'none'}")

    def _due(self, table: CameraTable, batch: TickBatch) -> Array:
        """Return whether a camera takes an image after each tick: the first tick of each of its frames."""
        if self._stage.mode != "dynamic":
            return np.ones(len(batch), dtype=bool)
        now = batch.time_s + _ROUNDING_S
        frames = (np.floor(time * table.rate_Hz) for time in (now, now - self._stage.tick_s))
        return np.not_equal(*frames)

    def _image(self, table: CameraTable, snapshot: Snapshot) -> CameraImage:
        renderer = self._renderer or self._made(len(snapshot.node_position))
        renderer.place(snapshot.body_position, snapshot.body_quaternion, snapshot.node_position)
        origin, axes = self._carrier(table, snapshot)
        position = origin + axes @ np.array(table.position_m)
        rotation = axes @ looking(np.array(table.direction), np.array(table.upward))
        drawn = renderer.draw(self._tables.index(table), position, rotation)
        return CameraImage(table.name, drawn.rgb, drawn.depth_m, drawn.segments, position, rotation)

    def _carrier(self, table: CameraTable, snapshot: Snapshot) -> tuple[Array, Array]:
        """Return origin (3,) [m] and axes (3, 3), world from carrier."""
        flange = snapshot.world_from_flange
        if table.on == "world":
            return np.zeros(3), np.eye(3)
        if table.on == "flange":
            return flange.translation, flange.rotation
        if table.on == "palm":
            palm = self._stage.body_names.index(_PALM)
            return snapshot.body_position[palm], rotation_from_quaternion(snapshot.body_quaternion[palm])
        along = snapshot.tip_direction
        level = next(x for x in (flange.rotation[:, 0], flange.rotation[:, 1]) if abs(x @ along) < 0.9)
        x = level - (level @ along) * along
        x = x / np.linalg.norm(x)
        return snapshot.tip_position, np.stack([x, np.cross(along, x), along], axis=1)

    def _made(self, nodes: int) -> "SceneRenderer":
        from cosim.rigid.scene.renderer import DrawnScene, Lens, SceneRenderer  # loads MuJoCo

        stage = self._stage
        scene = DrawnScene(stage.shapes, len(stage.body_names), stage.soft_triangles, nodes)
        self._renderer = SceneRenderer(scene, [Lens(*table.size, table.fov_rad) for table in self._tables])
        return self._renderer


def looking(direction: Array, up: Array) -> Array:
    """Return the axes (3, 3) of a camera: x to the right, y up, z against the line of sight.

    Args:
        direction: (3,), line of sight.
        up: (3,), up in the image, not along the direction.
    """
    back = -direction / np.linalg.norm(direction)
    right = np.cross(up, back)
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(back, right), back], axis=1)


def segment_names(body_names: Sequence[str]) -> Mapping[int, str]:
    """Return the names of the numbers in `CameraImage.segments`; see `cosim.rigid.scene.renderer`."""
    return dict(enumerate(("nothing", "film", *body_names)))
