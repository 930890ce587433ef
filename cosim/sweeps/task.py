"""What travels to a worker and back: a design with its measures, and its row of figures.

Columns of one's own: a function of a run's result, named so that every worker finds it.

The figures of a run as a flat row: numbers of its summary by name, of its last phase without a prefix.
"""

from __future__ import annotations

import importlib.util
import inspect
import pickle
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import Any, Final, final

from cosim.config.schema.scenario import Scenario
from cosim.errors import InputError
from cosim.results.result import RunResult

Measure = Callable[[RunResult], Mapping[str, float]]
"""Returns more columns of a run, by names that end in their unit."""
_KINDS: Final = (int, float, bool)


@cache
def measure_named(name: str) -> Measure:
    """Return a function by its name.

    Args:
        name: "module:function" or "file.py:function".

    Raises:
        InputError: there is no such function.
    """
    place, _, function = name.rpartition(":")
    try:
        module = _of_file(Path(place)) if place.endswith(".py") else import_module(place)
    except Exception as error:  # whatever a module of someone's own raises
        raise InputError(
            f"measure = {name!r}: cannot be imported: {type(error).__name__}: {error}"
        ) from error
    found = getattr(module, function, None)
    if not callable(found):
        raise InputError(f"measure = {name!r}: {place} holds no function '{function}'")
    made: Measure = found
    return made


def check_travels(measure: Measure) -> None:
    """Check that a function can be sent to other processes.

    Raises:
        InputError: it is defined within another one, or is none that has a name.
    """
    try:
        pickle.dumps(measure)
    except Exception as error:  # pickle raises what it likes
        raise InputError(
            f"measure: cannot be sent to other processes: define it in a module, by its own name ({error})"
        ) from error


def measure_identity(measure: Measure) -> str:
    """Return a hash of the file that a function is in; of its name where there is none."""
    try:
        text = Path(inspect.getsourcefile(measure) or "").read_text(encoding="utf-8")
    except (OSError, TypeError):
        text = ""
    return sha256(f"{getattr(measure, '__qualname__', measure)}\n{text}".encode()).hexdigest()[:16]


def measured(measure: Measure, result: RunResult) -> dict[str, float]:
    """Return what a function says of a run.

    Raises:
        InputError: it returns something else than numbers by name.
    """
    found = measure(result)
    if not isinstance(found, Mapping):
        raise InputError(f"the measure returned a {type(found).__name__}; return numbers by name")
    columns = {}
    for name, value in found.items():
        plain: Any = value.item() if hasattr(value, "item") and getattr(value, "size", 0) == 1 else value
        if not isinstance(plain, _KINDS):
            raise InputError(f"the measure returned for {name} a {type(value).__name__}; return a number")
        columns[str(name)] = plain
    return columns


def _of_file(path: Path) -> Any:
    name = f"cosim_measure_{sha256(str(path.resolve()).encode()).hexdigest()[:8]}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is no Python file")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


LOST: Final = "lost"
"""Status of a design whose worker died."""


@final
@dataclass(frozen=True)
class Task:
    """A design to run, as it travels to a worker.

    Args:
        scenario: pickled, since its tables may be of kinds that `modules` make known.
        modules: to import first.
        measure: function of the result, or its name; None for none.
        directory: of the run's files; None keeps none.
    """

    scenario: bytes
    modules: tuple[str, ...] = ()
    measure: Measure | str | None = None
    directory: str | None = None

    @classmethod
    def of(cls, scenario: Scenario, **how: Any) -> Task:
        """Return the task of a checked scenario."""
        return cls(pickle.dumps(scenario), **how)


@final
@dataclass(frozen=True)
class Row:
    """What came out of a design.

    Args:
        status: "completed", "failed", "refused" (it cannot be built) or "lost" (its worker died).
        reason: why it is not completed.
        figures: numbers of the run, by name; up to where it failed.
        wall_s: wall time of the run, without what the first one of a process waits for.
        cpu_s: CPU time of the run, the same.
        worker: which process it was.
        files: digests of the files that building it read, by names; see `cosim.base.files`.
    """

    status: str
    reason: str | None = None
    figures: dict[str, Any] | None = None
    wall_s: float = 0.0
    cpu_s: float = 0.0
    worker: str = ""
    files: dict[str, str] = field(default_factory=dict)


PHASES: Final = "phases"
"""What names of the figures of every phase begin with."""
_OF_THE_CLOCK: Final = frozenset({"startup_s", "wall_s", "real_time_factor"})
"""What differs from one time to the next."""
_PASSED_OVER: Final = frozenset(
    {"schema", "phases", "arm", "modelled", "expected_error", "warnings", "resumed_at_ticks"}
)
_XYZ: Final = ("x", "y", "z")
_VECTORS: Final[dict[str, tuple[str, ...]]] = {
    "flange_position_m": _XYZ, "tip_position_m": _XYZ, "tip_direction": _XYZ, "tip_target_m": _XYZ,
    "force_N": _XYZ, "torque_Nm": _XYZ, "flange_quaternion": ("w", *_XYZ),
}  # fmt: skip
"""Lists whose entries have names; those of others are counted from 1."""


def figures_of(summary: Mapping[str, Any]) -> dict[str, float | int | bool]:
    """Return the numbers of a summary that do not depend on the clock on the wall.

    Args:
        summary: as in summary.json.

    Returns:
        by key: of the run; of its last phase; and of every phase, as phases.NAME.KEY. Vectors have a key for
        each component, such as tip_position_m.z; what is not a number is left out.
    """
    phases = summary["phases"]
    own = {key: value for key, value in summary.items() if key not in _OF_THE_CLOCK | _PASSED_OVER}
    tables = [own, *phases[-1:], {PHASES: {phase["name"]: phase for phase in phases}}]
    found: dict[str, float | int | bool] = {}
    for table in tables:
        _gather(found, table, "")
    return found


def _gather(found: dict[str, float | int | bool], value: Any, path: str) -> None:
    if isinstance(value, int | float):
        found.setdefault(path, value)
    elif isinstance(value, list):
        names = _VECTORS.get(path.rpartition(".")[2], tuple(map(str, range(1, len(value) + 1))))
        value = dict(zip(names, value, strict=True))
    if isinstance(value, Mapping):
        for key, item in value.items():
            _gather(found, item, f"{path}.{key}" if path else key)
