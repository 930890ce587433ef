"""A run that is interrupted and gone on with."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.interrupted import Command


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, made_up_build: Callable[..., Any], tmp_path: Path) -> Command:
    return Command(monkeypatch, made_up_build, tmp_path / "out")
