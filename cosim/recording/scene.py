"""Writes the scene of a recording: poses of bodies, film, seams, cables, loads and tip."""

from collections.abc import Sequence
from typing import Final, TypeAlias, final

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun import components

from cosim.base.frames import Array, IntArray
from cosim.recording import colours
from cosim.recording.columns import column
from cosim.recording.entity_paths import FOLLOW
from cosim.recording.eyes import close_eye, soft_size
from cosim.recording.film_colours import MembraneColours
from cosim.recording.lines import crease_lines, send_lines, style_lines
from cosim.recording.load_arrows import LoadArrows
from cosim.recording.rigid_meshes import body_path
from cosim.recording.tip_marks import TipMarks
from cosim.telemetry.run_info import DrawnFilm, RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch

Single: TypeAlias = NDArray[np.float32]

_SEAM: Final = (12, 14, 20)
_SEAM_RADIUS_M: Final = 5e-4
_CABLE_RADIUS_M: Final = 1.2e-3
_FOLLOWED: Final = 0.38
"""Target of the close camera, from flange (0) to tip (1)."""
_AT_ONCE: Final = 64
"""Frames that are coloured together, few enough for the processor's cache."""
_HALF_TAUT_N: Final = 1.0
"""Tension at which a cable's colour is halfway between slack and taut."""


@final
class Scene:
    """Writes the poses of the bodies, and all entities of the soft robot.

    Args:
        stream: to write to.
        stage: constants of the run.
        first: the first snapshot; the seams are the creases of its shape.
    """

    def __init__(self, stream: rr.RecordingStream, stage: RunInfo, first: Snapshot) -> None:
        self._stream = stream
        self._stage = stage
        positions = first.node_position
        given = stage.soft_triangles, stage.cables, stage.membrane_stress
        self._film = stage.drawn or DrawnFilm(np.arange(len(positions)), *given)
        nodes = len(self._film.nodes)
        self._mean = np.full(nodes, 1.0 / nodes)
        # a copy, since kernels accept no read-only arrays
        self._colours = MembraneColours(self._film.triangles.copy(), nodes)
        self._seams = crease_lines(positions[self._film.nodes], self._film.triangles)
        self._paths = [body_path(name) for name in stage.body_names]
        self._drawn = sorted({shape.body for shape in stage.shapes})
        size = soft_size(stage, first)
        self._loads = LoadArrows(stream, stage, size, close_eye(stage, first))
        self._tip = TipMarks(stream, first.tip_position)
        self._log_static()

    def resume(self, last: Snapshot) -> None:
        """Continue the path of the tip from a snapshot."""
        self._tip = TipMarks(self._stream, last.tip_position)

    def send(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> None:
        """Write frames.

        Args:
            frames: in the order of time.
            times: time columns of the same length.
        """
        self._send_bodies(frames, times)
        positions, centre = self._send_film(frames, times)
        self._send_node_lines("seams", positions, self._seams, times)
        self._send_cables(frames, positions, times)
        self._loads.send(frames, centre, times)
        self._tip.send(frames, times)

    def _log_static(self) -> None:
        log = self._stream.log
        log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if self._seams:
            style_lines(self._stream, "/world/soft/seams", _SEAM_RADIUS_M, _SEAM)
        if self._film.cables:
            style_lines(self._stream, "/world/soft/cables", _CABLE_RADIUS_M)
        # Static vertices would hide the frames, so only the indices are static.
        indices = self._film.triangles.astype(np.uint32)
        log("/world/soft/film", rr.Mesh3D.from_fields(triangle_indices=indices), static=True)

    def _send_bodies(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> None:
        positions = frames.body_position
        quaternions = frames.body_quaternion[..., [1, 2, 3, 0]]
        for body in self._drawn:
            there = column(rr.Transform3D, "translation", components.Translation3DBatch(positions[:, body]))
            turned = column(rr.Transform3D, "quaternion", components.RotationQuatBatch(quaternions[:, body]))
            self._stream.send_columns(self._paths[body], times, [there, turned])
        seen = frames.flange_position + _FOLLOWED * (frames.tip_position - frames.flange_position)
        followed = column(rr.Transform3D, "translation", components.Translation3DBatch(seen))
        self._stream.send_columns(FOLLOW, times, [followed])

    def _send_film(self, frames: TickBatch, times: Sequence[rr.TimeColumn]) -> tuple[Single, Array]:
        """Write the film; return its nodes (frames, n, 3) and their mean (frames, 3)."""
        count, nodes = len(frames), len(self._mean)
        positions, centre = np.empty((count, nodes, 3), dtype=np.float32), np.empty((count, 3))
        packed = np.empty((count, nodes), dtype=np.uint32)
        for begin in range(0, count, _AT_ONCE):
            some = slice(begin, begin + _AT_ONCE)
            x = frames.film.node_position(some)
            if self._stage.drawn is not None:
                x = x[:, self._film.nodes]
            positions[some], centre[some] = x, self._mean @ x
            packed[some] = self._colours.packed(x, np.array([self._film.stress(one) for one in x]))
        each = np.full(count, nodes)
        columns = [
            column(rr.Mesh3D, "vertex_positions", components.Position3DBatch(positions.reshape(-1, 3)), each),
            column(rr.Mesh3D, "vertex_colors", components.ColorBatch(packed.ravel()), each),
        ]
        self._stream.send_columns("/world/soft/film", times, columns)
        return positions, centre

    def _send_cables(self, frames: TickBatch, positions: Single, times: Sequence[rr.TimeColumn]) -> None:
        tension = frames.cable_tension_N.reshape(-1, 1)
        taut = tension / (tension + _HALF_TAUT_N)
        shade = (1.0 - taut) * np.array(colours.GREY) + taut * np.array(colours.ORANGE)
        self._send_node_lines("cables", positions, self._film.cables, times, shade.astype(np.uint8))

    def _send_node_lines(
        self,
        name: str,
        positions: Single,
        lines: Sequence[IntArray],
        times: Sequence[rr.TimeColumn],
        shades: NDArray[np.uint8] | None = None,
    ) -> None:
        if not lines:
            return
        points = positions[:, np.concatenate(lines)].reshape(-1, 3)
        lengths = np.tile([len(line) for line in lines], len(positions))
        per_frame = np.full(len(positions), len(lines))
        send_lines(self._stream, f"/world/soft/{name}", times, points, lengths, per_frame, shades)
