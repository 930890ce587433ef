"""How the viewer lays a recording out."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import Final

import rerun as rr
import rerun.blueprint as rrb

from cosim.recording.camera import Eye
from cosim.recording.colours import BACKGROUND
from cosim.recording.plot import Plot
from cosim.recording.stress_legend import LEGEND_X, LEGEND_Y

TIMELINE: Final = "sim_time"
TICKS: Final = "tick"
FOLLOW: Final = "/world/follow"
TIP_PATH: Final = "/world/soft/tip_path"


def blueprint(plots: Sequence[Plot], scene: Eye, close: Eye, *, live: bool = False) -> rrb.Blueprint:
    """Return the layout: the scene at the left; soft robot, stress scale and plots at the right.

    Args:
        plots: in the order in which they are shown.
        scene: camera of the scene.
        close: camera of the soft robot, in the frame that follows it.
        live: whether time goes on with the run.
    """
    left = rrb.Vertical(
        _space("Scene", "/world", scene),
        rrb.StateTimelineView(origin="/phase", name="Phase"),
        row_shares=[8, 1],
    )
    right = rrb.Vertical(
        _space("Soft robot (the camera follows it)", FOLLOW, close),
        rrb.Spatial2DView(
            origin="/stress_scale",
            name="Largest principal stress of the film [MPa]",
            background=list(BACKGROUND),
            visual_bounds=rrb.VisualBounds2D(x_range=LEGEND_X, y_range=LEGEND_Y),
        ),
        rrb.Tabs(*_tabs(plots), rrb.TextDocumentView(origin="/summary", name="Summary"), active_tab=0),
        row_shares=[20, 5, 20],
    )
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


def _space(name: str, origin: str, eye: Eye) -> rrb.Spatial3DView:
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
        overrides={TIP_PATH: rrb.VisibleTimeRanges([until_now])},
    )


def _tabs(plots: Sequence[Plot]) -> list[rrb.Vertical]:
    shown = [plot for plot in plots if plot.title]
    groups = {
        tab: [_plot(plot) for plot in group] for tab, group in groupby(shown, key=lambda plot: plot.tab)
    }
    return [rrb.Vertical(*_rows(views), name=tab) for tab, views in groups.items()]


def _rows(views: Sequence[rrb.TimeSeriesView]) -> list[rrb.Horizontal]:
    """Return rows of two, the first of one where the number is odd."""
    odd = len(views) % 2
    starts = [0] * odd + list(range(odd, len(views), 2))
    return [rrb.Horizontal(*views[k : k + 1 if k < odd else k + 2]) for k in starts]


def _plot(plot: Plot) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=f"/plots/{plot.entity}",
        name=plot.title,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=plot.legend),
    )
