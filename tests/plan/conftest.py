"""The small arm of section models."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from cosim.build import section_models
from cosim.config.loading import load_scenario
from tests.small_section import on_a_ur5e, section


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what loads a scenario of the small arm; its model is not built again."""
    (tmp_path / "small.toml").write_text(on_a_ur5e(20e3, ""), encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(section_models, "build_model", lambda *_: section().model)
    return lambda *phases, **others: load_scenario(tmp_path / "small.toml", {"phase": list(phases), **others})
