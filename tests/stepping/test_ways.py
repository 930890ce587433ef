"""The ways of a pressure, a contact force and a key are as short as docs/architecture.md draws them."""

from __future__ import annotations

import inspect
import re
import sys
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import FrameType
from typing import Any, final

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import cosim
from cosim.base.kernels import RecordStore
from cosim.build.simulation import build
from cosim.config.loading import load_scenario
from cosim.stepping import stepped_run
from tests.stepping.snapshots import python_takes_every_soft_half

PRESSURE_Pa = 31234.5  # nothing else is that large
MOST_FILES = 9
MOST_FILES_OF_A_FORCE = 7
MOST_FILES_OF_A_KEY = 5
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
    """Stands for a compiled kernel, and notes its file where it is given the number, or returns it."""

    def __init__(self, kernel: Any, note: Callable[[str], None], holds: Callable[[Any], bool]) -> None:
        self._kernel, self._note, self._holds = kernel, note, holds

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel, name)

    def __call__(self, *given: Any) -> Any:
        found = self._kernel(*given)
        if any(map(self._holds, (*given, found))):
            self._note(inspect.getfile(self._kernel.py_func))
        return found


def watching(note: Callable[[str], None], known: Callable[[Any], bool]) -> Callable[..., None]:
    """Return what notes the files of the functions that have a known value as a variable or a result."""

    def watch(frame: FrameType, event: str, result: Any) -> None:
        here: FrameType | None = frame
        if event in ("call", "return") and any(map(known, (*frame.f_locals.values(), result))):
            while here is not None and here.f_code.co_filename == "<string>":  # a dataclass is made
                here = here.f_back
            note("" if here is None else here.f_code.co_filename)

    return watch


def noted(
    found: set[str], run: Callable[[], object], known: Callable[[Any], bool], within: Callable[[Any], bool]
) -> None:
    """Add the files of the package that have a known value in a run; kernels, within what they are given."""

    def note(name: str) -> None:
        # what hands arguments to kernels does for all what the library's own dispatchers do for some
        if Path(name).is_relative_to(PACKAGE) and Path(name) != PACKAGE / "base" / "kernels.py":
            found.add(Path(name).relative_to(PACKAGE).as_posix())

    with pytest.MonkeyPatch.context() as patch:
        for module in [module for name, module in sys.modules.items() if name.startswith("cosim.")]:
            for name, value in list(vars(module).items()):
                if isinstance(value, Dispatcher):
                    patch.setattr(module, name, Kernel(value, note, within))
        sys.setprofile(watching(note, known))
        try:
            run()
        finally:
            sys.setprofile(None)


@pytest.fixture
def visited(tmp_path: Path) -> set[str]:
    """The files of the package that handle the pressure of a run."""
    file, found = tmp_path / "pressure.toml", set[str]()
    file.write_text(SCENARIO, encoding="utf-8")

    def run() -> None:
        for _ in build(load_scenario(file)).steps():
            pass

    run()  # compiles what it needs
    noted(found, run, holds, holds)
    return found


def test_the_way_of_a_pressure_is_the_figure_and_at_most_nine_files(visited: set[str]) -> None:
    """The figure's files with a star are those that handle the number.

    A file handles it where one of its functions or kernels has it as an argument, a variable or a result:
    alone, or as a value of a list, tuple, table or array. Making an object of it counts, passing on an object
    that holds it does not. It is followed through a run of the lumped model without an arm, from the file to
    the last snapshot, and so also where it is only checked or shown. Libraries are not cosim's files.
    """
    text = PAGE.read_text(encoding="utf-8").partition("## The way of a pressure\n")[2].partition("\n## ")[0]
    drawn = re.findall(r"^ *\* (\S+\.py)", text, flags=re.MULTILINE)
    passing = re.findall(r"^ +(\S+\.py)", text, flags=re.MULTILINE)
    assert sorted(visited) == sorted(drawn)
    assert len(visited) <= MOST_FILES
    assert passing
    assert all((PACKAGE / name).is_file() for name in passing)


FORCE_SCENARIO = """
schema = 2
title = "two units pressed on a loose plate"
robot = "ur5e"
soft_robot = { file = "hexagon_arm", stack = { units = 2 }, cable = [] }
fidelity = "lumped"
clock = { tick_s = 0.002 }

[start]
flange = { position_m = [0.4, 0.0, 0.5], direction = [0.0, 0.0, -1.0] }
pressure_Pa = 2e3

[[object]]
name = "block"
shape = "box"
size_m = [0.3, 0.3, 0.1]
position_m = [0.4, 0.0, 0.4175]

[[phase]]
name = "lower"
duration_s = 0.06
flange_shift_m = [0.0, 0.0, -0.02]
"""


def test_the_way_of_a_contact_force_is_the_figure_and_at_most_seven_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the film to MuJoCo, and what is shown of it, in ticks that kernels take and that Python finishes.

    A file handles it where one of its functions or kernels has the number as an argument, a variable or a
    result, in an array or alone. Kernels that are called by others are a part of these here.
    """
    file, found = tmp_path / "force.toml", set[str]()
    file.write_text(FORCE_SCENARIO, encoding="utf-8")
    begun = build(load_scenario(file))
    begun.advance(begun.stage.ticks - 5)
    state = begun.save_state()
    forces = np.abs([snapshot.body_contact_force for snapshot in begun.steps()][-3:])
    forces = forces[forces > 1e-3]
    assert len(forces), "the block is touched"

    def known(value: Any) -> bool:
        if isinstance(value, float | np.floating):
            return bool((forces == abs(value)).any())
        if isinstance(value, list | tuple):  # arrays of a named tuple: an object that holds it
            return any(type(item) is float and known(item) for item in value)
        if not isinstance(value, np.ndarray) or value.dtype != np.float64:
            return False
        return bool(np.isin(np.abs(value), forces).any())

    address, records = RecordStore.address, dict[int, Any]()

    def noted_address(store: RecordStore, record: Any) -> int:
        at = address(store, record)
        records[at] = record
        return at

    def within(value: Any) -> bool:
        if type(value) is int:  # the address of a record that a kernel reads
            value = records.get(value)
        return any(map(within, value)) if isinstance(value, tuple) else known(value)

    monkeypatch.setattr(RecordStore, "address", noted_address)
    # on a busy machine a row would be one tick, which receives no force within it
    monkeypatch.setattr(stepped_run, "_SHOWN_S", 1e3)
    for python in (False, True):
        with python_takes_every_soft_half() if python else nullcontext():
            here = build(load_scenario(file))
            here.advance(1)
            here.restore_state(state)
            noted(found, lambda run=here: list(run.batches()), known, within)  # type: ignore[misc]
    text = PAGE.read_text(encoding="utf-8").partition("## The way of a contact force\n")[2]
    assert sorted(found) == sorted(re.findall(r"^ *\* (\S+\.py)", text.partition("\n## ")[0], re.MULTILINE))
    assert len(found) <= MOST_FILES_OF_A_FORCE


KEY = 0.00123456


@pytest.mark.parametrize(
    ("place", "key"),
    [
        ("cable = []", f"cable = [], film.thickness_m = {KEY}"),
        # films that touch one another use it as well, by a way of their own
        ("clock = {", f"contact = {{ stick_m = {KEY}, self_contact = false }}\nclock = {{"),
        ("clock = {", f"solver.damping_per_s = {KEY}\nclock = {{"),
    ],
)
def test_the_way_of_a_key_is_at_most_five_files(place: str, key: str, tmp_path: Path) -> None:
    """From the scenario's file to where a number is used, in a run of the film on an arm with contact."""
    file, found = tmp_path / "key.toml", set[str]()
    file.write_text(FORCE_SCENARIO.replace(place, key, 1), encoding="utf-8")

    def known(value: Any) -> bool:
        values = (
            value.values() if type(value) is dict else value if isinstance(value, list | tuple) else (value,)
        )
        if any(isinstance(item, float) and item == KEY for item in values):
            return True
        return isinstance(value, np.ndarray) and value.dtype == np.float64 and bool((value == KEY).any())

    def within(value: Any) -> bool:
        return any(map(within, value)) if isinstance(value, tuple) else known(value)

    noted(found, lambda: build(load_scenario(file)).advance(2), known, within)
    assert {"config/toml/reading.py", "config/toml/parsing.py"} < found
    assert len(found) <= MOST_FILES_OF_A_KEY, sorted(found)
