"""What a user sees of 18 runs stays as recorded, far within any error bar; six of them whole, every week."""

from __future__ import annotations

import io
from pathlib import Path

import pytest

from cosim.base import state_file
from cosim.reduced.section_model import SectionModel
from tests.golden.comparison import read
from tests.golden.runs import SECTION_MODEL, SHORT, WHOLE, figures_of


@pytest.mark.parametrize("name", [*(pytest.param(name, marks=pytest.mark.long) for name in WHOLE), *SHORT])
def test_figures_are_those_that_were_recorded(name: str, tmp_path: Path) -> None:
    off = [line for _, line in read(name).differences(figures_of(name, tmp_path))]
    assert not off, "\n".join(off)


def test_the_section_model_of_these_runs_can_be_read() -> None:
    """Otherwise it is built again for each of them: a class of it has been renamed, see `record.py`."""
    (file,) = SECTION_MODEL.iterdir()
    _, _, data = file.read_bytes().partition(b"\n")
    assert isinstance(state_file.load(io.BytesIO(data)), SectionModel)
