"""The way of a pressure from a scenario's file to the nodes is as short as docs/architecture.md draws it."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, final

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import cosim
from cosim.build.simulation import build
from cosim.config.loading import load_scenario

PRESSURE_Pa = 31234.5  # nothing else is that large
MOST_FILES = 10
PACKAGE = Path(cosim.__file__).parent
PAGE = PACKAGE.parent / "docs" / "architecture.md"
SCENARIO = f"""
schema = 2
title = "a pressure"
robot = "none"
soft_robot = "square_core"
model.published = true
fidelity = "lumped"

[start]
flange.position_m = [0.0, 0.0, 0.5]
flange.direction = [0.0, 0.0, -1.0]

[[phase]]
name = "inflate"
duration_s = 0.004
settle_s = 0.004
pressure_Pa = {PRESSURE_Pa}
"""


def holds(value: Any) -> bool:
    """Whether a value is the pressure, or a list, tuple, table or array with it among its values."""
    if isinstance(value, float | np.floating):
        return bool(value == PRESSURE_Pa)
    if isinstance(value, dict):
        return any(type(item) is float and item == PRESSURE_Pa for item in value.values())
    if isinstance(value, list | tuple):
        return any(type(item) is float and item == PRESSURE_Pa for item in value)
    return isinstance(value, np.ndarray) and value.dtype == np.float64 and bool((value == PRESSURE_Pa).any())


@final
class Kernel:
    """Stands for a compiled kernel, and notes its file where it is handed the pressure."""

    def __init__(self, kernel: Any, note: Callable[[str], None]) -> None:
        self._kernel, self._note = kernel, note

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel, name)

    def __call__(self, *given: Any) -> Any:
        if any(map(holds, given)):
            self._note(inspect.getfile(self._kernel.py_func))
        return self._kernel(*given)


@pytest.fixture
def visited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> set[str]:
    """The files of the package that handle the pressure of a run."""
    file, found = tmp_path / "pressure.toml", set()
    file.write_text(SCENARIO, encoding="utf-8")

    def note(name: str) -> None:
        path = Path(name)
        if path.is_relative_to(PACKAGE):
            found.add(path.relative_to(PACKAGE).as_posix())

    def watch(frame: FrameType, event: str, result: Any) -> None:
        here: FrameType | None = frame
        if event in ("call", "return") and any(map(holds, (*frame.f_locals.values(), result))):
            while here is not None and here.f_code.co_filename == "<string>":  # a dataclass is made
                here = here.f_back
            note("" if here is None else here.f_code.co_filename)

    def run() -> None:
        for _ in build(load_scenario(file)).steps():
            pass

    run()  # compiles what it needs
    for module in [module for name, module in sys.modules.items() if name.startswith("cosim.")]:
        for name, value in list(vars(module).items()):
            if isinstance(value, Dispatcher):
                monkeypatch.setattr(module, name, Kernel(value, note))
    sys.setprofile(watch)
    try:
        run()
    finally:
        sys.setprofile(None)
    return found


def test_the_way_of_a_pressure_is_the_figure_and_at_most_ten_files(visited: set[str]) -> None:
    """The figure's files with a star are those that handle the number.

    A file handles it where one of its functions or kernels has it as an argument, a variable or a result:
    alone, or as a value of a list, tuple, table or array. Making an object of it counts, passing on an object
    that holds it does not. It is followed through a run of the lumped model without an arm, from the file to
    the last snapshot, and so also where it is only checked or shown. Libraries are not cosim's files.
    """
    text = PAGE.read_text(encoding="utf-8").partition("## The way of a pressure\n")[2].partition("\n## ")[0]
    drawn = re.findall(r"^ *\* (\S+\.py)", text, flags=re.MULTILINE)
    passing = re.findall(r"^ +(\S+\.py)", text, flags=re.MULTILINE)
    assert sorted(visited) == sorted(drawn), "\n".join(sorted(visited))
    assert len(visited) <= MOST_FILES
    assert passing
    assert all((PACKAGE / name).is_file() for name in passing)
