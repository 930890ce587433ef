"""A sample of forged checkpoints: refused in a line, failed by name, or gone on with, never a crash."""

from __future__ import annotations

from pathlib import Path

from benchmarks.faults.forged_checkpoints import interrupted_run, try_forgeries


def test_no_forged_checkpoint_crashes_or_ends_in_a_traceback(tmp_path: Path) -> None:
    run = interrupted_run("statics", tmp_path)
    results = try_forgeries(run, 40, 3, tmp_path)
    assert [result for result in results if result[1].startswith("FAULT")] == []
    assert sum(outcome == "refused" for _, outcome, _ in results) > 20
