"""How the viewer lays a recording out: views, cameras, legend.

Where to look from, so that arm and soft robot fill their views at the start of any run.

The colour scale of the film's stress, as a picture with numbers.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final, final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from cosim.base.frames import Array, rotation_from_quaternion
from cosim.recording.colours import BACKGROUND, STRESS_RANGE_PA, WHITE, stress_scale
from cosim.recording.plots import Plot
from cosim.soft.geometry.surface import triangle_area
from cosim.telemetry.snapshot import RunInfo, Snapshot

_UP: Final = np.array([0.0, 0.0, 1.0])
_HALF_VIEW: Final = np.radians(25.5)
"""A little less than half of the viewer's field of view."""
_FLOOR_M: Final = 2.0
"""Shapes that are larger represent the surroundings."""
_SCENE_TURN: Final = np.radians(32.0)
_SCENE_ELEVATION: Final = np.radians(14.0)
_CLOSE_TURN: Final = np.radians(18.0)
_CLOSE_ELEVATION: Final = np.radians(8.0)


@dataclass(frozen=True)
class Eye:
    """A camera: its position and the point it looks at (3,) each [m]."""

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
    """Return the side of a square of the film's area [m]: a chamber grows no larger, however it is folded."""
    return float(np.sqrt(triangle_area(first.node_position, stage.soft_triangles).sum()))


def scene_eye(stage: RunInfo, first: Snapshot) -> Eye:
    """Return a camera that holds the arm and the space that the soft robot will need.

    It stands to the right of the line from the arm's base to its flange, turned towards the front.

    Args:
        stage: what is run.
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
    """All nodes and rigid corners but those of the floor, and where the soft robot may swing: (n, 3) [m]."""
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
    """Return a camera on the soft robot, in a frame that follows it without turning.

    Args:
        stage: what is run.
        first: the first snapshot.
    """
    distance = 1.25 * soft_size(stage, first)
    return Eye(distance * _direction(first, _CLOSE_TURN, _CLOSE_ELEVATION), np.zeros(3))


def _direction(first: Snapshot, turn: float, elevation: float) -> Array:
    """Unit vector from the target to the eye."""
    forward = first.world_from_flange.translation * (1.0, 1.0, 0.0)
    length = np.linalg.norm(forward)
    forward = forward / length if length > 1e-3 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, _UP)
    level = np.cos(turn) * right + np.sin(turn) * forward
    return np.asarray(np.cos(elevation) * level + np.sin(elevation) * _UP)


PATH: Final = "/stress_scale"
_WIDTH: Final = 512
_HEIGHT: Final = 20
_TICKS: Final = 6
LEGEND_X: Final = (-20.0, _WIDTH + 20.0)
LEGEND_Y: Final = (-4.0, _HEIGHT + 26.0)


def log_stress_legend(stream: rr.RecordingStream) -> None:
    """Log the scale with evenly spaced numbers."""
    row = stress_scale(_WIDTH)[:, :3]
    stream.log(f"{PATH}/colours", rr.Image(np.tile(row, (_HEIGHT, 1, 1))), static=True)
    fraction = np.linspace(0.0, 1.0, _TICKS)
    low, high = STRESS_RANGE_PA
    x, y = fraction * _WIDTH, np.full(_TICKS, _HEIGHT + 4.0)
    labels = [f"{1e-6 * (low + s * (high - low)):.3g}" for s in fraction]
    ticks = rr.Points2D(
        np.stack([x, y], axis=1), radii=[1.0], colors=[WHITE], labels=labels, show_labels=True
    )
    stream.log(f"{PATH}/numbers", ticks, static=True)


TIMELINE: Final = "sim_time"
TICKS: Final = "tick"
FOLLOW: Final = "/world/follow"
TIP_PATH: Final = "/world/soft/tip_path"


@final
@dataclass(frozen=True)
class RunViews:
    """What is shown of a run, or of one of several arms.

    Args:
        plots: in the order in which they are shown.
        scene: camera of the scene.
        close: camera of the soft robot, in the frame that follows it.
        cameras: entities of each camera's pictures.
        arm: name of the arm; empty where it is the only one.
    """

    plots: Sequence[Plot]
    scene: Eye
    close: Eye
    cameras: Sequence[tuple[str, ...]] = ()
    arm: str = ""


def path_of_arm(arm: str, path: str) -> str:
    """Return where an entity of one of several arms is: its own things have its name in front.

    Args:
        arm: its name; empty: it is the only one.
        path: where it is for a single arm.
    """
    shared = path == "/world" or path.startswith(("/world/rigid/", PATH))
    if not arm or shared:
        return path
    within = path.startswith("/world/")
    return f"/world/{arm}/{path.removeprefix('/world/')}" if within else f"/{arm}{path}"


def blueprint(arms: Sequence[RunViews], *, live: bool = False) -> rrb.Blueprint:
    """Return the layout: the scene at the left; soft robot, stress scale, plots at the right, a tab an arm.

    Args:
        arms: what is shown of each.
        live: whether time goes on with the run.
    """
    phases = [
        rrb.StateTimelineView(origin=path_of_arm(one.arm, "/phase"), name=_named("Phase", one))
        for one in arms
    ]
    scene = _space("Scene", "/world", arms[0].scene, [one.arm for one in arms])
    left = rrb.Vertical(scene, *phases, row_shares=[8, *[1] * len(arms)])
    columns = [_soft_robot(one) for one in arms]
    right = columns[0] if len(arms) == 1 else rrb.Tabs(*columns, active_tab=0)
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[11, 10]),
        rrb.TopPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(
            state="collapsed",
            timeline=TIMELINE,
            play_state="following" if live else "paused",
            loop_mode="off" if live else "all",
        ),
        auto_views=False,
        auto_layout=False,
    )


def _named(name: str, one: RunViews) -> str:
    return f"{name}, {one.arm}" if one.arm else name


def _soft_robot(one: RunViews) -> rrb.Vertical:
    """Return the views of a soft robot."""
    name = _named("Soft robot (the camera follows it)", one)
    return rrb.Vertical(
        _space(name, path_of_arm(one.arm, FOLLOW), one.close, [one.arm]),
        rrb.Spatial2DView(
            origin=PATH,
            name=_named("Largest principal stress of the film [MPa]", one),
            background=list(BACKGROUND),
            visual_bounds=rrb.VisualBounds2D(x_range=LEGEND_X, y_range=LEGEND_Y),
        ),
        rrb.Tabs(
            *_camera_tabs(one.cameras),
            *_tabs(one),
            rrb.TextDocumentView(origin=path_of_arm(one.arm, "/summary"), name=_named("Summary", one)),
            active_tab=0,
        ),
        row_shares=[20, 5, 20],
        name=one.arm or None,
    )


def _space(name: str, origin: str, eye: Eye, arms: Sequence[str]) -> rrb.Spatial3DView:
    until_now = rr.VisibleTimeRange(
        TIMELINE, start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.cursor_relative()
    )
    return rrb.Spatial3DView(
        origin=origin,
        contents=["/world/**"],
        name=name,
        background=list(BACKGROUND),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital, position=eye.position, look_target=eye.target, eye_up=(0.0, 0.0, 1.0)
        ),
        overrides={path_of_arm(arm, TIP_PATH): rrb.VisibleTimeRanges([until_now]) for arm in arms},
    )


def _camera_tabs(cameras: Sequence[tuple[str, ...]]) -> list[rrb.Vertical]:
    """Return a tab with a row of pictures for each camera; none without cameras."""
    rows = [
        rrb.Horizontal(*(rrb.Spatial2DView(origin=path, name=path.strip("/")) for path in paths))
        for paths in cameras
    ]
    return [rrb.Vertical(*rows, name="Cameras")] if rows else []


def _tabs(one: RunViews) -> list[rrb.Vertical]:
    shown = [plot for plot in one.plots if plot.title]
    groups = {
        tab: [_plot(plot, one) for plot in group] for tab, group in groupby(shown, key=lambda plot: plot.tab)
    }
    return [rrb.Vertical(*_rows(views), name=tab) for tab, views in groups.items()]


def _rows(views: Sequence[rrb.TimeSeriesView]) -> list[rrb.Horizontal]:
    """Return rows of two, the first of one where the number is odd."""
    odd = len(views) % 2
    starts = [0] * odd + list(range(odd, len(views), 2))
    return [rrb.Horizontal(*views[k : k + 1 if k < odd else k + 2]) for k in starts]


def _plot(plot: Plot, one: RunViews) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=path_of_arm(one.arm, f"/plots/{plot.entity}"),
        name=_named(plot.title, one),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
    )
