"""What a user sees of 18 runs stays as recorded, far within any error bar."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.golden.comparison import read
from tests.golden.runs import RUNS, figures_of


@pytest.mark.parametrize("name", RUNS)
def test_figures_are_those_that_were_recorded(name: str, tmp_path: Path) -> None:
    off = [line for _, line in read(name).differences(figures_of(name, tmp_path))]
    assert not off, "\n".join(off)
