"""What a recording holds, read back from its file."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from cosim.errors import InputError
from cosim.recording.recorder import NullRecorder
from cosim.recording.rerun_recorder import RerunRecorder
from cosim.scenario.snapshot import Snapshot, Stage

pytestmark = pytest.mark.usefixtures("strict")

MakeStage = Callable[..., Stage]
MakeSnapshot = Callable[..., Snapshot]
FILM = "/world/soft/film"
SINGLE = 6e-8
"""Relative rounding error of single precision, in which the viewer keeps positions."""


class Recorded:
    """All chunks of a recording, by entity and component."""

    def __init__(self, path: Path) -> None:
        self.chunks = [chunk for chunk in RrdReader(path).stream().to_chunks() if not chunk.is_empty]
        self.entities = {str(chunk.entity_path) for chunk in self.chunks}

    def batches(self, entity: str, component: str) -> list[Any]:
        """Return the record batches that hold a component of an entity."""
        found = [chunk.to_record_batch() for chunk in self.chunks if str(chunk.entity_path) == entity]
        return [batch for batch in found if component in batch.schema.names]

    def static(self, entity: str, component: str) -> Any:
        """Return the latest static value."""
        batches = self.batches(entity, component)
        assert batches, f"{entity} has no {component}"
        assert "sim_time" not in batches[-1].schema.names
        return batches[-1].column(component).to_pylist()[-1]

    def by_time(self, entity: str, component: str) -> dict[int, Any]:
        """Return the values of a component by time [ns], in order."""
        rows: dict[int, Any] = {}
        for batch in self.batches(entity, component):
            times = batch.column("sim_time").cast("int64").to_pylist()
            assert not rows.keys() & set(times), "two rows at one time"
            rows |= dict(zip(times, batch.column(component).to_pylist(), strict=True))
        return dict(sorted(rows.items()))


def record(
    path: Path, stage: Stage, make_snapshot: MakeSnapshot, ticks: int | None = None, **options: Any
) -> Recorded:
    recorder = RerunRecorder(path, **options)
    recorder.open(stage)
    for tick in range((stage.ticks if ticks is None else ticks) + 1):
        recorder.record(make_snapshot(stage, tick))
    recorder.close("## The end", "completed")
    return Recorded(path)


def frame_times(stage: Stage, frames_per_s: float) -> list[int]:
    """First tick at or after each frame's instant, and the last tick [ns]."""
    tick_ns = round(1e9 * stage.tick_s)
    instants = np.arange(stage.duration_s * frames_per_s) / frames_per_s
    ticks = np.ceil(instants * 1e9 / tick_ns - 1e-6).astype(int)
    return sorted({*(ticks * tick_ns).tolist(), stage.ticks * tick_ns})


def test_everything_that_changes_is_on_both_timelines(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
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
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
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
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    stage = make_stage()
    recorded = record(rrd, stage, make_snapshot)
    np.testing.assert_array_equal(recorded.static(FILM, "Mesh3D:triangle_indices"), stage.soft_triangles)
    for time, drawn in recorded.by_time(FILM, "Mesh3D:vertex_positions").items():
        nodes = make_snapshot(stage, time // 2_000_000).node_position
        np.testing.assert_allclose(drawn, nodes, rtol=SINGLE, atol=1e-9)


def test_no_vertex_data_is_static(rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot) -> None:
    # Static data hides what changes for the same component.
    recorded = record(rrd, make_stage(), make_snapshot, ticks=10)
    for chunk in recorded.chunks:
        if str(chunk.entity_path) == FILM and chunk.is_static:
            names = chunk.to_record_batch().schema.names
            assert [name for name in names if name.startswith("Mesh3D")] == ["Mesh3D:triangle_indices"]


def test_bodies_carry_their_shapes(rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot) -> None:
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


def test_colours_follow_the_stress(rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot) -> None:
    def brightness(packed: NDArray[np.uint32]) -> float:
        channels = [(packed >> shift) & 0xFF for shift in (24, 16, 8)]
        return float(np.mean(np.array([0.2126, 0.7152, 0.0722]) @ np.array(channels)))

    means = []
    for stress in (0.0, 0.5e6, 1e6):
        stage = make_stage(membrane_stress=lambda x, s=stress: np.full(len(make_stage().soft_triangles), s))
        path = rrd.with_name(f"{stress}.rrd")
        recorded = record(path, stage, make_snapshot, ticks=0, stress_range_Pa=(0.0, 1e6))
        (colours,) = recorded.by_time(FILM, "Mesh3D:vertex_colors").values()
        packed = np.array(colours, dtype=np.uint32)
        assert set(packed & 0xFF) == {255}
        means.append(brightness(packed))
    assert means[0] < 0.6 * means[1] < 0.6**2 * means[2]


def test_target_shows_only_while_there_is_one(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot)
    lines = {
        time: len(strips) for time, strips in recorded.by_time("/world/target", "LineStrips3D:strips").items()
    }
    assert {count for time, count in lines.items() if time < 750_000_000} == {0}
    assert {count for time, count in lines.items() if time >= 750_000_000} == {3}
    distances = recorded.by_time("/plots/sag/target", "Scalars:scalars")
    assert list(distances) == [2_000_000 * tick for tick in range(375, 751)]


def test_without_targets_no_curve_of_them(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot, ticks=100)
    assert "/plots/sag/target" not in recorded.entities
    assert "/plots/sag" in recorded.entities


def test_force_ends_at_the_flange_and_torque_turns_about_it(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
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
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot, ticks=3)
    assert recorded.static("/summary", "TextDocument:text") == ["## The end\n\nModel: made up."]
    assert recorded.static("/__properties/outcome", "status") == ["completed"]
    assert recorded.static("/__properties/run", "scenario") == ["made_up"]
    phases = record(rrd, make_stage(), make_snapshot).by_time("/phase", "StateChange:state")
    assert phases == {0: ["rest"], 750_000_000: ["swing"]}


def test_interrupted_run_ends_with_its_last_snapshot(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    recorded = record(rrd, make_stage(), make_snapshot, ticks=601)
    assert max(recorded.by_time(FILM, "Mesh3D:vertex_positions")) == 601 * 2_000_000
    assert RrdReader(rrd).store() is not None  # the footer is there


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_killed_process_leaves_all_but_the_last_second(rrd: Path, tmp_path: Path) -> None:
    script = tmp_path / "killed.py"
    script.write_text(
        "import os, runpy, sys\n"
        "from pathlib import Path\n"
        "from cosim.recording.rerun_recorder import RerunRecorder\n"
        f"made_up = runpy.run_path({str(Path(__file__).with_name('conftest.py'))!r})\n"
        "stage = made_up['make_stage']()\n"
        "recorder = RerunRecorder(Path(sys.argv[1]))\n"
        "recorder.open(stage)\n"
        "for tick in range(700):\n"
        "    recorder.record(made_up['make_snapshot'](stage, tick))\n"
        "os._exit(1)\n"
    )
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    subprocess.run([sys.executable, str(script), str(rrd)], check=False, env=environment, timeout=60)
    times = Recorded(rrd).by_time("/plots/pressure", "Scalars:scalars")
    assert list(times) == [2_000_000 * tick for tick in range(501)]


@pytest.mark.parametrize("mode", ["dynamic", "quasistatic"])
def test_bare_stage_is_recorded(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot, mode: str
) -> None:
    # One triangle, no cable, nothing rigid, no weight, no gravity.
    triangle = np.array([[0, 1, 2]])
    stage = make_stage(
        mode=mode,
        shapes=(),
        cables=(),
        soft_triangles=triangle,
        soft_weight_N=0.0,
        gravity=np.zeros(3),
        membrane_stress=lambda positions: np.zeros(1),
    )
    recorder = RerunRecorder(rrd)
    recorder.open(stage)
    corners = np.array([[0.3, 0, 0.5], [0.4, 0, 0.5], [0.3, 0.1, 0.4]])
    for tick in range(20):
        changes = {"node_position": corners, "cable_tension_N": np.zeros(0), "tip_target": None}
        recorder.record(make_snapshot(stage, tick, **changes))
    recorder.close("", "completed")
    recorded = Recorded(rrd)
    assert recorded.static(FILM, "Mesh3D:triangle_indices") == [[0, 1, 2]]
    cost = next(iter(recorded.by_time("/plots/tick_cost", "Scalars:scalars").values()))
    assert cost == ([1.0, 2.0] if mode == "dynamic" else [1.0])  # a tick has no length in statics


def test_run_without_a_tick_leaves_a_readable_file(rrd: Path, make_stage: MakeStage) -> None:
    recorder = RerunRecorder(rrd)
    recorder.open(make_stage())
    recorder.close("nothing", "failed")
    recorder.close("again", "failed")  # closing twice changes nothing
    assert Recorded(rrd).static("/__properties/outcome", "status") == ["failed"]


def test_equal_ids_join_recordings(rrd: Path, make_stage: MakeStage) -> None:
    ids = []
    for name in ("a", "b"):
        recorder = RerunRecorder(rrd.with_name(name), recording_id="run-7")
        recorder.open(make_stage())
        recorder.close("", "completed")
        ids.append(rrd.with_name(name).read_bytes().count(b"run-7"))
    assert min(ids) > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames_per_s": 0.0}, r"frames_per_s is 0\.0"),
        ({"frames_per_s": float("nan")}, "frames_per_s is nan"),
        ({"stress_range_Pa": (1e6, 1e6)}, r"stress_range_Pa is \(1000000\.0, 1000000\.0\)"),
    ],
)
def test_impossible_options_are_refused(rrd: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        RerunRecorder(rrd, **options)
    assert not rrd.parent.exists()


def test_recording_before_opening_is_refused(
    rrd: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    with pytest.raises(RuntimeError, match=r"call open\(stage\)"):
        RerunRecorder(rrd).record(make_snapshot(make_stage(), 0))


def test_null_recorder_writes_nothing(
    tmp_path: Path, make_stage: MakeStage, make_snapshot: MakeSnapshot
) -> None:
    recorder = NullRecorder()
    recorder.open(make_stage())
    recorder.record(make_snapshot(make_stage(), 0))
    recorder.close("", "completed")
    assert list(tmp_path.iterdir()) == []
