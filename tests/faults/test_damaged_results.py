"""A sample of damaged result folders: refused by an error of ours, or read with the same values."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from benchmarks.faults import damaged_results
from benchmarks.faults.damaged_results import outcome_of, try_damages


def test_damaged_results_are_refused_or_read_as_they_were(tmp_path: Path) -> None:
    results = try_damages(24, 5, tmp_path)
    assert [result for result in results if result[2].startswith("FAULT")] == []
    outcomes = [outcome for _, _, outcome in results]
    assert min(outcomes.count("refused"), outcomes.count("the same")) > len(results) / 6


def test_what_hangs_fails_or_differs_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails() -> bool:
        raise KeyError("phases")

    monkeypatch.setattr(damaged_results, "LONGEST_S", 0.05)
    assert outcome_of(fails).startswith("FAULT KeyError at test_damaged_results.py")
    assert outcome_of(lambda: bool(time.sleep(60.0))) == "FAULT hangs"
    assert outcome_of(lambda: False) == "FAULT other values"
    assert outcome_of(lambda: True) == "the same"
