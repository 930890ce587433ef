"""A sample of damaged caches: a warning, and the same result as without."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.faults import damaged_caches
from cosim.build import soft_model


def test_damaged_caches_are_made_anew_with_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soft_model, "build_model", soft_model.build_model)  # put back at the end
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert damaged_caches.try_all(1, tmp_path, ways=40) == []
