"""What a recording holds, read back from its file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.chunk import RrdReader

import cosim
from cosim.recording.film_colours import STRESS_RANGE_PA
from cosim.telemetry.run_info import DrawnFilm, RunInfo
from cosim.telemetry.tick_batch import Snapshot

pytestmark = pytest.mark.usefixtures("strict")

MakeStage = Callable[..., RunInfo]
MakeSnapshot = Callable[..., Snapshot]
Record = Callable[..., Any]
Read = Callable[[Path], Any]
FILM = "/world/soft/film"
SINGLE = 6e-8
"""Relative rounding error of single precision, in which the viewer keeps positions."""


def frame_times(stage: RunInfo, frames_per_s: float) -> list[int]:
    """First tick at or after each frame's instant, and the last tick [ns]."""
    tick_ns = round(1e9 * stage.tick_s)
    instants = np.arange(stage.duration_s * frames_per_s) / frames_per_s
    ticks = np.ceil(instants * 1e9 / tick_ns - 1e-6).astype(int)
    return sorted({*(ticks * tick_ns).tolist(), stage.ticks * tick_ns})


def test_everything_that_changes_is_on_both_timelines(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    # Without a time the viewer would ignore rows silently.
    recorded = record(rrd, make_stage(), make_snapshot)
    moving = [chunk for chunk in recorded.chunks if not chunk.is_static]
    assert {str(chunk.entity_path) for chunk in moving} >= {
        FILM,
        "/world/rigid/box",
        "/plots/pressure",
        "/phase",
    }
    for chunk in moving:
        assert set(chunk.timeline_names) == {"sim_time", "tick"}, chunk.entity_path


def test_frames_come_at_their_rate_and_curves_at_every_tick(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    stage = make_stage()
    recorded = record(rrd, stage, make_snapshot, frames_per_s=30.0)
    expected = frame_times(stage, 30.0)
    assert len(expected) == 46
    for entity, component in (
        (FILM, "Mesh3D:vertex_positions"),
        (FILM, "Mesh3D:vertex_colors"),
        ("/world/rigid/box", "Transform3D:translation"),
        ("/world/soft/cables", "LineStrips3D:strips"),
        ("/world/loads/weight", "Arrows3D:vectors"),
        ("/world/soft/tip_path", "LineStrips3D:strips"),
        ("/world/follow", "Transform3D:translation"),
    ):
        assert list(recorded.by_time(entity, component)) == expected, entity
    pressure = recorded.by_time("/plots/pressure", "Scalars:scalars")
    assert list(pressure) == [2_000_000 * tick for tick in range(751)]
    np.testing.assert_allclose(np.ravel(list(pressure.values())), 1e-3 * 1e4 * 0.002 * np.arange(751))


def test_film_is_drawn_as_it_was_simulated(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    stage = make_stage()
    recorded = record(rrd, stage, make_snapshot)
    np.testing.assert_array_equal(recorded.static(FILM, "Mesh3D:triangle_indices"), stage.soft_triangles)
    for time, drawn in recorded.by_time(FILM, "Mesh3D:vertex_positions").items():
        nodes = make_snapshot(stage, time // 2_000_000).node_position
        np.testing.assert_allclose(drawn, nodes, rtol=SINGLE, atol=1e-9)


def test_a_coarser_film_is_drawn_at_its_own_nodes(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    stage = make_stage()
    some, cable = stage.soft_triangles[::4], stage.cables[0]
    nodes = np.unique(np.concatenate([some.ravel(), cable]))
    triangles, cables = np.searchsorted(nodes, some), np.searchsorted(nodes, cable)
    stress = np.linspace(*STRESS_RANGE_PA, len(triangles))
    drawn = DrawnFilm(nodes, triangles, (cables,), lambda x: stress * (len(x) == len(nodes)))
    recorded = record(rrd, replace(stage, drawn=drawn), make_snapshot, ticks=20)
    np.testing.assert_array_equal(recorded.static(FILM, "Mesh3D:triangle_indices"), triangles)
    time, found = list(recorded.by_time(FILM, "Mesh3D:vertex_positions").items())[-1]
    film = make_snapshot(stage, time // 2_000_000).node_position
    np.testing.assert_allclose(found, film[nodes], rtol=SINGLE, atol=1e-9)
    (line,) = recorded.by_time("/world/soft/cables", "LineStrips3D:strips")[time]
    np.testing.assert_allclose(line, film[cable], rtol=SINGLE, atol=1e-9)
    assert len(set(recorded.by_time(FILM, "Mesh3D:vertex_colors")[time])) > 5


def test_no_vertex_data_is_static(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    # Static data hides what changes for the same component.
    recorded = record(rrd, make_stage(), make_snapshot, ticks=10)
    for chunk in recorded.chunks:
        if str(chunk.entity_path) == FILM and chunk.is_static:
            names = chunk.to_record_batch().schema.names
            assert [name for name in names if name.startswith("Mesh3D")] == ["Mesh3D:triangle_indices"]


def test_bodies_carry_their_shapes(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    stage = make_stage()
    recorded = record(rrd, stage, make_snapshot, ticks=100)
    shape = stage.shapes[0]
    corners = shape.vertices[shape.triangles].reshape(-1, 3)
    np.testing.assert_allclose(
        recorded.static("/world/rigid/box/0", "Mesh3D:vertex_positions"), corners, rtol=SINGLE
    )
    quaternions = recorded.by_time("/world/rigid/box", "Transform3D:quaternion")
    time, drawn = list(quaternions.items())[-1]
    w, x, y, z = make_snapshot(stage, time // 2_000_000).body_quaternion[1]
    np.testing.assert_allclose(np.ravel(drawn), [x, y, z, w], rtol=SINGLE, atol=1e-9)
    assert "/world/rigid/world" not in recorded.entities  # nothing is drawn of it


def test_colours_follow_the_stress(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    def brightness(packed: NDArray[np.uint32]) -> float:
        channels = [(packed >> shift) & 0xFF for shift in (24, 16, 8)]
        return float(np.mean(np.array([0.2126, 0.7152, 0.0722]) @ np.array(channels)))

    means = []
    for stress in (0.0, 0.5 * STRESS_RANGE_PA[1], STRESS_RANGE_PA[1]):
        stage = make_stage(membrane_stress=lambda x, s=stress: np.full(len(make_stage().soft_triangles), s))
        path = rrd.with_name(f"{stress}.rrd")
        recorded = record(path, stage, make_snapshot, ticks=0)
        (colours,) = recorded.by_time(FILM, "Mesh3D:vertex_colors").values()
        packed = np.array(colours, dtype=np.uint32)
        assert set(packed & 0xFF) == {255}
        means.append(brightness(packed))
    assert means[0] < 0.6 * means[1] < 0.6**2 * means[2]


def test_target_shows_only_while_there_is_one(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot)
    lines = {
        time: len(strips) for time, strips in recorded.by_time("/world/target", "LineStrips3D:strips").items()
    }
    assert {count for time, count in lines.items() if time < 750_000_000} == {0}
    assert {count for time, count in lines.items() if time >= 750_000_000} == {3}
    distances = recorded.by_time("/plots/sag/target", "Scalars:scalars")
    assert list(distances) == [2_000_000 * tick for tick in range(375, 751)]


def test_free_components_of_a_target_follow_the_tip(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    # A target of height alone leaves x and y free: not a number in the snapshot.
    stage = make_stage()

    def at_a_height(stage: RunInfo, tick: int) -> Snapshot:
        return make_snapshot(stage, tick, tip_target=np.array([np.nan, np.nan, 0.4]))

    recorded = record(rrd, stage, at_a_height, ticks=50)
    tip = at_a_height(stage, 50).tip_position
    cross = np.array(list(recorded.by_time("/world/target", "LineStrips3D:strips").values())[-1])
    np.testing.assert_allclose(cross.mean(axis=(0, 1)), [tip[0], tip[1], 0.4], rtol=4 * SINGLE)
    distance = list(recorded.by_time("/plots/sag/target", "Scalars:scalars").values())[-1]
    np.testing.assert_allclose(distance, [1e3 * abs(tip[2] - 0.4)])


def test_without_targets_no_curve_of_them(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot, ticks=100)
    assert "/plots/sag/target" not in recorded.entities
    assert "/plots/sag" in recorded.entities


def test_force_ends_at_the_flange_and_torque_turns_about_it(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    stage = make_stage()
    recorded = record(rrd, stage, make_snapshot)
    force = recorded.by_time("/world/loads/flange_force", "Arrows3D:vectors")
    last = max(force)
    ((x, y, z),) = force[last]
    assert z < 0.0
    np.testing.assert_allclose([x / z, y], [0.1 / -2.0, 0.0], rtol=1e-5, atol=1e-9)
    (arc,) = recorded.by_time("/world/loads/flange_torque", "LineStrips3D:strips")[last]
    segments = np.diff(arc, axis=0)
    turned = np.cross(segments[0], segments[1])
    np.testing.assert_allclose(turned / np.linalg.norm(turned), [0.0, 1.0, 0.0], atol=1e-4)
    assert recorded.by_time("/world/loads/flange_torque", "LineStrips3D:strips")[0] == []


def test_summary_and_outcome_are_the_last_word(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot, ticks=3)
    assert recorded.static("/summary", "TextDocument:text") == ["## The end\n\nModel: made up."]
    assert recorded.static("/__properties/outcome", "status") == ["completed"]
    assert recorded.static("/__properties/run", "scenario") == ["made_up"]
    phases = record(rrd, make_stage(), make_snapshot).by_time("/phase", "StateChange:state")
    assert phases == {0: ["rest"], 750_000_000: ["swing"]}


def test_interrupted_run_ends_with_its_last_snapshot(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, record: Record
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot, ticks=601)
    assert max(recorded.by_time(FILM, "Mesh3D:vertex_positions")) == 601 * 2_000_000
    assert RrdReader(rrd).store() is not None  # the footer is there


def test_errors_stand_beside_their_figures_at_the_ends_of_phases(tmp_path: Path, read: Read) -> None:
    scenario = {"mode": "quasistatic", "phase.start.increments": 2, "phase.inflate.increments": 3}
    run = cosim.run(
        "three_unit_inflation", overrides=scenario, out=tmp_path / "run", recording=True, error=True
    )
    recorded = read(tmp_path / "run" / "recording.rrd")
    for key, entity in {"tip_m": "tip_position", "sag_m": "sag"}.items():
        shown = recorded.by_time(f"/plots/{entity}/error", "Scalars:scalars")
        bars = [1e3 * phase["error"][key] for phase in run.summary["phases"]]
        assert [value for (value,) in shown.values()] == pytest.approx(bars)
        assert list(shown) == [2 * round(run.stage.tick_s * 1e9), 5 * round(run.stage.tick_s * 1e9)]
