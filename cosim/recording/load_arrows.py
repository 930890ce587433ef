"""Draws the loads of the soft robot: its weight and the force on the flange as arrows, and the torque on the
flange as an arc.
"""

from collections.abc import Sequence
from typing import Final, final

import numpy as np
import rerun as rr
from rerun import components

from cosim.base.frames import Array, IntArray
from cosim.recording import colours
from cosim.recording.columns import column
from cosim.recording.eyes import Eye
from cosim.recording.lines import send_lines, style_lines
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import TickBatch

_WEIGHT_ARROW: Final = 0.33
"""Length of the weight's arrow over the size of the soft robot; all forces have the same scale."""
_ARC_RADIUS: Final = 0.3
"""Radius of a torque's arc over the size of the soft robot."""
_ARC_AT_REFERENCE: Final = np.radians(270.0)
"""Angle of the arc of a torque of weight times half the size of the soft robot."""
_ARC_LONGEST: Final = np.radians(330.0)
_ARC_POINTS: Final = 20
_HEAD: Final = 3
"""Points of the arc that its arrow head replaces."""
_SMALLEST_ARC: Final = np.radians(8.0)
_SMALLEST_ARROW_M: Final = 4e-3
_RADIUS_M: Final = 2.2e-3


@final
class LoadArrows:
    """Draws the soft robot's weight and the wrench that it exerts on the flange.

    The head of the force's arrow is at the flange, and the arc of the torque is about it. All arrows are
    moved towards the viewer, as film and wrist would hide them.

    Args:
        stream: to write to.
        stage: constants of the run.
        size_m: of the soft robot [m].
        eye: viewpoint of the soft robot.
    """

    def __init__(self, stream: rr.RecordingStream, stage: RunInfo, size_m: float, eye: Eye) -> None:
        self._stream = stream
        self._weight_N = stage.soft_weight_N
        self._down = stage.gravity / max(float(np.linalg.norm(stage.gravity)), 1e-30)
        self._metres_per_N = _WEIGHT_ARROW * size_m / max(stage.soft_weight_N, 1.0)
        self._radians_per_Nm = _ARC_AT_REFERENCE / (0.5 * size_m * max(stage.soft_weight_N, 1.0))
        self._arc_radius = _ARC_RADIUS * size_m
        self._towards_eye = eye.direction
        self._before_film = 0.2 * size_m * eye.direction
        self._before_wrist = 0.3 * size_m * eye.direction
        self._beside = 0.27 * size_m * eye.left
        self._log_styles()

    def send(self, frames: TickBatch, centre: Array, times: Sequence[rr.TimeColumn]) -> None:
        """Write frames.

        Args:
            frames: in the order of time.
            centre: (frames, 3) [m], of the film.
            times: time columns of the same length.
        """
        force, torque = frames.flange_force, frames.flange_torque
        flange, centre = frames.flange_position + self._before_wrist, centre + self._before_film
        weight = np.tile(self._metres_per_N * self._weight_N * self._down, (len(frames), 1))
        pull = self._metres_per_N * force
        self._send_arrows("weight", centre, weight, times)
        self._send_labels("weight", centre + weight + self._beside, None, times)
        self._send_arrows("flange_force", flange - pull, pull, times)
        sizes = zip(np.linalg.norm(force, axis=1), np.linalg.norm(torque, axis=1), strict=True)
        texts = [f"on flange\n{newton:.1f} N\n{moment:.2f} N m" for newton, moment in sizes]
        self._send_labels("flange_force", flange - 0.6 * pull + self._beside, texts, times)
        self._send_arcs(flange, torque, times)

    def _log_styles(self) -> None:
        """Write the static entities: colours, radii and the label of the weight."""
        arrows = (
            ("weight", colours.WHITE),
            ("flange_force", colours.VERMILION),
            ("flange_torque/head", colours.SKY),
        )
        for name, colour in arrows:
            style = rr.Arrows3D.from_fields(colors=[colour], radii=[_RADIUS_M])
            self._stream.log(f"/world/loads/{name}", style, static=True)
        for name, labels in (("weight", [f"weight {self._weight_N:.1f} N"]), ("flange_force", None)):
            label = rr.Points3D.from_fields(colors=[colours.WHITE], radii=[1e-4], labels=labels)
            self._stream.log(f"/world/loads/{name}/label", label, static=True)
        style_lines(self._stream, "/world/loads/flange_torque", _RADIUS_M, colours.SKY)

    def _send_arrows(self, name: str, origins: Array, vectors: Array, times: Sequence[rr.TimeColumn]) -> None:
        # an arrow of length 0 has no direction
        shown = np.linalg.norm(vectors, axis=1) > _SMALLEST_ARROW_M
        columns = _arrows(origins[shown], vectors[shown], shown.astype(np.int64))
        self._stream.send_columns(f"/world/loads/{name}", times, columns)

    def _send_labels(
        self, name: str, positions: Array, texts: list[str] | None, times: Sequence[rr.TimeColumn]
    ) -> None:
        columns = [column(rr.Points3D, "positions", components.Position3DBatch(positions))]
        if texts is not None:
            columns.append(column(rr.Points3D, "labels", components.TextBatch(texts)))
        self._stream.send_columns(f"/world/loads/{name}/label", times, columns)

    def _send_arcs(self, centres: Array, torque: Array, times: Sequence[rr.TimeColumn]) -> None:
        """Draw each torque as an arc that turns about it, with an arrow head."""
        size = np.linalg.norm(torque, axis=1)
        angle = np.minimum(self._radians_per_Nm * size, _ARC_LONGEST)
        shown = angle > _SMALLEST_ARC
        rows = shown.astype(int)
        axis = torque[shown] / size[shown, None]
        # The arc begins at its point farthest from the line of sight, so that it opens to the viewer.
        across = np.cross(axis, self._towards_eye)
        across[np.linalg.norm(across, axis=1) < 0.3] = (0.0, 0.0, 1.0)
        first = across - np.einsum("fa,fa->f", across, axis)[:, None] * axis
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        second = np.cross(axis, first)
        turn = (np.linspace(0.0, 1.0, _ARC_POINTS) * angle[shown, None])[:, :, None]
        circle = np.cos(turn) * first[:, None] + np.sin(turn) * second[:, None]
        points = centres[shown, None] + self._arc_radius * circle
        drawn = points[:, :-_HEAD]
        send_lines(
            self._stream, "/world/loads/flange_torque", times, drawn.reshape(-1, 3),
            np.full(len(drawn), drawn.shape[1]), rows,
        )  # fmt: skip
        tail = points[:, -_HEAD - 1]
        heads = _arrows(tail, points[:, -1] - tail, rows)
        self._stream.send_columns("/world/loads/flange_torque/head", times, heads)


def _arrows(origins: Array, vectors: Array, rows: IntArray) -> list[rr.ComponentColumn]:
    """Return the columns of arrows; `rows` is the number of arrows in each row."""
    return [
        column(rr.Arrows3D, "origins", components.Position3DBatch(origins), rows),
        column(rr.Arrows3D, "vectors", components.Vector3DBatch(vectors), rows),
    ]
