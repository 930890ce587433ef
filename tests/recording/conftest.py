"""A made-up run: a square chamber that stretches and swings on a moving box."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from cosim.base.frames import Array, Pose, quaternion_from_rotation, rotation_from_vector
from cosim.base.solid import BodyShape
from cosim.recording.rerun_recorder import RerunRecorder
from cosim.soft.geometry.polygonal_stack import PolygonalStack
from cosim.telemetry.run_info import RunInfo
from cosim.telemetry.tick_batch import Snapshot, TickBatch
from tests.ticks import made_tick, read_film

MakeStage: TypeAlias = Callable[..., RunInfo]
MakeSnapshot: TypeAlias = Callable[..., Snapshot]

MESH = PolygonalStack(sides=4, units=3, corner_radius_m=0.04, hole_radius_m=0.004, unit_height_m=0.004).mesh()
TETRAHEDRON = BodyShape(
    body=1,
    vertices=0.1 * np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float),
    triangles=np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]]),
    rgba=(0.8, 0.4, 0.2, 1.0),
)


def stretch_stress(positions: Array) -> Array:
    """Stand-in for a film law: stress grows with each triangle's distance below the flange."""
    return np.asarray(1e8 * (0.5 - positions[MESH.triangles, 2].mean(axis=1)))


def make_stage(**changes: Any) -> RunInfo:
    """Return a stage of 1.5 s at 2 ms ticks."""
    values: dict[str, Any] = {
        "scenario": "made_up",
        "title": "A chamber on a box",
        "mode": "dynamic",
        "tick_s": 0.002,
        "duration_s": 1.5,
        "ticks": 750,
        "phase_names": ("rest", "swing"),
        "joint_names": ("shoulder", "elbow"),
        "body_names": ("world", "box"),
        "shapes": (TETRAHEDRON,),
        "soft_triangles": MESH.triangles,
        "cables": (MESH.line("corner_0"), MESH.line("corner_1")),
        "chamber_names": ("chamber",),
        "soft_weight_N": 2.0,
        "gravity": np.array([0.0, 0.0, -9.81]),
        "membrane_stress": stretch_stress,
        "report": "Model: made up.",
    }
    return RunInfo(**(values | changes))


def make_snapshot(stage: RunInfo, tick: int, **changes: Any) -> Snapshot:
    """Return a snapshot; from halfway on there is a tip target and tension."""
    time = tick * stage.tick_s
    late = 2 * tick >= stage.ticks
    turn = rotation_from_vector(np.array([0.0, 0.3 * np.sin(time), 0.0])) @ np.diag([1.0, -1.0, -1.0])
    flange = Pose(turn, np.array([0.3, 0.05 * time, 0.5]))
    nodes = flange.apply(MESH.positions * (1.0, 1.0, 1.0 + 3.0 * time))
    tip = nodes[MESH.ring("tip")].mean(axis=0)
    values: dict[str, Any] = {
        "tick": tick,
        "time_s": time,
        "phase": int(late),
        "joint_position": np.array([0.1, 0.2]),
        "joint_velocity": np.zeros(2),
        "joint_torque": np.zeros(2),
        "joint_target": np.array([0.1, 0.201]),
        "body_position": np.stack([np.zeros(3), flange.translation]),
        "body_quaternion": np.stack([np.array([1.0, 0.0, 0.0, 0.0]), quaternion_from_rotation(turn)]),
        "body_contact_force": np.zeros((2, 3)),
        "flange_position": flange.translation,
        "flange_rotation": turn,
        "soft_center": flange.translation,
        "soft_inertia": np.zeros((3, 3)),
        "chamber_pressure_Pa": np.array([1e4 * time]),
        "cable_tension_N": np.array([3.0, 0.0]) * late,
        "tip_target": np.array([0.3, 0.0, 0.4]) if late else None,
        "wrench": np.array([0.1, 0.0, -2.0, 0.0, 0.2 * late, 0.0]),
        "rigid_power_W": 0.02,
        "soft_power_W": -0.019,
        "residual_N": 0.0 if tick == 0 else 1e-7,
        "newton_iterations": 2,
        "stability_ratio": 0.4,
        "tick_wall_s": 0.001,
    }
    values |= changes
    rare = {"images": values.pop("images", ())}
    if values["tip_target"] is None:
        del values["tip_target"]
    film = read_film(nodes, np.array([1e-4 * (1.0 + time)]), tip, turn[:, 2], 0.01 * time)
    return made_tick(film, values, **rare)


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
    path: Path, stage: RunInfo, make_snapshot: MakeSnapshot, ticks: int | None = None, **options: Any
) -> Recorded:
    recorder = RerunRecorder(path, **options)
    recorder.open(stage)
    shown = (make_snapshot(stage, tick) for tick in range((stage.ticks if ticks is None else ticks) + 1))
    for _, batch in groupby(shown, key=lambda snapshot: (snapshot.phase, snapshot.tick // 40)):
        recorder.record(TickBatch.of(list(batch)))
    recorder.close("## The end", "completed")
    return Recorded(path)


@pytest.fixture(name="make_stage")
def _make_stage() -> MakeStage:
    return make_stage


@pytest.fixture(name="make_snapshot")
def _make_snapshot() -> MakeSnapshot:
    return make_snapshot


@pytest.fixture
def strict() -> Iterator[None]:
    """Make rerun raise on bad arguments, which it would otherwise drop with a warning."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(before)


@pytest.fixture
def rrd(tmp_path: Path) -> Path:
    """Path of a recording in a folder that does not exist yet."""
    return tmp_path / "run" / "recording.rrd"


@pytest.fixture(name="read")
def _read() -> Callable[[Path], Recorded]:
    return Recorded


@pytest.fixture(name="record")
def _record() -> Callable[..., Recorded]:
    return record
