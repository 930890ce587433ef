"""A sample of damaged caches: a warning, and the same result as without."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.faults import damaged_caches
from cosim.build import soft_model
from cosim.trade import measuring, report


def test_damaged_caches_are_made_anew_with_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name in ((soft_model, "build_model"), (report, "measure"), (measuring, "compile_for_trade")):
        monkeypatch.setattr(module, name, getattr(module, name))  # put back at the end
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert damaged_caches.try_all(1, tmp_path, ways=40) == []
