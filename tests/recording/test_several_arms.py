"""One recording of several arms: bodies once, and below its name what each arm has of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cosim.recording.rerun_recorder import RerunRecorder
from cosim.telemetry.tick_batch import TickBatch


def test_each_arm_writes_below_its_name_and_bodies_once(
    rrd: Path, make_stage: Any, make_snapshot: Any, read: Any, strict: None
) -> None:
    stage, whole = make_stage(), RerunRecorder(rrd, frames_per_s=500.0)
    arms = whole.of_arms(("left", "right"))
    for arm in arms.values():
        arm.open(stage)
    for tick in range(4):
        for arm in arms.values():
            arm.record(TickBatch.of([make_snapshot(stage, tick)]))
    for arm in arms.values():
        arm.close("# done", "completed")
    found = read(rrd)
    for own in ("soft/film", "loads/weight", "follow"):
        assert {f"/world/{arm}/{own}" for arm in arms} <= found.entities
        assert f"/world/{own}" not in found.entities
    for own in ("plots/pressure", "phase", "summary"):
        assert {f"/{arm}/{own}" for arm in arms} <= found.entities
    bodies = [str(chunk.entity_path) for chunk in found.chunks if "/rigid/" in str(chunk.entity_path)]
    assert bodies
    assert all(path.startswith("/world/rigid/") for path in bodies)
    moved = [chunk for chunk in found.chunks if "/rigid/" in str(chunk.entity_path) and not chunk.is_static]
    alone = rrd.with_name("alone.rrd")
    one = RerunRecorder(alone, frames_per_s=500.0)
    one.open(stage)
    for tick in range(4):
        one.record(TickBatch.of([make_snapshot(stage, tick)]))
    one.close("# done", "completed")
    once = [c for c in read(alone).chunks if "/rigid/" in str(c.entity_path) and not c.is_static]
    assert sum(chunk.num_rows for chunk in moved) == sum(chunk.num_rows for chunk in once)
