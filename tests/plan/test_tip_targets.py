"""Tip targets from their benchmark, two of them: met statically, held in the coupled dynamic run."""

from __future__ import annotations

import pytest

from benchmarks import tip_targets
from benchmarks.tip_targets import BOUNDS, measure, summary


def test_two_targets_are_met_and_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tip_targets, "SETTLE_S", 2.5)
    found = measure(2, seed=3)
    for entry in found:
        assert 1 <= entry.iterations <= BOUNDS["iterations"]
        assert entry.tip_mm < BOUNDS["tip_mm"]
        assert entry.tip_degrees < BOUNDS["tip_degrees"]
        assert entry.dynamic_tip_mm is not None
        assert entry.dynamic_tip_mm < BOUNDS["dynamic_tip_mm"]
    assert max(entry.rigid_guess_mm for entry in found) > 5.0  # there is something to compensate
    totals = summary(found, 1.0)
    assert totals["targets"] == 2
    assert totals["tip_mm"]["within_bound"] == 2
    assert totals["tip_mm"]["max"] == max(entry.tip_mm for entry in found)
