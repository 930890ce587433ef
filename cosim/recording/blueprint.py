"""Layout of a recording in the viewer: views, tabs and timelines."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import final

import rerun as rr
import rerun.blueprint as rrb

from cosim.recording.colours import BACKGROUND
from cosim.recording.entity_paths import FOLLOW, STRESS_SCALE, TIMELINE, TIP_PATH, path_of_arm
from cosim.recording.eyes import Eye
from cosim.recording.plots import Plot
from cosim.recording.stress_legend import LEGEND_X, LEGEND_Y


@final
@dataclass(frozen=True)
class RunViews:
    """The views of a run, or of one of several arms.

    Args:
        plots: in the order of the viewer.
        scene: viewpoint of the scene.
        close: viewpoint of the soft robot, in the frame that moves with it.
        cameras: entities of each camera's pictures.
        arm: name of the arm; empty if it is the only one.
    """

    plots: Sequence[Plot]
    scene: Eye
    close: Eye
    cameras: Sequence[tuple[str, ...]] = ()
    arm: str = ""


def blueprint(arms: Sequence[RunViews], *, live: bool = False) -> rrb.Blueprint:
    """Return the layout: the scene at the left; soft robot, stress scale and plots at the right, by arm.

    Args:
        arms: views of each arm.
        live: whether the viewer shows the run while it is simulated.
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
            origin=STRESS_SCALE,
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
    """Return rows of two plots; the first row has one plot if their number is odd."""
    odd = len(views) % 2
    starts = [0] * odd + list(range(odd, len(views), 2))
    return [rrb.Horizontal(*views[k : k + 1 if k < odd else k + 2]) for k in starts]


def _plot(plot: Plot, one: RunViews) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=path_of_arm(one.arm, f"/plots/{plot.entity}"),
        name=_named(plot.title, one),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
    )
