"""What a user sees of 18 runs stays as recorded, far within any error bar; six of them whole, every week."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.golden.comparison import read
from tests.golden.runs import SHORT, WHOLE, figures_of


@pytest.mark.parametrize("name", [*(pytest.param(name, marks=pytest.mark.long) for name in WHOLE), *SHORT])
def test_figures_are_those_that_were_recorded(name: str, tmp_path: Path) -> None:
    off = [line for _, line in read(name).differences(figures_of(name, tmp_path))]
    assert not off, "\n".join(off)
